"""The sky, the sun and the fog of a picture, of CARLA's weather parameters."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, isfinite, radians, sin
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self

import numpy as np

if TYPE_CHECKING:
    from carla_recap.util.arrays import Floats


_PLEASANT_AZIMUTH: Final = 230.0  # degrees, where the weather leaves it to the map


class Lighting(NamedTuple):
    """The light of a picture; colours of light are linear, those of the sky are as displayed, from 0 to 1."""

    sun: Floats  # the direction to the sun, or at night to the moon, right-handed, (3,)
    sunlight: Floats  # the light from there
    skylight: Floats  # the light from above
    groundlight: Floats  # the light from below
    zenith: Floats  # the colour of the sky overhead
    haze: Floats  # the colour of the sky at the horizon, and of fog
    clouds: Floats  # the colour of clouds
    disc: float  # the brightness of the sun's disc, from 0 to 1
    shade: float  # the share of light in shadows on the ground, from 0 to 1; 1: there are none


@dataclass(frozen=True)
class Sky:
    """The weather as far as it is seen; the default is a clear day."""

    # the direction of the sun as a yaw angle of CARLA (clockwise from the x axis), in degrees
    sun_azimuth: float = _PLEASANT_AZIMUTH
    sun_altitude: float = 45.0  # the height of the sun over the horizon, in degrees; below 0, it is night
    cloudiness: float = 0.1  # the share of the sky that clouds cover, 0 to 1
    fog: float = 0.02  # the density of the fog, 0 to 1
    fog_distance: float = 0.75  # the distance at which fog begins, in m
    wetness: float = 0.0  # how wet surfaces are, 0 to 1
    dust: float = 0.0  # the density of dust, 0 to 1

    @classmethod
    def of_weather(cls, weather: Any) -> Self:
        """Return the sky of weather parameters.

        Args:
            weather: A record of a recording, an object with CARLA's attributes, such as `carla.WeatherParameters`, or None
                for a clear day. Negative values leave a choice to the map, and numbers that are not finite count as such.
        """
        if weather is None:
            return cls()

        def read(name: str, default: float, most: float) -> float:
            value = _number(weather, name)
            return min(value, most) if value >= 0 else default

        altitude = _number(weather, "sun_altitude_angle")
        rain = read("precipitation", 0, 100)
        return cls(
            sun_azimuth=read("sun_azimuth_angle", _PLEASANT_AZIMUTH, 1e6),
            sun_altitude=45.0 if altitude == -1 else max(-90.0, min(90.0, altitude)),
            cloudiness=max(read("cloudiness", 10, 100), rain) / 100,
            fog=read("fog_density", 2, 100) / 100,
            fog_distance=read("fog_distance", 0.75, 1e4),
            wetness=max(read("wetness", 0, 100), read("precipitation_deposits", 0, 100), rain) / 100,
            dust=read("dust_storm", 0, 100) / 100,
        )

    @property
    def is_night(self) -> bool:
        """Whether the sun is below the horizon."""
        return self.sun_altitude < 0

    @property
    def density(self) -> float:
        """The density of fog and dust: the share of light that is lost per m, as an exponent of 2."""
        thick = max(self.fog, self.dust)
        return 0.0011 + 0.03 * float(thick**2.2)

    @property
    def halo(self) -> float:
        """The brightness of the light around lit lamps, from 0 to 1."""
        return 0.85 - 0.6 * _smooth(-6, 12, self.sun_altitude) * (1 - 0.6 * self.cloudiness)

    def light(self) -> Lighting:
        """Return the light of the picture."""
        day = _smooth(-6, 8, self.sun_altitude)
        evening = 1 - _smooth(3, 32, self.sun_altitude)  # 1: the sun is at the horizon
        clear = 1 - 0.85 * self.cloudiness**1.5
        high = max(self.sun_altitude, 12.0) if not self.is_night else 50.0
        altitude, azimuth = radians(high), radians(-self.sun_azimuth)
        sun = np.array((cos(altitude) * cos(azimuth), cos(altitude) * sin(azimuth), sin(altitude)))
        warm = _mix((1.0, 0.965, 0.9), (1.0, 0.72, 0.45), evening)
        sunlight = _mix((0.05, 0.065, 0.1), 1.15 * warm * clear, day)
        grey = np.full(3, 0.55)
        skylight = _mix((0.05, 0.065, 0.11), _mix((0.5, 0.57, 0.7), 1.1 * grey, self.cloudiness), day)
        skylight = skylight * (1 - 0.3 * evening * day)
        groundlight = skylight * (0.52, 0.5, 0.46) + 0.1 * sunlight
        zenith = _mix(_mix((74, 126, 196), (70, 98, 158), evening), (150, 157, 166), self.cloudiness**1.3)
        haze = _mix(_mix((200, 216, 230), (246, 208, 168), evening), (196, 200, 204), self.cloudiness)
        haze = _mix(haze, (196, 168, 126), self.dust)
        zenith = _mix(zenith, haze, min(1.0, 1.4 * max(self.fog, self.dust)))
        zenith = _mix((12, 17, 32), zenith, day) / 255
        haze = _mix((34, 42, 60), haze, day) / 255
        bright = skylight * 0.55 + sunlight * 0.45 * (1 - 0.4 * self.cloudiness)
        clouds = (bright * (1 + 0.12 * bright) / (1 + 0.42 * bright)) ** (1 / 2.2)  # as the shaders encode light
        disc = day * max(0.0, 1 - 1.1 * self.cloudiness) * (1 - max(self.fog, self.dust))
        shade = 1 - (0.42 * clear * day + 0.12 * (1 - day))
        return Lighting(sun, sunlight, skylight, groundlight, zenith, haze, clouds, disc, shade)


def _number(weather: Any, name: str) -> float:
    """Return a parameter of the weather; -1 where it is missing or not finite."""
    value = float(weather[name] if isinstance(weather, np.void) else getattr(weather, name, -1))
    return value if isfinite(value) else -1.0


def _smooth(low: float, high: float, value: float) -> float:
    """Return 0 below `low`, 1 above `high`, and a smooth transition in between."""
    part = min(1.0, max(0.0, (value - low) / (high - low)))
    return part * part * (3 - 2 * part)


def _mix(first: Any, second: Any, part: float) -> Floats:
    mixed: Floats = np.asarray(first, float) * (1 - part) + np.asarray(second, float) * part
    return mixed
