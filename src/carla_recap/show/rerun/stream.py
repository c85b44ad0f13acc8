"""A Rerun stream with the timelines of a recording, and what is written to it in blocks of frames: the poses of actors.

The timelines are `frame`, a sequence, and `sim_time`, a duration.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import groupby, pairwise
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun_bindings as bindings

from carla_recap.model.motion import possible_step
from carla_recap.replay import quaternions
from carla_recap.replay.pose import LOCATION
from carla_recap.replay.selection import NO_IDS
from carla_recap.show.rerun import entities

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.replay import SceneBatch
    from carla_recap.scene.description import SceneDescription
    from carla_recap.util.arrays import Booleans, Floats, Ids

    ColumnsOf = Callable[[Sequence[Any]], Iterable[rr.ComponentColumn]]


FRAME: Final = "frame"
SIM_TIME: Final = "sim_time"

ROWS: Final = 1024
"""The number of frames in a block, more or less."""

_MAX_POSES: Final = 1 << 19  # the number of poses in a block of many actors, more or less
_LARGEST_PIECE: Final = 1 << 20  # bytes of an entity's rows that are written together, more or less
_MAX_HELD: Final = 16 << 20  # bytes of all rows that are held back
_ROW: Final = _MAX_HELD >> 13  # bytes that a small row counts, with what Python needs for it
_TRANSLATION: Final = rr.Transform3D.descriptor_translation()
_ROTATION: Final = rr.Transform3D.descriptor_quaternion()

_NANOSECONDS: Final = 1e9
_MAX_SECONDS: Final = 9e9  # as nanoseconds they fit into 64 bits
_MAX_FRAME: Final = 2**63 - 1


class TimePoint(NamedTuple):
    """A point on both timelines: the number of a frame, and elapsed nanoseconds."""

    frame: int
    elapsed: int


class TimeColumns(NamedTuple):
    """Points on both timelines, as columns."""

    frame: NDArray[np.int64]
    elapsed: NDArray[np.int64]

    @classmethod
    def of(cls, batch: SceneBatch) -> Self:
        """Return those of the scenes of a batch."""
        elapsed = np.rint(np.fmin(_MAX_SECONDS, np.fmax(0.0, batch.time)) * _NANOSECONDS)
        return cls(np.minimum(batch.frames.id, np.uint64(_MAX_FRAME)).astype(np.int64), elapsed.astype(np.int64))

    @classmethod
    def of_points(cls, points: Iterable[TimePoint]) -> Self:
        """Return single points as columns."""
        table = np.array(list(points), np.int64).reshape(-1, 2)
        return cls(table[:, 0], table[:, 1])

    @classmethod
    def joined(cls, columns: Sequence[TimeColumns]) -> Self:
        """Return columns one after the other."""
        return cls(np.concatenate([each.frame for each in columns]), np.concatenate([each.elapsed for each in columns]))

    @property
    def seconds(self) -> NDArray[np.float64]:
        """Elapsed seconds."""
        return self.elapsed / _NANOSECONDS

    def point(self, row: int) -> TimePoint:
        """Return one of the points."""
        return TimePoint(int(self.frame[row]), int(self.elapsed[row]))

    def take(self, rows: NDArray[Any] | slice) -> TimeColumns:
        """Return some of the points."""
        return TimeColumns(self.frame[rows], self.elapsed[rows])


class Stream:
    """Writes to a Rerun stream, by rows and by columns."""

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._recording = recording
        self._held: defaultdict[tuple[str, ColumnsOf], list[tuple[TimePoint, Any]]] = defaultdict(list)
        self._sizes: defaultdict[tuple[str, ColumnsOf], int] = defaultdict(int)
        self._size = 0
        recording.set_log_time_enabled(False)

    def log(self, path: str, time: TimePoint, *archetypes: rr.AsComponents) -> None:
        """Log archetypes at a time."""
        self._recording.set_time(FRAME, sequence=time.frame)
        self._recording.set_time(SIM_TIME, duration=np.timedelta64(time.elapsed, "ns"))
        self._recording.log(path, *archetypes)

    def log_static(self, path: str, *archetypes: rr.AsComponents) -> None:
        """Log archetypes for all times."""
        self._recording.log(path, *archetypes, static=True)

    def clear(self, path: str, time: TimePoint) -> None:
        """Remove an entity and all below it."""
        self.log(path, time, rr.Clear(recursive=True))

    def trajectories(self, rows: Iterable[tuple[str, int, int]], times: TimeColumns, poses: Floats) -> None:
        """Log poses as the transforms of many entities.

        Each has a path, a first row and the one after its last; poses are in m and degrees, right-handed.
        """
        single = poses.astype(np.float32)
        indexes = {FRAME: pa.array(times.frame), SIM_TIME: pa.array(times.elapsed).view(pa.duration("ns"))}
        columns = {
            _TRANSLATION: rr.components.Translation3DBatch(single[:, LOCATION]).as_arrow_array(),
            _ROTATION: rr.components.RotationQuatBatch(quaternions(single)).as_arrow_array(),
        }
        for path, start, stop in rows:  # slices, since to make arrays for each entity takes longer than to send them
            bindings.send_arrow_chunk(
                path,
                timelines={name: column.slice(start, stop - start) for name, column in indexes.items()},
                components={name: column.slice(start, stop - start) for name, column in columns.items()},
                recording=self._recording.to_native(),
            )

    def columns(self, path: str, times: TimeColumns, *columns: Iterable[rr.ComponentColumn]) -> None:
        """Log many rows: columns of times and columns of components."""
        if not len(times.frame):  # the viewer would wait for rows that never come
            return
        indexes = [
            rr.TimeColumn(FRAME, sequence=times.frame),
            rr.TimeColumn(SIM_TIME, duration=times.elapsed.view("m8[ns]")),
        ]
        self._recording.send_columns(path, indexes, [column for group in columns for column in group])

    def hold(self, path: str, columns: ColumnsOf, time: TimePoint, value: Any, size: int = _ROW) -> None:
        """Log a row of an entity later, together with others: when there are many, or when `flush` is called.

        `columns` returns the components of rows, given their values; the size of a value is in bytes.
        """
        entity = path, columns
        self._held[entity].append((time, value))
        self._sizes[entity] += size
        self._size += size
        if self._sizes[entity] >= _LARGEST_PIECE:
            self._write_held(entity)
        elif self._size >= _MAX_HELD:
            self.flush()

    def flush(self) -> None:
        """Log all rows that are held back."""
        for entity in list(self._held):
            self._write_held(entity)

    def _write_held(self, entity: tuple[str, ColumnsOf]) -> None:
        (path, columns), rows = entity, self._held.pop(entity)
        self._size -= self._sizes.pop(entity)
        self.columns(path, TimeColumns.of_points(time for time, _ in rows), columns([value for _, value in rows]))


def screen_radii(points: float) -> list[float]:
    """Return radii in points of the screen, which Rerun expects as negative numbers; positive ones are metres."""
    return [-points]


def map_points(locations: Floats) -> Floats:
    """Return where locations in m, right-handed, (…, 3), are on the map, whose y points downwards as CARLA's, (…, 2)."""
    return np.asarray(locations[..., :2] * (1, -1))


@dataclass(frozen=True)
class PoseBlock:
    """The poses of consecutive frames: the first axis of arrays is the frames, the second one the actors.

    Row 0 is the last frame of the block before; in the first block, no actor is present in it.
    """

    times: TimeColumns  # the times of the frames
    ids: Ids  # the actors, ascending
    poses: Floats  # x, y, z in m and roll, pitch, yaw in degrees, right-handed
    present: Booleans  # whether an actor is somewhere to be seen
    written: Booleans  # whether a pose has to be written: it differs from the one before, or the next one differs from it

    @cached_property
    def joined(self) -> Booleans:
        """Whether an actor gets from each pose to the next one without a jump, (frames - 1, ids)."""
        steps = np.linalg.norm(np.diff(self.poses[..., :2], axis=0), axis=2)
        possible = possible_step(np.diff(self.times.seconds))[:, None]
        return np.asarray(self.present[1:] & self.present[:-1] & (steps <= possible))

    @property
    def credible(self) -> Booleans:
        """Whether an actor is present and gets there or from there without a jump, or is there only once, (frames, ids)."""
        nowhere = np.zeros((1, len(self.ids)), np.bool_)
        joined = np.concatenate((nowhere, self.joined)) | np.concatenate((self.joined, nowhere))
        return np.asarray(joined | (self.present & (self.present.sum(axis=0) == 1)))

    def write(self, stream: Stream, shown: Container[int], parent: str = entities.ACTORS) -> None:
        """Write the transforms of the actors that are shown, at their ids below a path."""
        actors, rows = np.nonzero(self.written.T)
        ends = np.searchsorted(actors, np.arange(len(self.ids) + 1)).tolist()
        rows_of = (
            (f"{parent}/{id}", start, end)
            for id, (start, end) in zip(self.ids.tolist(), pairwise(ends), strict=True)
            if start < end and id in shown
        )
        stream.trajectories(rows_of, self.times.take(rows), self.poses[rows, actors])

    def write_points(
        self, stream: Stream, path: str, shown: Iterable[int], colors: Mapping[int, int] | None = None
    ) -> Floats:
        """Write the actors that are shown as points on the map, in their colours by id; return the credible ones, (n, 2)."""
        present = self.present[1:] & np.isin(self.ids, list(shown))
        points = map_points(self.poses[1:][present])
        painted = None
        if colors is not None:
            color_of = np.array([colors.get(id, 0) for id in self.ids.tolist()], np.uint32)
            painted = np.broadcast_to(color_of, present.shape)[present]
        columns = rr.Points2D.columns(positions=points.astype(np.float32), colors=painted)
        counts = present.sum(axis=1)
        times = self.times.take(slice(1, None))
        stream.columns(path, times, [each.partition(counts) for each in columns])
        return np.asarray(points[self.credible[1:][present]])


class PoseBuffer:
    """Gathers the recorded poses of scenes into blocks."""

    def __init__(self) -> None:
        self._times: list[TimeColumns] = []
        self._pieces: list[tuple[Ids, Floats, Booleans]] = []
        self._spawned: list[tuple[int, int]] = []  # row, id
        self._rows = self._count = 0
        self._before: PoseBlock | None = None

    @property
    def is_full(self) -> bool:
        """Whether it is time to take a block."""
        return self._rows >= ROWS or self._count >= _MAX_POSES

    def add(self, description: SceneDescription, times: TimeColumns, spawned: Iterable[int]) -> None:
        """Add scenes.

        `spawned` are the ids that belong to new actors from the first scene on.
        """
        self._spawned += [(self._rows, id) for id in spawned]
        self._times.append(times)
        self._pieces.append((description.batch.ids, description.recorded_poses, description.recorded_shown))
        self._rows += len(description)
        self._count += description.recorded_shown.size

    def take(self) -> PoseBlock | None:
        """Return the block of the scenes since the last one; None if there are none."""
        if not self._rows:
            return None
        before = self._before
        first = before.times.take(slice(-1, None)) if before else self._times[0].take(slice(1))
        ids, poses, present, was_written = self._joined()
        different = reduce(np.logical_or, np.moveaxis(poses[1:] != poses[:-1], -1, 0))
        changed = present[1:] & (~present[:-1] | different)
        if self._spawned and len(ids):
            spawned = np.array(self._spawned)
            rows, those = spawned[np.isin(spawned[:, 1], ids)].T
            where = np.searchsorted(ids, those)
            changed[rows, where] |= present[rows + 1, where]
        written = np.zeros_like(present)
        written[1:] = changed
        written[:-1] |= changed & present[:-1]
        written[0] &= ~was_written
        block = self._before = PoseBlock(TimeColumns.joined([first, *self._times]), ids, poses, present, written)
        self._times, self._pieces, self._spawned, self._rows, self._count = [], [], [], 0, 0
        return block

    def _joined(self) -> tuple[Ids, Floats, Booleans, Booleans]:
        """Return the ids, poses and presence of a block, and whether the poses of row 0 have been written."""
        before = self._before
        held = before.ids[before.present[-1]] if before else NO_IDS
        runs = [list(run) for _, run in groupby(self._pieces, key=lambda piece: id(piece[0]))]
        ids = np.unique(np.concatenate([held, *(run[0][0] for run in runs)]))
        poses = np.zeros((self._rows + 1, len(ids), 6))
        present, was_written = np.zeros(poses.shape[:2], np.bool_), np.ones(len(ids), np.bool_)
        if before:
            where, last = np.searchsorted(ids, held), before.present[-1]
            poses[0, where], present[0, where], was_written[where] = before.poses[-1, last], True, before.written[-1, last]
        row = 1
        for run in runs:
            those = run[0][0]
            columns: slice | NDArray[np.intp] = slice(None) if len(those) == len(ids) else np.searchsorted(ids, those)
            for _, piece, shown in run:
                rows = slice(row, row + len(piece))
                poses[rows, columns], present[rows, columns] = piece, shown
                row += len(piece)
        return ids, poses, present, was_written
