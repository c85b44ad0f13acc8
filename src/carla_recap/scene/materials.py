"""The materials of all surfaces: their colours and CARLA's semantic tags."""

from __future__ import annotations

from enum import IntEnum
from typing import TYPE_CHECKING, Final, NamedTuple

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


class Material(IntEnum):
    """The material of a vertex: an index of `MATERIALS`."""

    GRASS = 0
    GROUND = 1
    MEDIAN = 2
    SHOULDER = 3
    PARKING = 4
    BIKE_LANE = 5
    ROAD = 6
    JUNCTION = 7
    SIDEWALK = 8
    KERB = 9
    BRIDGE = 10
    CROSSING = 11
    WHITE_LINE = 12
    YELLOW_LINE = 13
    STOP_LINE = 14
    COLLISION_MARK = 15
    POLE = 16
    LIGHT_HOUSING = 17
    SIGN_BACK = 18
    SIGN_WHITE = 19
    SIGN_RED = 20
    SIGN_YELLOW = 21
    RED_LAMP = 22
    YELLOW_LAMP = 23
    GREEN_LAMP = 24
    PAINT = 25
    SECOND_PAINT = 26
    GLASS = 27
    TRIM = 28
    CHROME = 29
    TYRE = 30
    RIM = 31
    HEADLIGHT = 32
    TAIL_LIGHT = 33
    LEFT_INDICATOR = 34
    RIGHT_INDICATOR = 35
    REVERSE_LIGHT = 36
    BEACON = 37
    SKIN = 38
    HAIR = 39
    TROUSERS = 40
    SHOES = 41
    RIDER_SKIN = 42
    RIDER_CLOTHES = 43
    RIDER_TROUSERS = 44
    RIDER_HELMET = 45
    WOOD = 46
    CARDBOARD = 47
    CONCRETE = 48
    WARNING_ORANGE = 49
    FOLIAGE = 50
    SIGN_BLACK = 51
    BRAKE_LIGHT = 52
    FAIR_SKIN = 53
    DARK_SKIN = 54
    FAIR_HAIR = 55
    DARK_HAIR = 56
    JEANS = 57
    LIGHT_TROUSERS = 58
    YELLOW_BAND = 59
    RED_BAND = 60
    TRUNK = 61
    PLAIN = 62
    GUARD_RAIL = 63
    FENCE = 64


class Finish(NamedTuple):
    """How a material looks."""

    color: Color  # the colour in white light; of a lamp, that of the unlit lamp. Paint has the actor's colour instead
    tag: Tag | None = None  # the semantic tag; None: that of the actor
    glow: Color | None = None  # the colour of a lamp that is lit; None: it is no lamp
    gloss: float = 0.0  # the share of light that is reflected like by a mirror, 0 to 1


_M: Final = Material
MATERIALS: Final[dict[Material, Finish]] = {
    _M.GRASS: Finish((101, 116, 76), Tag.TERRAIN),
    _M.GROUND: Finish((134, 128, 112), Tag.GROUND),
    _M.MEDIAN: Finish((118, 120, 112), Tag.GROUND),
    _M.SHOULDER: Finish((80, 80, 82), Tag.ROADS),
    _M.PARKING: Finish((82, 83, 88), Tag.ROADS),
    _M.BIKE_LANE: Finish((124, 74, 66), Tag.ROADS),
    _M.ROAD: Finish((70, 71, 74), Tag.ROADS),
    _M.JUNCTION: Finish((70, 71, 74), Tag.ROADS),
    _M.SIDEWALK: Finish((164, 160, 152), Tag.SIDEWALKS),
    _M.KERB: Finish((186, 184, 178), Tag.SIDEWALKS),
    _M.BRIDGE: Finish((150, 150, 148), Tag.BRIDGE),
    _M.CROSSING: Finish((224, 224, 220), Tag.ROAD_LINES),
    _M.WHITE_LINE: Finish((228, 228, 224), Tag.ROAD_LINES),
    _M.YELLOW_LINE: Finish((226, 180, 48), Tag.ROAD_LINES),
    _M.STOP_LINE: Finish((232, 232, 228), Tag.ROAD_LINES),
    _M.COLLISION_MARK: Finish((214, 40, 40), Tag.ROADS),
    _M.POLE: Finish((96, 100, 104), Tag.POLES),
    _M.LIGHT_HOUSING: Finish((38, 40, 42), Tag.TRAFFIC_LIGHT),
    _M.SIGN_BACK: Finish((150, 152, 154), Tag.TRAFFIC_SIGNS),
    _M.SIGN_WHITE: Finish((236, 236, 234), Tag.TRAFFIC_SIGNS),
    _M.SIGN_RED: Finish((196, 34, 40), Tag.TRAFFIC_SIGNS),
    _M.SIGN_YELLOW: Finish((240, 192, 40), Tag.TRAFFIC_SIGNS),
    _M.RED_LAMP: Finish((64, 20, 20), Tag.TRAFFIC_LIGHT, (255, 48, 40)),
    _M.YELLOW_LAMP: Finish((64, 52, 16), Tag.TRAFFIC_LIGHT, (255, 200, 40)),
    _M.GREEN_LAMP: Finish((16, 56, 32), Tag.TRAFFIC_LIGHT, (48, 240, 120)),
    _M.PAINT: Finish((200, 200, 200), gloss=0.35),
    _M.SECOND_PAINT: Finish((235, 235, 235), gloss=0.3),
    _M.GLASS: Finish((32, 40, 50), gloss=0.6),
    _M.TRIM: Finish((44, 45, 48), gloss=0.1),
    _M.CHROME: Finish((176, 180, 184), gloss=0.6),
    _M.TYRE: Finish((30, 30, 32)),
    _M.RIM: Finish((142, 146, 150), gloss=0.4),
    _M.HEADLIGHT: Finish((172, 182, 192), glow=(255, 252, 226), gloss=0.4),
    _M.TAIL_LIGHT: Finish((110, 18, 22), glow=(255, 44, 40), gloss=0.3),
    _M.LEFT_INDICATOR: Finish((150, 92, 28), glow=(255, 170, 40), gloss=0.3),
    _M.RIGHT_INDICATOR: Finish((150, 92, 28), glow=(255, 170, 40), gloss=0.3),
    _M.REVERSE_LIGHT: Finish((190, 190, 192), glow=(255, 255, 255), gloss=0.3),
    _M.BEACON: Finish((36, 60, 140), glow=(70, 130, 255), gloss=0.3),
    _M.SKIN: Finish((198, 152, 124)),
    _M.HAIR: Finish((58, 42, 34)),
    _M.TROUSERS: Finish((58, 66, 84)),
    _M.SHOES: Finish((40, 38, 38)),
    _M.RIDER_SKIN: Finish((198, 152, 124), Tag.RIDER),
    _M.RIDER_CLOTHES: Finish((70, 90, 120), Tag.RIDER),
    _M.RIDER_TROUSERS: Finish((54, 56, 62), Tag.RIDER),
    _M.RIDER_HELMET: Finish((220, 220, 216), Tag.RIDER, gloss=0.2),
    _M.WOOD: Finish((136, 104, 72)),
    _M.CARDBOARD: Finish((182, 148, 104)),
    _M.CONCRETE: Finish((168, 166, 160)),
    _M.WARNING_ORANGE: Finish((240, 106, 34)),
    _M.FOLIAGE: Finish((74, 106, 54), Tag.VEGETATION),
    _M.SIGN_BLACK: Finish((34, 34, 36), Tag.TRAFFIC_SIGNS),
    _M.BRAKE_LIGHT: Finish((96, 14, 18), glow=(255, 44, 40), gloss=0.3),
    _M.FAIR_SKIN: Finish((232, 190, 164)),
    _M.DARK_SKIN: Finish((116, 78, 58)),
    _M.FAIR_HAIR: Finish((176, 134, 80)),
    _M.DARK_HAIR: Finish((30, 26, 26)),
    _M.JEANS: Finish((60, 86, 128)),
    _M.LIGHT_TROUSERS: Finish((164, 150, 128)),
    _M.YELLOW_BAND: Finish((240, 192, 40), gloss=0.2),
    _M.RED_BAND: Finish((196, 34, 40), gloss=0.2),
    _M.TRUNK: Finish((98, 80, 62), Tag.VEGETATION),
    _M.PLAIN: Finish((200, 200, 200)),
    _M.GUARD_RAIL: Finish((166, 170, 172), Tag.GUARD_RAIL),
    _M.FENCE: Finish((84, 92, 88), Tag.FENCES),
}
"""All materials."""
LAMPS: Final = tuple(material for material, finish in MATERIALS.items() if finish.glow)
"""The materials that are lamps."""
LAMP_BITS: Final = np.uint64(sum(1 << lamp for lamp in LAMPS))
"""Their bits in `Instances.lamps`."""
SIGNAL_LAMPS: Final = (_M.RED_LAMP, _M.YELLOW_LAMP, _M.GREEN_LAMP)
"""The lamps of traffic lights, in the order of CARLA's states."""


def palette() -> NDArray[np.uint8]:
    """Return the colours of all materials, by their numbers: (materials, 3)."""
    return np.array([MATERIALS[material].color for material in Material], np.uint8)
