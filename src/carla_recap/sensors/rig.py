"""Rigs: which sensors are where on an actor, from JSON files or lists of dicts as the Leaderboard's agents return them.

rig = SensorRig.load("rig.json")
for sensor in rig:
    print(sensor.id, sensor.type, sensor.x, sensor.y, sensor.z)
"""

from __future__ import annotations

import json
import re
import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.rendering.camera import ImageKind
from carla_recap.sensors.kinds import LEADERBOARD_CHOICES, SENSOR_TYPES, SensorAttribute
from carla_recap.util.files import read_document
from carla_recap.util.text import first_of, nearest, visible

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from carla_recap.sensors.kinds import Kind, SensorType, Value

MOST_SENSORS: Final = 100
"""The greatest number of sensors of a rig."""

_LARGEST_FILE: Final = 1 << 20  # bytes
_UNNAMED: Final = "rig"
_ID: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}")
_SHOWN: Final = 60  # characters of a wrong value in an error
_LISTED: Final = 16  # keys or ids that an error lists
_PLACE: Final = ("x", "y", "z")
_ANGLES: Final = ("roll", "pitch", "yaw")
_POSE: Final[Mapping[str, SensorAttribute]] = {
    **dict.fromkeys(_PLACE, SensorAttribute("0.0", float, -1000.0, 1000.0, "m")),
    **dict.fromkeys(_ANGLES, SensorAttribute("0.0", float, -360.0, 360.0, "degrees")),
}
_PLACED: Final = ("camera", "lidar", "semantic_lidar", "radar")  # kinds whose place matters so much that it must be given
_MAP: Final = "sensor.opendrive_map"
_ALIASES: Final[Mapping[str, str]] = {"width": "image_size_x", "height": "image_size_y"}
_READING_FREQUENCY: Final = "reading_frequency"  # Hz: the Leaderboard's name for 1 / sensor_tick of what is no actor
_FREQUENCY: Final = SensorAttribute("20.0", float, 0.001, 1000.0, "Hz")


@dataclass(frozen=True, slots=True)
class SensorSpec:
    """A sensor of a rig: its type, its place on the actor, and its attributes.

    Axes are CARLA's: x forward, y right, z up; the pose is relative to the actor's origin.

    Attributes:
        id: The name of the sensor, which topics and files have, too.
        type: CARLA's name of the type, such as `sensor.camera.rgb`; a key of `SENSOR_TYPES`.
        x: The position forward, in m.
        y: The position to the right, in m.
        z: The position upwards, in m.
        roll: The roll in degrees.
        pitch: The pitch in degrees, positive upwards.
        yaw: The yaw in degrees, positive to the right.
        attributes: All attributes of the type by CARLA's names, those that the rig leaves out included.
    """

    id: str
    type: str
    x: float
    y: float
    z: float
    roll: float
    pitch: float
    yaw: float
    attributes: Mapping[str, Value] = field(hash=False)

    @property
    def kind(self) -> Kind:
        """The kind of sensor, such as `camera`."""
        return SENSOR_TYPES[self.type].kind

    @property
    def image(self) -> ImageKind | None:
        """The kind of image of a camera; None for other sensors."""
        return SENSOR_TYPES[self.type].image

    def number(self, key: str) -> float:
        """Return an attribute as a number.

        Raises:
            KeyError: The type has no such attribute.
        """
        return float(self.attributes[key])

    def texts(self) -> dict[str, str]:
        """Return the attributes as CARLA's blueprints take them: as texts, with true and false in lower case."""
        return {key: str(value).lower() if isinstance(value, bool) else str(value) for key, value in self.attributes.items()}

    @classmethod
    def of_texts(cls, id: str, type: str, pose: Sequence[float], texts: Mapping[str, str]) -> SensorSpec:
        """Return the sensor of an actor of CARLA.

        Args:
            id: Its name.
            type: The type of the actor.
            pose: x, y, z in m, roll, pitch, yaw in degrees, in CARLA's axes: relative to the actor that carries it, or if
                there is none, in the world.
            texts: The attributes of the actor; those that are missing have their defaults, and unknown ones are left out.

        Raises:
            RecapError: The type or an attribute is none that a rig can have; the message names sensor and key.
        """
        known = SENSOR_TYPES[type].attributes if type in SENSOR_TYPES else {}
        values = {key: row.parse(texts[key]) for key, row in known.items() if key in texts}
        place = dict.fromkeys(_PLACE, 0.0)
        (spec,) = _rig([{"id": id, "type": type, **place, **values}], "the server", leaderboard=False)
        x, y, z, roll, pitch, yaw = map(float, pose)
        return replace(spec, x=x, y=y, z=z, roll=roll, pitch=pitch, yaw=yaw)

    def to_dict(self) -> dict[str, Value]:
        """Return the sensor as a dict that a rig can be made of."""
        pose = {key: getattr(self, key) for key in (*_PLACE, *_ANGLES)}
        return {"type": self.type, "id": self.id, **pose, **self.attributes}


@dataclass(frozen=True, slots=True)
class SensorRig:
    """Sensors on an actor; `rig["front"]` is the one of an id.

    Attributes:
        sensors: The sensors, in the order of the file or list.
        name: What it is called in errors: its file, if it has one.
    """

    sensors: tuple[SensorSpec, ...]
    name: str = field(default=_UNNAMED, compare=False)

    @classmethod
    def load(cls, path: Path | str, *, leaderboard: bool = False) -> SensorRig:
        """Return the rig of a JSON file: a list of objects, as `of` takes them, or ROS bridge's objects.

        Of the latter, an object with the member `objects`, it is the sensors of the ego vehicle, whose poses there are in
        ROS's axes: y to the left, positive pitch down, positive yaw to the left.

        Args:
            path: The file; of 1 MB at most.
            leaderboard: Whether the sensors have the values that the Leaderboard gives to them.

        Raises:
            RecapError: The file cannot be read, or is no rig; the message names the sensor and the key.

        Warns:
            RecapWarning: Sensors that a rig cannot have are left out.
        """
        try:
            sensors = json.loads(read_document(path, _LARGEST_FILE, "a rig"), object_pairs_hook=_Members)
        except json.JSONDecodeError as error:
            raise RecapError(f"{path}: line {error.lineno}: {error.msg}; JSON was expected") from None
        except RecursionError:
            raise RecapError(f"{path}: is nested too deeply; a list of sensors was expected") from None
        except ValueError:  # of `int`
            raise RecapError(f"{path}: has a number of thousands of digits; a list of sensors was expected") from None
        return _rig(sensors, str(path), leaderboard=leaderboard)

    @classmethod
    def of(cls, sensors: Sequence[Mapping[str, Any]], *, leaderboard: bool = False) -> SensorRig:
        """Return the rig of a list of dicts in the form of the Leaderboard's `sensors()`.

        Args:
            sensors: The sensors. Each has a `type` and an `id`; `x`, `y`, `z` in m and `roll`, `pitch`, `yaw` in degrees in
                CARLA's axes; and attributes by CARLA's names, of which `width` and `height` stand for `image_size_x` and
                `image_size_y`. Cameras, lidars and radars need `x`, `y` and `z`; all else has a default.
            leaderboard: Whether the sensors have the values that the Leaderboard gives to them, whatever they say: of the
                attributes, it takes the size and `fov` of cameras and the angles of radars.

        Raises:
            RecapError: They are no rig; the message names the sensor and the key.
        """
        return _rig(sensors, _UNNAMED, leaderboard=leaderboard)

    def __getitem__(self, id: str) -> SensorSpec:
        for sensor in self.sensors:
            if sensor.id == id:
                return sensor
        raise KeyError(id)

    def __iter__(self) -> Iterator[SensorSpec]:
        return iter(self.sensors)

    def __len__(self) -> int:
        return len(self.sensors)

    def rgb_cameras(self, ids: Sequence[str] | None = None) -> list[SensorSpec]:
        """Return the RGB cameras.

        Args:
            ids: The ids of those that are wanted, in this order; None: all.

        Raises:
            RecapError: There is none, or not one of these; the message lists those that there are.
        """
        found = {sensor.id: sensor for sensor in self if sensor.image is ImageKind.RGB}
        if not found:
            raise RecapError(f"{self.name}: has no sensor.camera.rgb; one at least was expected")
        for id in ids or ():
            if id not in found:
                expected = f"one of {first_of(list(found), _LISTED)} was expected"
                raise RecapError(f"{self.name}: has no RGB camera {_key(id)!r}; {expected}")
        return list(found.values()) if ids is None else [found[id] for id in dict.fromkeys(ids)]

    def to_dicts(self) -> list[dict[str, Value]]:
        """Return the sensors as dicts with all attributes, of which `of` makes the same rig."""
        return [sensor.to_dict() for sensor in self.sensors]


def as_rig(rig: SensorRig | Path | str) -> SensorRig:
    """Return a rig, which may be given as its file.

    Raises:
        RecapError: See `SensorRig.load`.
    """
    return rig if isinstance(rig, SensorRig) else SensorRig.load(rig)


class _Members(dict[str, Any]):
    """An object of a JSON file; `repeated` is a key that it has twice, or empty."""

    def __init__(self, pairs: Iterable[tuple[str, Any]]) -> None:
        pairs = list(pairs)
        super().__init__(pairs)
        self.repeated = next((key for key, count in Counter(key for key, _ in pairs).items() if count > 1), "")


def _rig(sensors: object, name: str, *, leaderboard: bool) -> SensorRig:
    """Return the rig of dicts, which may be anything; the name is what they are called in errors."""
    if isinstance(sensors, Mapping) and "objects" in sensors:
        from carla_recap.sensors.ros_objects import sensors_of_objects  # which imports what replays

        sensors = sensors_of_objects(sensors["objects"], name)
    if not isinstance(sensors, Sequence) or isinstance(sensors, (str, bytes)):
        raise RecapError(f"{name}: {_shown(sensors)}; a list of sensors was expected")
    if len(sensors) > MOST_SENSORS:
        raise RecapError(f"{name}: has {len(sensors)} sensors; {MOST_SENSORS} at most were expected")
    found: list[SensorSpec] = []
    positions: dict[str, int] = {}
    for position, members in enumerate(sensors, 1):
        reader = _SensorReader(members, f"{name}: sensor {position}", name)
        if (first := positions.setdefault(reader.id, position)) != position:
            raise RecapError(
                f"{name}: sensor {position}: id: {reader.id!r}; another one than that of sensor {first} was expected"
            )
        if reader.is_map:  # whatever else it says
            warnings.warn(RecapWarning(f"{name}: sensor {reader.id!r}: {_MAP} is left out"), stacklevel=3)
        else:
            found.append(reader.spec(leaderboard=leaderboard))
    if not found:
        raise RecapError(f"{name}: has no sensors; a list of sensors was expected")
    return SensorRig(tuple(found), name)


class _SensorReader:
    """Reads a sensor of a rig, which may be anything; it is called by its place in errors until its id is known."""

    def __init__(self, members: object, place: str, name: str) -> None:
        self._place = place
        if not isinstance(members, Mapping):
            raise RecapError(f"{place}: {_shown(members)}; an object with a type and an id was expected")
        self._members = members
        self.id = self._text("id")
        if not _ID.fullmatch(self.id):
            self.refuse("id", "a name of 64 letters, digits and _ at most, which begins with no digit,")
        self._place = f"{name}: sensor {self.id!r}"
        if isinstance(members, _Members) and members.repeated:
            raise RecapError(f"{self._place}: {_key(members.repeated)}: is there twice; once was expected")
        type = self._text("type")
        if type not in SENSOR_TYPES:
            self.refuse("type", nearest(type, SENSOR_TYPES))
        self._type: SensorType = SENSOR_TYPES[type]
        self.is_map = type == _MAP

    def spec(self, *, leaderboard: bool) -> SensorSpec:
        """Return the sensor."""
        self._check_keys()
        if self._type.kind in _PLACED:
            for key in _PLACE:
                self._require(key)
        pose = {key: self._value(key, row) for key, row in _POSE.items()}
        names = {attribute: alias for alias, attribute in _ALIASES.items() if alias in self._members}
        attributes = {key: self._value(names.get(key, key), row) for key, row in self._type.attributes.items()}
        if _READING_FREQUENCY in self._members:
            attributes["sensor_tick"] = 1.0 / float(self._value(_READING_FREQUENCY, _FREQUENCY))
        if leaderboard and self._type.leaderboard is not None:
            chosen = LEADERBOARD_CHOICES.get(self._type.kind, ())
            fixed = {key: row.default for key, row in self._type.attributes.items() if key not in chosen}
            attributes |= {**fixed, **self._type.leaderboard}
        return SensorSpec(self.id, self._type.name, **pose, attributes=attributes)  # type: ignore[arg-type]

    def refuse(self, key: str, expected: str) -> None:
        """Raise an error about the value of a key."""
        raise RecapError(f"{self._place}: {_key(key)}: {_shown(self._members.get(key))}; {expected} was expected")

    def _require(self, key: str) -> None:
        if key not in self._members:
            raise RecapError(f"{self._place}: {key} is missing")

    def _text(self, key: str) -> str:
        self._require(key)
        value = self._members[key]
        if not isinstance(value, str):
            self.refuse(key, "a text")
        return str(value)

    def _check_keys(self) -> None:
        """Make sure that all keys are known, and that none is given by two names."""
        attributes = self._type.attributes
        aliases = [alias for alias, key in _ALIASES.items() if key in attributes]
        if not self._type.is_actor:
            aliases.append(_READING_FREQUENCY)
        known = ["type", "id", *_POSE, *aliases, *attributes]
        for key in self._members:
            if key not in known:
                expected = nearest(str(key), known, _LISTED)
                raise RecapError(f"{self._place}: {_key(key)}: is no key of {self._type.name}; {expected} was expected")
        for alias, key in _ALIASES.items():
            if alias in self._members and key in self._members:
                raise RecapError(f"{self._place}: {alias}: is {key}, which is given, too; one of them was expected")

    def _value(self, key: str, attribute: SensorAttribute) -> Value:
        """Return the value of a key; the default if it is missing."""
        if key not in self._members:
            return attribute.default
        value = self._members[key]
        if attribute.type is bool:
            is_valid = isinstance(value, bool)
        elif attribute.type is str:
            is_valid = value in attribute.choices
        else:
            is_valid = isinstance(value, Real) and not isinstance(value, bool)
            is_valid = is_valid and attribute.least <= value <= attribute.greatest
            is_valid = is_valid and (attribute.type is float or value == int(value))
        if not is_valid:
            self.refuse(key, attribute.values)
        return attribute.type(value)


def _key(key: object) -> str:
    """Return a key or an id as errors show it."""
    return visible(str(key))[:_SHOWN]


def _shown(value: object) -> str:
    """Return a value as errors show it."""
    if isinstance(value, (Mapping, list, tuple)):
        return f"{'an object' if isinstance(value, Mapping) else 'a list'} of {len(value)}"
    if isinstance(value, int) and abs(value) >= 10**_SHOWN:
        return "a number of many digits"
    text = json.dumps(value, ensure_ascii=False) if value is None or isinstance(value, (str, bool)) else repr(value)
    return visible(text if len(text) <= _SHOWN else f"{text[:_SHOWN]}…")
