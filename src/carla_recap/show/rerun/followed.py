"""The followed actor: the axes of its camera, its trail, and the ground below it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import pyarrow as pa
import rerun as rr

from carla_recap.model.motion import possible_step
from carla_recap.model.records import CM
from carla_recap.replay import calm_headings, level, right_handed
from carla_recap.replay.pose import LOCATION, YAW
from carla_recap.scene import style
from carla_recap.show.rerun import paths
from carla_recap.show.rerun.ground import ground_below
from carla_recap.show.rerun.plots import CONTROLS, PlotWriter
from carla_recap.show.rerun.poses import ROWS
from carla_recap.show.rerun.stream import TimeColumns, screen_radii

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.replay import SceneBatch
    from carla_recap.show.rerun.stream import Stream, TimePoint

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]
    Rows = NDArray[np.intp]

_TRAIL: Final = 0.04  # m; the radius of the trail
_RADIUS: Final = 6.0  # points of the screen; of the actor on the map


def jumps(seconds: Floats, poses: Floats) -> Flags:
    """Return which poses are too far from the one before for an actor to have driven there."""
    distances = np.sqrt((np.diff(poses[:, LOCATION], axis=0) ** 2).sum(axis=1))
    return np.concatenate(([False], distances * CM > possible_step(np.diff(seconds))))


class CameraAxes:
    """Writes level axes that follow an actor and turn calmly; a camera is fixed in them.

    Args:
        stream: The stream.
        path: The path of the entity.
    """

    def __init__(self, stream: Stream, path: str) -> None:
        self._stream = stream
        self._path = path
        self._seconds = np.zeros(0)  # of the last row
        self._pose = np.zeros((0, 6))  # with the heading of the camera as its yaw

    def write(self, times: TimeColumns, poses: Floats, present: Rows) -> None:
        """Write the axes of the next frames.

        Args:
            times: The times of the frames.
            poses: The poses of the actor, in cm and degrees, left-handed.
            present: The rows in which it has one.
        """
        held = len(self._pose)
        seconds = np.concatenate((self._seconds, times.seconds[present]))
        path = np.concatenate((self._pose, poses[present]))
        absent = np.concatenate((np.zeros(held, np.bool_), np.diff(present, prepend=-1) > 1))
        starts = np.flatnonzero(jumps(seconds, path) | absent)
        runs = zip(np.split(seconds, starts), np.split(path[:, YAW], starts), strict=True)
        calm = level(path, np.concatenate([calm_headings(*run) for run in runs]))
        stays = len(present) > 0 and present[-1] == len(poses) - 1
        self._seconds, self._pose = (seconds[-1:], calm[-1:]) if stays else (seconds[:0], calm[:0])
        before = calm[:1] if held else np.full((1, 6), np.nan)
        calm = calm[held:]
        changed = np.flatnonzero(np.diff(calm, axis=0, prepend=before).any(axis=1))
        if len(changed):
            self._stream.transforms(self._path, times.take(present[changed]), calm[changed])


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
        self._poses: list[Floats] = []
        self._velocities: list[Floats] = []
        self._controls: list[Floats] = []
        self._rows = 0
        self._before: tuple[Floats, Floats] | None = None  # seconds and pose of the last row

    def write(self, batch: SceneBatch, times: TimeColumns) -> None:
        """Write scenes."""
        self._first = self._first or times.point(0)
        poses = batch.pose_of(self._id)
        if poses is not None and not self._appeared:
            self._appear(batch, times, poses)
        self._times.append(times)
        self._poses.append(np.full((len(batch), 6), np.nan) if poses is None else poses)
        self._velocities.append(_values(batch, "velocities", self._id, ("x", "y", "z")))
        self._controls.append(_values(batch, "vehicle_controls", self._id, CONTROLS))
        self._rows += len(batch)
        if self._rows >= ROWS:
            self.flush()

    def flush(self) -> None:
        """Write what is held back."""
        if not self._rows:
            return
        times, poses = TimeColumns.joined(self._times), np.concatenate(self._poses)
        present = np.flatnonzero(np.isfinite(poses).all(axis=1))
        self._axes.write(times, poses, present)
        speeds = np.full(len(poses), np.nan)
        if len(present):
            velocities = np.concatenate(self._velocities)[present]
            speeds[present] = self._write_path(times.take(present), poses[present], velocities)
        controls = np.concatenate(self._controls)
        recorded = np.flatnonzero(np.isfinite(controls).all(axis=1))
        self._plots.write_controls(times.take(recorded), controls[recorded], speeds[recorded])
        self._times, self._poses, self._velocities, self._controls, self._rows = [], [], [], [], 0

    def _appear(self, batch: SceneBatch, times: TimeColumns, poses: Floats) -> None:
        self._appeared = True
        if self._first is not None and self._first != times.point(0):  # until then, the camera waits where it will be
            first = TimeColumns.of_points([self._first])
            CameraAxes(self._stream, paths.CHASE).write(first, poses[:1], np.zeros(1, np.intp))
        actor = batch.actors.get(self._id)
        if actor is not None:
            box = style.box_of(actor)
            self._bottom = box.z - box.extent_z
        color = style.OTHER.color if actor is None else style.color_of(actor)
        self._stream.log_static(paths.trail(self._id), rr.LineStrips3D.from_fields(colors=[color], radii=[_TRAIL]))
        self._stream.log_static(paths.MAP_FOLLOWED, rr.Points2D.from_fields(colors=[color], radii=screen_radii(_RADIUS)))

    def _write_path(self, times: TimeColumns, poses: Floats, velocities: Floats) -> Floats:
        """Write the speeds and the locations at some times, and return the speeds in m/s.

        Velocities, in m/s, are NaN if they are not recorded.
        """
        before = self._before or (times.seconds[:1], poses[:1])
        self._before = times.seconds[-1:], poses[-1:]
        seconds, poses = np.concatenate((before[0], times.seconds)), np.concatenate((before[1], poses))
        steps = np.diff(right_handed(poses)[:, LOCATION], axis=0)
        steps[jumps(seconds, poses)[1:]] = 0
        speeds = np.linalg.norm(velocities, axis=1)
        speeds = np.where(np.isfinite(speeds), speeds, _slopes(steps, np.diff(seconds)))
        self._plots.write_speeds(times, speeds)
        self._write_locations(times, right_handed(poses)[1:, LOCATION], steps)
        return speeds

    def _write_locations(self, times: TimeColumns, locations: Floats, steps: Floats) -> None:
        """Write the location on the map, the ground and the trail.

        Args:
            times: The times.
            locations: The locations in m, right-handed.
            steps: The steps from the location before to each of them, in m; 0 for a jump.
        """
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


def _values(batch: SceneBatch, name: str, id: int, fields: Sequence[str]) -> Floats:
    """Return some fields of the records of an actor, (scenes, fields); NaN if it has no records."""
    values = np.full((len(batch), len(fields)), np.nan)
    records = batch.frames.records(name)
    if records.size and len(found := np.flatnonzero(records["id"][0] == id)):  # the last record of an actor counts
        for column, field in enumerate(fields):
            values[:, column] = records[field][:, found[-1]]
    return values


def _slopes(steps: Floats, spans: Floats) -> Floats:
    """Return the speeds of steps in m, of which the first one may be none at all, and the seconds that they take."""
    slopes: Floats = np.divide(np.linalg.norm(steps, axis=1), spans, out=np.zeros(len(spans)), where=spans > 0)
    if not spans[0]:
        slopes[:1] = slopes[1:2] if len(slopes) > 1 else 0
    return slopes


def _segments(ends: NDArray[np.float32]) -> pa.Array:
    """Return lines of two ends each, (n, 2, 3), in Rerun's layout, which is slow to make them from arrays."""
    kind = rr.components.LineStrip3DBatch._ARROW_DATATYPE
    points = pa.FixedSizeListArray.from_arrays(ends.ravel(), type=kind.value_type)
    return pa.ListArray.from_arrays(np.arange(0, 2 * len(ends) + 1, 2, dtype=np.int32), points, type=kind)
