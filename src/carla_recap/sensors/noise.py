"""The errors of measured values: the same for the same seed."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

Numbers = Callable[[str], float]
"""Returns an attribute of a sensor as a number, such as `SensorSpec.number`."""


def generator(seed: float, purpose: str = "") -> np.random.Generator:
    """Return a source of random numbers for one purpose: the same for the same seed.

    The sign and the fraction of the seed do not count; purposes tell two sources of a sensor apart.
    """
    return np.random.default_rng((abs(int(seed)), zlib.crc32(purpose.encode())))


class Noise:
    """The error of the values of a sensor, given the attributes with constant errors and with standard deviations."""

    def __init__(self, numbers: Numbers, bias: Sequence[str], deviation: Sequence[str]) -> None:
        self._bias = np.array([numbers(key) for key in bias])
        self._deviation = np.array([abs(numbers(key)) for key in deviation])
        self._random = generator(numbers("noise_seed"), deviation[0])

    def add_to(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return values with errors, (n,)."""
        if len(self._bias):
            values = values + self._bias
        if self._deviation.any():
            values = values + self._random.normal(0.0, self._deviation)
        return values
