"""What lies on the ground: the surfaces of the town, in pieces that a viewer can cull, and marks of collisions."""

from __future__ import annotations

from collections import defaultdict
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.replay.recorded_map import corridors_of, map_around
from carla_recap.scene.marks import MARK_RADIUS
from carla_recap.scene.mesh import Mesh
from carla_recap.scene.models import INDEX, MODELS
from carla_recap.show.foxglove.bodies import TIMESTAMP, mesh_shape
from carla_recap.show.foxglove.messages import ALL_DELETED, WORLD, MessagePart, SceneEntity, SceneUpdate, single
from carla_recap.town.mesh import town_of_map

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carla_recap.recording import Recording
    from carla_recap.replay import Player
    from carla_recap.roads import RoadMap
    from carla_recap.scene.description import SceneDescription
    from carla_recap.show.foxglove.messages import Stamps, TopicMessages
    from carla_recap.town.mesh import TownMesh
    from carla_recap.util.arrays import Floats

MAP: Final = "/map"
MARKS: Final = "/scene/marks"

_SHORT: Final = 180.0  # s; of longer recordings, corridors take too long to find
_PIECE: Final = 200.0  # m; the side of the pieces into which the tiles are put together
_ABOVE: Final = 0.02  # m; of a drawn mark above its location


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


def map_message(town: TownMesh | None, stamp: Stamps) -> bytes:
    """Return the surfaces of a town as a `SceneUpdate`, an entity for each piece; empty without a town."""
    pieces: defaultdict[tuple[int, int], list[Mesh]] = defaultdict(list)
    for tile, bounds in () if town is None else zip(town.tiles, town.bounds, strict=True):
        x, y = np.floor(bounds.mean(axis=0)[:2] / _PIECE).astype(int).tolist()
        pieces[x, y].append(tile)
    return b"".join(_entity(f"ground {x} {y}", Mesh.concatenate(tiles), stamp) for (x, y), tiles in sorted(pieces.items()))


def mark_messages(description: SceneDescription, stamps: Stamps) -> Iterator[TopicMessages]:
    """Yield the messages of the marks: each has all of them, whenever one appears or disappears."""
    changes = description.marks
    if description.batch.fresh and not (changes and changes[0][0] == 0):
        changes = [(0, description.marked), *changes]
    for row, locations in changes:
        data = b"".join(_entity(f"collision {n}", _mark(place), stamps[row]) for n, place in enumerate(locations))
        yield single(MARKS, row, ALL_DELETED.SerializeToString() + data)


def _mark(location: Floats) -> Mesh:
    model = MODELS[INDEX["collision mark"]].mesh
    vertices = model.vertices * (MARK_RADIUS, MARK_RADIUS, 0.0) + location + (0.0, 0.0, _ABOVE)
    return replace(model, vertices=vertices.astype(np.float32))


def _entity(id: str, mesh: Mesh, stamp: Stamps) -> bytes:
    data = SceneEntity(frame_id=WORLD, id=id).SerializeToString() + mesh_shape(mesh)
    entity = (MessagePart(data) + TIMESTAMP).within(SceneUpdate.ENTITIES_FIELD_NUMBER).data
    return entity[: -stamp.size] + stamp.tobytes()
