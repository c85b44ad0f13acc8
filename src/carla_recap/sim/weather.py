"""The weather; it has no influence on the simulation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final


@dataclass(frozen=True, slots=True)
class Weather:
    """CARLA's weather parameters.

    Attributes:
        cloudiness: 0 to 100.
        precipitation: 0 to 100.
        precipitation_deposits: Puddles, 0 to 100.
        wind_intensity: 0 to 100.
        sun_azimuth_angle: 0 to 360 degrees.
        sun_altitude_angle: -90 (midnight) to 90 degrees (noon).
        fog_density: 0 to 100.
        fog_distance: The distance at which fog begins, in m.
        fog_falloff: The rate at which fog thins out with height.
        wetness: 0 to 100.
        scattering_intensity: The contribution of light to volumetric fog.
        mie_scattering_scale: The scattering of light by large particles.
        rayleigh_scattering_scale: The scattering of light by air.
        dust_storm: 0 to 100.
    """

    cloudiness: float = 0.0
    precipitation: float = 0.0
    precipitation_deposits: float = 0.0
    wind_intensity: float = 10.0
    sun_azimuth_angle: float = -1.0
    sun_altitude_angle: float = 45.0
    fog_density: float = 2.0
    fog_distance: float = 0.75
    fog_falloff: float = 0.1
    wetness: float = 0.0
    scattering_intensity: float = 1.0
    mie_scattering_scale: float = 0.03
    rayleigh_scattering_scale: float = 0.0331
    dust_storm: float = 0.0


_SKIES: Final = {  # clouds, rain, puddles, wind, fog, fog distance, wetness
    "Clear": (5, 0, 0, 10, 2, 0.75, 0),
    "Cloudy": (60, 0, 0, 10, 3, 0.75, 0),
    "Wet": (5, 0, 50, 10, 3, 0.75, 0),
    "WetCloudy": (60, 0, 50, 10, 3, 0.75, 0),
    "MidRainy": (60, 60, 60, 60, 3, 0.75, 0),
    "HardRain": (100, 100, 90, 100, 7, 0.75, 0),
    "SoftRain": (20, 30, 50, 30, 3, 0.75, 0),
}
_SUNS: Final = {"Noon": 45.0, "Sunset": 15.0, "Night": -90.0}


def _preset(sky: tuple[float, ...], altitude: float) -> Weather:
    clouds, rain, puddles, wind, fog, fog_distance, wetness = map(float, sky)
    return replace(
        Weather(clouds, rain, puddles, wind, sun_altitude_angle=altitude, wetness=wetness),
        fog_density=fog if altitude > 0 else 60.0,
        fog_distance=fog_distance,
    )


PRESETS: Final = {
    "Default": Weather(),
    **{f"{sky}{sun}": _preset(values, altitude) for sun, altitude in _SUNS.items() for sky, values in _SKIES.items()},
    "DustStorm": replace(Weather(100.0, 0.0, 0.0, 100.0), dust_storm=100.0),
}
"""CARLA's presets by name, such as ClearNoon."""
