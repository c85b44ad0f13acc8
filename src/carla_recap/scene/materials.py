"""The materials of all surfaces: their colours and CARLA's semantic tags."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

Color = tuple[int, int, int]
"""Red, green, blue, from 0 to 255."""


class Tag(IntEnum):
    """The semantic tags of CARLA 0.9.16 (`carla.CityObjectLabel`)."""

    UNLABELLED = 0
    ROADS = 1
    SIDEWALKS = 2
    BUILDINGS = 3
    WALLS = 4
    FENCES = 5
    POLES = 6
    TRAFFIC_LIGHT = 7
    TRAFFIC_SIGNS = 8
    VEGETATION = 9
    TERRAIN = 10
    SKY = 11
    PEDESTRIANS = 12
    RIDER = 13
    CAR = 14
    TRUCK = 15
    BUS = 16
    TRAIN = 17
    MOTORCYCLE = 18
    BICYCLE = 19
    STATIC = 20
    DYNAMIC = 21
    OTHER = 22
    WATER = 23
    ROAD_LINES = 24
    GROUND = 25
    BRIDGE = 26
    RAIL_TRACK = 27
    GUARD_RAIL = 28


TAG_COLORS: Final[tuple[Color, ...]] = (
    *((0, 0, 0), (128, 64, 128), (244, 35, 232), (70, 70, 70), (102, 102, 156), (190, 153, 153), (153, 153, 153)),
    *((250, 170, 30), (220, 220, 0), (107, 142, 35), (152, 251, 152), (70, 130, 180), (220, 20, 60), (255, 0, 0)),
    *((0, 0, 142), (0, 0, 70), (0, 60, 100), (0, 80, 100), (0, 0, 230), (119, 11, 32), (110, 190, 160)),
    *((170, 120, 50), (55, 90, 80), (45, 60, 150), (157, 234, 50), (81, 0, 81), (150, 100, 100), (230, 150, 140)),
    (180, 165, 180),
)
"""The colours of the tags in CARLA's `ColorConverter.CityScapesPalette`."""


class Finish(NamedTuple):
    """How a material looks."""

    color: Color  # the colour in white light; of a lamp, that of the unlit lamp. Paint has the actor's colour instead
    tag: Tag | None = None  # the semantic tag; None: that of the actor
    glow: Color | None = None  # the colour of a lamp that is lit; None: it is no lamp
    gloss: float = 0.0  # the share of light that is reflected like by a mirror, 0 to 1


class Material(IntEnum):
    """The material of a vertex: an index of `MATERIALS`, and its `Finish`."""

    finish: Finish

    def __new__(cls, number: int, *finish: Any) -> Self:
        """Return a material with its finish."""
        material = int.__new__(cls, number)
        material._value_, material.finish = number, Finish(*finish)
        return material

    GRASS = 0, (101, 116, 76), Tag.TERRAIN
    GROUND = 1, (134, 128, 112), Tag.GROUND
    MEDIAN = 2, (118, 120, 112), Tag.GROUND
    SHOULDER = 3, (80, 80, 82), Tag.ROADS
    PARKING = 4, (82, 83, 88), Tag.ROADS
    BIKE_LANE = 5, (124, 74, 66), Tag.ROADS
    ROAD = 6, (70, 71, 74), Tag.ROADS
    JUNCTION = 7, (70, 71, 74), Tag.ROADS
    SIDEWALK = 8, (164, 160, 152), Tag.SIDEWALKS
    KERB = 9, (186, 184, 178), Tag.SIDEWALKS
    BRIDGE = 10, (150, 150, 148), Tag.BRIDGE
    CROSSING = 11, (224, 224, 220), Tag.ROAD_LINES
    WHITE_LINE = 12, (228, 228, 224), Tag.ROAD_LINES
    YELLOW_LINE = 13, (226, 180, 48), Tag.ROAD_LINES
    STOP_LINE = 14, (232, 232, 228), Tag.ROAD_LINES
    COLLISION_MARK = 15, (214, 40, 40), Tag.ROADS
    POLE = 16, (96, 100, 104), Tag.POLES
    LIGHT_HOUSING = 17, (38, 40, 42), Tag.TRAFFIC_LIGHT
    SIGN_BACK = 18, (150, 152, 154), Tag.TRAFFIC_SIGNS
    SIGN_WHITE = 19, (236, 236, 234), Tag.TRAFFIC_SIGNS
    SIGN_RED = 20, (196, 34, 40), Tag.TRAFFIC_SIGNS
    SIGN_YELLOW = 21, (240, 192, 40), Tag.TRAFFIC_SIGNS
    RED_LAMP = 22, (64, 20, 20), Tag.TRAFFIC_LIGHT, (255, 48, 40)
    YELLOW_LAMP = 23, (64, 52, 16), Tag.TRAFFIC_LIGHT, (255, 200, 40)
    GREEN_LAMP = 24, (16, 56, 32), Tag.TRAFFIC_LIGHT, (48, 240, 120)
    PAINT = 25, (200, 200, 200), None, None, 0.35
    SECOND_PAINT = 26, (235, 235, 235), None, None, 0.3
    GLASS = 27, (32, 40, 50), None, None, 0.6
    TRIM = 28, (44, 45, 48), None, None, 0.1
    CHROME = 29, (176, 180, 184), None, None, 0.6
    TYRE = 30, (30, 30, 32)
    RIM = 31, (142, 146, 150), None, None, 0.4
    HEADLIGHT = 32, (172, 182, 192), None, (255, 252, 226), 0.4
    TAIL_LIGHT = 33, (110, 18, 22), None, (255, 44, 40), 0.3
    LEFT_INDICATOR = 34, (150, 92, 28), None, (255, 170, 40), 0.3
    RIGHT_INDICATOR = 35, (150, 92, 28), None, (255, 170, 40), 0.3
    REVERSE_LIGHT = 36, (190, 190, 192), None, (255, 255, 255), 0.3
    BEACON = 37, (36, 60, 140), None, (70, 130, 255), 0.3
    SKIN = 38, (198, 152, 124)
    HAIR = 39, (58, 42, 34)
    TROUSERS = 40, (58, 66, 84)
    SHOES = 41, (40, 38, 38)
    RIDER_SKIN = 42, (198, 152, 124), Tag.RIDER
    RIDER_CLOTHES = 43, (70, 90, 120), Tag.RIDER
    RIDER_TROUSERS = 44, (54, 56, 62), Tag.RIDER
    RIDER_HELMET = 45, (220, 220, 216), Tag.RIDER, None, 0.2
    WOOD = 46, (136, 104, 72)
    CARDBOARD = 47, (182, 148, 104)
    CONCRETE = 48, (168, 166, 160)
    WARNING_ORANGE = 49, (240, 106, 34)
    FOLIAGE = 50, (74, 106, 54), Tag.VEGETATION
    SIGN_BLACK = 51, (34, 34, 36), Tag.TRAFFIC_SIGNS
    BRAKE_LIGHT = 52, (96, 14, 18), None, (255, 44, 40), 0.3
    FAIR_SKIN = 53, (232, 190, 164)
    DARK_SKIN = 54, (116, 78, 58)
    FAIR_HAIR = 55, (176, 134, 80)
    DARK_HAIR = 56, (30, 26, 26)
    JEANS = 57, (60, 86, 128)
    LIGHT_TROUSERS = 58, (164, 150, 128)
    YELLOW_BAND = 59, (240, 192, 40), None, None, 0.2
    RED_BAND = 60, (196, 34, 40), None, None, 0.2
    TRUNK = 61, (98, 80, 62), Tag.VEGETATION
    PLAIN = 62, (200, 200, 200)
    GUARD_RAIL = 63, (166, 170, 172), Tag.GUARD_RAIL
    FENCE = 64, (84, 92, 88), Tag.FENCES


MATERIALS: Final = {material: material.finish for material in Material}
"""The finishes of all materials."""
LAMPS: Final = tuple(material for material, finish in MATERIALS.items() if finish.glow)
"""The materials that are lamps."""
LAMP_BITS: Final = np.uint64(sum(1 << lamp for lamp in LAMPS))
"""Their bits in `Instances.lamps`."""
SIGNAL_LAMPS: Final = (Material.RED_LAMP, Material.YELLOW_LAMP, Material.GREEN_LAMP)
"""The lamps of traffic lights, in the order of CARLA's states."""


def palette() -> NDArray[np.uint8]:
    """Return the colours of all materials, by their numbers: (materials, 3)."""
    return np.array([MATERIALS[material].color for material in Material], np.uint8)
