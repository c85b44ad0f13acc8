"""Inertial measurement units: how their parents move, felt in the axes of the sensor."""

from __future__ import annotations

from math import radians, tau
from typing import TYPE_CHECKING, Final

import msgpack
import numpy as np

from carla_recap.server.sensors.feed import Noise
from carla_recap.server.sensors.rays import axes, row

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.server.sensors.feed import Feed, Tell
    from carla_recap.sim.actors.actor import Actor

_GRAVITY: Final = (0.0, 0.0, 9.81)  # m/s²: what rests feels itself pushed upwards
_NORTH: Final = radians(-90.0)  # the yaw of the compass's north in CARLA


def imu(sensor: Actor, tell: Tell) -> Feed:
    """Acceleration in m/s² with gravity, rate of turn in rad/s, and the compass: radians from north, clockwise.

    The motion is that of the parent's origin, wherever on the parent the sensor is.
    """
    felt_noise = Noise(sensor, (), _axes("noise_accel_stddev"))
    turning_noise = Noise(sensor, _axes("noise_gyro_bias"), _axes("noise_gyro_stddev"))

    def frames() -> Iterable[bytes]:
        place = sensor.transform
        own = axes(place)
        felt = (row(sensor.acceleration) + _GRAVITY) @ own
        turning = np.radians(row(sensor.angular_velocity)) @ own
        compass = (radians(place.rotation.yaw) - _NORTH) % tau
        yield msgpack.packb([felt_noise.upon(felt), turning_noise.upon(turning), compass])

    return frames


def _axes(key: str) -> list[str]:
    return [f"{key}_{axis}" for axis in "xyz"]
