"""A position in a recording: the frame at a time, the next one, and the state after all frames so far."""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.segment import segments
from carla_recap.replay.events import Collided, Event, Parented, Spawned
from carla_recap.replay.state import EVENTS, ReplayState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Frame

_NUMBERS: Final = ("transforms", "light_states", "vehicle_controls", "walker_controls", "vehicle_lights", "velocities")
_LOOK_BACK: Final = 10.0  # s; the time before a frame in which what it lacks is searched first
_WIDER: Final = 4.0  # the factor by which it grows
_NEAR: Final = 10.0  # s; the time up to which reading on is no slower than seeking
_MAX_FRAMES: Final = 1024


class Cursor:
    """Reads forward, one frame ahead, and seeks by the recording's index.

    Attributes:
        frame: The frame before `next`; before the first frame, the first.
        next: The first frame later than `SAME_TIME` after the time; None after the last one.
        time: The elapsed seconds of `frame`, or of an earlier frame, if the clock has gone back.
        behind: How many frames have been read whose clock was behind `time`.
        state: The state after all frames until `frame`.
        events: The events that were not taken yet.
        observer: Is called with each batch that is read.
    """

    frame: Frame
    next: Frame | None

    def __init__(self, reader: Reader, new_state: Callable[[], ReplayState]) -> None:
        self._reader = reader
        self._new_state = new_state
        self._batches: Iterator[Batch] = iter(())
        self._opened = False
        self._batch: Batch | None = None  # that of `next`
        self._row = 0  # of `next` in its batch
        self._ahead: Batch | None = None  # the batch after it, if it has been read
        self._ends: list[int] | None = None  # of the segments of the batch: rows, ascending
        self.time = -math.inf
        self.behind = 0
        self.state = new_state()
        self.events: list[Event] = []
        self._frame_events: list[Event] = []
        # By type and life, the record that was the latest one before a time, if there was any.
        self._known: dict[tuple[str, int, float], tuple[float, NDArray[np.void] | None]] = {}
        self.observer: Callable[[Batch], object] | None = None

    def advance(self, time: float) -> None:
        """Read on until some elapsed seconds."""
        while self.next is not None and not self.next.elapsed > time + SAME_TIME:
            self._enter(self.next)

    def advance_batch(self, time: float, stop: float) -> tuple[Batch, dict[str, NDArray[np.void]]] | None:
        """Read on over frames without events that have the same ids, and are more than `SAME_TIME` apart.

        Args:
            time: The current elapsed time, in seconds.
            stop: The elapsed time at which to stop (exclusive), in seconds.

        Returns:
            The frames, and what `ReplayState.apply_batch` returns; None if the next frame has to be read by `advance`.
        """
        batch, start = self._batch, self._row
        if batch is None or len(batch) - start < 2 or any(c.type and c.type.name in EVENTS for c in batch.columns):
            return None
        times = batch.elapsed[start : start + _MAX_FRAMES]
        if not np.all(np.diff(times, prepend=time) > SAME_TIME) or not times[-1] < math.inf:
            return None
        if self._ends is None:
            self._ends = sorted({each.frames.stop for name in _NUMBERS for each in segments(batch.records(name))})
        end = min(start + int(np.searchsorted(times, stop)), start + len(times), self._ends[bisect_right(self._ends, start)])
        if end == len(batch):
            self._ahead = self._ahead or next(self._batches, None)
            if self._ahead is not None and not self._ahead.elapsed[0] > batch.elapsed[-1] + SAME_TIME:
                end -= 1
        if end <= start:
            return None
        frames = batch if end - start == len(batch) else batch[start:end]
        latest = self.state.apply_batch(frames)
        self.frame, self._frame_events = frames.frame(-1), []
        self.time = self.frame.elapsed
        self._row = end
        self._read_next()
        return frames, latest

    def seek(self, time: float) -> None:
        """Go to some elapsed seconds; the events are then those that build up the state from nothing.

        Raises:
            RecapError: The recording has no frames.
        """
        if not self._opened or not -SAME_TIME <= time - self.time < _NEAR:
            self._jump(time)
        self.advance(time)
        actors = self.state.actors.values()
        self.events = [Spawned(actor.spawned_at, actor) for actor in actors]
        self.events += [Parented(actor.spawned_at, actor.id, actor.parent) for actor in actors if actor.parent is not None]
        self.events += [event for event in self._frame_events if isinstance(event, Collided)]

    def go_to(self, frame: Frame) -> None:
        """Go to a frame of the recording."""
        self._jump(frame.elapsed)
        while self.next is not None and self.next.index <= frame.index:
            self._enter(self.next)

    def take_events(self) -> tuple[Event, ...]:
        """Return the events since the last call."""
        events, self.events = tuple(self.events), []
        return events

    def _enter(self, frame: Frame) -> None:
        """Make `next` the current frame."""
        self.frame = frame
        self.behind += frame.elapsed < self.time - SAME_TIME
        self.time = max(self.time, frame.elapsed)
        self._frame_events = self.state.apply(frame)
        self.events += self._frame_events
        self._row += 1
        self._read_next()

    def _read_next(self) -> None:
        if self._batch is None or self._row >= len(self._batch):
            self._batch, self._ahead = self._ahead or next(self._batches, None), None
            self._row, self._ends = 0, None
        self.next = None if self._batch is None else self._batch.frame(self._row)

    def _read_batches(self, start: float) -> Iterator[Batch]:
        for batch in self._reader.batches((*EVENTS, *_NUMBERS), start=start):
            if self.observer is not None:
                self.observer(batch)
            yield batch

    def _jump(self, time: float) -> None:
        found = self._reader.frame_at(time)
        if found is not None and math.isnan(found.elapsed):
            found = None
        start, since = -math.inf if found is None else found.elapsed, -math.inf
        if self._opened and self.next is not None and self.frame.elapsed + 2 * SAME_TIME < self.next.elapsed < start:
            since = self.next.elapsed  # the state is built up on from the current frame
        else:
            self.state, self.time = self._new_state(), -math.inf
        if found is not None:
            for frame in self._reader.frames(EVENTS, sparse=True, start=since, stop=start):
                self.state.apply(frame)
            for name in self.state.latest:
                self._recall(name, found)
        self._batches, self._opened = self._read_batches(start), True
        self._batch = self._ahead = None
        self._read_next()
        if self.next is None:
            raise RecapError(f"{self._reader.location}: the recording has no frames")
        self._enter(self.next)

    def _recall(self, name: str, found: Frame) -> None:
        """Search earlier frames for the records of a type that a frame lacks; most recordings have all in each."""
        actors, now = self.state.actors, found.elapsed
        missing = set(self.state.lasting(name).tolist()) - set(found[name]["id"].tolist())
        since: dict[int, float] = {}
        recalled: dict[int, NDArray[np.void] | None] = {}
        for id in missing:
            spawned = actors[id].spawned_at
            since[id], recalled[id] = self._known.get((name, id, spawned), (spawned, None))
            if not math.isfinite(spawned) or (recalled[id] is not None and since[id] > now):
                since[id], recalled[id] = spawned if math.isfinite(spawned) else -math.inf, None
        stop, width = now, _LOOK_BACK
        while missing := {id for id in missing if since[id] < stop}:
            earliest = min(since[id] for id in missing)
            start = max(stop - width, earliest) if math.isfinite(stop) and earliest > -math.inf else -math.inf
            last = self._last_records(name, missing, start, stop)
            recalled |= last
            missing -= last.keys()
            stop, width = start, width * _WIDER
        for id, record in recalled.items():
            if since[id] <= now:
                self._known[name, id, actors[id].spawned_at] = now, record
        kept = [record for record in recalled.values() if record is not None]
        if kept:
            self.state.latest[name].recall(np.concatenate(kept))

    def _last_records(self, name: str, ids: set[int], start: float, stop: float) -> dict[int, NDArray[np.void] | None]:
        """Return the last records of some ids in a part of the recording; None for one that is spawned after its last."""
        last: dict[int, NDArray[np.void] | None] = {}
        wanted = np.array(list(ids), np.uint32)
        for batch in self._reader.batches((name, "spawned"), start=start, stop=stop):
            is_spawning = any(column.type is not None and column.type.name == "spawned" for column in batch.columns)
            for part in (batch[row : row + 1] for row in range(len(batch))) if is_spawning else (batch,):
                if is_spawning:
                    last |= {spawn.id: None for spawn in part.frame(0)["spawned"] if spawn.id in ids}
                for segment in segments(part.records(name)):
                    for row in np.flatnonzero(np.isin(segment.ids, wanted)).tolist():
                        last[segment.ids.item(row)] = segment.records[-1, row : row + 1].copy()
        return last
