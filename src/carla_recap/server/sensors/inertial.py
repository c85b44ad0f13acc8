"""IMUs and GNSS receivers, and the projection of maps onto the earth."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from math import asin, atan2, cos, cosh, degrees, radians, sin, sinh, tau
from typing import TYPE_CHECKING, Final

import msgpack
import numpy as np

from carla_recap.server.sensors.feed import Noise
from carla_recap.server.sensors.rays import axes, row
from carla_recap.sim.physics.drivetrain import GRAVITY

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.server.sensors.feed import Feed, FeedContext
    from carla_recap.sim.actors.actor import Actor
    from carla_recap.sim.geometry import Location

_UPWARDS: Final = (0.0, 0.0, GRAVITY)  # m/s²: the acceleration that an actor at rest measures
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

    def locate(self, location: Location) -> tuple[float, float, float]:
        """Return latitude and longitude in degrees, and altitude in m, of a location in m."""
        east = location.x / (_SCALE * _EARTH_RADIUS)
        north = location.y / (_SCALE * _EARTH_RADIUS) + radians(self.latitude)
        latitude = degrees(asin(sin(north) / cosh(east)))
        longitude = degrees(radians(self.longitude) + atan2(sinh(east), cos(north)))
        return latitude, longitude, location.z


geo_reference = lru_cache(maxsize=4)(GeoReference.of)


class Gnss:
    """Positions on the earth with the bias and the noise that a sensor's attributes ask for."""

    def __init__(self, sensor: Actor) -> None:
        self._reference = geo_reference(sensor.context.town.opendrive)
        bias, deviation = ([f"noise_{part}_{kind}" for part in ("lat", "lon", "alt")] for kind in ("bias", "stddev"))
        self._noise = Noise(sensor, bias, deviation)

    def measure(self, location: Location) -> list[float]:
        """Return latitude and longitude in degrees, and altitude in m."""
        return self._noise.add_to(np.array(self._reference.locate(location)))


def gnss(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a GNSS receiver: latitude, longitude and altitude."""
    receiver = Gnss(sensor)

    def frames() -> Iterable[bytes]:
        yield msgpack.packb(receiver.measure(sensor.transform.location))

    return frames


def imu(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of an IMU: acceleration in m/s² with gravity, rotation in rad/s, compass in radians from north.

    The motion is that of the parent's origin, in the axes of the sensor.
    """
    acceleration_noise = Noise(sensor, (), _axes("noise_accel_stddev"))
    rotation_noise = Noise(sensor, _axes("noise_gyro_bias"), _axes("noise_gyro_stddev"))

    def frames() -> Iterable[bytes]:
        transform = sensor.transform
        own = axes(transform)
        acceleration = (row(sensor.acceleration) + _UPWARDS) @ own
        rotation = np.radians(row(sensor.angular_velocity)) @ own
        compass = (radians(transform.rotation.yaw) - _NORTH) % tau
        yield msgpack.packb([acceleration_noise.add_to(acceleration), rotation_noise.add_to(rotation), compass])

    return frames


def _axes(key: str) -> list[str]:
    return [f"{key}_{axis}" for axis in "xyz"]
