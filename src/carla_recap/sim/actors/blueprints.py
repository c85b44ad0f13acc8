"""What can be spawned: blueprints under CARLA's names, about as large, heavy and strong as what they are named after."""

from __future__ import annotations

from dataclasses import dataclass, field
from difflib import get_close_matches
from fnmatch import fnmatchcase
from math import pi
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from carla_recap.records import ActorKind
from carla_recap.sim.actors.attributes import CHOICES, SENSORS
from carla_recap.sim.errors import SpawnError
from carla_recap.sim.geometry import Box, Location, Vector
from carla_recap.sim.physics.physics_control import Gear, PhysicsControl, WheelPhysics

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping


@dataclass(frozen=True)
class Blueprint:
    """Something that can be spawned.

    Attributes:
        id: Its name, such as vehicle.tesla.model3.
        kind: What becomes of it.
        attributes: What its actors have, with the values of those that are not told otherwise.
        box: The box around an actor, in the actor's axes; of no size where it has no body.
        physics: How it moves; None for what is no vehicle.
        wheelbase: The distance between the axles in m; 0 for what is no vehicle.
        choices: Values that some of its attributes are meant to have, for those who want variety.
        uid: Its place in the library, from 1; 0 for what a town has by itself.
    """

    id: str
    kind: ActorKind
    attributes: Mapping[str, str]
    box: Box
    physics: PhysicsControl | None = None
    wheelbase: float = 0.0
    choices: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: MappingProxyType({}))
    uid: int = 0

    def expect(self, attributes: Iterable[str]) -> None:
        """Make sure that it has attributes of some names.

        Raises:
            SpawnError: It has not; the message has names that are like it.
        """
        for key in attributes:
            if key not in self.attributes:
                near = get_close_matches(key, self.attributes, n=3, cutoff=0.5)
                raise SpawnError(f"{self.id} has no attribute {key!r}; it has {', '.join(near or self.attributes)}")


_FAMILIES: Final = "there are vehicle.*, walker.*, static.prop.*, sensor.* and controller.*"


class BlueprintLibrary:
    """All blueprints, in the order of their names."""

    def __init__(self, blueprints: list[Blueprint]) -> None:
        self._blueprints = {blueprint.id: blueprint for blueprint in blueprints}

    def __len__(self) -> int:
        return len(self._blueprints)

    def __iter__(self) -> Iterator[Blueprint]:
        return iter(self._blueprints.values())

    def __contains__(self, id: str) -> bool:
        return id in self._blueprints

    def get(self, id: str) -> Blueprint:
        """The blueprint of a name.

        Raises:
            SpawnError: There is none; the message has names that are like it.
        """
        try:
            return self._blueprints[id]
        except KeyError:
            near = get_close_matches(id, self._blueprints, n=3, cutoff=0.5)
            hint = f"did you mean {' or '.join(near)}?" if near else _FAMILIES
            raise SpawnError(f"no blueprint {id!r}; {hint}") from None

    def filter(self, pattern: str) -> list[Blueprint]:
        """The blueprints whose names match a pattern with * and ?, or contain it, as CARLA's filter takes it."""
        return [b for b in self if fnmatchcase(b.id, pattern) or fnmatchcase(b.id, f"*{pattern}*")]


@dataclass(frozen=True)
class _Model:
    """A row of the table of vehicles: sizes in m, mass in kg, power in kW, top speed in km/h, wheel radius in m."""

    id: str
    base_type: str
    length: float
    width: float
    height: float
    wheelbase: float
    mass: float
    power: float
    top_speed: float
    gears: int
    drag: float
    radius: float
    colors: tuple[str, ...]
    special_type: str = ""
    wheels: int = 4
    generation: int = 1
    max_rpm: float = 6000.0
    steer: float = 70.0


_PAINTS: Final = ("180,44,44", "17,37,103", "137,0,0", "0,12,26", "75,87,173", "255,255,255", "29,110,42", "110,110,112")

# Lengths, widths and heights are about those of CARLA's boxes; wheelbases, masses, powers and speeds those of the makers.
# fmt: off
_MODELS: Final = (
    _Model("vehicle.audi.a2", "car", 3.71, 1.79, 1.55, 2.41, 895, 55, 173, 5, 0.25, 0.30, _PAINTS),
    _Model("vehicle.audi.etron", "car", 4.86, 2.03, 1.65, 2.93, 2490, 265, 200, 1, 0.28, 0.37, _PAINTS, generation=2,
           max_rpm=13000),
    _Model("vehicle.audi.tt", "car", 4.18, 1.99, 1.39, 2.51, 1335, 169, 250, 6, 0.30, 0.34, _PAINTS),
    _Model("vehicle.bh.crossbike", "bicycle", 1.49, 0.86, 1.80, 1.05, 95, 0.6, 36, 1, 1.00, 0.34, _PAINTS, wheels=2,
           max_rpm=500),
    _Model("vehicle.bmw.grandtourer", "car", 4.61, 2.24, 1.67, 2.78, 1540, 141, 225, 6, 0.30, 0.33, _PAINTS),
    _Model("vehicle.carlamotors.firetruck", "truck", 8.47, 2.89, 3.83, 4.50, 14000, 260, 110, 8, 0.70, 0.52,
           ("180,20,20",), special_type="emergency", generation=2, max_rpm=2500, steer=50),
    _Model("vehicle.diamondback.century", "bicycle", 1.66, 0.58, 1.86, 1.02, 90, 0.7, 42, 1, 0.90, 0.34, _PAINTS, wheels=2,
           max_rpm=500),
    _Model("vehicle.dodge.charger_2020", "car", 5.01, 1.88, 1.53, 3.05, 1830, 276, 260, 6, 0.33, 0.36, _PAINTS,
           generation=2),
    _Model("vehicle.ford.mustang", "car", 4.72, 1.89, 1.30, 2.72, 1640, 228, 230, 6, 0.35, 0.34, _PAINTS),
    _Model("vehicle.harley-davidson.low_rider", "motorcycle", 2.35, 0.76, 1.64, 1.63, 380, 63, 175, 6, 0.60, 0.32, _PAINTS,
           wheels=2),
    _Model("vehicle.kawasaki.ninja", "motorcycle", 2.04, 0.80, 1.45, 1.41, 270, 93, 240, 6, 0.55, 0.31, _PAINTS, wheels=2,
           max_rpm=11000),
    _Model("vehicle.lincoln.mkz_2020", "car", 4.89, 1.84, 1.49, 2.85, 1696, 183, 225, 6, 0.30, 0.355, _PAINTS, generation=2),
    _Model("vehicle.mercedes.sprinter", "van", 5.92, 1.99, 2.73, 3.67, 2500, 140, 162, 7, 0.35, 0.35,
           ("255,255,255", "110,110,112"), generation=2, max_rpm=4500),
    _Model("vehicle.mini.cooper_s", "car", 3.81, 1.97, 1.48, 2.47, 1170, 135, 225, 6, 0.36, 0.31, _PAINTS),
    _Model("vehicle.nissan.patrol", "car", 4.60, 1.93, 1.86, 2.71, 2400, 298, 210, 7, 0.37, 0.40, _PAINTS),
    _Model("vehicle.seat.leon", "car", 4.19, 1.82, 1.47, 2.58, 1310, 110, 213, 6, 0.32, 0.32, _PAINTS),
    _Model("vehicle.tesla.model3", "car", 4.79, 2.16, 1.49, 2.88, 1845, 202, 225, 1, 0.23, 0.34, _PAINTS, generation=2,
           max_rpm=16000),
    _Model("vehicle.toyota.prius", "car", 4.51, 2.01, 1.52, 2.70, 1375, 90, 180, 1, 0.25, 0.32, _PAINTS, max_rpm=13000),
    _Model("vehicle.vespa.zx125", "motorcycle", 1.80, 0.87, 1.57, 1.26, 200, 7.5, 90, 1, 0.65, 0.23, _PAINTS, wheels=2,
           max_rpm=8000),
    _Model("vehicle.volkswagen.t2", "van", 4.48, 2.07, 2.04, 2.40, 1400, 51, 127, 4, 0.42, 0.32, _PAINTS, max_rpm=4800),
)
# fmt: on

_REAR_TRACK: Final = 0.78  # of the width, between the middles of the tyres
_REV_RANGE: Final = (0.0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0)
_PEAK: Final = {"electric": 0.30, "combustion": 0.70}  # the share of the revolutions at which full power is reached
_BRAKING: Final = 1.0  # g, by all brakes together; tyres of dry asphalt give about as much
_FIRST_GEAR: Final = 0.23  # the share of the top speed that the first of many gears reaches
_GRAVITY: Final = 9.81


def _physics(model: _Model) -> PhysicsControl:
    top = model.top_speed / 3.6
    turns = model.max_rpm * 2 * pi / 60
    final = turns * model.radius / top
    peak = _PEAK["electric" if model.gears == 1 else "combustion"]
    torque = model.power * 1000 / (turns * peak)
    curve = tuple((share * model.max_rpm, torque * min(1.0, peak / max(share, 1e-9))) for share in _REV_RANGE)
    steps = [_FIRST_GEAR ** (number / (model.gears - 1)) if model.gears > 1 else 1.0 for number in range(model.gears)]
    return PhysicsControl(
        torque_curve=curve,
        max_rpm=model.max_rpm,
        final_ratio=final,
        forward_gears=[Gear(_FIRST_GEAR**-1 * step if model.gears > 1 else 1.0) for step in steps],
        mass=float(model.mass),
        drag_coefficient=model.drag,
        center_of_mass=Vector(0.0, 0.0, 0.3 * model.height),
        wheels=_wheels(model),
    )


def _wheels(model: _Model) -> list[WheelPhysics]:
    aside = _REAR_TRACK * model.width / 2 if model.wheels > 2 else 0.0
    brake = _BRAKING * _GRAVITY * model.mass * model.radius / model.wheels
    sides = (-1, 1) if model.wheels > 2 else (0,)
    return [
        WheelPhysics(
            max_steer_angle=model.steer if ahead > 0 else 0.0,
            radius=100 * model.radius,
            max_brake_torque=brake,
            max_handbrake_torque=0.0 if ahead > 0 else 2 * brake,
            position=Vector(100 * ahead * model.wheelbase / 2, 100 * side * aside, 100 * model.radius),
        )
        for ahead in (1, -1)
        for side in sides
    ]


_ROLES: Final = ("autopilot", "scenario", "ego_vehicle")
_RIDERS: Final = ("0", "1", "2", "3")


def _vehicle(model: _Model) -> Blueprint:
    attributes = {
        "generation": str(model.generation),
        "number_of_wheels": str(model.wheels),
        "base_type": model.base_type,
        "special_type": model.special_type,
        "has_lights": "true" if model.base_type != "bicycle" else "false",
        "has_dynamic_doors": "false",
        "object_type": "",
        "color": model.colors[0],
        "sticky_control": "true",
        "role_name": "autopilot",
    }
    choices = {"color": model.colors, "role_name": _ROLES}
    if model.wheels == 2:
        attributes["driver_id"] = _RIDERS[0]
        choices["driver_id"] = _RIDERS
    box = Box(Location(0.0, 0.0, model.height / 2), Vector(model.length / 2, model.width / 2, model.height / 2))
    physics = _physics(model)
    return Blueprint(model.id, ActorKind.VEHICLE, attributes, box, physics, model.wheelbase, MappingProxyType(choices))


_PEOPLE: Final = 51  # as many as CARLA 0.9.15 has
_RUNNING: Final = "3.0"  # m/s
_EITHER: Final = ("true", "false")
_CHILDREN: Final = frozenset((9, 10, 11, 12, 13, 14, 48, 49))


def _walker(number: int) -> Blueprint:
    child = number in _CHILDREN
    attributes = {
        "generation": "2" if number in (*range(15, 31), *range(42, 52)) else "1",
        "gender": "female" if number % 2 else "male",
        "age": "child" if child else "adult",
        "speed": "1.3" if child else "1.4",
        "is_invincible": "true",
        "can_use_wheelchair": "false",
        "use_wheelchair": "false",
        "role_name": "pedestrian",
    }
    choices = MappingProxyType(
        {"speed": ("0.0", attributes["speed"], _RUNNING), "is_invincible": _EITHER, "use_wheelchair": _EITHER}
    )
    height = 1.2 if child else 1.8
    box = Box(Location(), Vector(0.19, 0.19, height / 2))
    return Blueprint(f"walker.pedestrian.{number:04}", ActorKind.WALKER, attributes, box, choices=choices)


_PROPS: Final[dict[str, tuple[float, float, float]]] = {  # length, width, height in m
    "barrel": (0.60, 0.60, 0.90),
    "bench01": (0.55, 1.50, 0.85),
    "bin": (0.60, 0.60, 1.10),
    "box01": (0.50, 0.50, 0.40),
    "busstop": (1.60, 4.20, 2.60),
    "constructioncone": (0.36, 0.36, 0.60),
    "container": (2.60, 5.90, 2.60),
    "dirtdebris01": (1.60, 1.60, 0.06),
    "streetbarrier": (0.40, 1.25, 1.05),
    "trafficcone01": (0.40, 0.40, 0.90),
    "trafficwarning": (1.20, 2.40, 2.80),
    "trashcan01": (0.65, 0.65, 1.10),
    "vendingmachine": (0.85, 1.00, 1.85),
}


def _prop(name: str, length: float, width: float, height: float) -> Blueprint:
    box = Box(Location(0.0, 0.0, height / 2), Vector(length / 2, width / 2, height / 2))
    return Blueprint(f"static.prop.{name}", ActorKind.OTHER, {"size": "medium", "role_name": "prop"}, box)


_NOTHING: Final = Box(Location(), Vector())
_SIDES: Final = ("front", "back", "left", "right")
_CONTROLLER: Final = "controller.ai.walker"


def _sensor(id: str, attributes: dict[str, str]) -> Blueprint:
    choices = {"role_name": _SIDES, **{key: CHOICES[key] for key in attributes if key in CHOICES}}
    return Blueprint(id, ActorKind.SENSOR, {"role_name": "front", **attributes}, _NOTHING, choices=MappingProxyType(choices))


COLLISION_SENSOR: Final = "sensor.other.collision"
SPECTATOR: Final = Blueprint("spectator", ActorKind.OTHER, {}, _NOTHING)
TRAFFIC_LIGHT: Final = Blueprint("traffic.traffic_light", ActorKind.TRAFFIC_LIGHT, {}, _NOTHING)
STOP_SIGN: Final = Blueprint("traffic.stop", ActorKind.TRAFFIC_SIGN, {}, _NOTHING)
YIELD_SIGN: Final = Blueprint("traffic.yield", ActorKind.TRAFFIC_SIGN, {}, _NOTHING)


def speed_limit(speed: float) -> Blueprint:
    """The sign of a speed limit, in km/h."""
    return Blueprint(f"traffic.speed_limit.{round(speed)}", ActorKind.TRAFFIC_SIGN, {}, _NOTHING)


def standard_library() -> BlueprintLibrary:
    """The blueprints of every world."""
    blueprints = [
        *(_vehicle(model) for model in _MODELS),
        *(_walker(number) for number in range(1, _PEOPLE + 1)),
        *(_prop(name, *size) for name, size in _PROPS.items()),
        *(_sensor(id, attributes) for id, attributes in SENSORS.items()),
        Blueprint(_CONTROLLER, ActorKind.OTHER, {"role_name": "default"}, _NOTHING),
    ]
    ordered = sorted(blueprints, key=lambda blueprint: blueprint.id)
    return BlueprintLibrary(
        [
            Blueprint(b.id, b.kind, MappingProxyType(dict(b.attributes)), b.box, b.physics, b.wheelbase, b.choices, uid)
            for uid, b in enumerate(ordered, 1)
        ]
    )
