"""A Rerun stream with the timelines of a recording: `frame`, a sequence, and `sim_time`, a duration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun_bindings as bindings

from carla_recap.replay import quaternions, right_handed
from carla_recap.replay.pose import LOCATION

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from carla_recap.replay import SceneBatch

FRAME: Final = "frame"
SIM_TIME: Final = "sim_time"

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
    """Writes to a Rerun stream, by rows and by columns.

    Args:
        recording: The stream; its own clock is switched off.
    """

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._recording = recording
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

    def transforms(self, path: str, times: TimeColumns, poses: NDArray[np.float64]) -> None:
        """Log CARLA's poses, in cm and degrees, left-handed, as transforms."""
        self.tracks([(path, 0, len(poses))], times, poses)

    def tracks(self, tracks: Iterable[tuple[str, int, int]], times: TimeColumns, poses: NDArray[np.float64]) -> None:
        """Log CARLA's poses as the transforms of many entities.

        Args:
            tracks: The path of each entity, and its first row and the one after its last.
            times: The times of the rows.
            poses: The poses, in cm and degrees, left-handed.
        """
        single = right_handed(poses).astype(np.float32)
        indexes = _indexes(times)
        columns = {
            _TRANSLATION: rr.components.Translation3DBatch(single[:, LOCATION]).as_arrow_array(),
            _ROTATION: rr.components.RotationQuatBatch(quaternions(single)).as_arrow_array(),
        }
        for path, start, stop in tracks:  # slices, since to make arrays for each entity takes longer than to send them
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


def _indexes(times: TimeColumns) -> dict[str, pa.Array]:
    return {FRAME: pa.array(times.frame), SIM_TIME: pa.array(times.elapsed).view(pa.duration("ns"))}


def screen_radii(points: float) -> list[float]:
    """Return radii in points of the screen, which Rerun expects as negative numbers; positive ones are metres."""
    return [-points]
