"""Random numbers and errors by seed: the definition stays, so that what a seed gives stays, too."""

from __future__ import annotations

import zlib
from collections import defaultdict

import numpy as np
import pytest

from carla_recap.sensors.noise import Noise, generator


@pytest.mark.parametrize(("seed", "same"), [(7.0, 7), (-7.0, 7), (7.9, 7), (0.0, 0)])
def test_a_generator_is_that_of_the_whole_seed_and_the_purpose(seed: float, same: int) -> None:
    expected = np.random.default_rng((same, zlib.crc32(b"noise_lat_stddev"))).random(5)
    assert (generator(seed, "noise_lat_stddev").random(5) == expected).all()
    assert (generator(seed).random(5) != expected).all()


def test_errors_are_a_bias_and_a_deviation_of_each_value() -> None:
    numbers = defaultdict(float, noise_seed=4.0, bias=10.0, a=-2.0, b=0.0)
    noise = Noise(numbers.__getitem__, ["bias", "none"], ["a", "b"])
    expected = generator(4.0, "a")
    for _ in range(3):
        assert (noise.add_to(np.array([1.0, 2.0])) == [11.0 + expected.normal(0.0, 2.0), 2.0]).all()
        expected.normal()  # that of the value without deviation
