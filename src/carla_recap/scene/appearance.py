"""How each actor looks: its model, size, colour and semantic tag."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, Final, NamedTuple

from carla_recap.model.blueprints import blueprint_box, other_names
from carla_recap.model.lives import BoundingBox
from carla_recap.model.records import ActorKind
from carla_recap.scene.materials import Color, Tag
from carla_recap.scene.models import INDEX, MODELS, own_model

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.model.lives import ActorLife

Triple = tuple[float, float, float]


class Look(NamedTuple):
    """The look of an actor."""

    model: int  # the index of its model
    color: Color  # the paint
    half_extents: Triple  # half the size of its box in m
    center: Triple  # the middle of its box in its own right-handed axes, in m
    tag: Tag  # its semantic tag


_VEHICLES: Final = (
    ("fire engine", "firetruck"),
    ("ambulance", "ambulance"),
    ("police car", "police"),
    ("taxi", "taxi crown"),
    ("bus", "fusorosa bus"),
    ("box truck", "carlacola"),
    ("lorry", "hgv"),
    ("pickup", "cybertruck pickup"),
    ("van", "sprinter"),
    ("minibus", "t2"),
    ("scooter", "vespa"),
    ("motorcycle", "low_rider ninja yzf"),
    ("bicycle", "crossbike century omafiets"),
    ("off-roader", "wrangler"),
    ("suv", "patrol etron"),
    ("coupe", "audi.tt mustang coupe"),
    ("hatchback", "audi.a2 grandtourer c3"),
    ("microcar", "microlino isetta"),
    ("hatchback", "mini micra leon"),
    ("sedan", "prius model3 impala charger mkz"),
)
"""The models of vehicles whose names contain one of some words; the first words count."""

_TAGS: Final = {
    "box truck": Tag.TRUCK,
    "lorry": Tag.TRUCK,
    "fire engine": Tag.TRUCK,
    "pickup": Tag.TRUCK,
    "bus": Tag.BUS,
    "motorcycle": Tag.MOTORCYCLE,
    "scooter": Tag.MOTORCYCLE,
    "bicycle": Tag.BICYCLE,
}
BASE_TYPES: Final = {
    "car": Tag.CAR,
    "van": Tag.CAR,
    "truck": Tag.TRUCK,
    "bus": Tag.BUS,
    "motorcycle": Tag.MOTORCYCLE,
    "bicycle": Tag.BICYCLE,
}

_PROPS: Final[tuple[tuple[str, str, Color], ...]] = (
    ("cone", "cone", (240, 106, 34)),
    ("chainbarrier", "chain barrier", (220, 60, 50)),
    ("barrier", "barrier", (220, 60, 50)),
    ("creasedbox", "debris", (182, 148, 104)),
    ("box", "cardboard box", (182, 148, 104)),
    ("barrel", "barrel", (60, 92, 140)),
    ("trashcan", "bin", (62, 84, 72)),
    ("trashbag", "bag", (44, 46, 50)),
    ("bin", "bin", (62, 84, 72)),
    ("mailbox", "bin", (226, 178, 40)),
    ("bench", "bench", (136, 104, 72)),
    ("plantpot", "plant", (150, 100, 76)),
    ("palm", "palm", (92, 124, 60)),
    ("cypress", "conifer", (62, 92, 56)),
    ("tree", "tree", (74, 106, 54)),
    ("table", "table", (196, 186, 170)),
    ("chair", "chair", (214, 210, 202)),
    ("bag", "bag", (150, 110, 80)),
    ("purse", "bag", (130, 60, 60)),
    ("case", "case", (70, 76, 92)),
    ("trolley", "case", (110, 60, 60)),
    ("advertisement", "board", (70, 76, 84)),
    ("streetsign", "board", (60, 96, 160)),
    ("warning", "warning board", (240, 150, 30)),
    ("busstop", "shelter", (84, 96, 104)),
    ("pergola", "shelter", (136, 104, 72)),
    ("debris", "debris", (96, 84, 70)),
    ("garbage", "debris", (130, 124, 110)),
    ("tile", "debris", (160, 110, 90)),
    ("plank", "debris", (120, 116, 112)),
    ("fountain", "fountain", (168, 166, 160)),
    ("vending", "cabinet", (190, 40, 44)),
    ("atm", "cabinet", (60, 90, 140)),
    ("kiosk", "cabinet", (90, 110, 96)),
    ("container", "cabinet", (60, 110, 80)),
    ("haybale", "barrel", (206, 178, 92)),
    ("gnome", "figure", (190, 50, 50)),
    ("mesh", "box", (170, 168, 164)),
)
"""The models and colours of props whose names contain a word; the longest word counts."""
_PROP: Final[tuple[str, Color]] = ("box", (170, 168, 164))

_CALM: Final[tuple[Color, ...]] = (
    (200, 202, 204),
    (120, 124, 130),
    (44, 46, 52),
    (36, 62, 110),
    (128, 30, 34),
    (92, 112, 130),
    (176, 168, 150),
    (40, 84, 74),
    (232, 232, 230),
    (70, 60, 56),
    (188, 132, 52),
)
"""Colours of vehicles without a recorded one: a prime number of them, so that neighbouring ids have different ones."""
_CLOTHES: Final[tuple[Color, ...]] = (
    (66, 98, 140),
    (156, 66, 60),
    (88, 116, 88),
    (206, 196, 178),
    (52, 56, 66),
    (186, 140, 64),
    (120, 88, 128),
    (226, 226, 222),
    (74, 128, 136),
    (148, 120, 98),
    (92, 96, 74),
)
"""Colours of the clothes of walkers, a prime number of them, too."""

_UNDRAWN: Final = ("sensor.", "controller.", "static.trigger", "util.", "spectator")
_MOST: Final = 50.0  # m; a greater extent is none
_LEAST: Final = 0.005  # m


UNKNOWN: Final = Look(INDEX["box"], (150, 150, 150), (0.15, 0.15, 0.15), (0.0, 0.0, 0.15), Tag.OTHER)
"""The look of an actor of which poses are recorded, but no spawn: nothing says what it is."""


def look_of(
    type_id: str,
    kind: int,
    attributes: Mapping[str, str],
    box: BoundingBox | None = None,
    *,
    id: int = 0,
    signs: bool = False,
) -> Look | None:
    """Return the look of an actor; None of one that is not drawn: a sensor, the spectator.

    Args:
        type_id: The blueprint; names that are not CARLA's are recognized by their kind, wheels and size.
        kind: The kind; see `carla_recap.ActorKind`.
        attributes: The attributes.
        box: Its recorded box; None: that of the blueprint, else the usual size of its class.
        id: The actor id, which varies the colour of actors without a recorded one.
        signs: Whether signs are drawn as actors, too: those of a map are part of its `TownMesh`.
    """
    if kind == ActorKind.SENSOR or type_id.startswith(_UNDRAWN):
        return None
    recorded = box if box is None or _is_sound(box) else None
    box = recorded or blueprint_box(type_id, kind)
    if kind == ActorKind.TRAFFIC_LIGHT or type_id.startswith("traffic.traffic_light"):
        return _fixed("traffic light", Tag.TRAFFIC_LIGHT)
    if kind == ActorKind.TRAFFIC_SIGN or type_id.startswith("traffic."):
        return _fixed(_sign_of(type_id), Tag.TRAFFIC_SIGNS) if signs else None
    if kind == ActorKind.VEHICLE or type_id.startswith("vehicle."):
        name = _vehicle_of(type_id, attributes, recorded)
        tag = BASE_TYPES.get(attributes.get("base_type", ""), _TAGS.get(name, Tag.CAR))
        color = recorded_color(attributes) or _CALM[id % len(_CALM)]
        return _look(name, color, tag, type_id, box)
    if kind == ActorKind.WALKER or type_id.startswith("walker."):
        name = _walker_of(attributes, recorded, id)
        return _look(name, _CLOTHES[id % len(_CLOTHES)], Tag.PEDESTRIANS, type_id, box)
    name, color = _prop_of(type_id, attributes)
    return _look(name, recorded_color(attributes) or color, Tag.STATIC, type_id, box)


def look_of_present(actor: ActorLife, *, signs: bool = False) -> Look | None:
    """Return the look of a recorded actor; None of one that is not drawn; see `look_of`."""
    return look_of(actor.type_id, actor.spawn.kind, actor.attributes, actor.bounding_box, id=actor.id, signs=signs)


def _is_sound(box: BoundingBox) -> bool:
    extents = (box.extent_x, box.extent_y, box.extent_z)
    return all(math.isfinite(value) and abs(value) <= _MOST for value in (box.x, box.y, box.z, *extents)) and (
        min(extents) > 0
    )


def _look(name: str, color: Color, tag: Tag, type_id: str, box: BoundingBox | None) -> Look:
    """Return a look of the size of a box, else of a blueprint, else of a model."""
    own = own_model(type_id)
    index = _index(name) if own is None else own
    if box is None:
        length, width, height = MODELS[index].size
        middle = 0.0 if tag == Tag.PEDESTRIANS else height / 2
        box = BoundingBox(0.0, 0.0, middle, length / 2, width / 2, height / 2)
    x, y, z = (max(extent, _LEAST) for extent in (box.extent_x, box.extent_y, box.extent_z))
    return Look(index, color, (x, y, z), (box.x, box.y, box.z), tag)


def _fixed(name: str, tag: Tag) -> Look:
    """Return the look of a light or a sign, whose boxes are not recorded or mean something else."""
    index = _index(name)
    x, y, z = (extent / 2 for extent in MODELS[index].size)
    return Look(index, (200, 200, 200), (x, y, z), MODELS[index].center, tag)


def _index(name: str) -> int:
    return INDEX.get(name, INDEX["box"])


def recorded_color(attributes: Mapping[str, str]) -> Color | None:
    """Return the recorded colour; None without a valid one."""
    try:
        red, green, blue = (int(part) for part in attributes.get("color", "").split(","))
    except ValueError:
        return None
    return (red, green, blue) if min(red, green, blue) >= 0 and max(red, green, blue) <= 255 else None


def _vehicle_of(type_id: str, attributes: Mapping[str, str], box: BoundingBox | None) -> str:
    """Return the model of a vehicle: by its name, else by its type, its wheels and its size."""
    lowered = other_names().get(type_id, type_id).lower()
    for name, words in _VEHICLES:
        for word in words.split():
            if re.search(rf"(?<![a-z0-9]){re.escape(word)}(?![a-z])", lowered):  # mkz is in mkz2017, but t2 is not in test2
                return name
    length, height = (2 * box.extent_x, 2 * box.extent_z) if box else (0.0, 0.0)
    base = attributes.get("base_type", "")
    if base in ("bicycle", "motorcycle", "van", "bus"):
        return base
    if attributes.get("number_of_wheels") == "2":
        return "bicycle" if "bike" in lowered or "cycle" in lowered or 0 < length < 1.9 else "motorcycle"
    if base == "truck" or length > 6:
        return "bus" if length > 9.5 else "box truck" if length < 7 else "lorry"
    if height > 2.1:
        return "van"
    if height > 1.7:
        return "suv"
    return "hatchback" if 0 < length < 4.2 else "sedan"


def _walker_of(attributes: Mapping[str, str], box: BoundingBox | None, number: int) -> str:
    if attributes.get("age") == "child" or (box is not None and box.extent_z < 0.7):
        return f"child {number % VARIANTS}"
    gender = attributes.get("gender") or ("female", "male")[number // 3 % 2]
    return f"{'woman' if gender == 'female' else 'man'} {number % VARIANTS}"


VARIANTS: Final = 3
"""The number of complexions of walkers."""


def _sign_of(type_id: str) -> str:
    kind = type_id.removeprefix("traffic.")
    if kind.startswith("speed_limit."):
        name = f"speed limit {kind.removeprefix('speed_limit.')}"
        return name if name in INDEX else "speed limit"
    return {"stop": "stop sign", "yield": "yield sign"}.get(kind, "sign")


def _prop_of(type_id: str, attributes: Mapping[str, str]) -> tuple[str, Color]:
    mesh = attributes.get("mesh_path", "").rpartition("/")[2]
    lowered = (mesh or type_id.removeprefix("static.prop.")).lower()
    found = max((row for row in _PROPS if row[0] in lowered), key=lambda row: len(row[0]), default=None)
    return found[1:] if found else _PROP
