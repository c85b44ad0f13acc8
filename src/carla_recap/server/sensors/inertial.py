"""The feeds of IMUs and GNSS receivers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgpack

from carla_recap.sensors.position import Gnss, Imu, geo_reference
from carla_recap.server.sensors.feed import numbers
from carla_recap.server.sensors.rays import axes, row

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.server.sensors.feed import Feed, FeedContext
    from carla_recap.sim.actors.actor import Actor


def receiver(sensor: Actor) -> Gnss:
    """Return the GNSS receiver of a sensor, in the map that it is in."""
    return Gnss(numbers(sensor), geo_reference(sensor.context.town.opendrive))


def gnss(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a GNSS receiver: latitude, longitude and altitude."""
    own = receiver(sensor)

    def frames() -> Iterable[bytes]:
        yield msgpack.packb(own.measure(row(sensor.transform.location)).tolist())

    return frames


def imu(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of an IMU: acceleration in m/s² with gravity, rotation in rad/s, compass in radians from north.

    The motion is that of the parent's origin, in the axes of the sensor.
    """
    own = Imu(numbers(sensor))

    def frames() -> Iterable[bytes]:
        transform = sensor.transform
        motion = row(sensor.acceleration), row(sensor.angular_velocity)
        acceleration, rotation, compass = own.measure(axes(transform), transform.rotation.yaw, *motion)
        yield msgpack.packb([acceleration.tolist(), rotation.tolist(), compass])

    return frames
