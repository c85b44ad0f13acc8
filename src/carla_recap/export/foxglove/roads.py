"""A road map as a 3D scene."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.export.foxglove.entities import WORLD, color
from carla_recap.export.foxglove.schemas import LinePrimitive, Point3, SceneEntity, SceneUpdate
from carla_recap.export.style import ROADS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.export.style import Color
    from carla_recap.maps import RoadMap

    Floats = NDArray[np.float64]

MAP: Final = "/map"


def map_message(road_map: RoadMap | None, time: int) -> SceneUpdate:
    """All lines of a map, an entity for those of a kind.

    Args:
        road_map: The map; None: the message is empty.
        time: Since when they are there, in nanoseconds since 1970.
    """
    if road_map is None:
        return SceneUpdate()
    entities = [_entity(name, getattr(road_map, name), rgb, width) for name, rgb, width in ROADS]
    for entity in entities:
        entity.timestamp.FromNanoseconds(time)
    return SceneUpdate(entities=entities)


def _entity(name: str, lines: list[Floats], rgb: Color, width: float) -> SceneEntity:
    ends = [np.repeat(line, 2, axis=0)[1:-1] for line in lines]  # of each piece of each line
    points = np.concatenate(ends).tolist() if ends else []
    primitive = LinePrimitive(
        type=LinePrimitive.LINE_LIST,
        thickness=width,
        color=color(rgb),
        points=[Point3(x=x, y=y, z=z) for x, y, z in points],
    )
    primitive.pose.orientation.w = 1.0
    return SceneEntity(frame_id=WORLD, id=name.replace("_", " "), lines=[primitive])
