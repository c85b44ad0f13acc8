"""A town as triangle meshes, from an OpenDRIVE map."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from hashlib import sha256
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import FormatError, RecapError, RecapWarning
from carla_recap.replay.recorded_map import LONGEST_DRIVEN, load_map_of
from carla_recap.roads.corridors import is_of_corridors
from carla_recap.roads.files import content_digest, expecting, read_parts
from carla_recap.roads.lanes import TownRoads
from carla_recap.roads.opendrive import read_opendrive
from carla_recap.scene.materials import Material
from carla_recap.scene.mesh import Mesh
from carla_recap.town.building import MeshBuilder, TriangleGrid
from carla_recap.town.markings import Painter, add_lines, paint_objects, paint_stops
from carla_recap.town.road_surfaces import PAVED, add_lanes, driving_grid, fill_junctions, sample_roads, surface_grid
from carla_recap.town.roadside import LightPost, add_barriers, add_signs, add_trees, light_posts
from carla_recap.town.terrain import Terrain, add_edges
from carla_recap.util.cache import kept

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.recording import Recording
    from carla_recap.roads import RoadMap
    from carla_recap.util.arrays import Floats


_KEPT: Final = 4  # towns in memory
TOWN_SOURCES: Final = ("town", "roads", "scene")  # the folders of the modules that a town is made by
_PAVEMENT: Final = (*PAVED, Material.JUNCTION)
_SURFACES: Final = (*_PAVEMENT, Material.SIDEWALK, Material.KERB, Material.MEDIAN, Material.GROUND)
_GROUND: Final = (*_SURFACES, Material.GRASS)
_LEAST_UPWARDS: Final = 0.3  # of a normal, of a surface on which one can stand


@dataclass(frozen=True, eq=False)
class TownMesh:
    """The ground and the furniture of a town: all that does not move, but the lamps of traffic lights.

    Attributes:
        name: The name of the map; empty where there is none.
        tiles: The triangles by squares of about 50 m, none of which is empty.
        lights: The traffic lights of the map.
        digest: A digest of the map; empty where there is none.
    """

    name: str
    tiles: list[Mesh]
    lights: list[LightPost] = field(default_factory=list)
    digest: bytes = b""

    @cached_property
    def bounds(self) -> Floats:
        """The least and the largest corner of each tile, (tiles, 2, 3), in m."""
        bounds = [(tile.vertices.min(axis=0), tile.vertices.max(axis=0)) for tile in self.tiles]
        return np.array(bounds, np.float64).reshape(-1, 2, 3)

    def ground_height(self, points: Floats) -> Floats:
        """Return the height of the ground at points, in m; NaN where there is none.

        Args:
            points: Rows of x, y, (n, 2): the highest ground; or of x, y, z, (n, 3): the highest that is not above z by
                more than 0.5 m.
        """
        return self._ground.highest(np.asarray(points, np.float64))

    @cached_property
    def _ground(self) -> TriangleGrid:
        mesh = Mesh.concatenate(self.tiles)
        corners = mesh.triangles
        flat = (mesh.normals[corners[:, 0], 2] > _LEAST_UPWARDS) & np.isin(mesh.materials[corners[:, 0]], _GROUND)
        return TriangleGrid(mesh.vertices.astype(np.float64), corners[flat].astype(np.int64))


def load_town_mesh(path: Path | str) -> TownMesh:
    """Return the town of an OpenDRIVE file.

    Args:
        path: The file, such as `Town01.xodr`.

    Raises:
        RecapError: The file cannot be read, or is no OpenDRIVE map with lanes.
    """
    path = Path(path)
    return _town_mesh(path.stem, path, content_digest(path))


def town_mesh_of(opendrive: str, name: str = "") -> TownMesh:
    """Return the town of the text of an OpenDRIVE file.

    Raises:
        FormatError: It is no OpenDRIVE map with lanes.
    """
    digest = sha256(opendrive.encode("utf-8", "replace")).digest()
    return _town_mesh(name, Path(name or "map"), digest, opendrive)


def load_town_of(
    recording: Recording,
    path: Path | str | None = None,
    start: float = 0.0,
    duration: float = 0.0,
    *,
    longest: float = LONGEST_DRIVEN,
) -> TownMesh | None:
    """Return the town of a recording; see `carla_recap.replay.recorded_map.load_map_of`."""
    return load_map_of(recording, path, load_town_mesh, town_of_map, start, duration, longest=longest)


def town_of_map(road_map: RoadMap | None) -> TownMesh | None:
    """Return the town of a map; None without a map, or without surfaces in it.

    Warns:
        RecapWarning: The surfaces cannot be made.
    """
    if road_map is None or not road_map.opendrive:
        return None
    try:
        return town_mesh_of(road_map.opendrive, road_map.name)
    except RecapError as error:
        warnings.warn(f"the roads have no surfaces: {error}", RecapWarning, stacklevel=2)
        return None


@lru_cache(maxsize=_KEPT)
def _town_mesh(name: str, path: Path, digest: bytes, text: str | None = None) -> TownMesh:
    """Return the town of a text, or of a file."""
    with expecting(path):
        arrays = kept(digest, "town", TOWN_SOURCES, lambda: _arrays(*build_town(read_parts(path) if text is None else text)))
    columns = [arrays[column] for column in _COLUMNS]
    if not columns[0]:
        raise FormatError(path, None, "an OpenDRIVE map was expected, and no lane is in it")
    lights = [
        LightPost(id, row[:3], row[3].item()) for id, row in zip(arrays["ids"][0].tolist(), arrays["lights"][0], strict=True)
    ]
    return TownMesh(name, [Mesh(*parts) for parts in zip(*columns, strict=True)], lights, digest)


_COLUMNS: Final = ("vertices", "normals", "materials", "triangles")


def _arrays(tiles: list[Mesh], lights: list[LightPost]) -> dict[str, list[NDArray[Any]]]:
    """Return tiles and lights as arrays."""
    rows = np.array([(*light.location, light.heading) for light in lights]).reshape(-1, 4)
    ids = np.array([light.id for light in lights], np.str_)
    return {column: [getattr(tile, column) for tile in tiles] for column in _COLUMNS} | {"lights": [rows], "ids": [ids]}


def build_town(text: str | Iterable[str]) -> tuple[list[Mesh], list[LightPost]]:
    """Return the tiles and lights of the text of an OpenDRIVE file, or of its parts, made in this process.

    Raises:
        ValueError: It is no OpenDRIVE file.
    """
    with np.errstate(all="ignore"):
        parts = iter((text,) if isinstance(text, str) else text)
        start = next(parts, "")
        content = read_opendrive(chain((start,), parts))
        roads = content.roads
        sections = sample_roads(roads)
        if not sections:
            return [], []
        surfaces, driving = surface_grid(sections), driving_grid(sections)
        builder = MeshBuilder()
        add_lanes(builder, sections, driving)
        fill_junctions(builder, sections, surfaces)
        surfaces, pavement = builder.grid(_SURFACES), builder.grid(_PAVEMENT)
        terrain = Terrain(sections)
        add_edges(builder, sections, terrain, surfaces)
        terrain.add_to(builder)
        add_lines(builder, sections, driving)
        painter = Painter(builder, pavement)
        for road in roads:
            paint_objects(painter, road)
        paint_stops(painter, roads)
        painter.finish()
        if not is_of_corridors(start):
            add_trees(builder, sections, surfaces, terrain)
            add_barriers(builder, TownRoads(content, sys.maxsize).lanes)  # `sample_roads` has limited them
        ground = builder.grid(_GROUND)
        add_signs(builder, roads, ground, driving)
        return builder.tiles(), light_posts(roads, ground)
