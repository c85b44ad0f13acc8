"""The settings of a world, its simulated time, and its weather, which has no influence on the simulation."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

from carla_recap.sim.errors import SimError
from carla_recap.sim.validation import expect_seconds

_COLLISIONS_OF: Final = ("heroes", "all")
_DATE: Final = 1767261600  # 2026-01-01 10:00 UTC


@dataclass(slots=True)
class Settings:
    """The settings of a world, with CARLA's names.

    Attributes:
        synchronous_mode: Whether the world only advances by `tick`; without it, by `run_realtime`.
        no_rendering_mode: Accepted without effect, since nothing is rendered.
        fixed_delta_seconds: The length of a tick, above 0 and at most 10 s; None if the caller chooses it.
        substepping: Whether long ticks are simulated in several steps.
        max_substep_delta_time: The greatest length of a step in s, above 0.
        max_substeps: The greatest number of steps in a tick.
        collisions_of: The actors whose collisions are reported, in addition to those with a collision sensor.

    Raises:
        SimError: A value is out of range, when it is set.
    """

    synchronous_mode: bool = True
    no_rendering_mode: bool = False
    fixed_delta_seconds: float | None = 0.05
    substepping: bool = True
    max_substep_delta_time: float = 0.05
    max_substeps: int = 10
    collisions_of: Literal["heroes", "all"] = "heroes"

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "max_substep_delta_time" or (name == "fixed_delta_seconds" and value is not None):
            expect_seconds(name, value)
        if name == "collisions_of" and value not in _COLLISIONS_OF:
            raise SimError(f"{name}: expected {' or '.join(_COLLISIONS_OF)}, found {value!r}")
        object.__setattr__(self, name, value)


@dataclass(slots=True)
class Clock:
    """The simulated time of an episode.

    Attributes:
        frame: The number of ticks so far.
        elapsed: The simulated time so far, in s.
        delta: The length of the latest tick, in s.
    """

    frame: int = 0
    elapsed: float = 0.0
    delta: float = 0.05

    def advance(self) -> None:
        """Count a tick of length `delta`."""
        self.frame += 1
        self.elapsed += self.delta


def seeded_date() -> int:
    """Return the date of recordings of a seed in Unix seconds: that of $SOURCE_DATE_EPOCH, else 2026-01-01 10:00 UTC."""
    return source_date(_DATE)


def source_date(otherwise: float) -> int:
    """Return the date of $SOURCE_DATE_EPOCH in Unix seconds, else another one; `SimError`: it is no whole number."""
    text = os.environ.get("SOURCE_DATE_EPOCH", str(int(otherwise)))
    try:
        return int(text)
    except ValueError:
        raise SimError(f"SOURCE_DATE_EPOCH: expected whole Unix seconds, found {text!r:.60}") from None


@dataclass(frozen=True, slots=True)
class Weather:
    """CARLA's weather parameters.

    Attributes:
        cloudiness, precipitation, wind_intensity, fog_density, wetness, dust_storm: 0 to 100.
        precipitation_deposits: Puddles, 0 to 100.
        sun_azimuth_angle: 0 to 360 degrees.
        sun_altitude_angle: -90 (midnight) to 90 degrees (noon).
        fog_distance: The distance at which fog begins, in m.
        fog_falloff: The rate at which fog thins out with height.
        scattering_intensity: The contribution of light to volumetric fog.
        mie_scattering_scale: The scattering of light by large particles.
        rayleigh_scattering_scale: The scattering of light by air.
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
