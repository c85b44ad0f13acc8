"""The sensors of CARLA 0.9.16 and their attributes: the first value of each is the default, all are recommended."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from carla_recap.sensors.kinds import SENSOR_ATTRIBUTES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.sensors.kinds import SensorAttribute

Values = dict[str, tuple[str, ...]]

COLLISION_SENSOR: Final = "sensor.other.collision"
V2X_SENSOR: Final = "sensor.other.v2x"
CUSTOM_V2X_SENSOR: Final = "sensor.other.v2x_custom"

_SIDES: Final = ("front", "back", "left", "right", "front_left", "front_right", "back_left", "back_right")
_DEFAULT: Final = ("default",)
_WITHOUT_SIDES: Final = ("sensor.other.gnss", "sensor.other.imu", "sensor.other.radar", V2X_SENSOR, CUSTOM_V2X_SENSOR)


def _values(id: str, attributes: Mapping[str, SensorAttribute]) -> Values:
    """Return the values of the role name and of the attributes of a sensor."""
    role = _DEFAULT if id in _WITHOUT_SIDES else _SIDES
    return {"role_name": role, **{key: attribute.choices or (attribute.text,) for key, attribute in attributes.items()}}


SENSORS: Final[dict[str, Values]] = {id: _values(id, attributes) for id, attributes in SENSOR_ATTRIBUTES.items()}
"""The sensors by name, with the values of their attributes, without those that all actors have."""
