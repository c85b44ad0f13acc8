"""The feeds of sensors: what all kinds share, and those of collision sensors, GNSS receivers and IMUs."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

import msgpack
import numpy as np

from carla_recap.model.motion import LONGEST_STEP
from carla_recap.sensors.position import Gnss, Imu, acceleration_at, geo_reference

if TYPE_CHECKING:
    from carla_recap.rendering.rays import RayScene
    from carla_recap.scene.instances import Instances
    from carla_recap.sensors.noise import Numbers
    from carla_recap.server.protocol.releases import Release
    from carla_recap.sim.episode import Actor
    from carla_recap.sim.geometry import Location, Transform, Vector
    from carla_recap.util.arrays import Floats

_LOG: Final = logging.getLogger(__name__)
_TOO_LARGE: Final = 1e10  # for any number of a sensor

Feed = Callable[[], Iterable[bytes]]
"""Returns the frames of a sensor for the latest tick, without the header that all frames have."""


@dataclass(frozen=True, slots=True)
class V2xMessage:
    """A message on the radio channel.

    Its sender is the carrier of the sensor, the power of transmission is in dBm, and the body is as it goes over the wire,
    with a received power of 0.
    """

    sender: Actor
    power: float
    body: bytes


@dataclass(frozen=True, slots=True)
class FeedContext:
    """What feeds need besides their sensors.

    Attributes:
        messages: Returns the V2X messages of a kind of sensor in the latest tick, but for those of a receiver.
        ray_scene: Returns the surfaces that rays meet; None if there are none but boxes, or none yet.
        actor_record: Returns the record of an actor for msgpack; None stands for what is no actor, and has a semantic
            tag.
    """

    release: Release
    messages: Callable[[str, Actor], list[V2xMessage]]
    instances: Callable[[], Instances]
    ray_scene: Callable[[], RayScene | None]
    actor_record: Callable[..., object]


MakeFeed = Callable[["Actor", FeedContext], Feed]
"""Makes the feed of a sensor when the first client begins to listen."""


def number(sensor: Actor, key: str) -> float:
    """Return an attribute as a number; the default if it is none, or beyond all reason, and 0 if there is no default."""
    for attributes in (sensor.attributes, sensor.blueprint.attributes):
        with suppress(ValueError):
            value = float(attributes.get(key, ""))
            if abs(value) < _TOO_LARGE:
                return value
    return 0.0


def numbers(sensor: Actor) -> Numbers:
    """Return what returns the attributes of a sensor as numbers."""
    return partial(number, sensor)


def flag(sensor: Actor, key: str) -> bool:
    """Return an attribute that is true or false; false if it is missing."""
    return sensor.attributes.get(key, "").lower() in ("true", "1")


def interval(sensor: Actor) -> float:
    """Return the simulated time between two frames of a sensor, in s."""
    return max(sensor.episode.clock.delta, number(sensor, "sensor_tick"))


def warn_of(sensor: Actor) -> Callable[[str], None]:
    """Return what logs a warning about the attributes of a sensor."""
    return partial(_LOG.warning, "%s %d: %s", sensor.type_id, sensor.id)


def axes(transform: Transform) -> Floats:
    """Return the axes of a transform, (3, 3); see `Rotation.matrix`."""
    return np.array(transform.rotation.matrix())


def row(value: Location | Vector) -> Floats:
    """Return a location or a direction as (3,)."""
    return np.array((value.x, value.y, value.z))


def packed(*values: Any) -> bytes:
    """Return values as MessagePack, as CARLA has them in frames."""
    data: bytes = msgpack.packb(values, unicode_errors="surrogateescape")
    return data


def silent(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a sensor that sends nothing."""
    return lambda: ()


def collisions(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a collision sensor: for each collision of the parent both actors, and its impulse in N s."""

    def frames() -> Iterable[bytes]:
        for collision in sensor.episode.events.collisions:
            if sensor.parent is not None and collision.actor1 == sensor.parent.id:
                impulse = collision.impulse
                actors = context.actor_record(collision.actor1), context.actor_record(collision.actor2)
                yield packed(*actors, [impulse.x, impulse.y, impulse.z])

    return frames


def receiver(sensor: Actor) -> Gnss:
    """Return the GNSS receiver of a sensor, in the map that it is in."""
    return Gnss(numbers(sensor), geo_reference(sensor.episode.town.opendrive))


def gnss(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a GNSS receiver: latitude, longitude and altitude."""
    own = receiver(sensor)

    def frames() -> Iterable[bytes]:
        yield packed(*own.measure(row(sensor.transform.location)).tolist())

    return frames


def imu(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of an IMU: acceleration in m/s² with gravity, rotation in rad/s, compass in radians from north.

    The acceleration is that of the place of the sensor, as CARLA derives it, in the axes of the sensor.
    """
    own, clock = Imu(numbers(sensor)), sensor.episode.clock
    before = -math.inf, np.zeros(3)

    def frames() -> Iterable[bytes]:
        nonlocal before
        transform, turning = sensor.transform, row(sensor.angular_velocity)
        passed = clock.elapsed - before[0]
        change = (turning - before[1]) / passed if 0 < passed <= LONGEST_STEP else np.zeros(3)
        before = clock.elapsed, turning
        origin = transform if sensor.carrier is None else sensor.carrier.transform
        offset = row(transform.location) - row(origin.location)
        felt = acceleration_at(offset, row(sensor.acceleration), turning, change)
        acceleration, rotation, compass = own.measure(axes(transform), transform.rotation.yaw, felt, turning)
        yield packed(acceleration.tolist(), rotation.tolist(), compass)

    return frames
