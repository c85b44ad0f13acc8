"""A place in a recording: the frame at a time, the next one, and the world that all frames so far have left behind."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.frame import SAME_TIME
from carla_recap.replay.events import Collided, Event, Parented, Spawned
from carla_recap.replay.rows import array
from carla_recap.replay.state import EVENTS, World

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.frame import Frame

TYPES: Final = (
    *EVENTS,
    "transforms",
    "light_states",
    "vehicle_controls",
    "walker_controls",
    "vehicle_lights",
    "velocities",
)
"""The record types that a replay reads."""

_LOOK_BACK: Final = 10.0  # s; how far back light states are looked for at first
_WIDER: Final = 4.0
_NEAR: Final = 10.0  # s; so far ahead it is no slower to read on than to seek


class Cursor:
    """Reads forward, one frame ahead, and seeks by the recording's index.

    Args:
        reader: The recording.
        new_world: Makes a world in which nothing has happened.

    Attributes:
        frame: The last frame at or before the time, or within `SAME_TIME` of it; before the first frame, the first.
        next: The frame behind it; None behind the last one.
        world: What all frames until `frame` have left behind.
        events: What happened since they were last taken.
    """

    frame: Frame
    next: Frame | None

    def __init__(self, reader: Reader, new_world: Callable[[], World]) -> None:
        self._reader = reader
        self._new_world = new_world
        self._stream: Iterator[Frame] | None = None
        self.world = new_world()
        self.events: list[Event] = []
        self._entered: list[Event] = []  # by the frame

    def advance(self, time: float) -> None:
        """Read on until some elapsed seconds."""
        while self.next is not None and not self.next.elapsed > time + SAME_TIME:
            self._enter(self.next)

    def seek(self, time: float) -> None:
        """Go to some elapsed seconds; the events are then those that make the world there out of nothing.

        Raises:
            RecapError: The recording has no frames.
        """
        if self._stream is None or not -SAME_TIME <= time - self.frame.elapsed < _NEAR:
            self._jump(time)
        self.advance(time)
        actors = self.world.actors.values()
        self.events = [Spawned(actor.since, actor) for actor in actors]
        self.events += [Parented(actor.since, actor.id, actor.parent) for actor in actors if actor.parent is not None]
        self.events += [event for event in self._entered if isinstance(event, Collided)]

    def take_events(self) -> tuple[Event, ...]:
        """What happened since this was last asked."""
        events, self.events = tuple(self.events), []
        return events

    def _enter(self, frame: Frame) -> None:
        assert self._stream is not None
        self.frame = frame
        self._entered = self.world.apply(frame)
        self.events += self._entered
        self.next = next(self._stream, None)

    def _jump(self, time: float) -> None:
        found = self._reader.frame_at(time)
        start = -math.inf if found is None else found.elapsed
        self.world = self._new_world()
        if found is not None:
            for frame in self._reader.frames(EVENTS, sparse=True, stop=start):
                self.world.apply(frame)
            self._recall_lights(found)
        self._stream = self._reader.frames(TYPES, start=start)
        first = next(self._stream, None)
        if first is None:
            raise RecapError(f"{self._reader.path}: the recording has no frames")
        self._enter(first)

    def _recall_lights(self, found: Frame) -> None:
        """Look back for the states of traffic lights that a frame does not tell; most recordings have all in each."""
        actors = self.world.actors
        missing = set(self.world.lights.tolist()) - set(array(found["light_states"])["id"].tolist())
        stop, width = found.elapsed, _LOOK_BACK
        recalled: list[NDArray[np.void]] = []
        while missing and stop > (earliest := min(actors[id].since for id in missing)):
            start = max(stop - width, earliest)
            states = self._light_states(start, stop, {id: actors[id].since for id in missing})
            missing -= states.keys()
            recalled += states.values()
            stop, width = start, width * _WIDER
        if recalled:
            self.world.recall_lights(np.concatenate(recalled))

    def _light_states(self, start: float, stop: float, since: dict[int, float]) -> dict[int, NDArray[np.void]]:
        """The latest states within a time of the lights that are there since some time."""
        states: dict[int, NDArray[np.void]] = {}
        for frame in self._reader.frames(("light_states",), start=start, stop=stop):
            records = array(frame["light_states"])
            for place, id in enumerate(records["id"].tolist()):
                if id in since and frame.elapsed >= since[id]:
                    states[id] = records[place : place + 1]
        return states
