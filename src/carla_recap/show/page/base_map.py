"""The base map of the incident page: the surfaces of a map from above, or without a map, the paths of vehicles."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import groupby
from operator import itemgetter
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.roads.corridors import fresh_parts
from carla_recap.roads.polylines import simplify
from carla_recap.scene.materials import Material
from carla_recap.town.mesh import TOWN_SOURCES
from carla_recap.util.cache import kept

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.scene.mesh import Mesh
    from carla_recap.show.page.samples import SampledReplay
    from carla_recap.town.mesh import TownMesh
    from carla_recap.util.arrays import Floats, Integers


PATH_WIDTH: Final = 3.2  # m
STEP: Final = 1.0  # m between points of a path
CELL: Final = 1.5  # m of a square in which one path is drawn
MOST: Final = 100_000  # points of paths
LAYERS: Final = {
    "junction": (Material.JUNCTION,),
    "shoulder": (Material.SHOULDER, Material.PARKING),
    "bike": (Material.BIKE_LANE,),
    "road": (Material.ROAD,),
    "median": (Material.MEDIAN, Material.GROUND),
    "sidewalk": (Material.SIDEWALK, Material.KERB),
    "crossing": (Material.CROSSING,),
    "white": (Material.WHITE_LINE, Material.STOP_LINE),
    "yellow": (Material.YELLOW_LINE,),
}
"""The surfaces of a map, from the lowest to the highest; those that are raised hide the edges of others."""

_LAYER_OF: Final = np.full(max(Material) + 1, -1)
"""The number of the layer of each material; -1 for none."""
for _number, _materials in enumerate(LAYERS.values()):
    _LAYER_OF[list(_materials)] = _number

_UPWARDS: Final = 0.3  # of the normal of a surface that is seen from above
_GRID: Final = 100  # corners per m, to find those that triangles share
_TOLERANCE: Final = 0.02  # m
_SOURCES: Final = (*TOWN_SOURCES, "show/page")  # the folders of the modules that outlines are made by
_MANY: Final = 5  # points from which an outline is simplified


class Outlines(NamedTuple):
    """The outlines of a surface within a part of a map."""

    layer: str  # the key in `LAYERS`
    rings: list[Floats]  # closed lines, (points, 2), in m, without the repeated first point; holes run the other way around


@dataclass(frozen=True)
class BaseMap:
    """What to draw below the actors: x, y in m, right-handed."""

    surfaces: list[Outlines] = field(default_factory=list)  # the surfaces of a map, the lowest first
    paths: list[Floats] = field(default_factory=list)  # the paths of vehicles, below the surfaces


def base_map(town: TownMesh | None, replays: Sequence[SampledReplay]) -> BaseMap:
    """Return the surfaces of a town, or without one, the paths of vehicles.

    Below the surfaces are the paths of all recordings but the first, since the town may be what the vehicles of the first
    one have driven along.
    """
    if town is None:
        return BaseMap(paths=list(_driven(replays)))
    return BaseMap(surfaces=outlines(town), paths=list(_driven(replays[1:])))


# --- surfaces ------------------------------------------------------------------------------------------------------------


def outlines(town: TownMesh) -> list[Outlines]:
    """Return the outlines of the surfaces of a town, by layer and tile."""
    found = kept(town.digest, "outlines", _SOURCES, lambda: _outlines(town)) if town.digest else _outlines(town)
    groups = groupby(zip(found["places"][0].tolist(), found["rings"], strict=True), itemgetter(0))
    names = list(LAYERS)
    return [Outlines(names[layer], [ring for _, ring in group]) for (layer, _), group in groups]


def _outlines(town: TownMesh) -> dict[str, list[NDArray[Any]]]:
    """Return the outlines as closed lines, and for each the numbers of its layer and tile, by which they are sorted."""
    rings, places = [], []
    tiles = [_corners(tile) for tile in town.tiles]
    for layer in range(len(LAYERS)):
        for tile, (layers, corners) in enumerate(tiles):
            found = [ring / _GRID for ring in _rings(corners[layers == layer])]
            rings += found
            places += [(layer, tile)] * len(found)
    return {"rings": rings, "places": [np.array(places, np.int64).reshape(-1, 2)]}


def _corners(mesh: Mesh) -> tuple[Integers, Integers]:
    """Return the corners of triangles seen from above, (triangles, 3, 2), on a grid; before them the layer of each."""
    first = mesh.triangles[:, 0]
    numbers = _LAYER_OF[mesh.materials[first]]
    points = mesh.vertices[:, :2][mesh.triangles].astype(np.float64)
    seen = (numbers >= 0) & (mesh.normals[first, 2] > _UPWARDS) & np.isfinite(points).all(axis=(1, 2))
    return numbers[seen], np.rint(points[seen] * _GRID).astype(np.int64)


def _rings(corners: Integers) -> Iterator[Floats]:
    """Yield the outlines of triangles: the edges that no other triangle has in the other direction, as closed lines."""
    if not len(corners):
        return
    every = corners.reshape(-1, 2)
    low = every.min(axis=0)
    width = int(np.ptp(every[:, 1])) + 1
    _, first, indices = np.unique(
        (every[:, 0] - low[0]) * width + every[:, 1] - low[1], return_index=True, return_inverse=True
    )
    points, triangles = every[first], indices.reshape(-1, 3)
    (x0, y0), (x1, y1), (x2, y2) = (points[triangles[:, i]].T for i in range(3))
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    triangles = np.where((area < 0)[:, None], triangles[:, ::-1], triangles)[area != 0]
    starts, stops = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    count = len(points)
    edges, signs = np.minimum(starts, stops) * count + np.maximum(starts, stops), np.where(starts < stops, 1, -1)
    edges, which = np.unique(edges, return_inverse=True)
    net = np.bincount(which.ravel(), signs).astype(np.int64)
    following: dict[int, list[int]] = defaultdict(list)
    for edge, times in zip(edges[net != 0].tolist(), net[net != 0].tolist(), strict=True):
        low, high = divmod(edge, count)
        start, stop = (low, high) if times > 0 else (high, low)
        following[start] += [stop] * abs(times)
    while following:
        start, stops_left = next(iter(following.items()))
        ring, at = [start], stops_left.pop()
        if not stops_left:
            del following[start]
        while at != start:
            ring.append(at)
            stops_left = following[at]
            before, at = at, stops_left.pop()
            if not stops_left:
                del following[before]
        if len(ring) > 2:
            yield _simple(points[ring].astype(np.float64))


def _simple(ring: Floats) -> Floats:
    if len(ring) < _MANY:
        return ring
    closed = simplify(np.vstack((ring, ring[:1])) / _GRID, _TOLERANCE)
    return closed[:-1] * _GRID if len(closed) > 3 else ring


# --- paths ---------------------------------------------------------------------------------------------------------------


def _driven(replays: Sequence[SampledReplay]) -> Iterator[Floats]:
    """Return the paths of all vehicles, without those parts where one is drawn already."""
    paths = []
    for replay in replays:
        vehicles = {i for i, actor in enumerate(replay.actors) if actor.actor.kind == "vehicle"}
        moving = (track for track in replay.tracks if track.actor in vehicles and not track.is_still)
        paths += [_thinned(track.rows[:, :2]) for track in moving]
    return fresh_parts(paths, CELL, MOST)


def _thinned(line: Floats) -> Floats:
    """Return a line with a point for each step of its length, and its last point."""
    far = np.cumsum(np.hypot(*np.diff(line, axis=0, prepend=line[:1]).T)) // STEP
    kept = np.flatnonzero(np.diff(far, prepend=-1.0) > 0)
    thin: Floats = line[np.union1d(kept, [len(line) - 1])]
    return thin
