"""How far the paths of matched actors part, and how long traffic lights differ, in one pass over two recordings.

Both recordings are read side by side, some frames at a time, on their elapsed times. Nothing is aligned or shifted.
"""

from __future__ import annotations

import builtins
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.kinematics import possible_step
from carla_recap.model.records import CM
from carla_recap.model.segment import Segment, SegmentBuffer, segments

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.lives import ActorLives
    from carla_recap.util.arrays import Booleans, Floats, Indices

    Ids = NDArray[np.integer[Any]]

_TYPES: Final = ("transforms", "light_states")
_FRAMES: Final = 1024  # that are handled at once
_RECORDS: Final = 1 << 18  # that are handled at once
_CELLS: Final = 1 << 20  # frames times actors that are compared at once
_ROUNDING: Final = 1e-9  # degrees; between angles that are whole turns apart
_REMEMBERED: Final = 4096  # lists of ids
_POSE: Final = ("x", "y", "z", "yaw")


class PathTotals:
    """What is known of the difference of each track: arrays with a value for each, (tracks,).

    A track is an actor of both recordings.

    Attributes:
        frames: The frames in which both were compared.
        poses: The poses of the track in each recording, (2, tracks).
        total, squares: The sums of the distances in m, and of their squares, where they are finite.
        finite: The number of these.
        largest: The largest distance in m; inf where one of the positions is no number.
        largest_at: Its time, in elapsed seconds.
        first_at: The first time at which the distance is beyond the tolerance; NaN if it never is.
        first: The distance at that time, in m.
        final: The distance in the last frame that was compared, in m.
        heading: The largest difference between the headings, in degrees.
        light_frames: The frames in which the states of a traffic light were compared.
        light_first_at: The first time at which the states differ; NaN if they never do.
        light_seconds: The seconds during which they differ.
    """

    def __init__(self, tracks: int) -> None:
        self.frames, self.finite, self.light_frames = np.zeros((3, tracks), np.int64)
        self.poses = np.zeros((2, tracks), np.int64)
        self.total, self.squares, self.largest, self.heading, self.light_seconds = np.zeros((5, tracks))
        self.largest_at, self.first_at, self.first, self.final, self.light_first_at = np.full((5, tracks), np.nan)

    def grow(self, tracks: int) -> None:
        """Make room for more tracks."""
        more = tracks - len(self.frames)
        if more > 0:
            new = PathTotals(max(more, len(self.frames)))
            for name, values in vars(self).items():
                setattr(self, name, np.concatenate((values, getattr(new, name)), axis=-1))


class PathComparison:
    """Compares the paths of two recordings.

    Args:
        sources: The two recordings.
        lives: The actors of each.
        tracks: The number of the track of each actor that is in both, by `id()` of its life.
        count: The number of tracks.
        tolerance: The distance in m beyond which paths differ.

    Attributes:
        totals: The differences, by track.
        unknown: The tracks of actors whose spawn was not recorded, by id; they follow those that were given.
        elapsed: The elapsed seconds of the frames of each recording.
    """

    def __init__(
        self,
        sources: tuple[Reader, Reader],
        lives: tuple[ActorLives, ActorLives],
        tracks: dict[int, int],
        count: int,
        tolerance: float,
    ) -> None:
        self.totals = PathTotals(count)
        self.unknown: dict[int, int] = {}
        self._count = count
        self._tolerance = tolerance
        self._streams = tuple(
            _FrameStream(source, _Tracks(each, tracks, self._unknown), self.totals, side)
            for side, (source, each) in enumerate(zip(sources, lives, strict=True))
        )

    @property
    def elapsed(self) -> tuple[Floats, Floats]:
        """See the class."""
        first, second = (np.concatenate([np.empty(0), *stream.elapsed]) for stream in self._streams)
        return first, second

    @np.errstate(all="ignore")
    def read(self) -> None:
        """Read and compare both recordings.

        Raises:
            FormatError: A file contradicts its format.
        """
        ours, theirs = self._streams
        while ours.read():
            start = 0
            while start < len(ours.clock):
                theirs.drop(int(np.searchsorted(theirs.clock, ours.clock[start], "right")) - 1)
                stop = len(ours.clock)
                if not theirs.exhausted:  # frames behind the last one of the other recording are compared later
                    stop = int(np.searchsorted(ours.clock, theirs.clock[-1], "right")) if len(theirs.clock) else 0
                if stop > start:
                    self._compare(start, stop)
                    start = stop
                else:
                    theirs.read()
            ours.drop(len(ours.clock))
        while theirs.read():  # to count its poses
            theirs.drop(len(theirs.clock))

    def _unknown(self, id: int) -> int:
        """Return the track of an actor whose spawn was not recorded."""
        track = self.unknown.get(id)
        if track is None:
            track = self.unknown[id] = self._count + len(self.unknown)
            self.totals.grow(track + 1)
        return track

    def _compare(self, start: int, stop: int) -> None:
        """Compare frames of the first recording with the frames of the other one around them."""
        ours, theirs = self._streams
        tracks = ours.segments["transforms"].ids(start, stop)
        if len(tracks) * (stop - start) > _CELLS and stop - start > 1:  # as if frames list other actors than those before
            middle = (start + stop) // 2
            self._compare(start, middle)
            self._compare(middle, stop)
            return
        if not len(theirs.clock):
            return
        pairing = _paired(ours.clock[start:stop], theirs.clock)
        rows = np.flatnonzero(pairing.valid)
        if len(rows):
            low, high = int(pairing.before[rows].min()), int(pairing.after[rows].max()) + 1
            pairing = pairing.moved(low)
            for tracks in self._tracks("transforms", start, stop, low, high):
                mine, present = ours.dense("transforms", _POSE, tracks, start, stop)
                other, known = _interpolated(pairing, *theirs.dense("transforms", _POSE, tracks, low, high))
                self._add_poses(tracks, ours.time[start:stop], mine, other, present & known)
            for tracks in self._tracks("light_states", start, stop, low, high):
                (state,), present = ours.dense("light_states", ("state",), tracks, start, stop)
                (others,), known = theirs.dense("light_states", ("state",), tracks, low, high)
                time, seconds = ours.time[start:stop], ours.seconds[start:stop]
                self._add_states(tracks, time, seconds, state, present, others, known, pairing)

    def _tracks(self, name: str, start: int, stop: int, low: int, high: int) -> Iterator[Ids]:
        """Yield the tracks that have records of a type in frames of both recordings, not too many to be compared at once."""
        ours, theirs = self._streams
        tracks = np.intersect1d(ours.segments[name].ids(start, stop), theirs.segments[name].ids(low, high))
        width = max(_CELLS // max(stop - start, high - low), 1)
        for first in range(0, len(tracks), width):
            yield tracks[first : first + width]

    def _add_poses(
        self,
        tracks: Ids,
        time: Floats,
        mine: NDArray[Any],
        theirs: NDArray[Any],
        present: Booleans,
    ) -> None:
        """Add poses of tracks in some frames, (4, frames, tracks), that are present in both recordings."""
        totals = self.totals
        same = (mine == theirs) | (np.isnan(mine) & np.isnan(theirs))
        totals.frames[tracks] += present.sum(axis=0)
        rows = len(time) - 1 - present[::-1].argmax(axis=0)  # the last ones
        compared = present.any(axis=0)
        if (same | ~present).all():
            totals.finite[tracks] += present.sum(axis=0)
            totals.final[tracks[compared]] = 0.0
            fresh = tracks[compared & np.isnan(totals.largest_at[tracks])]
            totals.largest_at[fresh] = time[present[:, np.isin(tracks, fresh)].argmax(axis=0)]
            return
        steps = np.where(same, 0.0, mine.astype(np.float64) - theirs)
        distance = np.sqrt((steps[:3] ** 2).sum(axis=0)) * CM
        turn = np.abs((steps[3] + 180.0) % 360.0 - 180.0)
        finite = present & np.isfinite(distance)
        totals.finite[tracks] += finite.sum(axis=0)
        known_distance = np.where(finite, distance, 0.0)
        totals.total[tracks] += known_distance.sum(axis=0)
        totals.squares[tracks] += (known_distance**2).sum(axis=0)
        distance = np.where(present, np.where(np.isfinite(distance), distance, np.inf), -np.inf)
        every = np.arange(len(tracks))
        totals.final[tracks[compared]] = distance[rows, every][compared]
        rows = distance.argmax(axis=0)
        largest = distance[rows, every]
        larger = compared & ~(largest <= np.where(np.isnan(totals.largest_at[tracks]), -np.inf, totals.largest[tracks]))
        totals.largest[tracks[larger]] = largest[larger]
        totals.largest_at[tracks[larger]] = time[rows][larger]
        beyond = distance > self._tolerance
        rows = beyond.argmax(axis=0)
        new = beyond.any(axis=0) & np.isnan(totals.first_at[tracks])
        totals.first_at[tracks[new]] = time[rows][new]
        totals.first[tracks[new]] = distance[rows, every][new]
        turn = np.where(present & np.isfinite(turn) & (turn > _ROUNDING), turn, 0.0).max(axis=0)
        totals.heading[tracks] = np.maximum(totals.heading[tracks], turn)

    def _add_states(
        self,
        tracks: Ids,
        time: Floats,
        seconds: Floats,
        mine: NDArray[Any],
        present: Booleans,
        other: NDArray[Any],
        known: Booleans,
        pairing: _Pairing,
    ) -> None:
        """Add states of traffic lights in some frames, and in those of the other recording, (frames, tracks)."""
        totals, before, after = self.totals, pairing.before, pairing.after
        present = present & known[before] & pairing.valid[:, None]
        totals.light_frames[tracks] += present.sum(axis=0)
        # Between two frames, a light may have either state.
        differs = present & (mine != other[before]) & ((mine != other[after]) | ~known[after])
        if differs.any():
            totals.light_seconds[tracks] += np.where(differs, seconds[:, None], 0.0).sum(axis=0)
            new = differs.any(axis=0) & np.isnan(totals.light_first_at[tracks])
            totals.light_first_at[tracks[new]] = time[differs.argmax(axis=0)][new]


@dataclass(frozen=True, eq=False)
class _Pairing:
    """Which frames of the other recording are around each frame, (frames,).

    Attributes:
        valid: Whether there are any.
        before, after: The last one before and the first one after it; both the same, where it has the same time.
        weight: The share of the latter.
        seconds: The time between the two.
    """

    valid: Booleans
    before: Indices
    after: Indices
    weight: Floats
    seconds: Floats

    def moved(self, first: int) -> _Pairing:
        """Return it for numbers of frames that begin later."""
        before, after = np.maximum(self.before - first, 0), np.maximum(self.after - first, 0)
        return _Pairing(self.valid, before, after, self.weight, self.seconds)


def _paired(clock: NDArray[np.complex128], others: NDArray[np.complex128]) -> _Pairing:
    """Return which of the other frames are around each frame, by their clocks; see `_FrameBlock`."""
    following = np.searchsorted(others, clock)
    after, before = np.minimum(following, len(others) - 1), np.maximum(following - 1, 0)
    later, earlier = others.real[after] - clock.real, clock.real - others.real[before]
    is_after = (others[after] == clock) | (np.abs(later) <= SAME_TIME)
    is_before = ~is_after & (np.abs(earlier) <= SAME_TIME)
    before, after = np.where(is_after, after, before), np.where(is_before, before, after)
    valid = is_after | is_before | ((following > 0) & (following < len(others)))
    seconds = others.real[after] - others.real[before]
    weight = np.where(before == after, 0.0, earlier / seconds)
    return _Pairing(valid, np.where(valid, before, 0), np.where(valid, after, 0), weight, seconds)


def _interpolated(pairing: _Pairing, poses: NDArray[Any], present: Booleans) -> tuple[NDArray[Any], Booleans]:
    """Return poses at the times of the frames of the other recording, (4, frames, tracks), and whether they are known."""
    before, after = pairing.before, pairing.after
    if (before == after).all():
        if len(before) == poses.shape[1] and (before == np.arange(len(before))).all():
            return poses, present & pairing.valid[:, None]
        return poses[:, before], present[before] & pairing.valid[:, None]
    first = poses[:, before].astype(np.float64)
    steps = poses[:, after] - first
    steps[3] = (steps[3] + 180.0) % 360.0 - 180.0
    far = possible_step(pairing.seconds)[:, None] / CM
    known = present[before] & present[after] & ~((steps[:3] ** 2).sum(axis=0) > far**2) & pairing.valid[:, None]
    between = (before != after)[:, None]
    return np.where(between, first + pairing.weight[:, None] * steps, first), known


# --- reading -------------------------------------------------------------------------------------------------------------


class _Tracks:
    """The tracks of the actors of a recording.

    Args:
        lives: The actors.
        tracks: The tracks by `id()` of the life; actors without a track are not compared.
        unknown: Returns the track of an id that no actor has.
    """

    def __init__(self, lives: ActorLives, tracks: dict[int, int], unknown: Callable[[int], int]) -> None:
        self._lives, self._tracks, self._unknown = lives, tracks, unknown
        reuses = lives.reuses()
        self.changes: Floats = np.unique([time for times in reuses.values() for time in times])
        self._reused = np.array(sorted(reuses), np.uint32)
        self._known: dict[bytes, Indices] = {}

    def of(self, ids: Ids, time: float) -> Indices:
        """Return the tracks of ids at a time; -1 for actors without one."""
        key = ids.tobytes()
        found = self._known.get(key)
        if found is None:
            found = np.array([self._track(id, time) for id in ids.tolist()], np.intp)
            if not len(self._reused) or not np.isin(ids, self._reused).any():
                if len(self._known) >= _REMEMBERED:
                    self._known.clear()
                self._known[key] = found
        return found

    def _track(self, id: int, time: float) -> int:
        life = self._lives.at(id, time)
        return self._unknown(id) if life is None else self._tracks.get(builtins.id(life), -1)


class _FrameStream:
    """The frames of a recording that are not compared yet.

    Args:
        source: The recording.
        tracks: The tracks of its actors.
        totals: Where the poses are counted.
        side: Which of the two recordings it is: 0 or 1.

    Attributes:
        elapsed: The elapsed seconds of all frames until now.
        exhausted: Whether all frames have been read.
        clock: A value for each frame, which always grows: the elapsed time, and the number of frames before with the same.
        time: The elapsed seconds of each.
        seconds: The seconds until the next one.
        segments: The records of tracks, by type.
    """

    def __init__(self, source: Reader, tracks: _Tracks, totals: PathTotals, side: int) -> None:
        self.elapsed: list[Floats] = []
        self.exhausted = False
        self.clock = np.zeros(0, np.complex128)
        self.time, self.seconds = np.zeros((2, 0))
        self.segments = {name: SegmentBuffer() for name in _TYPES}
        self._tracks, self._totals, self._side = tracks, totals, side
        self._portions = _portions(source)
        self._latest = 0.0  # the latest time of all frames until now
        self._repeats = 0  # the frames before with this time, the first one not counted

    def read(self) -> bool:
        """Read some more frames; return whether there are any."""
        batches = next(self._portions, None)
        if batches is None:
            self.exhausted = True
            return False
        time = np.concatenate([batch.elapsed for batch in batches])
        seconds = np.concatenate([batch.duration for batch in batches])
        seconds = np.where(np.isfinite(seconds), np.maximum(seconds, 0.0), 0.0)
        self.elapsed.append(time)
        self.clock = np.concatenate((self.clock, self._clock(time)))
        self.time, self.seconds = np.concatenate((self.time, time)), np.concatenate((self.seconds, seconds))
        for batch in batches:
            for name, buffer in self.segments.items():
                buffer.add(self._segments(batch, name), len(batch))
        return True

    def drop(self, count: int) -> None:
        """Drop the first frames."""
        if count > 0:
            self.clock, self.time, self.seconds = self.clock[count:], self.time[count:], self.seconds[count:]
            for buffer in self.segments.values():
                buffer.drop(count)

    def dense(self, name: str, fields: Sequence[str], tracks: Ids, start: int, stop: int) -> tuple[NDArray[Any], Booleans]:
        """Return fields of the records of tracks, (fields, frames, tracks), and where there are such records."""
        values, known = self.segments[name].dense(fields, tracks, start, stop)
        return np.ascontiguousarray(values.swapaxes(1, 2)), np.ascontiguousarray(known.T)

    def _clock(self, time: Floats) -> NDArray[np.complex128]:
        steady = np.fmax.accumulate(np.concatenate(([self._latest], np.nan_to_num(time, nan=-np.inf))))
        repeated = steady[1:] == steady[:-1]
        rows = np.arange(1, len(steady))
        fresh = np.maximum.accumulate(np.where(repeated, 0, rows))  # the row in which each time is new
        repeats = np.where(fresh == 0, self._repeats + rows, rows - fresh)
        clock = np.empty(len(time), np.complex128)
        clock.real, clock.imag = steady[1:], repeats
        self._latest, self._repeats = float(steady[-1]), int(repeats[-1])
        return clock

    def _segments(self, batch: Batch, name: str) -> Iterator[Segment]:
        """Yield the segments of a type, with tracks in place of ids."""
        passed = np.searchsorted(self._tracks.changes, batch.elapsed, "right")
        for segment in segments(batch.records(name), cuts=passed[1:] != passed[:-1]):
            tracks = self._tracks.of(segment.ids, float(batch.elapsed[segment.first]))
            found = replace(segment, ids=tracks).only(tracks >= 0)
            if name == "transforms":
                self._totals.poses[self._side, found.ids] += len(segment)
            yield found


def _portions(source: Reader) -> Iterator[list[Batch]]:
    """Yield the batches of a recording in lists of a limited number of frames and records."""
    portion: list[Batch] = []
    frames = count = 0
    for batch in source.batches(_TYPES):
        if batch.preamble:
            continue
        width = sum(batch.records(name).shape[1] for name in _TYPES)
        step = min(max(_RECORDS // max(width, 1), 1), _FRAMES)
        for start in range(0, len(batch), step):
            part = batch[start : start + step] if len(batch) > step else batch
            portion.append(part)
            frames, count = frames + len(part), count + len(part) * width
            if frames >= _FRAMES or count >= _RECORDS:
                yield portion
                portion, frames, count = [], 0, 0
    if portion:
        yield portion
