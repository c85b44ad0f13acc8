"""What all kinds of sensors share: feeds, attributes as numbers, and noise."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from carla_recap.scene.materials import Tag

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.rendering.rays import RayScene
    from carla_recap.scene.instances import Instances
    from carla_recap.sim.actors.actor import Actor

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


def flag(sensor: Actor, key: str) -> bool:
    """Return an attribute that is true or false; false if it is missing."""
    return sensor.attributes.get(key, "").lower() in ("true", "1")


def interval(sensor: Actor) -> float:
    """Return the simulated time between two frames of a sensor, in s."""
    return max(sensor.context.clock.delta, number(sensor, "sensor_tick"))


def generator(sensor: Actor, purpose: str = "") -> np.random.Generator:
    """Return a source of random numbers for one purpose: the same for the same `noise_seed`."""
    return np.random.default_rng((abs(int(number(sensor, "noise_seed"))), zlib.crc32(purpose.encode())))


class Noise:
    """The error of measured values: the same for the same seed.

    Args:
        sensor: The sensor, whose attribute `noise_seed` is the seed.
        bias: The attributes with the constant errors; none for no constant error.
        deviation: The attributes with the standard deviations.
    """

    def __init__(self, sensor: Actor, bias: Iterable[str], deviation: Iterable[str]) -> None:
        deviation = list(deviation)
        self._bias = np.array([number(sensor, key) for key in bias])
        self._deviation = np.array([abs(number(sensor, key)) for key in deviation])
        self._random = generator(sensor, deviation[0])

    def add_to(self, values: NDArray[np.float64]) -> list[float]:
        """Return values with errors."""
        if len(self._bias):
            values = values + self._bias
        if self._deviation.any():
            values = values + self._random.normal(0.0, self._deviation)
        measured: list[float] = values.tolist()
        return measured


def silent(sensor: Actor, context: FeedContext) -> Feed:
    """Return the feed of a sensor that sends nothing."""
    return lambda: ()
