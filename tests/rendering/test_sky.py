"""The sky of weather parameters."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from carla_recap.rendering.sky import Sky
from carla_recap.sim.settings import PRESETS, Weather


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_each_preset_has_colours_that_can_be_displayed(name: str) -> None:
    light = Sky.of_weather(PRESETS[name]).light()
    for color in (light.zenith, light.haze):
        assert ((color >= 0) & (color <= 1)).all()
    for color in (light.sunlight, light.skylight, light.groundlight):
        assert ((color >= 0) & (color <= 2)).all()
    assert np.linalg.norm(light.sun) == pytest.approx(1)
    assert light.sun[2] > 0
    assert 0 < light.shade <= 1


def test_a_record_of_a_recording_gives_the_same_as_the_weather_of_the_simulation() -> None:
    weather = PRESETS["HardRainSunset"]
    values = {name: getattr(weather, name) for name in Weather.__slots__}
    record = np.zeros((), [(name, "f4") for name in values])
    for name, value in values.items():
        record[name] = value
    assert asdict(Sky.of_weather(record[()])) == pytest.approx(asdict(Sky.of_weather(weather)))


def test_the_sun_is_in_the_direction_of_its_yaw_angle() -> None:
    sun = Sky(sun_azimuth=90, sun_altitude=30).light().sun
    np.testing.assert_allclose(sun, (0, -np.cos(np.radians(30)), 0.5), atol=1e-9)  # to the right: -y


def test_parameters_that_are_left_to_the_map_or_not_finite_give_a_clear_day() -> None:
    assert Sky.of_weather(None) == Sky()
    for value in (-1.0, float("nan")):
        sky = Sky.of_weather(Weather(*[value] * 14))
        assert sky == Sky()
        assert not sky.is_night
