"""The followed actor: its camera, the trail behind it, the ground beneath it, and plots of what it does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import pyarrow as pa
import rerun as rr

from carla_recap.export import style
from carla_recap.export.rerun import tree
from carla_recap.export.rerun.cameras import Chase, jumps
from carla_recap.export.rerun.stream import Times, screen
from carla_recap.export.rerun.tracks import ROWS
from carla_recap.replay import right_handed
from carla_recap.replay.pose import LOCATION

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.export.rerun.stream import Moment, Stream
    from carla_recap.replay import Scene

    Floats = NDArray[np.float64]

_KMH: Final = 3.6  # in a m/s
_CONTROLS: Final = (("throttle", (90, 200, 120)), ("brake", (240, 90, 80)), ("steer", (130, 170, 255)))
_RECORDS: Final = 1 << 19  # so many are held back at the most
_CELL: Final = 10.0  # m, of the ground
_REACH: Final = 200.0  # m; so far the ground goes
_GROUND: Final = (62, 66, 76)
_LINE: Final = 0.03  # m
_TRAIL: Final = 0.07  # m
_ON_MAP: Final = 6.0  # points of the screen
_ABSENT: Final = np.full(6, np.nan)


class Ego:
    """Writes what there is of the followed actor alone.

    Args:
        stream: Where to.
        id: The actor.
        ground: Whether a ground goes along with it; where there is no map, it shows how fast one goes.
    """

    def __init__(self, stream: Stream, id: int, *, ground: bool) -> None:
        self._stream = stream
        self._id = id
        self._ground = ground
        self._chase = Chase(stream, tree.CHASE)
        self._first: Moment | None = None
        self._seen = False
        self._bottom = 0.0  # m; of its box, above its place
        self._moments: list[Moment] = []
        self._poses: list[Floats] = []
        self._velocities: list[NDArray[np.void]] = []  # of all actors, as recorded
        self._controls: list[NDArray[np.void]] = []
        self._count = 0
        self._before: tuple[Floats, Floats] | None = None  # seconds and pose of the last row
        names, colors = zip(*_CONTROLS, strict=True)
        stream.always(tree.CONTROLS, rr.SeriesLines(colors=colors, names=names, widths=[1.5] * len(names)))
        if ground:
            stream.always(tree.GROUND, _grid())

    def enter(self, scene: Scene, moment: Moment) -> None:
        """Take a scene in."""
        self._first = self._first or moment
        pose = scene.pose_of(self._id)
        if pose is not None and not self._seen:
            self._appear(scene, moment, pose)
        self._moments.append(moment)
        self._poses.append(_ABSENT if pose is None else pose)
        self._velocities.append(scene.frame["velocities"])
        self._controls.append(scene.frame["vehicle_controls"])
        self._count += len(self._velocities[-1]) + len(self._controls[-1])
        if len(self._moments) >= ROWS or self._count >= _RECORDS:
            self.flush()

    def flush(self) -> None:
        """Write what is held back."""
        if not self._moments:
            return
        times, poses = Times.of(self._moments), np.array(self._poses)
        there = np.flatnonzero(np.isfinite(poses).all(axis=1))
        self._chase.move(times, poses, there)
        if len(there):
            self._move(times, poses, there)
        self._steer(times)
        self._moments, self._poses, self._velocities, self._controls, self._count = [], [], [], [], 0

    def _appear(self, scene: Scene, moment: Moment, pose: Floats) -> None:
        self._seen = True
        if self._first is not None and self._first != moment:  # until then, the camera waits where it will come
            Chase(self._stream, tree.CHASE).move(Times.of([self._first]), pose[None], np.zeros(1, np.intp))
        actor = scene.actors.get(self._id)
        if actor is not None:
            box = style.box_of(actor)
            self._bottom = box.z - box.extent_z
        color = style.OTHER.color if actor is None else style.color_of(actor)
        self._stream.always(tree.SPEED, rr.SeriesLines(colors=[color], names=["km/h"], widths=[2.0]))
        self._stream.always(tree.trail(self._id), rr.LineStrips3D.from_fields(colors=[color], radii=[_TRAIL]))
        self._stream.always(tree.MAP_FOLLOWED, rr.Points2D.from_fields(colors=[color], radii=screen(_ON_MAP)))

    def _move(self, times: Times, poses: Floats, rows: NDArray[np.intp]) -> None:
        """Where it is: in `rows`, the other ones are those where it is nowhere."""
        times, poses = times.take(rows), poses[rows]
        before = self._before or (times.seconds[:1], poses[:1])
        self._before = times.seconds[-1:], poses[-1:]
        seconds, poses = np.concatenate((before[0], times.seconds)), np.concatenate((before[1], poses))
        steps = np.diff(right_handed(poses)[:, LOCATION], axis=0)
        steps[jumps(seconds, poses)[1:]] = 0
        self._race(times, steps, np.diff(seconds), rows)
        self._pass(times, right_handed(poses)[1:, LOCATION], steps)

    def _race(self, times: Times, steps: Floats, spans: Floats, rows: NDArray[np.intp]) -> None:
        """How fast it is: as recorded, or else by its steps, in m, and the seconds that they took."""
        slopes = np.divide(np.linalg.norm(steps, axis=1), spans, out=np.zeros(len(rows)), where=spans > 0)
        if not spans[0]:
            slopes[:1] = slopes[1:2] if len(slopes) > 1 else 0
        recorded = np.linalg.norm(self._recorded(self._velocities, ("x", "y", "z"))[rows], axis=1)
        speeds = np.where(np.isfinite(recorded), recorded, slopes) * _KMH
        self._stream.columns(tree.SPEED, times, rr.Scalars.columns(scalars=speeds))

    def _pass(self, times: Times, places: Floats, steps: Floats) -> None:
        """Where it is on the map, what is beneath it and behind it; in m, right-handed."""
        on_map = (places[:, :2] * (1, -1)).astype(np.float32)
        self._stream.columns(tree.MAP_FOLLOWED, times, rr.Points2D.columns(positions=on_map))
        beneath = places + np.array((0, 0, self._bottom))
        moved = np.flatnonzero(steps.any(axis=1))
        ends = np.stack((beneath - steps, beneath), axis=1)[moved] + np.array((0, 0, _TRAIL / 2))
        self._stream.columns(
            tree.trail(self._id), times.take(moved), rr.LineStrips3D.columns(strips=_segments(ends.astype(np.float32)))
        )
        if self._ground:
            beneath[:, :2] = np.rint(beneath[:, :2] / _CELL) * _CELL
            news = np.concatenate(([True], (np.diff(beneath, axis=0) != 0).any(axis=1)))
            cells = beneath[news].astype(np.float32)
            self._stream.columns(tree.GROUND, times.take(news), rr.Transform3D.columns(translation=cells))

    def _steer(self, times: Times) -> None:
        controls = self._recorded(self._controls, [name for name, _ in _CONTROLS])
        told = np.flatnonzero(np.isfinite(controls).all(axis=1))
        if len(told):
            (column,) = rr.Scalars.columns(scalars=controls[told].ravel())
            lengths = np.full(len(told), controls.shape[1])
            self._stream.columns(tree.CONTROLS, times.take(told), [column.partition(lengths)])

    def _recorded(self, scenes: list[NDArray[np.void]], names: Sequence[str]) -> Floats:
        """What each scene's records have of the actor, a column for each name; NaN where they have nothing."""
        found = np.flatnonzero(_column(scenes, "id") == self._id)
        ends = np.cumsum([len(scene) for scene in scenes])
        values = np.full((len(scenes), len(names)), np.nan)
        if len(found):
            columns = [_column(scenes, name)[found] for name in names]
            values[np.searchsorted(ends, found, "right")] = np.stack(columns, axis=1)
        return values


def _column(scenes: list[NDArray[np.void]], name: str) -> NDArray[np.generic]:
    """A field of all records; whole records take thirty times as long to put together."""
    return np.concatenate([scene[name] for scene in scenes])


def _segments(ends: NDArray[np.float32]) -> pa.Array:
    """Lines of two ends each, (n, 2, 3), as Rerun keeps them; from arrays it would make them one by one."""
    kind = rr.components.LineStrip3DBatch._ARROW_DATATYPE
    points = pa.FixedSizeListArray.from_arrays(ends.ravel(), type=kind.value_type)
    return pa.ListArray.from_arrays(np.arange(0, 2 * len(ends) + 1, 2, dtype=np.int32), points, type=kind)


def _grid() -> rr.LineStrips3D:
    """Squares on the ground."""
    along = np.arange(-_REACH, _REACH + _CELL, _CELL)
    lines = [[(x, -_REACH, 0), (x, _REACH, 0)] for x in along] + [[(-_REACH, y, 0), (_REACH, y, 0)] for y in along]
    return rr.LineStrips3D(lines, colors=[_GROUND], radii=[_LINE])
