"""The followed actor: the axes of its camera, what is see-through for that, its trail, plots, and the ground below it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import pyarrow as pa
import rerun as rr

from carla_recap.model.blueprints import box_of
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.records import CM
from carla_recap.replay import camera, right_handed
from carla_recap.replay.pose import LOCATION, left_handed
from carla_recap.scene import style
from carla_recap.scene.follow import CONTROLS, CalmPath, FollowedActor, FollowedRecords
from carla_recap.scene.opacity import SteppedOpacity
from carla_recap.show.rerun import entities
from carla_recap.show.rerun.meshes import faded
from carla_recap.show.rerun.stream import ROWS, TimeColumns, map_points, screen_radii
from carla_recap.show.rerun.surroundings import ground_below
from carla_recap.show.rerun.timeline import LightAheadWriter

if TYPE_CHECKING:
    from collections.abc import Set

    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.measures import MeasureSeries
    from carla_recap.scene.ahead import StopPoints
    from carla_recap.scene.description import SceneDescription
    from carla_recap.scene.follow import FollowedSeries
    from carla_recap.scene.materials import Color
    from carla_recap.show.rerun.stream import Stream, TimePoint
    from carla_recap.util.arrays import Floats


Triple = tuple[float, float, float]

LOOK_DOWN: Final = -17.0
"""The pitch of the camera behind an actor, in degrees."""
FARTHEST: Final = 50.0
"""The distances up to which there are plots, in m."""
LATEST: Final = 5.0
"""The times up to which there are plots, in s."""

_CAR: Final = (2.4, 0.8)  # m; half the length and the height of a car, for which the camera's distances are right
_TRAIL: Final = 0.04  # m; the radius of the trail
_RADIUS: Final = 6.0  # points of the screen; of the actor on the map
_KMH: Final = 3.6  # in a m/s

_SPEED: Final[Color] = (255, 190, 80)
_ACCELERATION: Final[Color] = (205, 150, 240)
_THROTTLE: Final[Color] = (90, 200, 120)
_BRAKE: Final[Color] = (240, 90, 80)
_STEER: Final[Color] = (130, 170, 255)
_GAP: Final[Color] = (235, 235, 240)
_HEADWAY: Final[Color] = (110, 200, 235)


def chase_eye(half_extents: Triple | None) -> Triple:
    """Return where the camera behind an actor is, in its level axes, in m: farther away from one larger than a car."""
    back, up = camera.CHASE_BACK * CM, camera.CHASE_UP * CM
    if half_extents is not None:
        back += max(0.0, half_extents[0] - _CAR[0]) * 1.6
        up += max(0.0, 2 * half_extents[2] - 2 * _CAR[1]) * 1.1
    return -back, 0.0, up


class CameraAxes:
    """Writes level axes that follow an actor and turn calmly; a camera is fixed in them."""

    def __init__(self, stream: Stream, path: str) -> None:
        self._stream = stream
        self._path = path
        self._axes = CalmPath()
        self._last = np.full((1, 6), np.nan)

    def write(self, times: TimeColumns, poses: Floats) -> None:
        """Write the axes in the next frames, given the poses of the actor in m, right-handed; NaN without one."""
        self.write_axes(times, self._axes.add(times.seconds, left_handed(poses)).camera)

    def write_axes(self, times: TimeColumns, axes: Floats) -> None:
        """Write the axes in the next frames, as those of `FollowedSeries`, (frames, 6); NaN before the actor appears."""
        known = np.flatnonzero(np.isfinite(axes).all(axis=1))
        axes = axes[known]
        changed = np.flatnonzero((np.diff(axes, axis=0, prepend=self._last) != 0).any(axis=1))
        if len(changed):
            poses = right_handed(axes[changed])
            self._stream.trajectories([(self._path, 0, len(poses))], times.take(known[changed]), poses)
            self._last = axes[-1:]


class FollowedWriter:
    """Writes what is shown of the followed actor alone, and what is see-through for the camera behind it."""

    def __init__(self, stream: Stream, id: int, stops: StopPoints, models: Set[int], *, ground: bool) -> None:
        self._stream = stream
        self._id = id
        self._models = models
        self._ground = ground
        self._actor = FollowedActor(id, stops)
        self._axes = CameraAxes(stream, entities.CHASE)
        self._opacity = SteppedOpacity(id)
        self._ahead = LightAheadWriter(stream)
        self._first: TimePoint | None = None
        self._appeared = False
        self._bottom = 0.0  # m; of its box, above its location
        self._life: ActorLife | None = None
        self._times: list[TimeColumns] = []
        self._records: list[FollowedRecords] = []
        self._drawn: set[int] = set()  # the actors that have been drawn as models in the scenes that are held back
        self._rows = 0
        self._before = np.full((1, 3), np.nan)  # the last location in m, right-handed
        self._is_gone = np.array([True])  # in the last scene
        _name_plots(stream)

    def write(self, description: SceneDescription, times: TimeColumns) -> None:
        """Write scenes."""
        records = self._actor.read(description.batch)
        self._first = self._first or times.point(0)
        self._life = description.batch.actors.get(self._id, self._life)
        self._drawn.update(self._models)
        self._ahead.write(description, times, records)
        self._opacity.add(description)
        self._times.append(times)
        self._records.append(records)
        self._rows += len(description)
        if self._rows >= ROWS:
            self._write_series()

    def flush(self) -> None:
        """Write what is held back."""
        if self._rows:
            self._write_series()

    def _write_series(self) -> None:
        times, series = TimeColumns.joined(self._times), self._actor.derive(FollowedRecords.joined(self._records))
        if not self._appeared and series.known.any():
            self._appear(times, series)
        self._axes.write_axes(times, series.camera)
        self._write_plots(times, series)
        self._write_path(times, series)
        self._write_opacity(times, series)
        self._times, self._records, self._rows = [], [], 0
        self._drawn.clear()

    def _appear(self, times: TimeColumns, series: FollowedSeries) -> None:
        self._appeared = True
        row = int(np.argmax(series.known))
        if self._first is not None and self._first != times.point(row):  # until then, the camera waits where it will be
            self._axes.write_axes(TimeColumns.of_points([self._first]), series.camera[row : row + 1])
        if self._life is not None:
            box = box_of(self._life)
            self._bottom = box.z - box.extent_z
        color = style.OTHER.color if self._life is None else style.color_of(self._life)
        point = rr.Points2D.from_fields(colors=[color], radii=screen_radii(_RADIUS))
        self._stream.log_static(entities.trail(self._id), rr.LineStrips3D.from_fields(colors=[color], radii=[_TRAIL]))
        self._stream.log_static(entities.MAP_FOLLOWED, point)

    def _write_opacity(self, times: TimeColumns, series: FollowedSeries) -> None:
        """Write which actors are see-through for the camera behind this one."""
        for row, id, opacity in self._opacity.changes(series, chase_eye, LOOK_DOWN):
            if id in self._drawn:
                factor = rr.Mesh3D.from_fields(albedo_factor=faded(opacity))
                self._stream.log(entities.actor(id), times.point(row), factor)

    def _write_path(self, times: TimeColumns, series: FollowedSeries) -> None:
        """Write the location on the map, the trail and the ground."""
        known = np.flatnonzero(series.known)
        times, locations = times.take(known), right_handed(series.poses[known])[:, LOCATION]
        steps = np.diff(locations, axis=0, prepend=self._before)
        steps[series.jumped[known]] = 0
        self._before = np.concatenate((self._before, locations))[-1:]
        on_map = map_points(locations).astype(np.float32)
        self._stream.columns(entities.MAP_FOLLOWED, times, rr.Points2D.columns(positions=on_map))
        below = locations + np.array((0, 0, self._bottom))
        moved = np.flatnonzero(steps.any(axis=1))
        ends = np.stack((below - steps, below), axis=1)[moved] + np.array((0, 0, _TRAIL / 2))
        strips = _segments(ends.astype(np.float32))
        self._stream.columns(entities.trail(self._id), times.take(moved), rr.LineStrips3D.columns(strips=strips))
        if self._ground:
            below = ground_below(below)
            changed = np.append(True, (np.diff(below, axis=0) != 0).any(axis=1))[: len(below)]
            cells = below[changed].astype(np.float32)
            self._stream.columns(entities.GROUND, times.take(changed), rr.Transform3D.columns(translation=cells))

    def _write_plots(self, times: TimeColumns, series: FollowedSeries) -> None:
        """Write the controls as recorded, the pedals without their chatter at a standstill besides, and the motion."""
        present = series.known | np.isfinite(series.speed)  # where the speed is unknown, its line ends
        is_gone = np.append(self._is_gone, ~present)
        self._is_gone = is_gone[-1:]
        vanishes = is_gone[1:] & ~is_gone[:-1]  # where all lines end
        recorded = np.isfinite(series.pedals[:, 0])
        for path, values, shown in (
            (entities.SPEED, series.speed[:, None] * _KMH, present),
            (entities.ACCELERATION, series.acceleration[:, None], np.isfinite(series.acceleration)),
            (entities.CONTROLS, series.controls, recorded),
            (entities.PEDALS, series.pedals, recorded),
        ):
            rows = np.flatnonzero(shown | vanishes)
            (column,) = rr.Scalars.columns(scalars=values[rows].ravel())
            self._stream.columns(path, times.take(rows), [column.partition(np.full(len(rows), values.shape[1]))])


def _name_plots(stream: Stream) -> None:
    """Write the names, colours and widths of the lines of plots."""
    pedals = ("throttle, none while the brake is held", "brake, held at a standstill")
    for path, names, colors, width in (
        (entities.CONTROLS, CONTROLS, (_THROTTLE, _BRAKE, _STEER), 1.5),
        (entities.PEDALS, pedals, (_THROTTLE, _BRAKE), 2.0),
        (entities.SPEED, ("km/h",), (_SPEED,), 2.0),
        (entities.ACCELERATION, ("m/s²",), (_ACCELERATION,), 1.5),
    ):
        stream.log_static(path, rr.SeriesLines(colors=colors, names=names, widths=[width] * len(names)))


def write_measures(stream: Stream, clock: TimeColumns, series: MeasureSeries) -> None:
    """Write the plots of how close others are to the followed actor, at the scenes in which it is measured."""
    seconds = np.maximum.accumulate(clock.seconds)
    rows = np.searchsorted(seconds, series.time - SAME_TIME)
    known = np.flatnonzero(rows < len(seconds))
    known = known[np.abs(seconds[rows[known]] - series.time[known]) <= 2 * SAME_TIME]
    times = clock.take(rows[known])
    for path, color, name, values, most in (
        (entities.GAP, _GAP, "gap, m", series.gap, FARTHEST),
        (entities.HEADWAY, _HEADWAY, "headway, m", series.distance_headway, FARTHEST),
        (entities.TIME_TO_COLLISION, _BRAKE, "time to collision, s", series.time_to_collision, LATEST),
        (entities.TIME_HEADWAY, _HEADWAY, "time headway, s", series.time_headway, LATEST),
    ):
        stream.log_static(path, rr.SeriesLines(colors=[color], names=[name], widths=[2.0]))
        shown = values[known]
        shown = np.where(shown <= most, shown, np.nan)
        # A NaN ends a line; those that follow it are left out, but for the first and the last time of the axis.
        is_needed = ~(np.isnan(shown) & np.isnan(np.append(np.nan, shown[:-1])))
        is_needed[:1] = is_needed[-1:] = True
        kept = np.flatnonzero(is_needed)
        stream.columns(path, times.take(kept), rr.Scalars.columns(scalars=shown[kept]))


def _segments(ends: NDArray[np.float32]) -> pa.Array:
    """Return lines of two ends each, (n, 2, 3), in Rerun's layout, which is slow to make them from arrays."""
    kind = rr.components.LineStrip3DBatch._ARROW_DATATYPE
    points = pa.FixedSizeListArray.from_arrays(ends.ravel(), type=kind.value_type)
    return pa.ListArray.from_arrays(np.arange(0, 2 * len(ends) + 1, 2, dtype=np.int32), points, type=kind)
