"""The table of record types: everything that a recording can hold, one row each.

The `.log` codec, the MCAP codec, the reports and the exporters all read this table; none of them lists the types again.
A new packet is one row here and one message in `proto/`.

Numbers are CARLA's own: centimetres, degrees, seconds, in Unreal's left-handed axes (x forward, y right, z up), unless a
field's comment in `proto/` says otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from enum import Enum, IntEnum
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import RecordError
from carla_recap.model.layout import FLAG, REAL, TEXT, Framing, Layout, Many, PacketType, Records

if TYPE_CHECKING:
    from numpy.typing import NDArray

CM: Final = 0.01  # m
CM_PER_M: Final = 100.0

NO_ACTOR: Final = 0xFFFFFFFF
"""The id that stands for something that is no actor: a building, a barrier (since CARLA 0.9.13)."""


class ActorKind(IntEnum):
    """The actor type of a spawn, as CARLA 0.9.12 and later number it."""

    OTHER = 0
    VEHICLE = 1
    WALKER = 2
    TRAFFIC_LIGHT = 3
    TRAFFIC_SIGN = 4
    SENSOR = 5
    INVALID = 6


class Group(Enum):
    """Which chunks of an MCAP file a record goes to."""

    STATE = "state"  # in every frame
    EVENTS = "events"  # when something happens

    __hash__ = object.__hash__  # each member is one of its kind, and Enum's own takes ten times as long


@dataclass(slots=True)
class Attribute:
    """One attribute of a spawned actor.

    Attributes:
        type: 0 bool, 1 int, 2 float, 3 string, 4 colour; one more in recordings of version 2.
        key: The name, such as role_name.
        value: The value as text, such as hero, true, 1.5 or 255,0,0.
    """

    type: int
    key: str
    value: str


def attributes(**values: str | bool | int | float) -> list[Attribute]:
    """Return attributes of Python values, or numpy's: `attributes(role_name="hero", number_of_wheels=4)`.

    Raises:
        RecordError: A value is neither text, nor a truth value, nor a number.
    """
    return [_attribute(key, value.item() if isinstance(value, np.generic) else value) for key, value in values.items()]


def _attribute(key: str, value: str | bool | int | float) -> Attribute:
    for code, kind in enumerate((bool, int, float, str)):
        if isinstance(value, kind):
            return Attribute(code, key, str(value).lower() if kind is bool else str(value))
    raise RecordError(f"attribute {key!r}: expected text, a truth value or a number, found {type(value).__name__}")


@dataclass(slots=True)
class Spawn:
    """An actor appears. Axes are CARLA's: x forward, y right, z up, left-handed.

    Attributes:
        id: The id of the actor.
        kind: What it is, as in `ActorKind`.
        x, y, z: Position, in cm.
        roll, pitch, yaw: Rotation, in degrees.
        uid: Index in the build's list of blueprints; 0 where it has none.
        type_id: The blueprint, such as vehicle.tesla.model3.
        attributes: Its attributes; `attributes(role_name="hero")` makes them.
    """

    id: int
    kind: int = ActorKind.OTHER
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    uid: int = 0
    type_id: str = ""
    attributes: list[Attribute] = field(default_factory=list)

    def attribute(self, key: str) -> str | None:
        """Return the value of an attribute; None where the actor has no such attribute."""
        return next((a.value for a in self.attributes if a.key == key), None)


@dataclass(slots=True)
class Physics:
    """The physics control of a vehicle. Centre of mass in m; curves, gears and wheels are structured arrays."""

    id: int
    max_rpm: float
    moi: float
    damping_rate_full_throttle: float
    damping_rate_zero_throttle_clutch_engaged: float
    damping_rate_zero_throttle_clutch_disengaged: float
    use_gear_auto_box: int
    clutch_strength: float
    final_ratio: float
    mass: float
    drag_coefficient: float
    center_of_mass_x: float
    center_of_mass_y: float
    center_of_mass_z: float
    torque_curve: NDArray[np.void]
    forward_gears: NDArray[np.void]
    steering_curve: NDArray[np.void]
    wheels: NDArray[np.void]


@dataclass(slots=True)
class Bone:
    """A bone of a walker, relative to its parent bone: cm, degrees, left-handed."""

    name: str
    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float


@dataclass(slots=True)
class Bones:
    """The skeleton of a walker."""

    id: int
    bones: list[Bone] = field(default_factory=list)


@dataclass(slots=True)
class WheelSet:
    """How the wheels of a vehicle stand: rows of location, steer (degrees), rotation (degrees)."""

    id: int
    wheels: NDArray[np.void]


def _fixed(**fields: str) -> Layout:
    return Layout(dict(fields))


def _reals(*names: str) -> Layout:
    return Layout(dict.fromkeys(names, "f4"))


_POSE = dict.fromkeys(("x", "y", "z", "roll", "pitch", "yaw"), REAL)
_BOX = dict.fromkeys(("x", "y", "z", "extent_x", "extent_y", "extent_z"), REAL)
_CURVE = Many("u4", (_fixed(x="f4", y="f4"),))

_SPAWN = Layout(
    {
        "id": "u4",
        "kind": "u1",
        **_POSE,
        "uid": "u4",
        "type_id": TEXT,
        "attributes": Many("u2", (Layout({"type": "u1", "key": TEXT, "value": TEXT}, Attribute),)),
    },
    Spawn,
)

_TIRE: Final = ("tire_friction", "damping_rate", "max_steer_angle", "radius", "max_brake_torque", "max_handbrake_torque")
_STIFFNESS: Final = ("lat_stiff_max_load", "lat_stiff_value", "long_stiff_value")
_POSITION: Final = ("position_x", "position_y", "position_z")

_PHYSICS = Layout(
    {
        **dict.fromkeys((field.name for field in fields(Physics)), "f4"),
        "id": "u4",
        "use_gear_auto_box": FLAG,
        "torque_curve": _CURVE,
        "forward_gears": Many("u4", (_fixed(ratio="f4", down_ratio="f4", up_ratio="f4"),)),
        "steering_curve": _CURVE,
        # 48 bytes a wheel since 0.9.12, 36 before.
        "wheels": Many("u4", (_reals(*_TIRE, *_STIFFNESS, *_POSITION), _reals(*_TIRE, *_POSITION))),
    },
    Physics,
)

_BONES = Layout({"id": "u4", "bones": Many("u2", (Layout({"name": TEXT, **_POSE}, Bone),))}, Bones)

_WHEELS = Layout(
    {"id": "u4", "wheels": Many("u4", (_fixed(location="u1", steer="f4", rotation="f4"),))},
    WheelSet,
)

_WEATHER = _reals(
    *("cloudiness", "precipitation", "precipitation_deposits", "wind_intensity", "sun_azimuth_angle", "sun_altitude_angle"),
    *("fog_density", "fog_distance", "fog_falloff", "wetness", "scattering_intensity", "mie_scattering_scale"),
    *("rayleigh_scattering_scale", "dust_storm"),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordType(PacketType):
    """A row of the table."""

    id: int  # CARLA's packet id, as of 0.9.16
    topic: str  # the MCAP topic
    message: str  # the protobuf message of `carla_recap.v1` that holds one packet
    items: str  # the message's repeated field that holds the records; for `SINGLE`, the field that holds the value
    group: Group = Group.STATE  # the chunk group in MCAP
    always: bool = False  # CARLA writes the packet in every frame, empty or not
    additional: bool = False  # CARLA writes the packet only when it records additional data

    def __reduce__(self) -> tuple[Callable[..., RecordType], tuple[Any, ...]]:
        """Other processes have the same table."""
        return _of_table, (self.id, self.wide)

    @property
    def units(self) -> Mapping[str, str]:
        """The units of the fields that have one."""
        return _UNITS.get(self.name, {})

    @property
    def message_name(self) -> str:
        """The full protobuf name; types with lengths have a twin in double precision."""
        return f"carla_recap.v1.{self.message}" + ("Double" if self.wide and self.layout.has_reals else "")

    def records(self, values: Any) -> Records:
        """Return records of this type from values; a `RecordError` if they do not fit names the type and its fields.

        They are a structured array of `dtype`; columns by name (a single value stands for all rows, a missing field is
        zero); rows, each a tuple, a mapping, or, of a type with one field, a number; where the size varies, objects such as
        `Spawn`; for a clock, its number.
        """
        try:
            if not self.fixed:
                return self._objects(values)
            if isinstance(values, np.ndarray) and values.dtype.names:
                if values.dtype == self.dtype:
                    return np.atleast_1d(values)
                return self._from_columns({name: np.atleast_1d(values[name]) for name in values.dtype.names})
            if isinstance(values, Mapping):
                return self._from_columns(values)
            if np.ndim(values) == 0 and self.framing is Framing.SINGLE:
                values = [values]
            rows = [row if isinstance(row, Mapping) else self._row(row) for row in values]
            if not rows:
                return np.empty(0, self.dtype)
            names = dict.fromkeys(name for row in rows for name in row)
            return self._from_columns({name: [row.get(name, 0) for row in rows] for name in names})
        except (TypeError, ValueError, OverflowError) as error:
            raise RecordError(f"{self.name}: {error}; the fields are {', '.join(self.layout.fields)}") from None

    def _objects(self, values: Iterable[Any]) -> list[Any]:
        objects = list(values)
        make = self.layout.make
        for item in objects:
            if make is None or not isinstance(item, make):
                raise TypeError(f"expected a {make.__name__ if make else 'packet'}, found {item!r:.60}")
        return objects

    def _row(self, row: Any) -> dict[str, Any]:
        values = tuple(row) if np.ndim(row) or isinstance(row, np.void) else (row,)
        if len(values) != len(self.layout.fields):
            raise ValueError(f"expected rows of {len(self.layout.fields)} numbers, found {row!r:.60}")
        return dict(zip(self.layout.fields, values, strict=True))

    def _from_columns(self, columns: Mapping[str, Any]) -> NDArray[np.void]:
        unknown = set(columns) - set(self.layout.fields)
        if unknown:
            raise ValueError(f"there is no field {min(unknown)!r}")
        arrays = {name: np.asarray(column) for name, column in columns.items()}
        lengths = {len(array) for array in arrays.values() if array.ndim}
        if len(lengths) > 1 or any(array.ndim > 1 for array in arrays.values()):
            raise ValueError(f"expected columns of one length, found {sorted(lengths)}")
        records = np.zeros(lengths.pop() if lengths else int(bool(arrays)), dtype=self.dtype)
        for name, array in arrays.items():
            with np.errstate(over="ignore", invalid="ignore"):
                records[name] = array
            column = records[name]
            if column.dtype.kind in "iu" and (column != array).any():
                raise ValueError(f"{name} must be whole numbers within {column.dtype}")
            if column.dtype.kind == "f" and (np.isinf(column) & np.isfinite(array.astype(np.float64))).any():
                raise ValueError(f"{name} must be numbers within {column.dtype}")
        return records


_CONTROL = _fixed(id="u4", steer="f4", throttle="f4", brake="f4", hand_brake=FLAG, gear="i4")
_COLLISION = _fixed(id="u4", actor1="u4", actor2="u4", hero1=FLAG, hero2=FLAG)
_SCENE_LIGHT = _fixed(id="i4", intensity="f4", red="f4", green="f4", blue="f4", alpha="f4", on=FLAG, group="u1")
_VELOCITY = _fixed(id="u4", x=REAL, y=REAL, z=REAL, angular_x=REAL, angular_y=REAL, angular_z=REAL)
_LIGHT_STATE = _fixed(id="u4", frozen=FLAG, elapsed="f4", state="i1")
_WALKER_CONTROL = _fixed(id="u4", speed="f4")
_VEHICLE_LIGHT = _fixed(id="u4", flags="u4")
_BIKER = _fixed(id="u4", speed="f4", engine_rpm_ratio="f4")
_LIGHT_TIME = _fixed(id="u4", green="f4", yellow="f4", red="f4")
_TRANSFORM = Layout({"id": "u4", **_POSE})
_VOLUME = Layout({"id": "u4", **_BOX})
_FRAME = _fixed(id="u8", duration="f8", elapsed="f8")
_SECONDS = _fixed(seconds="f8")

_LIST, _SINGLE = Framing.LIST, Framing.SINGLE
_STATE, _EVENTS = Group.STATE, Group.EVENTS
_E, _N = {"always": True}, {"always": False}
_AE, _AN = {"always": True, "additional": True}, {"additional": True}


def _row(*values: Any) -> RecordType:
    *plain, presence = values
    names = ("id", "name", "topic", "message", "items", "layout", "framing", "group")
    return RecordType(**dict(zip(names, plain, strict=True)), **presence)


_PLACE: Final = dict.fromkeys("xyz", "cm") | dict.fromkeys(("roll", "pitch", "yaw"), "deg")
_EXTENT: Final = dict.fromkeys("xyz", "cm") | {f"extent_{axis}": "cm" for axis in "xyz"}
_UNITS: Final[Mapping[str, Mapping[str, str]]] = {
    "frame": {"duration": "s", "elapsed": "s"},
    "spawned": _PLACE,
    "transforms": _PLACE,
    "light_states": {"elapsed": "s"},
    "walker_controls": {"speed": "cm/s"},
    "velocities": dict.fromkeys("xyz", "m/s") | {f"angular_{axis}": "deg/s" for axis in "xyz"},
    "bounding_boxes": _EXTENT,
    "trigger_volumes": _EXTENT,
    "platform_time": {"seconds": "s"},
    "visual_time": {"seconds": "s"},
    "physics": {"max_rpm": "1/min", "mass": "kg", **{f"center_of_mass_{axis}": "m" for axis in "xyz"}},
    "light_times": {"green": "s", "yellow": "s", "red": "s"},
    "bikers": {"speed": "cm/s"},
    "weather": {"sun_azimuth_angle": "deg", "sun_altitude_angle": "deg", "fog_distance": "m"},
}
"""The units of the fields that have one, by type."""

# fmt: off
_ROWS: Final = (
    _row(0, "frame", "/frames", "Frame", "", _FRAME, _SINGLE, _STATE, _E),
    _row(1, "frame_end", "", "", "", _fixed(), Framing.MARKER, _STATE, _E),
    _row(2, "spawned", "/actors/spawned", "Spawned", "actors", _SPAWN, _LIST, _EVENTS, _E),
    _row(3, "destroyed", "/actors/destroyed", "Destroyed", "actors", _fixed(id="u4"), _LIST, _EVENTS, _E),
    _row(4, "parented", "/actors/parented", "Parented", "actors", _fixed(id="u4", parent="u4"), _LIST, _EVENTS, _E),
    _row(5, "collisions", "/collisions", "Collisions", "collisions", _COLLISION, _LIST, _EVENTS, _E),
    _row(6, "transforms", "/actors/transforms", "Transforms", "actors", _TRANSFORM, _LIST, _STATE, _E),
    _row(7, "light_states", "/traffic_lights/states", "TrafficLightStates", "lights", _LIGHT_STATE, _LIST, _STATE, _E),
    _row(8, "vehicle_controls", "/vehicles/controls", "VehicleControls", "vehicles", _CONTROL, _LIST, _STATE, _E),
    _row(9, "walker_controls", "/walkers/controls", "WalkerControls", "walkers", _WALKER_CONTROL, _LIST, _STATE, _E),
    _row(10, "vehicle_lights", "/vehicles/lights", "VehicleLights", "vehicles", _VEHICLE_LIGHT, _LIST, _STATE, _E),
    _row(11, "scene_lights", "/scene/lights", "SceneLights", "lights", _SCENE_LIGHT, _LIST, _EVENTS, _N),
    _row(12, "velocities", "/actors/velocities", "Velocities", "actors", _VELOCITY, _LIST, _STATE, _AN),
    _row(13, "bounding_boxes", "/actors/bounding_boxes", "BoundingBoxes", "actors", _VOLUME, _LIST, _EVENTS, _AE),
    _row(14, "platform_time", "/clock/platform", "PlatformTime", "seconds", _SECONDS, _SINGLE, _STATE, _AN),
    _row(15, "physics", "/vehicles/physics", "VehiclePhysics", "vehicles", _PHYSICS, _LIST, _EVENTS, _AN),
    _row(16, "light_times", "/traffic_lights/times", "TrafficLightTimes", "lights", _LIGHT_TIME, _LIST, _EVENTS, _AN),
    _row(17, "trigger_volumes", "/actors/trigger_volumes", "TriggerVolumes", "actors", _VOLUME, _LIST, _EVENTS, _AN),
    _row(18, "frame_counter", "/clock/frame_counter", "FrameCounter", "count", _fixed(count="u8"), _SINGLE, _STATE, _N),
    _row(19, "walker_bones", "/walkers/bones", "WalkerBones", "walkers", _BONES, _LIST, _STATE, _AE),
    _row(20, "visual_time", "/clock/visual", "VisualTime", "seconds", _SECONDS, _SINGLE, _STATE, _N),
    _row(21, "wheels", "/vehicles/wheels", "VehicleWheels", "vehicles", _WHEELS, _LIST, _STATE, _E),
    _row(22, "bikers", "/vehicles/bikers", "Bikers", "bikers", _BIKER, _LIST, _STATE, _E),
    _row(23, "doors", "/vehicles/doors", "VehicleDoors", "doors", _fixed(id="u4", door="u1", open=FLAG), _LIST, _EVENTS, _E),
    _row(24, "weather", "/weather", "Weather", "weather", _WEATHER, _LIST, _EVENTS, _N),
)
# fmt: on

ORDER: Final = (20, 2, 3, 4, 5, 23, 6, 7, 8, 9, 10, 11, 21, 22, 24, 12, 13, 17, 14, 15, 16, 19, 18)
"""The order in which CARLA 0.9.16 writes the packets of a frame, between its start and its end."""


class Table(Sequence[RecordType]):
    """All record types, as one family of builds writes them; `table[packet_id]`, `table.named("transforms")`."""

    def __init__(self, wide: bool) -> None:
        self.wide = wide
        # UE5 writes another, larger physics record with memory images inside.
        self._rows = tuple(replace(row, wide=True, opaque=row.name == "physics") for row in _ROWS) if wide else _ROWS
        self._named = {row.name: row for row in self._rows}

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, index: Any) -> Any:
        return self._rows[index]

    def named(self, name: str) -> RecordType:
        """Return the row of a name; a `RecordError` if no type has it."""
        try:
            return self._named[name]
        except KeyError:
            raise RecordError(f"no record type {name!r}; there are {', '.join(self._named)}") from None


UE4: Final = Table(wide=False)
UE5: Final = Table(wide=True)


def _of_table(id: int, wide: bool) -> RecordType:
    type: RecordType = (UE5 if wide else UE4)[id]
    return type


FRAME_START: Final = 0
FRAME_END: Final = 1
