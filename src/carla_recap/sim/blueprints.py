"""The library of blueprints: what CARLA 0.9.16 can spawn, with its names, attributes and sizes."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from fnmatch import fnmatchcase
from functools import cache
from math import pi
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.blueprints import blueprint_rows, other_names
from carla_recap.model.motion import GRAVITY
from carla_recap.model.records import ActorKind
from carla_recap.sensors.kinds import SENSOR_ATTRIBUTES
from carla_recap.sim.errors import SpawnError
from carla_recap.sim.geometry import Box, Location, Vector
from carla_recap.sim.physics.physics_control import CHASSIS_AREA, Gear, PhysicsControl, WheelPhysics

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping


COLLISION_SENSOR: Final = "sensor.other.collision"
V2X_SENSOR: Final = "sensor.other.v2x"
CUSTOM_V2X_SENSOR: Final = "sensor.other.v2x_custom"
FRICTION_TRIGGER: Final = "static.trigger.friction"


@dataclass(frozen=True)
class Blueprint:
    """Something that can be spawned.

    Attributes:
        id: The name, such as vehicle.tesla.model3.
        kind: The kind of its actors.
        attributes: The attributes of its actors, with their defaults.
        box: The box around an actor, in the actor's axes; of no size if it has no body.
        physics: The physics control of its vehicles; None if it is no vehicle.
        choices: The attributes that can be chosen when an actor is spawned, with their recommended values.
        uid: The position in the library, from 1; 0 for signs, lights and the spectator.
        is_traffic: Whether random traffic consists of it, among others.
    """

    id: str
    kind: ActorKind
    attributes: Mapping[str, str]
    box: Box
    physics: PhysicsControl | None = None
    choices: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: MappingProxyType({}))
    uid: int = 0
    is_traffic: bool = False

    def expect(self, attributes: Iterable[str]) -> None:
        """Make sure that there are attributes of the given names; `SpawnError` of a missing one has similar names."""
        for key in attributes:
            if key not in self.attributes:
                near = get_close_matches(key, self.attributes, n=3, cutoff=0.5)
                raise SpawnError(f"{self.id} has no attribute {key!r}; it has {', '.join(near or self.attributes)}")


_FAMILIES: Final = "there are vehicle.*, walker.*, static.prop.*, sensor.*, static.trigger.friction and controller.*"


class BlueprintLibrary:
    """All blueprints, in the order of their names; those of other releases can be got, but are not listed."""

    def __init__(self, blueprints: list[Blueprint], others: Iterable[Blueprint] = ()) -> None:
        self._blueprints = {blueprint.id: blueprint for blueprint in blueprints}
        self._others = {blueprint.id: blueprint for blueprint in others}

    def __len__(self) -> int:
        return len(self._blueprints)

    def __iter__(self) -> Iterator[Blueprint]:
        return iter(self._blueprints.values())

    def __contains__(self, id: str) -> bool:
        return id in self._blueprints or id in self._others

    def get(self, id: str) -> Blueprint:
        """Return the blueprint of a name; `SpawnError` of a missing one has similar names."""
        found = self._blueprints.get(id) or self._others.get(id)
        if found is None:
            near = get_close_matches(id, self._blueprints, n=3, cutoff=0.5)
            hint = f"did you mean {' or '.join(near)}?" if near else _FAMILIES
            raise SpawnError(f"no blueprint {id!r}; {hint}")
        return found

    def resolve(self, blueprint: Blueprint | str, attributes: Iterable[str]) -> Blueprint:
        """Return a blueprint, given or by its name, that has attributes of the given names; else `SpawnError`."""
        found = self.get(blueprint) if isinstance(blueprint, str) else blueprint
        found.expect(attributes)
        return found

    def filter(self, pattern: str) -> list[Blueprint]:
        """Return the blueprints whose names match a pattern with * and ?, or contain it, as CARLA's filter does."""
        return [b for b in self if fnmatchcase(b.id, pattern) or fnmatchcase(b.id, f"*{pattern}*")]

    def traffic(self, kind: ActorKind) -> list[Blueprint]:
        """Return the vehicles or walkers that random traffic consists of."""
        return [blueprint for blueprint in self if blueprint.is_traffic and blueprint.kind == kind]


@dataclass(frozen=True, slots=True)
class _Model:
    """A row of `vehicles.csv`, less what becomes an attribute as it is.

    Lengths, widths and heights are those of CARLA's boxes, or close to them; wheelbases, masses, powers and speeds are those
    of the makers, and absent where `vehicle_physics.toml` has CARLA's. Sizes are in m, the mass in kg, the power in kW, the
    top speed in km/h, the steering angle in degrees.
    """

    id: str
    number_of_wheels: str
    length: float
    width: float
    height: float
    wheelbase: float
    mass: float
    power: float
    top_speed: float
    gears: int
    max_rpm: float
    drag: float
    radius: float
    steer: float
    traffic: bool
    drivers: tuple[str, ...]
    colors: tuple[str, ...]

    @classmethod
    def of(cls, row: dict[str, str]) -> _Model:
        """Return the model of a row."""
        numbers = {name: float(row[name] or "nan") for name, type in cls.__annotations__.items() if type == "float"}
        special = {
            "gears": int(row["gears"] or 0),
            "traffic": row["traffic"] == "true",
            "drivers": tuple(row["drivers"].split()),
            "colors": tuple(",".join(map(str, bytes.fromhex(color))) for color in row["colors"].split()),
        }
        values: dict[str, Any] = {**row, **numbers, **special}
        return cls(**{name: values[name] for name in cls.__annotations__})


_TRACK: Final = 0.78  # of the width, between the middles of the tyres
_BIKE_TRACK: Final = 0.1  # of the width: CARLA's bikes have four wheels, left and right close together
_TANDEM: Final = 1.3  # m, between the rear axles of a vehicle with six wheels
_ELECTRIC: Final = ((0.0, 1.0), (0.3, 1.0), (0.45, 0.667), (0.6, 0.5), (0.75, 0.4), (1.0, 0.3))
"""The torque of an electric motor, and of a rider, as shares of the peak at shares of the most revolutions."""
_COMBUSTION: Final = ((0.0, 0.8), (0.33, 1.0), (1.0, 0.8))
"""The same of UE4's usual engine."""
_USUAL_ENGINE: Final = 500.0 / 628.0  # N m s, its peak torque by its most revolutions
_SHIFT_UP: Final = 0.46  # of the most revolutions, as of CARLA's Lincoln 2017, whose engine has its maker's power there
_SHIFT_DOWN: Final = 0.8  # of the revolutions after a shift up, so that it is not undone; those gearboxes have about as much
_SHIFT_TIME: Final = 0.1  # s, of CARLA's gearboxes since 0.9.12
_CAR: Final = 1500.0  # kg; wheels of lighter vehicles are damped less than a car's, so that bicycles get fast enough
_BRAKING: Final = 1.0  # g, by all brakes together; tyres of dry asphalt give about as much
_PULL: Final = 1.5  # g, by the engine at most; about a third is lost to turning masses and friction
_FIRST_GEARS: Final = (0.23, 0.6)  # the share of the top speed that the first of many gears reaches, at least and at most
_FRONT_AREA: Final = 0.85  # of the rectangle around it (Hucho, Aerodynamics of Road Vehicles)


@cache
def known_physics() -> Mapping[str, dict[str, Any]]:
    """Return what is known of the physics of CARLA's own vehicles, by blueprint: see `vehicle_physics.toml`."""
    with Path(__file__).with_name("vehicle_physics.toml").open("rb") as file:
        tables = tomllib.load(file)
    return {f"vehicle.{id}": tables[table.get("like", id)] | table for id, table in tables.items()}


def _physics(model: _Model) -> PhysicsControl:
    known = known_physics().get(f"vehicle.{model.id}")
    if known is not None:
        return _known(known)
    top = model.top_speed / 3.6
    turns = model.max_rpm * 2 * pi / 60
    one_gear = model.gears == 1
    curve = _ELECTRIC if one_gear else _COMBUSTION
    used = 1.0 if one_gear else _SHIFT_UP
    most = max(share * part for share, part in (*curve, (used, np.interp(used, *np.transpose(curve)))) if share <= used)
    torque = model.power * 1000 / float(turns * most)
    final = turns * model.radius / top
    pull = torque * final / (_PULL * GRAVITY * model.mass * model.radius)  # of the top gear, as a share of the most
    first = 1.0 if one_gear else min(max(pull, _FIRST_GEARS[0]), _FIRST_GEARS[1])
    step = 1.0 if one_gear else first ** (1 / (model.gears - 1))
    torque *= min(first / pull, 1.0)
    scale = torque / turns / _USUAL_ENGINE
    usual = PhysicsControl()
    shifts = (0.0, 0.0) if one_gear else (_SHIFT_DOWN * _SHIFT_UP * step, _SHIFT_UP)
    return PhysicsControl(
        torque_curve=tuple((share * model.max_rpm, part * torque) for share, part in curve),
        max_rpm=model.max_rpm,
        moi=usual.moi * scale,
        damping_rate_full_throttle=usual.damping_rate_full_throttle * scale,
        damping_rate_zero_throttle_clutch_engaged=usual.damping_rate_zero_throttle_clutch_engaged * scale,
        damping_rate_zero_throttle_clutch_disengaged=usual.damping_rate_zero_throttle_clutch_disengaged * scale,
        gear_switch_time=0.0 if one_gear else _SHIFT_TIME,
        clutch_strength=usual.clutch_strength * scale,
        final_ratio=final,
        forward_gears=[Gear(1 / step**number, *shifts) for number in reversed(range(model.gears))],
        mass=model.mass,
        drag_coefficient=model.drag * _FRONT_AREA * model.width * model.height / CHASSIS_AREA,
        center_of_mass=Vector(0.0, 0.0, 0.3 * model.height),
        wheels=_estimated_wheels(model),
    )


def _known(values: dict[str, Any]) -> PhysicsControl:
    """Return a physics control that is known."""
    special: dict[str, Any] = {
        "torque_curve": tuple((rpm, torque) for rpm, torque in values["torque_curve"]),
        "forward_gears": [Gear(*gear) for gear in values["forward_gears"]],
        "center_of_mass": Vector(*values["center_of_mass"]),
        "wheels": _wheels(*(values[name] for name in _OF_WHEELS)),
    }
    same = PhysicsControl.__annotations__.keys() & values.keys() - special.keys()
    return PhysicsControl(**special, **{name: values[name] for name in same})


_OF_WHEELS: Final = ("axles", "track", "radius", "max_brake_torque", "max_handbrake_torque", "max_steer_angle")


def _estimated_wheels(model: _Model) -> list[WheelPhysics]:
    half = model.wheelbase / 2
    axles = (half, -half) if model.number_of_wheels != "6" else (half, -half + _TANDEM / 2, -half - _TANDEM / 2)
    track = (_BIKE_TRACK if model.number_of_wheels == "2" else _TRACK) * model.width
    brake = _BRAKING * GRAVITY * model.mass * model.radius / (2 * len(axles))
    wheels = _wheels(axles, track, 100 * model.radius, brake, 2 * brake, model.steer)
    return [replace(wheel, damping_rate=wheel.damping_rate * min(model.mass / _CAR, 1.0)) for wheel in wheels]


def _wheels(
    axles: Iterable[float], track: float, radius: float, brake: float, hand_brake: float, steer: float
) -> list[WheelPhysics]:
    """Return the wheels from front to back, the left one of each axle first: the front steers, the rear has the hand brake.

    Axles are in m ahead of the middle of the vehicle, the track in m, the radius in cm, the most torques of the brakes of
    each wheel in N m, the greatest steering angle in degrees.
    """
    return [
        WheelPhysics(
            max_steer_angle=steer if axle > 0 else 0.0,
            radius=radius,
            max_brake_torque=brake,
            max_handbrake_torque=0.0 if axle > 0 else hand_brake,
            position=Vector(100 * axle, 50 * side * track, radius),
        )
        for axle in axles
        for side in (-1, 1)
    ]


_NOTHING: Final = Box(Location(), Vector())
_COMMON: Final = {"ros_name": ("",), "ros_frame_id": ("",), "ros_publish_tf": ("true",)}
_PROP: Final = {"role_name": ("prop",)}
_ANY_ROLE: Final = {"role_name": ("default",)}
_CONTROLLER: Final = "controller.ai.walker"
_SIDES: Final = ("front", "back", "left", "right", "front_left", "front_right", "back_left", "back_right")
_WITHOUT_SIDES: Final = ("sensor.other.gnss", "sensor.other.imu", "sensor.other.radar", V2X_SENSOR, CUSTOM_V2X_SENSOR)


def _blueprint(
    id: str, kind: ActorKind, choices: Mapping[str, tuple[str, ...]], box: Box = _NOTHING, **fixed: str
) -> Blueprint:
    """Return a blueprint with attributes that can be chosen, whose first recommended value is the default, and others."""
    recommended = {"role_name": choices["role_name"], **_COMMON, **choices}
    attributes = {**{key: values[0] for key, values in recommended.items()}, **fixed}
    return Blueprint(id, kind, MappingProxyType(attributes), box, choices=MappingProxyType(recommended))


def _vehicle(row: dict[str, str]) -> Blueprint:
    model = _Model.of(row)
    choices: dict[str, tuple[str, ...]] = {"role_name": ("autopilot", "scenario", "ego_vehicle")}
    choices |= {"color": model.colors} if model.colors else {}
    choices |= {"driver_id": model.drivers} if model.drivers else {}
    choices |= {"sticky_control": ("true",), "terramechanics": ("false",)}
    fixed = ("base_type", "special_type", "number_of_wheels", "generation", "has_dynamic_doors", "has_lights")
    blueprint = _blueprint(
        f"vehicle.{model.id}",
        ActorKind.VEHICLE,
        choices,
        _standing_box(model.length, model.width, model.height),
        object_type="",
        **{key: row[key] for key in fixed},
    )
    return replace(blueprint, physics=_physics(model), is_traffic=model.traffic)


def _walker(row: dict[str, str]) -> Blueprint:
    choices = {
        "role_name": ("pedestrian",),
        "speed": ("0.0", row["walking"], row["running"]),
        "is_invincible": ("true",),
        "use_wheelchair": ("false", "true") if row["can_use_wheelchair"] == "true" else ("false",),
    }
    half = float(row["width"]) / 2
    box = Box(Location(), Vector(half, half, float(row["height"]) / 2))
    fixed = {key: row[key] for key in ("gender", "generation", "age", "can_use_wheelchair")}
    return replace(
        _blueprint(f"walker.{row['id']}", ActorKind.WALKER, choices, box, **fixed), is_traffic=row["traffic"] == "true"
    )


def _prop(row: dict[str, str]) -> Blueprint:
    box = _standing_box(*(float(row[side]) for side in ("length", "width", "height")))
    return _blueprint(f"static.prop.{row['id']}", ActorKind.OTHER, _PROP, box, size=row["size"])


def _standing_box(length: float, width: float, height: float) -> Box:
    """Return the box of an actor whose origin is on the ground."""
    return Box(Location(0.0, 0.0, height / 2), Vector(length / 2, width / 2, height / 2))


def _others() -> Iterator[Blueprint]:
    """Return what has no body: sensors, the controller of walkers, the friction trigger, and empty actors."""
    for id, attributes in SENSOR_ATTRIBUTES.items():
        role = _ANY_ROLE["role_name"] if id in _WITHOUT_SIDES else _SIDES
        values = {key: attribute.choices or (attribute.text,) for key, attribute in attributes.items()}
        yield _blueprint(id, ActorKind.SENSOR, {"role_name": role, **values})
    yield _blueprint(_CONTROLLER, ActorKind.OTHER, _ANY_ROLE)
    yield _blueprint("util.actor.empty", ActorKind.OTHER, _ANY_ROLE)
    mesh = {"mesh_path": ("",), "mass": ("0.0",), "scale": ("1.0",)}
    yield _blueprint("static.prop.mesh", ActorKind.OTHER, {**_ANY_ROLE, **mesh})
    extent = {f"extent_{axis}": ("1.0",) for axis in "xyz"}
    yield _blueprint(FRICTION_TRIGGER, ActorKind.OTHER, {**_ANY_ROLE, "friction": ("3.5",), **extent})


SPECTATOR: Final = Blueprint("spectator", ActorKind.OTHER, {}, _NOTHING)
TRAFFIC_LIGHT: Final = Blueprint("traffic.traffic_light", ActorKind.TRAFFIC_LIGHT, {}, _NOTHING)
STOP_SIGN: Final = Blueprint("traffic.stop", ActorKind.TRAFFIC_SIGN, {}, _NOTHING)
YIELD_SIGN: Final = Blueprint("traffic.yield", ActorKind.TRAFFIC_SIGN, {}, _NOTHING)


def speed_limit(speed: float) -> Blueprint:
    """Return the blueprint of the sign of a speed limit in km/h."""
    return Blueprint(f"traffic.speed_limit.{round(speed)}", ActorKind.TRAFFIC_SIGN, {}, _NOTHING)


@cache
def standard_library() -> BlueprintLibrary:
    """Return the blueprints of every world: those of CARLA 0.9.16."""
    blueprints = [_vehicle(row) for row in blueprint_rows("vehicles")]
    blueprints += [_walker(row) for row in blueprint_rows("walkers")]
    blueprints += [_prop(row) for row in blueprint_rows("props")]
    ordered = sorted([*blueprints, *_others()], key=lambda blueprint: blueprint.id)
    numbered = {blueprint.id: replace(blueprint, uid=uid) for uid, blueprint in enumerate(ordered, 1)}
    others = enumerate(other_names().items(), len(numbered) + 1)
    return BlueprintLibrary(
        list(numbered.values()), [replace(numbered[like], id=id, uid=uid, is_traffic=False) for uid, (id, like) in others]
    )
