"""GNSS receivers and IMUs, and the projection of maps onto the earth.

Axes are CARLA's: x forward, y right, z up; in the world, x points east, and y south.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from math import asin, atan2, cos, cosh, degrees, radians, sin, sinh, tau
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.motion import GRAVITY
from carla_recap.sensors.noise import Noise

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.sensors.noise import Numbers
    from carla_recap.util.arrays import Floats


UPWARDS: Final = (0.0, 0.0, GRAVITY)
"""The acceleration that an actor at rest measures, in m/s²."""

_NORTH: Final = radians(-90.0)  # the yaw of north in CARLA
_EARTH_RADIUS: Final = 6378137.0  # m, at the equator
_SCALE: Final = 0.9996  # of the projection at its central meridian, as of UTM
_DEFAULT_ORIGIN: Final = (42.0, 2.0)  # degrees: CARLA's, for maps without a geo-reference that it understands
_TAG: Final = re.compile(r"<geoReference>\s*(?:<!\[CDATA\[)?(.*?)(?:\]\]>)?\s*</geoReference>", re.DOTALL)
_NUMBER: Final = r"{}=([-+]?[\d.]+(?:[eE][-+]?\d+)?)(?=\s|$)"


@dataclass(frozen=True, slots=True)
class GeoReference:
    """The position of a map's origin in degrees.

    CARLA 0.9.16 takes the earth for a sphere, and every map for a transverse Mercator projection around its `lat_0` and
    `lon_0`; it ignores the rest of the geo-reference, and y counts northwards. `carla.Map.transform_to_geolocation` of the
    client gives the same.
    """

    latitude: float
    longitude: float

    @classmethod
    def of(cls, opendrive: str) -> GeoReference:
        """Return that of an OpenDRIVE file."""
        tag = _TAG.search(opendrive)
        found = [re.search(_NUMBER.format(re.escape(key)), tag[1] if tag else "") for key in ("+lat_0", "+lon_0")]
        values = [float(match[1]) for match in found if match]
        return cls(*values) if len(values) == len(_DEFAULT_ORIGIN) else cls(*_DEFAULT_ORIGIN)

    def locate(self, location: Sequence[float] | Floats) -> tuple[float, float, float]:
        """Return latitude and longitude in degrees, and altitude in m, of a location (3,) in m."""
        x, y, z = map(float, location)
        east = x / (_SCALE * _EARTH_RADIUS)
        north = y / (_SCALE * _EARTH_RADIUS) + radians(self.latitude)
        latitude = degrees(asin(sin(north) / cosh(east)))
        longitude = degrees(radians(self.longitude) + atan2(sinh(east), cos(north)))
        return latitude, longitude, z


geo_reference = lru_cache(maxsize=4)(GeoReference.of)
"""Returns the geo-reference of an OpenDRIVE file; see `GeoReference.of`."""


class Gnss:
    """Positions on the earth with the bias and the noise that a sensor's attributes ask for."""

    def __init__(self, numbers: Numbers, reference: GeoReference) -> None:
        self._reference = reference
        bias, deviation = ([f"noise_{part}_{kind}" for part in ("lat", "lon", "alt")] for kind in ("bias", "stddev"))
        self._noise = Noise(numbers, bias, deviation)

    def measure(self, location: Sequence[float] | Floats) -> Floats:
        """Return latitude and longitude in degrees, and altitude in m, (3,), of a location (3,) in m."""
        return self._noise.add_to(np.array(self._reference.locate(location)))


def acceleration_at(offset: Floats, acceleration: Floats, rotation: Floats, change: Floats) -> Floats:
    """Return the acceleration of a point of a rigid body in m/s², (3,), given its offset in m from a point of known one.

    Rotation and its change are in degrees/s and degrees/s²; all in the axes of the world.
    """
    turning = np.radians(rotation)
    found: Floats = acceleration + np.cross(np.radians(change), offset) + np.cross(turning, np.cross(turning, offset))
    return found


class Imu:
    """The motion of a sensor, with the bias and the noise that its attributes ask for."""

    def __init__(self, numbers: Numbers) -> None:
        self._acceleration_noise = Noise(numbers, (), _axes("noise_accel_stddev"))
        self._rotation_noise = Noise(numbers, _axes("noise_gyro_bias"), _axes("noise_gyro_stddev"))

    def measure(self, axes: Floats, yaw: float, acceleration: Floats, rotation: Floats) -> tuple[Floats, Floats, float]:
        """Return the acceleration with gravity in m/s², (3,), the rotation in rad/s, (3,), and the radians from north.

        The columns of the axes point forward, to the right and upwards in the world, in whose axes the acceleration in m/s²
        and the angular velocity in degrees/s are; the yaw is in degrees.
        """
        felt = self._acceleration_noise.add_to((acceleration + UPWARDS) @ axes)
        turning = self._rotation_noise.add_to(np.radians(rotation) @ axes)
        return felt, turning, (radians(yaw) - _NORTH) % tau


def _axes(key: str) -> list[str]:
    return [f"{key}_{axis}" for axis in "xyz"]
