"""How far the paths of matched actors part, and how long traffic lights differ, in one pass over two recordings.

Both recordings are read side by side, some frames at a time, on their elapsed times. Nothing is aligned or shifted.
"""

from __future__ import annotations

import builtins
from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.records import CM

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.actors import ActorLives
    from carla_recap.model.batch import Batch

    Booleans = NDArray[np.bool_]
    Floats = NDArray[np.float64]
    Ids = NDArray[np.uint32]
    Indices = NDArray[np.intp]

_TYPES: Final = ("transforms", "light_states")
_FRAMES: Final = 1024  # that are handled at once
_RECORDS: Final = 1 << 18  # that are handled at once
_CELLS: Final = 1 << 20  # frames times actors that are compared at once
_JUMP: Final = 5.0  # m; a shorter step is no jump
_TOP_SPEED: Final = 100.0  # m/s; a faster step of more than that is a jump, between whose ends nothing is interpolated
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
        window: deque[_FrameBlock] = deque()
        exhausted = False
        for block in ours:
            start = 0
            while start < len(block.clock):
                while len(window) > 1 and window[1].clock[0] <= block.clock[start]:
                    window.popleft()
                stop = len(block.clock)
                if not exhausted:
                    until = window[-1].clock[-1:] if window else np.full(1, -np.inf + 0j)
                    stop = int(np.searchsorted(block.clock, until, "right")[0])
                if stop > start:
                    self._compare(block, start, stop, list(window))
                    start = stop
                    continue
                following = next(theirs, None)
                if following is None:
                    exhausted = True
                else:
                    window.append(following)
        for _ in theirs:  # to count its poses
            pass

    def _unknown(self, id: int) -> int:
        """Return the track of an actor whose spawn was not recorded."""
        track = self.unknown.get(id)
        if track is None:
            track = self.unknown[id] = self._count + len(self.unknown)
            self.totals.grow(track + 1)
        return track

    def _compare(self, block: _FrameBlock, start: int, stop: int, window: list[_FrameBlock]) -> None:
        """Compare frames of a block with the frames of the other recording around them."""
        if not window:
            return
        tracks = _Spans([block], start, stop).tracks("transforms")
        if len(tracks) * (stop - start) > _CELLS and stop - start > 1:  # as if frames list other actors than those before
            middle = (start + stop) // 2
            self._compare(block, start, middle, window)
            self._compare(block, middle, stop, window)
            return
        pairing = _paired(block.clock[start:stop], np.concatenate([other.clock for other in window]))
        rows = np.flatnonzero(pairing.valid)
        if len(rows):
            low, high = int(pairing.before[rows].min()), int(pairing.after[rows].max()) + 1
            pairing = pairing.moved(low)
            spans = _Spans(window, low, high)
            self._compare_poses(block, start, stop, pairing, spans)
            self._compare_lights(block, start, stop, pairing, spans)

    def _compare_poses(self, block: _FrameBlock, start: int, stop: int, pairing: _Pairing, spans: _Spans) -> None:
        ours = _Spans([block], start, stop)
        tracks = np.intersect1d(ours.tracks("transforms"), spans.tracks("transforms"))
        for columns in _parts(tracks, max(ours.count, spans.count)):
            mine, present = ours.dense("transforms", _POSE, columns)
            theirs, known = _interpolated(pairing, *spans.dense("transforms", _POSE, columns))
            self._add_poses(columns, block.time[start:stop], mine, theirs, present & known)

    def _add_poses(
        self,
        tracks: Indices,
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

    def _compare_lights(self, block: _FrameBlock, start: int, stop: int, pairing: _Pairing, spans: _Spans) -> None:
        ours = _Spans([block], start, stop)
        tracks = np.intersect1d(ours.tracks("light_states"), spans.tracks("light_states"))
        totals = self.totals
        before, after = pairing.before, pairing.after
        for columns in _parts(tracks, max(ours.count, spans.count)):
            (mine,), present = ours.dense("light_states", ("state",), columns)
            (other,), there = spans.dense("light_states", ("state",), columns)
            present &= there[before] & pairing.valid[:, None]
            totals.light_frames[columns] += present.sum(axis=0)
            # Between two frames, a light may have either state.
            differs = present & (mine != other[before]) & ((mine != other[after]) | ~there[after])
            if not differs.any():
                continue
            time, seconds = block.time[start:stop], block.seconds[start:stop]
            totals.light_seconds[columns] += np.where(differs, seconds[:, None], 0.0).sum(axis=0)
            new = differs.any(axis=0) & np.isnan(totals.light_first_at[columns])
            totals.light_first_at[columns[new]] = time[differs.argmax(axis=0)][new]


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
    far = np.maximum(_JUMP, _TOP_SPEED * pairing.seconds)[:, None] / CM
    known = present[before] & present[after] & ~((steps[:3] ** 2).sum(axis=0) > far**2) & pairing.valid[:, None]
    between = (before != after)[:, None]
    return np.where(between, first + pairing.weight[:, None] * steps, first), known


def _parts(tracks: Indices, frames: int) -> Iterator[Indices]:
    """Yield tracks in parts that are not too large to be compared at once."""
    width = max(_CELLS // frames, 1)
    for first in range(0, len(tracks), width):
        yield tracks[first : first + width]


# --- reading -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, slots=True)
class _TrackSegment:
    """Records of consecutive frames that list the same actors.

    Attributes:
        first: The number of the first frame in its block.
        records: The records, (frames, records of each).
        columns: The columns of the records of tracks.
        tracks: The tracks.
    """

    first: int
    records: NDArray[np.void]
    columns: Indices
    tracks: Indices


@dataclass(frozen=True, eq=False, slots=True)
class _FrameBlock:
    """Consecutive frames.

    Attributes:
        clock: A value for each frame, which always grows: the elapsed time, and the number of frames before with the same.
        time: The elapsed seconds of each.
        seconds: The seconds until the next one.
        segments: The records, by type.
    """

    clock: NDArray[np.complex128]
    time: Floats
    seconds: Floats
    segments: dict[str, list[_TrackSegment]]


class _Spans:
    """Some of the frames of consecutive blocks."""

    def __init__(self, blocks: list[_FrameBlock], start: int, stop: int) -> None:
        self._blocks, self._start, self._stop = blocks, start, stop

    @property
    def count(self) -> int:
        """The number of frames."""
        return self._stop - self._start

    def tracks(self, name: str) -> Indices:
        """Return the tracks that have records of a type, ascending."""
        found = {segment.tracks.tobytes(): segment.tracks for _, segment in self.segments(name)}
        return np.unique(np.concatenate([np.empty(0, np.intp), *found.values()]))

    def dense(self, name: str, fields: tuple[str, ...], tracks: Indices) -> tuple[NDArray[Any], Booleans]:
        """Return fields of the records of a type, (fields, frames, tracks), and where there are such records.

        Args:
            name: The type.
            fields: The fields.
            tracks: Tracks, ascending.
        """
        segments = list(self.segments(name))
        dtype = segments[0][1].records.dtype[fields[0]] if segments else np.dtype("f4")
        values = np.zeros((len(fields), self.count, len(tracks)), dtype)
        present = np.zeros((self.count, len(tracks)), np.bool_)
        for first, segment in segments:
            rows = slice(max(-first, 0), self.count - first)
            records = segment.records[rows]
            columns, chosen = segment.columns, np.searchsorted(tracks, segment.tracks)
            is_wanted = tracks[np.minimum(chosen, len(tracks) - 1)] == segment.tracks
            columns, chosen = columns[is_wanted], chosen[is_wanted]
            start = max(first, 0)
            for number, field in enumerate(fields):
                values[number, start : start + len(records), chosen] = records[field][:, columns].T
            present[start : start + len(records), chosen] = True
        return values, present

    def segments(self, name: str) -> Iterator[tuple[int, _TrackSegment]]:
        """Yield the segments of a type with the number of their first frame, which may be negative."""
        first = -self._start
        for block in self._blocks:
            if first < self.count and first + len(block.clock) > 0:
                for segment in block.segments[name]:
                    start = first + segment.first
                    if start < self.count and start + len(segment.records) > 0:
                        yield start, segment
            first += len(block.clock)


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
    """The frames of a recording, in blocks.

    Args:
        source: The recording.
        tracks: The tracks of its actors.
        totals: Where the poses are counted.
        side: Which of the two recordings it is: 0 or 1.

    Attributes:
        elapsed: The elapsed seconds of the frames until now.
    """

    def __init__(self, source: Reader, tracks: _Tracks, totals: PathTotals, side: int) -> None:
        self.elapsed: list[Floats] = []
        self._tracks, self._totals, self._side = tracks, totals, side
        self._portions = _portions(source)
        self._latest = 0.0  # the latest time of all frames until now
        self._repeats = 0  # the frames before with this time, the first one not counted

    def __iter__(self) -> Iterator[_FrameBlock]:
        return self

    def __next__(self) -> _FrameBlock:
        batches = next(self._portions)
        time = np.concatenate([batch.elapsed for batch in batches])
        self.elapsed.append(time)
        seconds = np.concatenate([batch.duration for batch in batches])
        seconds = np.where(np.isfinite(seconds), np.maximum(seconds, 0.0), 0.0)
        segments: dict[str, list[_TrackSegment]] = {name: [] for name in _TYPES}
        first = 0
        for batch in batches:
            for name in _TYPES:
                segments[name] += self._segments(batch, name, first)
            first += len(batch)
        return _FrameBlock(self._clock(time), time, seconds, segments)

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

    def _segments(self, batch: Batch, name: str, first: int) -> Iterator[_TrackSegment]:
        records = batch.records(name)
        if not records.shape[1]:
            return
        ids = np.ascontiguousarray(records["id"])
        cut = (ids[1:] != ids[:-1]).any(axis=1)
        if len(self._tracks.changes):
            passed = np.searchsorted(self._tracks.changes, batch.elapsed, "right")
            cut |= passed[1:] != passed[:-1]
        for start, stop in pairwise([0, *(np.flatnonzero(cut) + 1).tolist(), len(ids)]):
            tracks = self._tracks.of(ids[start], float(batch.elapsed[start]))
            columns = np.flatnonzero(tracks >= 0)
            tracks = tracks[columns]
            if name == "transforms":
                self._totals.poses[self._side, tracks] += stop - start
            yield _TrackSegment(first + start, records[start:stop], columns, tracks)


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
