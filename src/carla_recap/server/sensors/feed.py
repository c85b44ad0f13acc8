"""What all kinds of sensors share: feeds, and attributes as numbers."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final, Protocol

from carla_recap.scene.materials import Tag

if TYPE_CHECKING:
    from carla_recap.rendering.rays import RayScene
    from carla_recap.scene.instances import Instances
    from carla_recap.sensors.noise import Numbers
    from carla_recap.sim.actors.actor import Actor

_LOG: Final = logging.getLogger("carla_recap.server")
_TOO_LARGE: Final = 1e10  # for any number of a sensor

Feed = Callable[[], Iterable[bytes]]
"""Returns the frames of a sensor for the latest tick, without the header that all frames have."""


@dataclass(frozen=True, slots=True)
class V2xMessage:
    """A message on the radio channel.

    Attributes:
        sender: The carrier of the sensor that sent it.
        power: The power of transmission in dBm.
        body: The message as it goes over the wire, with a received power of 0.
    """

    sender: Actor
    power: float
    body: bytes


class FeedContext(Protocol):
    """What feeds need besides their sensors."""

    def messages(self, type_id: str, receiver: Actor) -> list[V2xMessage]:
        """Return the V2X messages of a kind of sensor in the latest tick, but for those of a receiver."""

    def instances(self) -> Instances:
        """Return what is drawn of the actors after the latest tick."""

    def ray_scene(self) -> RayScene | None:
        """Return the surfaces that rays meet; None if there are none but boxes, or none yet."""

    def actor_record(self, id: int | None, tag: int = Tag.WALLS) -> object:
        """Return the record of an actor for msgpack; None stands for what is no actor, and has a semantic tag."""


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
    return max(sensor.context.clock.delta, number(sensor, "sensor_tick"))


def warn_of(sensor: Actor) -> Callable[[str], None]:
    """Return what logs a warning about the attributes of a sensor."""
    return partial(_LOG.warning, "%s %d: %s", sensor.type_id, sensor.id)


def silent(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a sensor that sends nothing."""
    return lambda: ()
