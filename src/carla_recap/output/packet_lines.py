"""The text of records in CARLA's info text: a table of templates, one row per record type."""

from __future__ import annotations

import re
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.layout import REAL, TEXT, U16, Layout, Many, Records
from carla_recap.model.records import UE4
from carla_recap.util.text import number, readable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from numpy.typing import NDArray

    from carla_recap.model.frame import Packet


class PacketLines:
    """Formats the records of a type by a line with fields in braces; `{index}` is the number of the record in its packet.

    A packet has a heading with the number of records, unless it is None, and an end. For some fields, functions return the
    words for a value.
    """

    def __init__(
        self, layout: Layout, line: str, heading: str | None = None, end: str = "", /, **words: Callable[[Any], Any]
    ) -> None:
        self._heading, self._end = heading, end
        self._fields = _FIELD.findall(line)
        kinds = {"index": "u4", **layout.fields}
        texts = {field: readable for field in self._fields if kinds[field] == TEXT}
        self._words = {**texts, **words}
        self._reals = [kinds[field] in (REAL, "f4", "f8") for field in self._fields]
        self._line = _FIELD.sub(lambda match: "%.6g" if self._reals[self._fields.index(match[1])] else "%s", line)
        self._line_of_texts = _FIELD.sub("%s", line)

    def __call__(self, packet: Packet) -> str:
        """Return the text of a packet."""
        text = self.text(packet.records)
        return text if self._heading is None else f" {self._heading}: {_count(packet)}\n{text}{self._end}"

    def text(self, records: Records) -> str:
        """Return the text of some records."""
        if not len(records):
            return ""
        text = "".join(map(self._line.__mod__, self._rows(records)))
        if "nan" not in text:
            return text
        rows = ([number(v) if real else v for v, real in zip(row, self._reals, strict=True)] for row in self._rows(records))
        return "".join(self._line_of_texts % tuple(row) for row in rows)  # with the signs of NaNs, which Python omits

    def _rows(self, records: Records) -> Iterable[tuple[Any, ...]]:
        """Return the values of each record, in the order of the line."""
        return zip(*(self._column(field, records) for field in self._fields), strict=True)

    def _column(self, field: str, records: Records) -> Iterable[Any]:
        values: Iterable[Any] = range(len(records))
        if field != "index" and isinstance(records, np.ndarray):
            values = records[field].tolist()
        elif field != "index":
            values = [getattr(each, field) for each in records]
        return map(self._words[field], values) if field in self._words else values


_FIELD: Final = re.compile(r"\{(\w+)\}")


def _count(packet: Packet) -> int:
    if packet.type is None or not packet.type.opaque:
        return len(packet.records)
    return int(U16.unpack_from(packet.payload)[0]) if len(packet.payload) >= U16.size else 0


# --- words for numbers -----------------------------------------------------------------------------------

LIGHTS: Final = {
    "Position": 1 << 0,
    "LowBeam": 1 << 1,
    "HighBeam": 1 << 2,
    "Brake": 1 << 3,
    "RightBlinker": 1 << 4,
    "LeftBlinker": 1 << 5,
    "Reverse": 1 << 6,
    "Interior": 1 << 8,
    "Fog": 1 << 7,
    "Special1": 1 << 9,
    "Special2": 1 << 10,
}
"""The flags of vehicle lights by name, in the order of CARLA's text."""
_ALL_LIGHTS: Final = sum(LIGHTS.values())
_DOORS: Final = ("Front Left", "Front Right", "Rear Left", "Rear Right", "Hood", "Trunk", "All")


@cache
def _light_names(flags: int) -> str:
    return " ".join(name for name, bit in LIGHTS.items() if flags & bit) or "None"


def _door(door: int) -> str:
    return f" {_DOORS[door]} \n" if door < len(_DOORS) else "\n"


def _door_of_carla(door: int) -> str:
    """Return the name of a door; for an unknown one, CARLA prints no end of line."""
    return _door(door) if door < len(_DOORS) else ""


def _light_state(state: int) -> str:
    """Return the character with the code of `0` plus the state; `?` if it is not ASCII."""
    code = (ord("0") + state) & 0xFF
    return chr(code) if code < 0x80 else "?"


def _hero(flag: int) -> str:
    return " (hero) " if flag else ""


def _rounded_as_in_carla(metres: float) -> float:
    """Return a length as CARLA prints it, converted from m to cm and back in single precision."""
    with np.errstate(all="ignore"):
        return float(np.float32(0.01) * (np.float32(100.0) * np.float32(metres)))


# --- records inside records ------------------------------------------------------------------------------


def _inside(type: str, field: str) -> Layout:
    many = UE4.named(type).layout.fields[field]
    assert isinstance(many, Many)
    return many.layouts[0]


_ATTRIBUTE: Final = PacketLines(_inside("spawned", "attributes"), "  {key} = {value}\n")
_BONE: Final = PacketLines(
    _inside("walker_bones", "bones"), '     Bone: "{name}" relative: Loc({x}, {y}, {z}) Rot({roll}, {pitch}, {yaw})\n'
)
_GEAR: Final = PacketLines(
    _inside("physics", "forward_gears"), "    gear {index}: ratio {ratio} down_ratio {down_ratio} up_ratio {up_ratio}\n"
)
_WHEEL: Final = PacketLines(
    _inside("physics", "wheels"),
    "    wheel {index}: tire_friction {tire_friction} damping_rate {damping_rate} "
    "max_steer_angle {max_steer_angle} radius {radius} max_brake_torque {max_brake_torque} "
    "max_handbrake_torque {max_handbrake_torque} position ({position_x}, {position_y}, {position_z})\n",
)
_POINT: Final = PacketLines(_inside("physics", "torque_curve"), " ({x}, {y})")


def sorted_points(points: NDArray[np.void]) -> NDArray[np.void]:
    """Return the points of a curve as CARLA prints them: by x; of equal ones, the one recorded last comes first."""
    backwards = points[::-1]
    return backwards[np.argsort(backwards["x"], kind="stable")]


def _curve(points: NDArray[np.void]) -> str:
    return _POINT.text(sorted_points(points))


# --- the table -------------------------------------------------------------------------------------------


def _row(
    type: str, heading: str | None, line: str, end: str = "", /, **words: Callable[[Any], Any]
) -> tuple[str, PacketLines]:
    return type, PacketLines(UE4.named(type).layout, line, heading, end, **words)


_BOX: Final = "  Id: {id} origin: ({x}, {y}, {z}) extension: ({extent_x}, {extent_y}, {extent_z})\n"
_DOORS_ROW: Final = ("doors", "Vehicle door animations", "  Id: {id}\n  Doors opened: {door}")

# The gear switch time is not recorded: CARLA prints its default.
_PHYSICS: Final = """\
  Id: {id}
   max_rpm = {max_rpm}
   MOI = {moi}
   damping_rate_full_throttle = {damping_rate_full_throttle}
   damping_rate_zero_throttle_clutch_engaged = {damping_rate_zero_throttle_clutch_engaged}
   damping_rate_zero_throttle_clutch_disengaged = {damping_rate_zero_throttle_clutch_disengaged}
   use_gear_auto_box = {use_gear_auto_box}
   gear_switch_time = 0.5
   clutch_strength = {clutch_strength}
   final_ratio = {final_ratio}
   mass = {mass}
   drag_coefficient = {drag_coefficient}
   center_of_mass = ({center_of_mass_x}, {center_of_mass_y}, {center_of_mass_z})
   torque_curve ={torque_curve}
   steering_curve ={steering_curve}
   forward_gears:
{forward_gears}   wheels:
{wheels}"""
_PHYSICS_WORDS: Final[dict[str, Callable[[Any], Any]]] = {
    "use_gear_auto_box": lambda flag: "true" if flag else "false",
    "torque_curve": _curve,
    "steering_curve": _curve,
    "forward_gears": _GEAR.text,
    "wheels": _WHEEL.text,
}
_CENTER_OF_CARLA: Final[dict[str, Callable[[Any], Any]]] = dict.fromkeys(
    (f"center_of_mass_{axis}" for axis in "xyz"), _rounded_as_in_carla
)


_ROWS: Final = (
    _row("spawned", None, " Create {id}: {type_id} ({kind}) at ({x}, {y}, {z})\n{attributes}", attributes=_ATTRIBUTE.text),
    _row("destroyed", None, " Destroy {id}\n"),
    _row("parented", None, " Parenting {id} with {parent} (parent)\n"),
    _row("collisions", None, " Collision id {id} between {actor1}{hero1} with {actor2}{hero2}\n", hero1=_hero, hero2=_hero),
    _row("transforms", "Positions", "  Id: {id} Location: ({x}, {y}, {z}) Rotation: ({roll}, {pitch}, {yaw})\n"),
    _row(
        "light_states",
        "State traffic lights",
        "  Id: {id} state: {state} frozen: {frozen} elapsedTime: {elapsed}\n",
        state=_light_state,
    ),
    _row(
        "vehicle_controls",
        "Vehicle animations",
        "  Id: {id} Steering: {steer} Throttle: {throttle} Brake: {brake} Handbrake: {hand_brake} Gear: {gear}\n",
    ),
    _row("walker_controls", "Walker animations", "  Id: {id} speed: {speed}\n"),
    _row(*_DOORS_ROW, door=_door),
    _row(
        "vehicle_lights",
        "Vehicle light animations",
        "  Id: {id} {flags}\n",
        flags=lambda flags: _light_names(flags & _ALL_LIGHTS),
    ),
    _row(
        "scene_lights",
        "Scene light changes",
        "  Id: {id} enabled: {on} intensity: {intensity} RGB_color: ({red}, {green}, {blue})\n",
        on=bool,
    ),
    _row(
        "velocities",
        "Dynamic actors",
        "  Id: {id} linear_velocity: ({x}, {y}, {z}) angular_velocity: ({angular_x}, {angular_y}, {angular_z})\n",
    ),
    _row("bounding_boxes", "Actor bounding boxes", _BOX),
    _row("trigger_volumes", "Actor trigger volumes", _BOX),
    _row("platform_time", None, " Current platform time: {seconds}\n"),
    _row("physics", "Physics Control events", _PHYSICS, **_PHYSICS_WORDS),
    _row(
        "light_times", "Traffic Light time events", "  Id: {id} green_time: {green} yellow_time: {yellow} red_time: {red}\n"
    ),
    _row("walker_bones", "Walkers Bones", "  Id: {id}\n{bones}", "\n", bones=_BONE.text),
)
_LINES: Final = dict(_ROWS)
_ROWS_OF_CARLA: Final = (
    _row(*_DOORS_ROW, door=_door_of_carla),
    _row("physics", "Physics Control events", _PHYSICS, **_PHYSICS_WORDS, **_CENTER_OF_CARLA),
)
_LINES_OF_CARLA: Final = dict((*_ROWS, *_ROWS_OF_CARLA))


def packet_lines(*, compat: bool) -> Mapping[str, PacketLines]:
    """Return the formatters of packets, by the record types that CARLA prints."""
    return _LINES_OF_CARLA if compat else _LINES
