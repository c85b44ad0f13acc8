"""What a feed is, and what feeds read from the attributes of their sensors."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.actors.actor import Actor

_TOO_LARGE: Final = 1e10  # for any number that a sensor is meant to have

Feed = Callable[[], Iterable[bytes]]
"""Tells what a sensor has noticed in the latest tick: the frames to send, without the header that all have."""
Tell = Callable[[int | None], object]
"""An actor as clients are told of it in an event, for msgpack, by its id; None for a barrier, which is no actor."""
Make = Callable[["Actor", Tell], Feed]
"""Makes the feed of a sensor, once somebody listens to it."""


def number(sensor: Actor, key: str) -> float:
    """An attribute that is a number; the blueprint's where it is none, or beyond all reason, and 0 where that has none."""
    for attributes in (sensor.attributes, sensor.blueprint.attributes):
        with suppress(ValueError):
            value = float(attributes.get(key, ""))
            if abs(value) < _TOO_LARGE:
                return value
    return 0.0


def flag(sensor: Actor, key: str) -> bool:
    """An attribute that is true or false; false where it is missing."""
    return sensor.attributes.get(key, "").lower() in ("true", "1")


def random_numbers(sensor: Actor) -> np.random.Generator:
    """Return the random numbers of a sensor: the same ones for the same `noise_seed`, in every episode, as with CARLA."""
    return np.random.default_rng(abs(int(number(sensor, "noise_seed"))))


class Noise:
    """What is wrong with what a sensor measures: always the same for the same seed.

    Args:
        sensor: The sensor, whose attribute `noise_seed` is the seed.
        bias: The attributes that say by how much all values are wrong; none for no bias.
        deviation: Those that say by how much values differ from that: their standard deviation.
    """

    def __init__(self, sensor: Actor, bias: Iterable[str], deviation: Iterable[str]) -> None:
        self._bias = np.array([number(sensor, key) for key in bias])
        self._deviation = np.array([abs(number(sensor, key)) for key in deviation])
        self._random = random_numbers(sensor)

    def upon(self, values: NDArray[np.float64]) -> list[float]:
        """Values, and what is wrong with them."""
        if len(self._bias):
            values = values + self._bias
        if self._deviation.any():
            values = values + self._random.normal(0.0, self._deviation)
        measured: list[float] = values.tolist()
        return measured


def silent(sensor: Actor, tell: Tell) -> Feed:
    """A sensor that tells nothing."""
    return lambda: ()
