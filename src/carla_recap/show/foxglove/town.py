"""The town: its surfaces as triangles, in pieces that a viewer can cull."""

from __future__ import annotations

from collections import defaultdict
from contextlib import suppress
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.rendering.town import town_of_map
from carla_recap.replay.recorded_map import corridors_of, map_around
from carla_recap.scene.mesh import Mesh
from carla_recap.show.foxglove import shapes
from carla_recap.show.foxglove.messages import WORLD, MessagePart, SceneEntity, SceneUpdate

if TYPE_CHECKING:
    from carla_recap.recording import Recording
    from carla_recap.rendering.town import TownMesh
    from carla_recap.replay import Player
    from carla_recap.roads import RoadMap

MAP: Final = "/map"

_SHORT: Final = 180.0  # s; of longer recordings, corridors take too long to find
_PIECE: Final = 200.0  # m; the side of the pieces into which the tiles are put together


def town_around(road_map: RoadMap | None, player: Player, source: Recording) -> TownMesh | None:
    """Return the town of a map; without one, the corridors that vehicles drive in a short recording, else None.

    Warns:
        RecapWarning: The map is that of another town, or its surfaces cannot be made.
    """
    town = town_of_map(map_around(road_map, player))
    if town is None and player.total <= _SHORT:
        with suppress(RecapError), np.errstate(all="ignore"):  # a viewer without roads shows all the rest
            town = town_of_map(corridors_of(source))
    return town


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
