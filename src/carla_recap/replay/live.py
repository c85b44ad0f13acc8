"""A recording that is still being made, as scenes: a scene for each frame that comes."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from carla_recap.model.records import UE4
from carla_recap.replay.motion import Motion
from carla_recap.replay.rows import Selection
from carla_recap.replay.scene import Scene
from carla_recap.replay.state import World

if TYPE_CHECKING:
    from carla_recap.model.frame import Frame


class LiveScenes:
    """Turns the frames of a recording into scenes, from the first one on."""

    def __init__(self) -> None:
        self._world = World(UE4, ignore_hero=False, ignore_spectator=True)
        self._motion = Motion()
        self._selections: defaultdict[str, Selection] = defaultdict(Selection)
        self._fresh = True

    def scene(self, frame: Frame) -> Scene:
        """The scene of the next frame."""
        world = self._world
        events = tuple(world.apply(frame))
        ids, poses = self._motion.at(frame, None, world.hidden, 0.0)
        fresh, self._fresh = self._fresh, False
        return Scene(
            frame.elapsed,
            frame,
            fresh,
            events,
            ids,
            poses,
            world.actors,
            world.light_states,
            world.doors,
            world.weather,
            world.scene_lights,
            world.hidden,
            self._selections,
        )
