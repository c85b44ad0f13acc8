"""Replay: a recording at any moment.

with carla_recap.open_recording("crash.log") as recording:
    for scene in Player(recording, start=20, duration=5).scenes(rate=30):
        print(scene.time, scene.ids, scene.poses)
"""

from __future__ import annotations

from carla_recap.replay.camera import calm_heading, calm_headings, chase, level, top
from carla_recap.replay.events import Collided, Destroyed, Event, Parented, Spawned
from carla_recap.replay.follow import Follow, choose_followed, find_followed
from carla_recap.replay.player import Played, Player
from carla_recap.replay.pose import quaternions, right_handed, right_handed_velocities
from carla_recap.replay.scene import Scene, SceneBatch

__all__ = [
    "Collided",
    "Destroyed",
    "Event",
    "Follow",
    "Parented",
    "Played",
    "Player",
    "Scene",
    "SceneBatch",
    "Spawned",
    "calm_heading",
    "calm_headings",
    "chase",
    "choose_followed",
    "find_followed",
    "level",
    "quaternions",
    "right_handed",
    "right_handed_velocities",
    "top",
]
