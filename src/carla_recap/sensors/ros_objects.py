"""Sensors of the files of objects that ROS bridges spawn (`objects.json`), in the form of rigs."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.model.records import CM
from carla_recap.replay.pose import attach
from carla_recap.sensors.kinds import SENSOR_TYPES
from carla_recap.util.text import first_of, visible

if TYPE_CHECKING:
    from carla_recap.util.arrays import Floats

_EGO: Final = ("ego_vehicle", "hero")  # whose sensors are taken if several vehicles have some
_POSE: Final = ("x", "y", "z", "roll", "pitch", "yaw")
_MIRRORED: Final = ("y", "pitch", "yaw")  # ROS has y to the left, a positive pitch downwards and a positive yaw to the left
_FAR: Final = 1e6  # m or degrees; farther poses are refused as those of any rig are
_FAMILIES_LEFT_OUT: Final = ("sensor.pseudo.", "actor.pseudo.")
_TYPES_LEFT_OUT: Final = (
    "sensor.camera.dvs",
    "sensor.other.collision",
    "sensor.other.lane_invasion",
    "sensor.other.obstacle",
    "sensor.other.rss",
)


def sensors_of_objects(objects: object, name: str) -> list[dict[str, Any]]:
    """Return the sensors of the ego vehicle as dicts, in CARLA's axes; the name is what the file is called in errors.

    Of several vehicles with sensors it is the one with the id `ego_vehicle` or `hero`.

    Raises:
        RecapError: These are no objects, or none or several of them may be the ego vehicle.

    Warns:
        RecapWarning: Sensors are left out that a rig cannot have, or that are on no vehicle or another one.
    """
    each = _objects(objects, f"{name}: objects")
    carriers = [one for one in each if "sensors" in one and _type(one).startswith(("vehicle.", "walker."))]
    if len(carriers) > 1:
        carriers = [one for one in carriers if one.get("id") in _EGO] or carriers
    if len(carriers) != 1:
        raise RecapError(f"{name}: expected a vehicle with sensors and the id ego_vehicle, found {len(carriers) or 'none'}")
    (ego,) = carriers
    left_out = [
        str(one.get("id")) for one in each if one is not ego and ("sensors" in one or _type(one).startswith("sensor."))
    ]
    found = []
    waiting = [(one, np.zeros(len(_POSE))) for one in _objects(ego["sensors"], f"{name}: sensors")]
    for members, parent in waiting:
        place = f"{name}: sensor {visible(str(members.get('id')))[:64]!r}"
        sensor, pose = _sensor(members, place)
        if pose is not None and parent.any():
            pose = _attached(parent, pose)
        children = members.get("attached_objects", [])
        waiting += [(one, parent if pose is None else pose) for one in _objects(children, f"{place}: attached_objects")]
        if _type(members).startswith(_FAMILIES_LEFT_OUT) or _type(members) in _TYPES_LEFT_OUT:
            left_out.append(str(members.get("id")))
        else:
            found.append(sensor if pose is None else sensor | dict(zip(_POSE, pose.tolist(), strict=True)))
    if left_out:
        names = visible(first_of(left_out, 6))[:400]
        warnings.warn(RecapWarning(f"{name}: {len(left_out)} left out, which a rig cannot have: {names}"), stacklevel=4)
    return found


def _objects(value: object, place: str) -> list[Mapping[str, Any]]:
    if isinstance(value, Sequence) and all(isinstance(each, Mapping) for each in value):
        return list(value)
    raise RecapError(f"{place}: expected a list of objects, each with a type and an id")


def _type(members: Mapping[str, Any]) -> str:
    return str(members.get("type"))


def _sensor(members: Mapping[str, Any], place: str) -> tuple[dict[str, Any], Floats | None]:
    """Return a sensor with numbers that are texts as numbers, and its pose; None if that is none, which is refused later."""
    point = members.get("spawn_point", {})
    if not isinstance(point, Mapping):
        raise RecapError(f"{place}: spawn_point: expected an object with x, y, z, roll, pitch and yaw")
    repeated = getattr(members, "repeated", "") or getattr(point, "repeated", "")
    if repeated:
        raise RecapError(f"{place}: {visible(repeated)[:64]}: is there twice")
    known = SENSOR_TYPES[_type(members)].attributes if _type(members) in SENSOR_TYPES else {}
    given = {key: value for key, value in members.items() if key not in ("spawn_point", "attached_objects")}
    texts = {key: known[key].parse(value) for key, value in given.items() if isinstance(value, str) and key in known}
    pose = dict.fromkeys(_POSE, 0.0) | dict(point)
    sensor = given | texts | pose
    if pose.keys() != set(_POSE) or not all(type(value) in (int, float) and abs(value) < _FAR for value in pose.values()):
        return sensor, None
    return sensor, np.array([0.0 - pose[key] if key in _MIRRORED else pose[key] for key in _POSE], np.float64)


def _attached(parent: Floats, pose: Floats) -> Floats:
    """Return a pose on the vehicle that is given in the axes of a sensor there."""
    scale = np.array([CM, CM, CM, 1.0, 1.0, 1.0])
    attached: Floats = attach(parent / scale, pose / scale) * scale
    return attached
