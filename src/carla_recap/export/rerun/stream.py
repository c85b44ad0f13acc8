"""A Rerun stream with the two timelines of a replay: `frame`, a sequence, and `sim_time`, a duration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol, Self

import numpy as np
import rerun as rr

from carla_recap.replay import quaternions, right_handed
from carla_recap.replay.pose import LOCATION

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.replay import Scene

FRAME: Final = "frame"
SIM_TIME: Final = "sim_time"

_TRANSLATION: Final = rr.Transform3D.descriptor_translation()
_ROTATION: Final = rr.Transform3D.descriptor_quaternion()

_NANOSECONDS: Final = 1e9
_LATEST: Final = 9e9  # s; what fits into 64 bits of nanoseconds
_LAST: Final = 2**63 - 1


class Moment(NamedTuple):
    """A point on both timelines: the number of a frame, and nanoseconds."""

    frame: int
    elapsed: int

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """That of a scene."""
        return cls(min(scene.frame_id, _LAST), round(min(_LATEST, max(0.0, scene.time)) * _NANOSECONDS))

    @property
    def seconds(self) -> float:
        """Elapsed seconds."""
        return self.elapsed / _NANOSECONDS


class Times(NamedTuple):
    """Points on both timelines, as columns."""

    frame: NDArray[np.int64]
    elapsed: NDArray[np.int64]

    @classmethod
    def of(cls, moments: Iterable[Moment]) -> Self:
        """Those of some moments."""
        table = np.array(list(moments), np.int64).reshape(-1, 2)
        return cls(table[:, 0], table[:, 1])

    @property
    def seconds(self) -> NDArray[np.float64]:
        """Elapsed seconds."""
        return self.elapsed / _NANOSECONDS

    def take(self, rows: NDArray[Any] | slice) -> Times:
        """Some of them."""
        return Times(self.frame[rows], self.elapsed[rows])


class Transforms(NamedTuple):
    """Right-handed transforms, as columns.

    Attributes:
        translations: x, y, z in m.
        rotations: Quaternions x, y, z, w.
    """

    translations: NDArray[np.float32]
    rotations: NDArray[np.float32]

    @classmethod
    def of(cls, poses: NDArray[np.float64]) -> Self:
        """Those of CARLA's poses, in cm and degrees, left-handed."""
        single = right_handed(poses).astype(np.float32)
        return cls(single[:, LOCATION], quaternions(single))

    def take(self, rows: slice) -> Transforms:
        """Some of them."""
        return Transforms(self.translations[rows], self.rotations[rows])


class Part(Protocol):
    """Writes a part of what a recording holds."""

    def enter(self, scene: Scene, moment: Moment) -> None:
        """Take a scene in."""

    def flush(self) -> None:
        """Write what is held back."""


class Stream:
    """Writes to a Rerun stream, by rows and by columns.

    Args:
        recording: Where to; its own clock is switched off.
    """

    def __init__(self, recording: rr.RecordingStream) -> None:
        self._recording = recording
        recording.set_log_time_enabled(False)

    def log(self, path: str, moment: Moment, *archetypes: rr.AsComponents) -> None:
        """Log at a moment."""
        self._recording.set_time(FRAME, sequence=moment.frame)
        self._recording.set_time(SIM_TIME, duration=np.timedelta64(moment.elapsed, "ns"))
        self._recording.log(path, *archetypes)

    def always(self, path: str, *archetypes: rr.AsComponents) -> None:
        """Log what holds at all times."""
        self._recording.log(path, *archetypes, static=True)

    def clear(self, path: str, moment: Moment) -> None:
        """Let an entity, and all below it, disappear."""
        self.log(path, moment, rr.Clear(recursive=True))

    def transforms(self, path: str, times: Times, transforms: Transforms) -> None:
        """Log many transforms at once; `rr.Transform3D.columns` takes ten times as long."""
        translations = rr.components.Translation3DBatch(transforms.translations)
        rotations = rr.components.RotationQuatBatch(transforms.rotations)
        self.columns(path, times, (rr.ComponentColumn(_TRANSLATION, translations), rr.ComponentColumn(_ROTATION, rotations)))

    def columns(self, path: str, times: Times, *columns: Iterable[rr.ComponentColumn]) -> None:
        """Log many rows at once, a column of times beside columns of components."""
        if not len(times.frame):  # of no rows, the viewer would wait for more
            return
        indexes = (
            rr.TimeColumn(FRAME, sequence=times.frame),
            rr.TimeColumn(SIM_TIME, duration=times.elapsed.view("timedelta64[ns]")),
        )
        self._recording.send_columns(path, indexes, [column for group in columns for column in group])


def screen(points: float) -> list[float]:
    """A radius in points of the screen instead of metres."""
    return [-points]  # so Rerun tells them apart
