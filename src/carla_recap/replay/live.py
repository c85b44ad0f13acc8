"""A recording that is still being made, as scenes: a scene for each frame that comes."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np

from carla_recap.model.batch import Batch
from carla_recap.model.records import UE4
from carla_recap.replay.motion import Motion
from carla_recap.replay.rows import Selection
from carla_recap.replay.scene import Scene, SceneBatch
from carla_recap.replay.state import ReplayState

if TYPE_CHECKING:
    from carla_recap.model.frame import Frame


class LiveScenes:
    """Turns the frames of a recording into scenes, from the first one on."""

    def __init__(self) -> None:
        self._state = ReplayState(UE4, ignore_hero=False, ignore_spectator=True)
        self._motion = Motion()
        self._selections: defaultdict[str, Selection] = defaultdict(Selection)
        self._fresh = True

    def scene(self, frame: Frame) -> Scene:
        """Return the scene of the next frame."""
        state = self._state
        events = tuple(state.apply(frame))
        ids, poses = self._motion.at(frame, None, state.hidden, 0.0)
        fresh, self._fresh = self._fresh, False
        batch = SceneBatch(
            np.array([frame.elapsed]),
            Batch.of(frame),
            fresh,
            events,
            ids,
            poses[None],
            state.actors,
            state.light_states[None],
            state.doors,
            state.weather,
            state.scene_lights,
            state.hidden,
            self._selections,
        )
        return Scene(batch)
