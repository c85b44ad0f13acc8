"""The followed actor: the axes of its camera, its trail, and the ground below it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import pyarrow as pa
import rerun as rr

from carla_recap.model.blueprints import box_of
from carla_recap.replay import right_handed
from carla_recap.replay.pose import LOCATION
from carla_recap.scene import style
from carla_recap.scene.follow import CalmPath, FollowedSeries
from carla_recap.scene.opacity import SteppedOpacity
from carla_recap.show.rerun import paths
from carla_recap.show.rerun.eyes import LOOK_DOWN, chase_eye
from carla_recap.show.rerun.ground import ground_below
from carla_recap.show.rerun.meshes import faded
from carla_recap.show.rerun.plots import PlotWriter
from carla_recap.show.rerun.poses import ROWS
from carla_recap.show.rerun.stream import TimeColumns, screen_radii

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from carla_recap.replay import SceneBatch
    from carla_recap.scene.appearance import Look
    from carla_recap.show.rerun.stream import Stream, TimePoint

    Floats = NDArray[np.float64]

_TRAIL: Final = 0.04  # m; the radius of the trail
_RADIUS: Final = 6.0  # points of the screen; of the actor on the map


class CameraAxes:
    """Writes level axes that follow an actor and turn calmly; a camera is fixed in them.

    Args:
        stream: The stream.
        path: The path of the entity.
    """

    def __init__(self, stream: Stream, path: str) -> None:
        self._stream = stream
        self._path = path
        self._axes = CalmPath()
        self._last = np.full((1, 6), np.nan)

    def write(self, times: TimeColumns, poses: Floats) -> None:
        """Write the axes in the next frames, given the poses of the actor, in cm and degrees; NaN without one."""
        self.write_axes(times, self._axes.add(times.seconds, poses).camera)

    def write_axes(self, times: TimeColumns, axes: Floats) -> None:
        """Write the axes in the next frames, (frames, 6); NaN before the actor appears."""
        known = np.flatnonzero(np.isfinite(axes).all(axis=1))
        axes = axes[known]
        changed = np.flatnonzero((np.diff(axes, axis=0, prepend=self._last) != 0).any(axis=1))
        if len(changed):
            self._stream.transforms(self._path, times.take(known[changed]), axes[changed])
            self._last = axes[-1:]


class OpacityWriter:
    """Writes which actors are see-through for the camera behind the followed one.

    Args:
        stream: The stream.
        id: The followed actor.
        looks: The looks of the present actors by id.
    """

    def __init__(self, stream: Stream, id: int, looks: Mapping[int, Look]) -> None:
        self._stream = stream
        self._id = id
        self._looks = looks
        self._opacity = SteppedOpacity(id, looks)

    def write(self, batch: SceneBatch, times: TimeColumns, series: FollowedSeries) -> None:
        """Write scenes."""
        look = self._looks.get(self._id)
        eye = chase_eye(None if look is None else look.half_extents)
        for row, id, opacity in self._opacity.changes(batch, series, eye, LOOK_DOWN):
            self._stream.log(paths.actor(id), times.point(row), rr.Mesh3D.from_fields(albedo_factor=faded(opacity)))


class FollowedWriter:
    """Writes what is shown of the followed actor alone.

    Args:
        stream: The stream.
        id: The actor.
        ground: Whether a ground moves along with it, which shows its speed if there is no map.
    """

    def __init__(self, stream: Stream, id: int, *, ground: bool) -> None:
        self._stream = stream
        self._id = id
        self._ground = ground
        self._axes = CameraAxes(stream, paths.CHASE)
        self._plots = PlotWriter(stream)
        self._first: TimePoint | None = None
        self._appeared = False
        self._bottom = 0.0  # m; of its box, above its location
        self._times: list[TimeColumns] = []
        self._series: list[FollowedSeries] = []
        self._rows = 0
        self._before = np.full((1, 3), np.nan)  # the last location in m, right-handed

    def write(self, batch: SceneBatch, times: TimeColumns, series: FollowedSeries) -> None:
        """Write scenes."""
        self._first = self._first or times.point(0)
        if not self._appeared and np.isfinite(series.camera[-1]).all():
            self._appear(batch, times, series)
        self._times.append(times)
        self._series.append(series)
        self._rows += len(batch)
        if self._rows >= ROWS:
            self.flush()

    def flush(self) -> None:
        """Write what is held back."""
        if not self._rows:
            return
        times, series = TimeColumns.joined(self._times), FollowedSeries.joined(self._series)
        self._axes.write_axes(times, series.camera)
        self._plots.write(times, series)
        self._write_path(times, series)
        self._times, self._series, self._rows = [], [], 0

    def _appear(self, batch: SceneBatch, times: TimeColumns, series: FollowedSeries) -> None:
        self._appeared = True
        row = int(np.argmax(series.known))
        if self._first is not None and self._first != times.point(row):  # until then, the camera waits where it will be
            self._axes.write_axes(TimeColumns.of_points([self._first]), series.camera[row : row + 1])
        actor = batch.actors.get(self._id)
        if actor is not None:
            box = box_of(actor)
            self._bottom = box.z - box.extent_z
        color = style.OTHER.color if actor is None else style.color_of(actor)
        self._stream.log_static(paths.trail(self._id), rr.LineStrips3D.from_fields(colors=[color], radii=[_TRAIL]))
        self._stream.log_static(paths.MAP_FOLLOWED, rr.Points2D.from_fields(colors=[color], radii=screen_radii(_RADIUS)))

    def _write_path(self, times: TimeColumns, series: FollowedSeries) -> None:
        """Write the location on the map, the trail and the ground."""
        known = np.flatnonzero(series.known)
        times, locations = times.take(known), right_handed(series.poses[known])[:, LOCATION]
        steps = np.diff(locations, axis=0, prepend=self._before)
        steps[series.jumped[known]] = 0
        self._before = np.concatenate((self._before, locations))[-1:]
        on_map = (locations[:, :2] * (1, -1)).astype(np.float32)
        self._stream.columns(paths.MAP_FOLLOWED, times, rr.Points2D.columns(positions=on_map))
        below = locations + np.array((0, 0, self._bottom))
        moved = np.flatnonzero(steps.any(axis=1))
        ends = np.stack((below - steps, below), axis=1)[moved] + np.array((0, 0, _TRAIL / 2))
        self._stream.columns(
            paths.trail(self._id), times.take(moved), rr.LineStrips3D.columns(strips=_segments(ends.astype(np.float32)))
        )
        if self._ground:
            below = ground_below(below)
            changed = np.concatenate(([True], (np.diff(below, axis=0) != 0).any(axis=1)))
            cells = below[changed].astype(np.float32)
            self._stream.columns(paths.GROUND, times.take(changed), rr.Transform3D.columns(translation=cells))


def _segments(ends: NDArray[np.float32]) -> pa.Array:
    """Return lines of two ends each, (n, 2, 3), in Rerun's layout, which is slow to make them from arrays."""
    kind = rr.components.LineStrip3DBatch._ARROW_DATATYPE
    points = pa.FixedSizeListArray.from_arrays(ends.ravel(), type=kind.value_type)
    return pa.ListArray.from_arrays(np.arange(0, 2 * len(ends) + 1, 2, dtype=np.int32), points, type=kind)
