"""The town: its surfaces in the world under a sky, and its roads from above."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.scene import style
from carla_recap.scene.materials import Material, palette
from carla_recap.scene.mesh import Mesh
from carla_recap.show.rerun import paths
from carla_recap.show.rerun.meshes import mesh3d, packed
from carla_recap.show.rerun.stream import screen_radii

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.rendering.town import TownMesh
    from carla_recap.roads import RoadMap
    from carla_recap.show.rerun.stream import Stream

    Floats = NDArray[np.float64]

_MARGIN: Final = 100.0  # m; the distance from the roads at which an actor is still in the town
_AROUND: Final = 60.0  # m; the distance from the actors up to which roads are on the map
_FINE: Final = 5.0  # m between points where roads end on the map
_SKY: Final = 3000.0  # m; the least radius of the sky
_RINGS: Final = 12
_SECTORS: Final = 48
_BELOW: Final = 0.08  # radians below the horizon at which the sky ends
_STEEP: Final = 0.6  # the exponent of the share of the zenith's colour by height

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
    used, corners = np.unique(triangles, return_inverse=True)
    part = Mesh(mesh.vertices[used], mesh.normals[used], mesh.materials[used], corners.reshape(-1, 3).astype(np.uint32))
    stream.log_static(f"{paths.ROADS}/{name}", mesh3d(part, palette()[part.materials]))


def write_sky(stream: Stream, center: Floats, radius: float) -> None:
    """Write a dome that is seen from inside alone.

    Args:
        stream: The stream.
        center: Its centre in m, right-handed.
        radius: Its radius in m; it is larger than `_SKY` at least.
    """
    radius = max(radius, _SKY)
    rise = -_BELOW + (np.pi / 2 + _BELOW) * np.linspace(0, 1, _RINGS + 1)[:, None] ** 1.5
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
    stream.log_static(paths.SKY, sky)


def write_map(stream: Stream, roads: RoadMap, extent: Floats | None = None) -> None:
    """Write the roads as seen from above.

    Args:
        stream: The stream.
        roads: The roads.
        extent: The least x and y and the greatest x and y of the actors, in m, left-handed: only the roads around are
            written, so that the viewer shows these; None: all roads.
    """
    layers = (
        (paths.MAP_ROADS, roads.centre_lines, style.MAP_ROAD, [style.LANE / 2], 0.0),
        (paths.MAP_BORDERS, roads.lane_borders, style.MAP_LINE, screen_radii(0.4), 1.0),
    )
    for path, lines, color, radii, order in layers:
        flat = [line[:, :2] * np.array((1, -1)) for line in lines]
        if extent is not None:
            low, high = extent[:2] - _AROUND, extent[2:] + _AROUND
            flat = [part for line in flat for part in _within(line, low, high)]
        if flat:
            stream.log_static(path, rr.LineStrips2D(flat, colors=[color], radii=radii, draw_order=order))


def _within(line: Floats, low: Floats, high: Floats) -> Iterator[Floats]:
    """Yield the parts of a line that are in a rectangle, given by two corners."""
    if (line.max(axis=0) < low).any() or (line.min(axis=0) > high).any():
        return
    along = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))))
    stations = np.unique(np.concatenate((along, np.arange(0.0, along[-1], _FINE))))
    points = np.stack([np.interp(stations, along, axis) for axis in line.T], axis=1)
    inside = np.asarray(((points >= low) & (points <= high)).all(axis=1))
    if inside.all():
        yield line
        return
    for run in np.split(np.arange(len(points)), np.flatnonzero(np.diff(inside)) + 1):
        if inside[run[0]] and len(run) > 1:
            yield points[run]
