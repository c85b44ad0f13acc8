"""The town: its surfaces as triangles, in pieces that a viewer can cull."""

from __future__ import annotations

import warnings
from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.rendering.town import corridor_town, town_mesh_of
from carla_recap.replay import Player, right_handed
from carla_recap.scene.mesh import Mesh
from carla_recap.show.foxglove import shapes
from carla_recap.show.foxglove.messages import WORLD, MessagePart, SceneEntity, SceneUpdate

if TYPE_CHECKING:
    from carla_recap.recording import Recording
    from carla_recap.rendering.town import TownMesh
    from carla_recap.roads import RoadMap

MAP: Final = "/map"

_MARGIN: Final = 100.0  # m; the distance from the town at which an actor is still in it
_SHORT: Final = 180.0  # s; of longer recordings, corridors take too long to find
_PIECE: Final = 200.0  # m; the side of the pieces into which the tiles are put together


def town_of(road_map: RoadMap | None, player: Player, source: Recording) -> TownMesh | None:
    """Return the surfaces of a map; without one, the corridors that vehicles drive in a short recording, else None.

    Warns:
        RecapWarning: The map is that of another town, or its surfaces cannot be made.
    """
    if road_map is None or not road_map.opendrive:
        return _corridors(source) if player.total <= _SHORT else None
    town = mesh_of(road_map)
    if town is None:
        return None
    locations = right_handed(Player(player.reader).at(player.start).poses)[:, :2]
    locations = locations[np.isfinite(locations).all(axis=1)]
    low, high = town.bounds[:, 0, :2].min(axis=0) - _MARGIN, town.bounds[:, 1, :2].max(axis=0) + _MARGIN
    if len(locations) and not ((locations > low) & (locations < high)).all(axis=1).any():
        warnings.warn(f"{road_map.name}: no actor is near this map, which is left out", RecapWarning, stacklevel=3)
        return _corridors(source) if player.total <= _SHORT else None
    return town


def mesh_of(road_map: RoadMap) -> TownMesh | None:
    """Return the surfaces of a map; None if they cannot be made.

    Warns:
        RecapWarning: They cannot.
    """
    if not road_map.opendrive:
        return None
    try:
        return town_mesh_of(road_map.opendrive, road_map.name)
    except RecapError as error:
        warnings.warn(f"the roads have no surfaces: {error}", RecapWarning, stacklevel=4)
        return None


def _corridors(source: Recording) -> TownMesh | None:
    try:
        with np.errstate(all="ignore"):
            return corridor_town(source)
    except RecapError:  # a viewer without roads shows all the rest
        return None


def map_message(town: TownMesh | None, time: int) -> bytes:
    """Return the surfaces of a town as a `SceneUpdate`, an entity for each piece; empty without a town.

    Args:
        town: The town.
        time: The beginning of the recording, in ns since 1970.
    """
    if town is None:
        return SceneUpdate().SerializeToString()
    pieces: defaultdict[tuple[int, int], list[Mesh]] = defaultdict(list)
    for tile, bounds in zip(town.tiles, town.bounds, strict=True):
        x, y = np.floor(bounds.mean(axis=0)[:2] / _PIECE).astype(int).tolist()
        pieces[x, y].append(tile)
    return b"".join(_piece(f"ground {x} {y}", Mesh.concatenate(tiles), time) for (x, y), tiles in sorted(pieces.items()))


def _piece(id: str, mesh: Mesh, time: int) -> bytes:
    entity = SceneEntity(frame_id=WORLD, id=id)
    entity.timestamp.FromNanoseconds(time)
    data = entity.SerializeToString() + shapes.mesh(mesh)
    return MessagePart(data).within(SceneUpdate.ENTITIES_FIELD_NUMBER).data
