"""Navigation meshes of towns: what walkers with CARLA's AI controllers, which the client itself steers, walk on.

They are Detour's, byte for byte as CARLA's client reads them. The layout is that of Recast's sample programs: a set of tiles
("MSET", version 1), here of one tile ("DNAV", version 7), with 32-bit references. Detour's axes are x, up and z: CARLA's x,
z and y. All numbers are little-endian.
"""

from __future__ import annotations

import logging
from functools import lru_cache
from hashlib import sha256
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.server.walkways import (
    CORNERS,
    CROSSWALK,
    ROAD,
    SIDEWALK,
    WalkwayEditor,
    cross_roads,
    walkable_surface,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.server.walkways import WalkableSurface
    from carla_recap.sim.town.loading import Town
    from carla_recap.util.arrays import Integers

NAVIGATION: Final = "Nav"
"""The folder of the files that clients need to steer walkers."""
_LOG: Final = logging.getLogger(__name__)
_MOST_NODES: Final = 50_000  # of the walkway graph: about 250 km of sidewalks

MOST: Final = 0xFFFF
"""The most corners, and the most polygons, of a tile: their indices have 16 bits."""

# magic, version, tiles, then dtNavMeshParams: origin, size of a tile along x and z, tiles and polygons at most
SET_HEADER: Final = np.dtype(
    [
        ("magic", "<i4"),
        ("version", "<i4"),
        ("tiles", "<i4"),
        ("origin", "<f4", 3),
        ("tile_size", "<f4", 2),
        ("most_tiles", "<i4"),
        ("most_polygons", "<i4"),
    ]
)
# a reference made of salt, number of the tile and number of a polygon; bytes of the tile
TILE_HEADER: Final = np.dtype([("reference", "<u4"), ("size", "<i4")])
# dtMeshHeader: place in the grid of tiles, counts of all that follows, the walker that it is for, bounds
MESH_HEADER: Final = np.dtype(
    [
        ("magic", "<i4"),
        ("version", "<i4"),
        ("place", "<i4", 3),
        ("user", "<u4"),
        ("polygons", "<i4"),
        ("corners", "<i4"),
        ("links", "<i4"),
        ("details", "<i4"),
        ("detail_corners", "<i4"),
        ("triangles", "<i4"),
        ("boxes", "<i4"),
        ("connections", "<i4"),
        ("first_connection", "<i4"),
        ("walker_height", "<f4"),
        ("walker_radius", "<f4"),
        ("walker_climb", "<f4"),
        ("low", "<f4", 3),
        ("high", "<f4", 3),
        ("box_scale", "<f4"),
    ]
)
CORNER: Final = np.dtype(("<f4", 3))
# dtPoly: its corners, going from z towards x; beyond each side the number of the next polygon, plus 1; kind << 6 | area
POLYGON: Final = np.dtype(
    [
        ("first_link", "<u4"),
        ("corners", "<u2", CORNERS),
        ("neighbours", "<u2", CORNERS),
        ("flags", "<u2"),
        ("count", "u1"),
        ("area", "u1"),
    ]
)
# dtLink: room that the client fills
LINK: Final = np.dtype(("V", 12))
# dtPolyDetail: the triangles of a polygon
DETAIL: Final = np.dtype([("corner", "<u4"), ("triangle", "<u4"), ("corners", "u1"), ("triangles", "u1"), ("", "V2")])
# three corners of the polygon, and for each side 2 bits: whether it is a side of the polygon
TRIANGLE: Final = np.dtype(("u1", 4))
# dtBVNode: a box in steps of 1 / box_scale, and the polygon in it, or -(boxes to go on by where the box is missed)
BOX: Final = np.dtype([("low", "<u2", 3), ("high", "<u2", 3), ("number", "<i4")])

SET_MAGIC: Final = 0x4D534554  # "MSET"
SET_VERSION: Final = 1
MESH_MAGIC: Final = 0x444E4156  # "DNAV"
MESH_VERSION: Final = 7

# of areas, from carla/nav/Navigation.h of LibCarla 0.9.16
FLAGS: Final = {SIDEWALK: 0x02, CROSSWALK: 0x04, ROAD: 0x08}

_HEIGHT, _RADIUS = 1.8, 0.3  # m: of CARLA's walkers, from carla/nav/Navigation.cpp
_CLIMB = 0.4  # m: above or below a polygon that one is on
_STEP = 0.1  # m: the grid of boxes, where 16 bits hold the town
_MARGIN = 1.0  # m: between the outermost corner and the edge of the tile


@lru_cache(maxsize=4)
def navigation_mesh(town: Town) -> bytes:
    """Return the sidewalks and crossings of a town, and some paths across its roads, as a navigation mesh.

    It is empty if the town has no sidewalks, or more than such a mesh can hold.
    """
    if len(town.walks.nodes) > _MOST_NODES:
        return b""
    walkways = WalkwayEditor(town.walks)
    walkways.loosen()
    cross_roads(walkways, town)
    walkways.straighten()
    return mesh_bytes(walkable_surface(walkways))


def prepare_navigation(town: Town) -> None:
    """Compute the navigation mesh of a town before clients ask for it; a failure is logged, and costs only the mesh."""
    try:
        navigation_mesh(town)
    except Exception as error:  # whatever an odd map causes
        _LOG.error("%s: no navigation mesh can be made: %r", town.name, error)


def navigation_files(town: Town) -> dict[str, bytes]:
    """Return the files that a client needs to steer walkers, by name.

    A client caches files in a folder of its own under their names for ever: so a name contains a hash of the file, and
    differs from CARLA's names.
    """
    mesh = navigation_mesh(town)
    return {f"carla-recap/Nav/{sha256(mesh).hexdigest()[:16]}.bin": mesh} if mesh else {}


def mesh_bytes(surface: WalkableSurface) -> bytes:
    """Return a surface as a navigation mesh; no bytes if it is empty, or too large for a tile."""
    if not 0 < len(surface.polygons) <= MOST or len(surface.corners) > MOST:
        return b""
    corners = surface.corners[:, (0, 2, 1)].astype("<f4")
    low, high = corners.min(axis=0) - np.float32(_MARGIN), corners.max(axis=0) + np.float32(_MARGIN)
    polygons = _polygons(surface)
    details, triangles = _details(polygons["count"])
    scale = min(1 / _STEP, MOST / float((high - low).max()))
    boxes = _boxes(surface.polygons, (corners - low) * scale)
    header = np.zeros((), MESH_HEADER)
    header["magic"], header["version"] = MESH_MAGIC, MESH_VERSION
    header["polygons"], header["corners"], header["links"] = len(polygons), len(corners), polygons["count"].sum()
    header["details"], header["triangles"], header["boxes"] = len(details), len(triangles), len(boxes)
    header["first_connection"] = len(polygons)
    header["walker_height"], header["walker_radius"], header["walker_climb"] = _HEIGHT, _RADIUS, _CLIMB
    header["low"], header["high"], header["box_scale"] = low, high, scale
    links = np.zeros(int(header["links"]), LINK)
    tile = b"".join(part.tobytes() for part in (header, corners, polygons, links, details, triangles, boxes))
    return _set_of_one(tile, low, high, len(polygons))


def _set_of_one(tile: bytes, low: NDArray[np.float32], high: NDArray[np.float32], polygons: int) -> bytes:
    bits = polygons.bit_length()
    header, tile_header = np.zeros((), SET_HEADER), np.zeros((), TILE_HEADER)
    header["magic"], header["version"], header["tiles"] = SET_MAGIC, SET_VERSION, 1
    header["origin"], header["tile_size"] = low, (high - low)[[0, 2]]
    header["most_tiles"], header["most_polygons"] = 1, 1 << bits
    tile_header["reference"], tile_header["size"] = 1 << bits, len(tile)  # the first tile, with the salt 1
    return header.tobytes() + tile_header.tobytes() + tile


def _polygons(surface: WalkableSurface) -> NDArray[np.void]:
    rows = np.zeros(len(surface.polygons), POLYGON)
    for row, corners, neighbours in zip(rows, surface.polygons, surface.neighbours, strict=True):
        row["corners"][: len(corners)] = corners
        row["neighbours"][: len(corners)] = [0 if other is None else other + 1 for other in neighbours]
        row["count"] = len(corners)
    rows["area"] = surface.areas
    rows["flags"] = [FLAGS[area] for area in surface.areas]
    return rows


def _details(counts: NDArray[np.uint8]) -> tuple[NDArray[np.void], NDArray[np.uint8]]:
    """Return the triangles of the polygons: fans around their first corners."""
    fans = {count: _fan(count) for count in set(counts.tolist())}
    details = np.zeros(len(counts), DETAIL)
    details["triangles"] = counts - 2
    details["triangle"][1:] = np.cumsum(counts - 2, dtype=np.uint32)[:-1]
    return details, np.concatenate([fans[count] for count in counts.tolist()])


def _fan(count: int) -> NDArray[np.uint8]:
    fan = [(0, corner, corner + 1, 0b000100) for corner in range(1, count - 1)]
    fan[0] = (*fan[0][:3], fan[0][3] | 0b000001)
    fan[-1] = (*fan[-1][:3], fan[-1][3] | 0b010000)
    return np.array(fan, np.uint8)


def _boxes(polygons: list[tuple[int, ...]], corners: NDArray[np.float32]) -> NDArray[np.void]:
    """Return a tree of boxes around the polygons, each before its children; the corners are in steps of the boxes' grid."""
    low = np.array([np.floor(corners[list(polygon)].min(axis=0)) for polygon in polygons], np.uint16)
    high = np.array([np.ceil(corners[list(polygon)].max(axis=0)) for polygon in polygons], np.uint16)
    boxes = np.zeros(2 * len(polygons) - 1, BOX)
    rest: list[tuple[int, Integers]] = [(0, np.arange(len(polygons)))]
    while rest:
        index, inside = rest.pop()
        box = boxes[index]
        box["low"], box["high"] = low[inside].min(axis=0), high[inside].max(axis=0)
        if len(inside) == 1:
            box["number"] = inside[0]
            continue
        box["number"] = 1 - 2 * len(inside)
        axis = int(np.argmax(box["high"] - box["low"]))
        inside = inside[np.argsort(low[inside, axis], kind="stable")]
        half = len(inside) // 2
        rest += [(index + 1, inside[:half]), (index + 2 * half, inside[half:])]
    return boxes
