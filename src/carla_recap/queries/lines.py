"""How CARLA's info text prints the records of each type: one row per type, with its heading and its line."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.payload import U16
from carla_recap.queries.answer import readable
from carla_recap.records import UE4

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.frame import Packet
    from carla_recap.records import Bones, Physics, Spawn

Printer = Callable[["Packet"], str]


def number(value: float) -> str:
    """A number with six digits, as C++ prints it: with the sign of a NaN too."""
    return "-nan" if math.isnan(value) and math.copysign(1.0, value) < 0 else f"{value:.6g}"


class _Lines:
    """Prints the records of a type that is fixed in size.

    Args:
        type: The record type's name.
        heading: What comes before the number of records; None for no heading.
        line: A record's line, with the fields in braces.
        words: For some fields, what to print for a number.
    """

    def __init__(
        self,
        type: str,
        heading: str | None,
        line: str,
        words: Mapping[str, Callable[[int], str]] | None = None,
    ) -> None:
        dtype = UE4.named(type).dtype
        self._heading = heading
        self._fields = _FIELD.findall(line)
        self._words = words or {}
        self._reals = {field for field in self._fields if dtype[field].kind == "f"}
        codes = {
            field: "%s" if field in self._words else "%.6g" if field in self._reals else "%d"
            for field in self._fields
        }
        self._line = _FIELD.sub(lambda match: codes[match[1]], line)
        self._line_of_texts = _FIELD.sub("%s", line)

    def __call__(self, packet: Packet) -> str:
        records = packet.records
        assert isinstance(records, np.ndarray)
        heading = "" if self._heading is None else f" {self._heading}: {len(records)}\n"
        if not len(records):
            return heading
        columns = [self._column(field, records) for field in self._fields]
        text = "".join(map(self._line.__mod__, zip(*columns, strict=True)))
        if "nan" in text:
            text = self._with_signs(columns)
        return heading + text

    def _column(self, field: str, records: NDArray[np.void]) -> list[Any]:
        column: list[Any] = records[field].tolist()
        return list(map(self._words[field], column)) if field in self._words else column

    def _with_signs(self, columns: list[list[Any]]) -> str:
        """The lines of records with a NaN among them, whose sign Python would not print."""
        texts = [
            map(number, column) if field in self._reals else column
            for field, column in zip(self._fields, columns, strict=True)
        ]
        return "".join(map(self._line_of_texts.__mod__, zip(*texts, strict=True)))


_FIELD: Final = re.compile(r"\{(\w+)\}")


# --- words for numbers -------------------------------------------------------------------------------------------------

_LIGHTS: Final = {  # in CARLA's order
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
_ALL_LIGHTS: Final = sum(_LIGHTS.values())
_DOORS: Final = ("Front Left", "Front Right", "Rear Left", "Rear Right", "Hood", "Trunk", "All")


def _hero(flag: int) -> str:
    return " (hero) " if flag else ""


def _true(flag: int) -> str:
    return "True" if flag else "False"


def _light_state(state: int) -> str:
    """One character, as many after 0 as the state says; CARLA's text can hold ASCII alone."""
    code = (ord("0") + state) & 0xFF
    return chr(code) if code < 0x80 else "?"


def _lights(flags: int) -> str:
    return _light_names(flags & _ALL_LIGHTS)


@cache
def _light_names(flags: int) -> str:
    return " ".join(name for name, bit in _LIGHTS.items() if flags & bit) or "None"


def _door(door: int) -> str:
    return f" {_DOORS[door]} \n" if door < len(_DOORS) else "\n"


def _door_of_carla(door: int) -> str:
    """CARLA leaves the line of an unknown door open."""
    return _door(door) if door < len(_DOORS) else ""


# --- records whose size varies -----------------------------------------------------------------------------------------


def _spawned(packet: Packet) -> str:
    return "".join(map(_spawn, packet.records))


def _spawn(spawn: Spawn) -> str:
    place = f"({number(spawn.x)}, {number(spawn.y)}, {number(spawn.z)})"
    lines = [f" Create {spawn.id}: {readable(spawn.type_id)} ({spawn.kind}) at {place}\n"]
    lines += [
        f"  {readable(attribute.key)} = {readable(attribute.value)}\n" for attribute in spawn.attributes
    ]
    return "".join(lines)


_GEAR_SWITCH_TIME: Final = 0.5  # not recorded: CARLA prints its default


def _physics(packet: Packet) -> str:
    if packet.type and packet.type.opaque:
        count = U16.unpack_from(packet.payload)[0] if len(packet.payload) >= U16.size else 0
    else:
        count = len(packet.records)
    return f" Physics Control events: {count}\n" + "".join(map(_physics_control, packet.records))


def _physics_control(physics: Physics) -> str:
    center = (physics.center_of_mass_x, physics.center_of_mass_y, physics.center_of_mass_z)
    values = {
        "max_rpm": number(physics.max_rpm),
        "MOI": number(physics.moi),
        "damping_rate_full_throttle": number(physics.damping_rate_full_throttle),
        "damping_rate_zero_throttle_clutch_engaged": number(
            physics.damping_rate_zero_throttle_clutch_engaged
        ),
        "damping_rate_zero_throttle_clutch_disengaged": number(
            physics.damping_rate_zero_throttle_clutch_disengaged
        ),
        "use_gear_auto_box": "true" if physics.use_gear_auto_box else "false",
        "gear_switch_time": number(_GEAR_SWITCH_TIME),
        "clutch_strength": number(physics.clutch_strength),
        "final_ratio": number(physics.final_ratio),
        "mass": number(physics.mass),
        "drag_coefficient": number(physics.drag_coefficient),
        "center_of_mass": f"({', '.join(map(number, center))})",
    }
    lines = [f"  Id: {physics.id}\n", *(f"   {name} = {value}\n" for name, value in values.items())]
    for name, curve in (("torque_curve", physics.torque_curve), ("steering_curve", physics.steering_curve)):
        lines.append(
            f"   {name} ={''.join(f' ({number(x)}, {number(y)})' for x, y in _sorted_points(curve))}\n"
        )
    lines.append("   forward_gears:\n")
    for index, gear in enumerate(physics.forward_gears):
        ratio, down, up = (number(gear[name].item()) for name in ("ratio", "down_ratio", "up_ratio"))
        lines.append(f"    gear {index}: ratio {ratio} down_ratio {down} up_ratio {up}\n")
    lines.append("   wheels:\n")
    for index, wheel in enumerate(physics.wheels):
        shown = "".join(f" {name} {number(wheel[field].item())}" for name, field in _WHEEL.items())
        position = ", ".join(number(wheel[f"position_{axis}"].item()) for axis in "xyz")
        lines.append(f"    wheel {index}:{shown} position ({position})\n")
    return "".join(lines)


_WHEEL: Final = {
    "tire_friction": "tire_friction",
    "damping_rate": "damping_rate",
    "max_steer_angle": "max_steer_angle",
    "radius": "radius",
    "max_brake_torque": "max_brake_torque",
    "max_handbrake_torque": "max_handbrake_torque",
}


def _sorted_points(curve: NDArray[np.void]) -> list[tuple[float, float]]:
    """The points of a curve by their first number; of equal ones, the later recorded comes first."""
    backwards = curve[::-1]
    return backwards[np.argsort(backwards["x"], kind="stable")].tolist()  # type: ignore[no-any-return]


def _walker_bones(packet: Packet) -> str:
    return f" Walkers Bones: {len(packet.records)}\n" + "".join(map(_bones, packet.records)) + "\n"


def _bones(walker: Bones) -> str:
    lines = [f"  Id: {walker.id}\n"]
    for bone in walker.bones:
        location = f"Loc({number(bone.x)}, {number(bone.y)}, {number(bone.z)})"
        rotation = f"Rot({number(bone.roll)}, {number(bone.pitch)}, {number(bone.yaw)})"
        lines.append(f'     Bone: "{readable(bone.name)}" relative: {location} {rotation}\n')
    return "".join(lines)


# --- the rows ----------------------------------------------------------------------------------------------------------

_BOX: Final = "  Id: {id} origin: ({x}, {y}, {z}) extension: ({extent_x}, {extent_y}, {extent_z})\n"
_DOOR_LINES: Final = ("doors", "Vehicle door animations", "  Id: {id}\n  Doors opened: {door}")

_PRINTERS: Final[Mapping[str, Printer]] = {
    "spawned": _spawned,
    "destroyed": _Lines("destroyed", None, " Destroy {id}\n"),
    "parented": _Lines("parented", None, " Parenting {id} with {parent} (parent)\n"),
    "collisions": _Lines(
        "collisions",
        None,
        " Collision id {id} between {actor1}{hero1} with {actor2}{hero2}\n",
        {"hero1": _hero, "hero2": _hero},
    ),
    "transforms": _Lines(
        "transforms", "Positions", "  Id: {id} Location: ({x}, {y}, {z}) Rotation: ({roll}, {pitch}, {yaw})\n"
    ),
    "light_states": _Lines(
        "light_states",
        "State traffic lights",
        "  Id: {id} state: {state} frozen: {frozen} elapsedTime: {elapsed}\n",
        {"state": _light_state},
    ),
    "vehicle_controls": _Lines(
        "vehicle_controls",
        "Vehicle animations",
        "  Id: {id} Steering: {steer} Throttle: {throttle} Brake: {brake} Handbrake: {hand_brake} Gear: {gear}\n",
    ),
    "walker_controls": _Lines("walker_controls", "Walker animations", "  Id: {id} speed: {speed}\n"),
    "doors": _Lines(*_DOOR_LINES, {"door": _door}),
    "vehicle_lights": _Lines(
        "vehicle_lights", "Vehicle light animations", "  Id: {id} {flags}\n", {"flags": _lights}
    ),
    "scene_lights": _Lines(
        "scene_lights",
        "Scene light changes",
        "  Id: {id} enabled: {on} intensity: {intensity} RGB_color: ({red}, {green}, {blue})\n",
        {"on": _true},
    ),
    "velocities": _Lines(
        "velocities",
        "Dynamic actors",
        "  Id: {id} linear_velocity: ({x}, {y}, {z}) angular_velocity: ({angular_x}, {angular_y}, {angular_z})\n",
    ),
    "bounding_boxes": _Lines("bounding_boxes", "Actor bounding boxes", _BOX),
    "trigger_volumes": _Lines("trigger_volumes", "Actor trigger volumes", _BOX),
    "platform_time": _Lines("platform_time", None, " Current platform time: {seconds}\n"),
    "physics": _physics,
    "light_times": _Lines(
        "light_times",
        "Traffic Light time events",
        "  Id: {id} green_time: {green} yellow_time: {yellow} red_time: {red}\n",
    ),
    "walker_bones": _walker_bones,
}
_PRINTERS_OF_CARLA: Final[Mapping[str, Printer]] = {
    **_PRINTERS,
    "doors": _Lines(*_DOOR_LINES, {"door": _door_of_carla}),
}


def packet_lines(compat: bool) -> Mapping[str, Printer]:
    """For each record type that is shown, what prints a packet of it."""
    return _PRINTERS_OF_CARLA if compat else _PRINTERS
