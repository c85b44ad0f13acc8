"""What is around the actors: the surfaces of the town, its roads from above, and the sky.

Without a town mesh, the ground is a plane with lines, which show the speed of the actor that it moves along with. On it are
roads where vehicles have driven. `carla_recap.roads.corridors` makes better ones, but has to read a recording beforehand;
here they are gathered on the way: for a running simulation, for recordings of more than half an hour, and for calls of
`export_rerun` without a map.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.replay.pose import LOCATION
from carla_recap.roads.polylines import stations
from carla_recap.scene import style
from carla_recap.scene.materials import MATERIALS, Material, palette
from carla_recap.scene.mesh import Mesh
from carla_recap.show.rerun import entities
from carla_recap.show.rerun.meshes import circle, fan, mesh3d, packed, unlit
from carla_recap.show.rerun.stream import map_points, screen_radii

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.roads import RoadMap
    from carla_recap.show.rerun.stream import PoseBlock, Stream
    from carla_recap.town.mesh import TownMesh
    from carla_recap.util.arrays import Floats


_AROUND: Final = 60.0  # m; the distance from the actors up to which roads are on the map
_FINE: Final = 5.0  # m between points where roads end on the map
_SKY: Final = 3000.0  # m; the least radius of the sky
_RINGS: Final = 12
_SECTORS: Final = 48
_BELOW_HORIZON: Final = 0.08  # radians below the horizon at which the sky ends
_STEEP: Final = 0.6  # the exponent of the share of the zenith's colour by height

_SQUARE: Final = 10.0  # m; the size of a square of the ground
_REACH: Final = 200.0  # m; the distance to which the lines of the ground extend
_GROUND_LINE: Final = (118, 113, 98)
_HORIZON: Final = 2900.0  # m; the radius of the ground, which ends within the sky
_CORNERS: Final = 64
_UNDER: Final = 0.1  # m of the ground below the followed actor
_BELOW_LINES: Final = 0.05  # m of the ground below its lines
_LINE: Final = 0.03  # m; the radius of the lines of the ground

_STEP: Final = 0.3  # s between points of a corridor
_SHORTEST: Final = 0.5  # m between points that are apart
_CELL: Final = 2.0  # m of a square in which one piece of a corridor is enough
_MOST: Final = 20_000  # pieces
_WIDTH: Final = 3.8  # m
_OVERLAP: Final = 1.0  # m of a piece beyond its ends, so that bends have no gaps
_BELOW: Final = 0.03  # m below the vehicles' origins

_LAYERS: Final = {
    "ground": {Material.GRASS, Material.GROUND, Material.MEDIAN},
    "markings": {Material.WHITE_LINE, Material.YELLOW_LINE, Material.STOP_LINE, Material.CROSSING},
    "sidewalks": {Material.SIDEWALK, Material.KERB},
    "roads": {Material.ROAD, Material.JUNCTION, Material.SHOULDER, Material.PARKING, Material.BIKE_LANE},
}
"""The entities of surfaces, which can be hidden one by one; what is not among these is `OTHER`."""
_OTHER: Final = "furniture"


def write_town(stream: Stream, town: TownMesh) -> None:
    """Write the surfaces of a town, and the sky above it."""
    mesh = Mesh.concatenate(town.tiles)
    if not len(mesh.triangles):
        return
    materials = mesh.materials[mesh.triangles[:, 0]]
    left = np.ones(len(materials), np.bool_)
    for name, those in _LAYERS.items():
        chosen = np.isin(materials, list(those))
        left &= ~chosen
        _write_layer(stream, name, mesh, mesh.triangles[chosen])
    _write_layer(stream, _OTHER, mesh, mesh.triangles[left])
    low, high = town.bounds[:, 0].min(axis=0), town.bounds[:, 1].max(axis=0)
    write_sky(stream, (low + high) / 2, float(np.hypot(*(high - low)[:2])))


def _write_layer(stream: Stream, name: str, mesh: Mesh, triangles: NDArray[np.uint32]) -> None:
    if not len(triangles):
        return
    part = mesh.part(triangles)
    stream.log_static(f"{entities.ROADS}/{name}", mesh3d(part, palette()[part.materials]))


def write_sky(stream: Stream, center: Floats, radius: float) -> None:
    """Write a dome that is seen from inside alone.

    Its radius in m is larger than `_SKY` at least.
    """
    radius = max(radius, _SKY)
    rise = -_BELOW_HORIZON + (np.pi / 2 + _BELOW_HORIZON) * np.linspace(0, 1, _RINGS + 1)[:, None] ** 1.5
    turn = np.linspace(0, 2 * np.pi, _SECTORS, endpoint=False)
    unit = np.stack(
        (np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.broadcast_to(np.sin(rise), (_RINGS + 1, _SECTORS))), -1
    )
    share = np.clip(np.sin(np.maximum(rise, 0)), 0, 1) ** _STEEP
    horizon, zenith = np.array(style.HORIZON), np.array(style.ZENITH)
    colors = np.repeat((horizon + share * (zenith - horizon)).astype(np.uint8), _SECTORS, axis=0)
    corner = np.arange(_RINGS * _SECTORS).reshape(_RINGS, _SECTORS)
    beside = np.roll(corner, -1, axis=1)
    above, above_beside = corner + _SECTORS, beside + _SECTORS
    halves = np.stack((corner, above, beside, beside, above, above_beside), axis=-1)
    sky = rr.Mesh3D(
        vertex_positions=(center + radius * unit).reshape(-1, 3).astype(np.float32),
        vertex_colors=packed(colors),
        triangle_indices=halves.reshape(-1, 3),
        face_rendering=rr.components.MeshFaceRendering.Front,
    )
    stream.log_static(entities.SKY, sky)


def write_map(stream: Stream, roads: RoadMap, extent: Floats | None = None) -> None:
    """Write the roads as seen from above, in an extent only those around, so that the viewer shows these.

    It is the least x and y and the greatest x and y of the actors, in m, in the axes of the map.
    """
    layers = (
        (entities.MAP_ROADS, roads.centre_lines, style.MAP_ROAD, [style.LANE / 2], 0.0),
        (entities.MAP_BORDERS, roads.lane_borders, style.MAP_LINE, screen_radii(0.4), 1.0),
    )
    for path, lines, color, radii, order in layers:
        flat = [map_points(line) for line in lines]
        if extent is not None:
            low, high = extent[:2] - _AROUND, extent[2:] + _AROUND
            flat = [part for line in flat for part in _within(line, low, high)]
        if flat:
            stream.log_static(path, rr.LineStrips2D(flat, colors=[color], radii=radii, draw_order=order))


def _within(line: Floats, low: Floats, high: Floats) -> Iterator[Floats]:
    """Yield the parts of a line that are in a rectangle, given by two corners."""
    if (line.max(axis=0) < low).any() or (line.min(axis=0) > high).any():
        return
    along = stations(line)
    fine = np.unique(np.concatenate((along, np.arange(0.0, along[-1], _FINE))))
    points = np.stack([np.interp(fine, along, axis) for axis in line.T], axis=1)
    inside = np.asarray(((points >= low) & (points <= high)).all(axis=1))
    if inside.all():
        yield line
        return
    for run in np.split(np.arange(len(points)), np.flatnonzero(np.diff(inside)) + 1):
        if inside[run[0]] and len(run) > 1:
            yield points[run]


def write_ground(stream: Stream) -> None:
    """Write the ground up to the horizon, with squares on it, around the origin of its axes."""
    along = np.arange(-_REACH, _REACH + _SQUARE, _SQUARE)
    lines = [[(x, -_REACH, 0), (x, _REACH, 0)] for x in along] + [[(-_REACH, y, 0), (_REACH, y, 0)] for y in along]
    rim = np.column_stack((_HORIZON * circle(_CORNERS), np.full(_CORNERS, -_BELOW_LINES))).astype(np.float32)
    colors = np.broadcast_to(np.array(MATERIALS[Material.GROUND].color, np.uint8), rim.shape)
    plane = rr.Mesh3D(vertex_positions=rim, triangle_indices=fan(_CORNERS), vertex_colors=packed(colors))
    stream.log_static(entities.GROUND, rr.LineStrips3D(lines, colors=[_GROUND_LINE], radii=[_LINE]), plane)


def ground_below(points: Floats) -> Floats:
    """Return where the ground is for an actor at points, (n, 3) in m: in steps, so that its lines stand still."""
    found = points.copy()
    found[:, :2] = np.rint(found[:, :2] / _SQUARE) * _SQUARE
    found[:, 2] -= _UNDER
    return found


class CorridorWriter:
    """Gathers what vehicles drive along, and writes it at the end."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._pieces: list[Floats] = []  # (pieces, 2, 3): their ends in m, right-handed
        self._known = np.zeros(0, np.int64)

    def add(self, block: PoseBlock, vehicles: NDArray[np.bool_]) -> None:
        """Add a block of poses."""
        if not vehicles.any() or len(self._known) >= _MOST:
            return
        seconds = block.times.seconds
        begin = int(not block.present[0].any())
        rows = begin + np.flatnonzero(np.diff(np.floor(seconds[begin:] / _STEP + 1e-6), prepend=-1.0))
        if len(rows) < 2:
            return
        places, breaks = block.poses[:, vehicles, LOCATION], np.cumsum(~block.joined[:, vehicles], axis=0, dtype=np.intp)
        breaks = np.concatenate((np.zeros_like(breaks[:1]), breaks))[rows]
        ends = np.stack((places[rows[:-1]], places[rows[1:]]), axis=2)
        lengths = np.linalg.norm(ends[:, :, 1, :2] - ends[:, :, 0, :2], axis=2)
        ends = ends[(np.diff(breaks, axis=0) == 0) & (lengths > _SHORTEST)]
        ends = ends[np.abs(ends).max(axis=(1, 2)) < 1e6]
        cells = np.floor(ends[..., :2].mean(axis=1) / _CELL).astype(np.int64)
        keys, firsts = np.unique(cells[:, 0] << 32 ^ cells[:, 1] & 0xFFFF_FFFF, return_index=True)
        fresh = ~np.isin(keys, self._known)
        self._known = np.concatenate((self._known, keys[fresh]))
        self._pieces.append(ends[firsts[fresh]])

    def close(self) -> None:
        """Write the roads, in the world and on the map."""
        pieces = np.concatenate([np.zeros((0, 2, 3)), *self._pieces])[:_MOST]
        if not len(pieces):
            return
        way = pieces[:, 1] - pieces[:, 0]
        way /= np.linalg.norm(way[:, :2], axis=1, keepdims=True)
        across = np.stack((-way[:, 1], way[:, 0], np.zeros(len(way))), axis=1) * _WIDTH / 2
        start, end = pieces[:, 0] - _OVERLAP * way, pieces[:, 1] + _OVERLAP * way
        corners = np.stack((start - across, end - across, end + across, start + across), axis=1).reshape(-1, 3)
        corners[:, 2] -= _BELOW
        triangles = (np.array([(0, 1, 2), (0, 2, 3)]) + 4 * np.arange(len(pieces))[:, None, None]).reshape(-1, 3)
        up = np.broadcast_to(np.array((0, 0, 1), np.float32), corners.shape)
        materials = np.full(len(corners), Material.ROAD, np.uint8)
        mesh = Mesh(corners.astype(np.float32), up, materials, triangles.astype(np.uint32))
        colors = np.broadcast_to(np.array(MATERIALS[Material.ROAD].color, np.uint8), corners.shape)
        self._stream.log_static(f"{entities.ROADS}/corridors", unlit(mesh, colors))
        flat = map_points(np.stack((start, end), axis=1)).astype(np.float32)
        lines = rr.LineStrips2D(flat, colors=[style.MAP_ROAD], radii=[_WIDTH / 2], draw_order=0.0)
        self._stream.log_static(entities.MAP_ROADS, lines)
