"""The corridors that vehicles have driven, as an OpenDRIVE map for a recording whose map is unavailable.

Units are m and radians; axes are right-handed: x forward, y left, z up.
"""

from __future__ import annotations

import math
import warnings
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.model.motion import possible_step
from carla_recap.roads.drawing import RoadMap
from carla_recap.roads.polylines import stations

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.util.arrays import Floats


LANE_WIDTH: Final = 3.5
"""The width of a corridor, in m."""

POSE: Final = np.dtype([(name, np.float64) for name in ("time", "x", "y", "z", "yaw")])
"""The pose of an actor at a time: elapsed seconds, m, and degrees."""

_HEADER: Final = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<OpenDRIVE><header revMajor="1" revMinor="4" name="Corridors" vendor="carla-recap"/>\n'
)
_STEP: Final = 1.0  # m between points of a path
_CELL: Final = 1.5  # m of a square in which one path is a road
_MOST: Final = 15_000  # points of roads
_FARTHEST: Final = 1e5  # m from the origin
_SHARP: Final = np.cos(np.radians(50.0))  # of a turn at a point, at which a path ends
_FEWEST: Final = 7  # points of a part of a path that is a road, about a metre apart
_FAR: Final = 12.0  # m; the largest distance between points of a road
_TURN: Final = np.radians(4.0)  # between points of a road
_SLOPE: Final = 0.03  # change of the slope between points of a road
_BEYOND: Final = 4.0  # m of road before and after a path
_SMOOTHED: Final = 5  # points on both sides, of heights
_SHOULDER: Final = 0.6  # m
_ALONE: Final = 40.0  # m of the road where no vehicle has driven


def corridor_opendrive(driven: Sequence[NDArray[np.void]], others: Iterable[NDArray[np.void]] = ()) -> str:
    """Return an OpenDRIVE map whose roads, of one lane, are what vehicles have driven along, once each.

    Where no vehicle has moved, there is one short road, at the first pose of one or of another actor.
    """
    return _opendrive(_roads(driven, others))


def corridor_map(name: str, driven: Sequence[NDArray[np.void]], others: Iterable[NDArray[np.void]] = ()) -> RoadMap:
    """Return what vehicles have driven along as a road map; see `corridor_opendrive`."""
    roads = _roads(driven, others)
    borders = []
    for road in roads:
        ways = np.gradient(road[:, :2], axis=0)
        ways /= np.maximum(np.linalg.norm(ways, axis=1, keepdims=True), 1e-9)
        lefts = np.stack((-ways[:, 1], ways[:, 0], np.zeros(len(ways))), axis=1)
        borders += [road + side * LANE_WIDTH / 2 * lefts for side in (1, -1)]
    return RoadMap(name, borders, roads, [], [], [], _opendrive(roads))


def _roads(driven: Sequence[NDArray[np.void]], others: Iterable[NDArray[np.void]]) -> list[Floats]:
    """Return the middles of the roads, with points where they bend."""
    paths = [path for poses in driven for path in _paths(poses)]
    roads = [_bends(_extended(part)) for part in fresh_parts(paths, _CELL, _MOST, _FEWEST)]
    return roads or [_somewhere(driven or others)]


def fresh_parts(paths: Sequence[Floats], cell: float, most: int, fewest: int = 2) -> Iterator[Floats]:
    """Yield paths, (n, 2) or more columns, without those parts in whose square `cell`, in m, one is already.

    Parts of fewer points than `fewest` are left out; a warning says what is left out after `most` points.
    """
    if not paths:
        return
    points = np.concatenate([path[:, :2] for path in paths])
    x, y = np.rint(points / cell).astype(np.int32).astype(np.int64).T
    _, firsts = np.unique((x << 32) + y, return_index=True)
    fresh = np.zeros(len(points), np.bool_)
    fresh[firsts] = True
    left = most
    news = np.split(fresh, np.cumsum([len(path) for path in paths])[:-1])
    for number, (path, new) in enumerate(zip(paths, news, strict=True), 1):
        for run in _runs(path, new, fewest):
            if left <= 0:
                message = f"driven paths from {number} of {len(paths)} on are left out: those before have {most:,} points"
                warnings.warn(message, RecapWarning, stacklevel=3)
                return
            left -= len(run)
            yield run


def _runs(path: Floats, wanted: NDArray[np.bool_], fewest: int) -> Iterator[Floats]:
    """Yield the parts of a path that contain the wanted points, with the points next to these; none of fewer points."""
    near = wanted.copy()
    near[1:] |= wanted[:-1]
    near[:-1] |= wanted[1:]
    ends = np.flatnonzero(np.diff(np.concatenate(([0], near.astype(np.int8), [0]))))
    for first, last in ends.reshape(-1, 2).tolist():
        if last - first >= fewest:
            yield path[first:last]


def _paths(poses: NDArray[np.void]) -> Iterator[Floats]:
    """Yield the parts of the path of a vehicle without jumps and sharp turns, a point for each metre."""
    points = np.stack([poses[axis] for axis in "xyz"], axis=1)
    good = np.isfinite(points).all(axis=1) & (np.abs(points).max(axis=1, initial=0.0) < _FARTHEST)
    points, times = points[good], poses["time"][good]
    steps = np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1)
    jumps = steps > possible_step(np.diff(times))
    for part in np.split(points, np.flatnonzero(jumps) + 1):
        path = _thinned(part) if len(part) else part
        if len(path) < 2:
            continue
        ways = np.diff(path[:, :2], axis=0)
        ways /= np.linalg.norm(ways, axis=1, keepdims=True)
        turns = np.einsum("ij,ij->i", ways[1:], ways[:-1]) < _SHARP
        for piece in np.split(path, np.flatnonzero(turns) + 2):
            if len(piece) > 1:
                yield piece


def _thinned(path: Floats) -> Floats:
    """Return points of a path that are apart, also where a vehicle stands and its pose trembles."""
    far = stations(path[:, :2]) // _STEP
    thin = path[np.diff(far, prepend=-1.0) > 0]
    apart = np.linalg.norm(np.diff(thin[:, :2], axis=0), axis=1) > _STEP / 2
    return thin[np.concatenate(([True], apart))]


def _extended(path: Floats) -> Floats:
    """Return a path with some road before and after it, and with smooth heights."""
    ends = []
    for end, inner in ((path[0], path[min(2, len(path) - 1)]), (path[-1], path[max(-3, -len(path))])):
        way = end - inner
        way[2] = 0.0
        ends.append(end + way * (_BEYOND / max(float(np.linalg.norm(way)), 1e-6)))
    longer = np.concatenate((ends[:1], path, ends[1:]))
    padded = np.pad(longer[:, 2], _SMOOTHED, mode="edge")
    longer[:, 2] = np.convolve(padded, np.full(2 * _SMOOTHED + 1, 1 / (2 * _SMOOTHED + 1)), mode="valid")
    return longer


def _bends(path: Floats) -> Floats:
    """Return the points of a path with others left out where it is nearly straight."""
    ways = np.diff(path, axis=0)
    lengths = np.maximum(np.linalg.norm(ways[:, :2], axis=1), 1e-9)
    turns = np.abs(np.diff(np.unwrap(np.arctan2(ways[:, 1], ways[:, 0]))))
    slopes = np.abs(np.diff(ways[:, 2] / lengths))
    progress = np.cumsum(lengths[:-1] / _FAR + turns / _TURN + slopes / _SLOPE)
    kept = np.concatenate(([True], np.diff(np.floor(progress), prepend=0.0) > 0, [True]))
    return path[kept]


def _somewhere(actors: Iterable[NDArray[np.void]]) -> Floats:
    """Return a short road at the first pose of an actor, or at the origin."""
    middle, heading = np.zeros(3), 0.0
    for poses in actors:
        _, x, y, z, yaw = poses[0].item() if len(poses) else (math.nan,) * 5
        if np.isfinite((x, y, z, yaw)).all():
            middle, heading = np.clip((x, y, z), -_FARTHEST, _FARTHEST), math.radians(yaw)
            break
    way = np.array((np.cos(heading), np.sin(heading), 0.0))
    road: Floats = middle + np.linspace(-_ALONE / 2, _ALONE / 2, 9)[:, None] * way
    return road


def is_of_corridors(opendrive: str) -> bool:
    """Return whether the text of a map is that of corridors, whose surroundings are unknown."""
    return opendrive.startswith(_HEADER)


def _opendrive(roads: Sequence[Floats]) -> str:
    return _HEADER + "".join(_road(number, path) for number, path in enumerate(roads, 1)) + "</OpenDRIVE>\n"


def _road(number: int, path: Floats) -> str:
    ways = np.diff(path, axis=0)
    lengths = np.linalg.norm(ways[:, :2], axis=1)
    along = stations(path[:, :2])
    headings = np.arctan2(ways[:, 1], ways[:, 0])
    slopes = ways[:, 2] / lengths
    rows = zip(pairwise(along.tolist()), path.tolist(), headings.tolist(), slopes.tolist(), strict=False)
    plan, heights = [], []
    for (start, stop), (x, y, z), heading, slope in rows:
        plan.append(
            f'<geometry s="{start:.3f}" x="{x:.3f}" y="{y:.3f}" hdg="{heading:.6f}" length="{stop - start:.3f}">'
            "<line/></geometry>"
        )
        heights.append(f'<elevation s="{start:.3f}" a="{z:.3f}" b="{slope:.6f}" c="0" d="0"/>')
    return (
        f'<road name="" length="{along[-1]:.3f}" id="{number}" junction="-1"><link/>'
        f"<planView>{''.join(plan)}</planView><elevationProfile>{''.join(heights)}</elevationProfile>"
        f'<lanes><laneOffset s="0" a="{LANE_WIDTH / 2}" b="0" c="0" d="0"/><laneSection s="0">'
        f"<left>{_lane(1, 'shoulder', _SHOULDER, 'none')}</left><center>{_lane(0, 'none', None, 'solid')}</center>"
        f"<right>{_lane(-1, 'driving', LANE_WIDTH, 'solid')}{_lane(-2, 'shoulder', _SHOULDER, 'none')}</right>"
        "</laneSection></lanes></road>\n"
    )


def _lane(id: int, kind: str, width: float | None, mark: str) -> str:
    across = "" if width is None else f'<width sOffset="0" a="{width}" b="0" c="0" d="0"/>'
    paint = f'<roadMark sOffset="0" type="{mark}" weight="standard" color="standard" width="0.12" laneChange="none"/>'
    return f'<lane id="{id}" type="{kind}" level="false"><link/>{across}{paint}</lane>'
