"""The types of sensors: the attributes of each with defaults and ranges, and what its data are.

Names, types, defaults and recommended values are those of CARLA 0.9.16; the ranges are those that rigs may use.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, Literal

from carla_recap.rendering.camera import ImageKind

if TYPE_CHECKING:
    from collections.abc import Mapping

Value = bool | int | float | str
"""The value of an attribute."""

Kind = Literal["camera", "lidar", "semantic_lidar", "radar", "gnss", "imu", "speedometer", "map"]
"""A kind of sensor: the types of a kind measure alike."""

LARGEST_SIDE: Final = 4096
"""The greatest width and height of images in pixels, which keeps an image within 64 MiB."""
NARROWEST, WIDEST = 0.1, 175.0
"""The least and the greatest field of view that a camera is drawn with, in degrees."""
MOST_CHANNELS: Final = 512
"""The greatest number of channels of a lidar."""
WIDEST_RADAR: Final = 179.0
"""The greatest field of view of a radar, in degrees."""
_LARGEST: Final = 1e9  # that any number can be
_LARGEST_DEVIATION: Final = 1e6
_MOST_POINTS: Final = 10_000_000  # in a second
_NEAREST, _FARTHEST = 0.1, 10_000.0  # m
_LONGEST: Final = 3600.0  # s
_GREATEST_SEED: Final = 2**31 - 1


@dataclass(frozen=True, slots=True)
class SensorAttribute:
    """An attribute of a sensor."""

    text: str  # the default, as CARLA writes it
    type: type[bool] | type[int] | type[float] | type[str] = float  # the type of the values
    least: float = -_LARGEST  # the least value of a number
    greatest: float = _LARGEST  # the greatest value of a number
    unit: str = ""  # the unit of a number; empty if it has none
    choices: tuple[str, ...] = ()  # the texts that can be chosen, the default first; none if any can

    @property
    def values(self) -> str:
        """The values that a rig can give to it, in words."""
        if self.type is bool:
            return "true or false"
        if self.type is str:
            return " or ".join(self.choices)
        number = "a whole number" if self.type is int else "a number"
        return f"{number} from {self.least:.10g} to {self.greatest:.10g} {self.unit}".rstrip()

    @property
    def default(self) -> Value:
        """The default as a value of the type."""
        return self.text == "true" if self.type is bool else self.type(self.text)

    def parse(self, text: str) -> Value:
        """Return the value that a text means, as attributes of CARLA's actors are; the text itself if it is none."""
        try:
            if self.type is bool:
                return {"true": True, "1": True, "false": False, "0": False}.get(text.lower(), text)
            return self.type(text)
        except ValueError:
            return text


Attributes = dict[str, SensorAttribute]


@dataclass(frozen=True, slots=True)
class SensorType:
    """A type of sensor that a rig can have."""

    name: str  # CARLA's name, such as `sensor.camera.rgb`
    kind: Kind  # the kind of sensor
    data: str  # what its data are, in words
    attributes: Mapping[str, SensorAttribute] = field(hash=False)  # the attributes by their names
    image: ImageKind | None = None  # the kind of image of a camera; None for others
    is_actor: bool = True  # whether CARLA has a blueprint of it; the others are read by the Leaderboard itself
    # the values other than the default that the Leaderboard gives to attributes, whatever a rig says; None if it has
    # no such sensors
    leaderboard: Mapping[str, Value] | None = field(default=None, hash=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "attributes", MappingProxyType(self.attributes))


def _share(text: str) -> SensorAttribute:
    """Return an attribute from 0 to 1."""
    return SensorAttribute(text, float, 0.0, 1.0)


def _positive(text: str) -> SensorAttribute:
    """Return an attribute of 0 or more."""
    return SensorAttribute(text, float, 0.0, _LARGEST_DEVIATION)


def _angle(text: str, least: float, greatest: float) -> SensorAttribute:
    """Return an attribute that is an angle in degrees."""
    return SensorAttribute(text, float, least, greatest, "degrees")


def _distance(text: str) -> SensorAttribute:
    """Return an attribute that is a range in m."""
    return SensorAttribute(text, float, _NEAREST, _FARTHEST, "m")


def _any(**texts: str) -> Attributes:
    """Return attributes that can be any number."""
    return {key: SensorAttribute(text) for key, text in texts.items()}


def _deviations(*keys: str) -> Attributes:
    return {key: _positive("0.0") for key in keys}


def _flag(text: str) -> SensorAttribute:
    return SensorAttribute(text, bool)


def _choice(*choices: str) -> SensorAttribute:
    return SensorAttribute(choices[0], str, choices=choices)


def _side(text: str) -> SensorAttribute:
    return SensorAttribute(text, int, 1, LARGEST_SIDE, "pixels")


def _points(text: str) -> SensorAttribute:
    return SensorAttribute(text, int, 1, _MOST_POINTS)


def _position_noise() -> Attributes:
    noise: Attributes = {}
    for axis in ("lat", "lon", "alt"):
        noise |= _deviations(f"noise_{axis}_stddev") | _any(**{f"noise_{axis}_bias": "0.0"})
    return noise


_TICK: Final = {"sensor_tick": SensorAttribute("0.0", float, 0.0, _LONGEST, "s")}
_SEED: Final = {"noise_seed": SensorAttribute("0", int, 0, _GREATEST_SEED)}
_LENS: Final = {
    **_TICK,
    "image_size_x": _side("800"),
    "image_size_y": _side("600"),
    "fov": _angle("90.0", NARROWEST, WIDEST),
    **_any(
        lens_circle_falloff="5.0",
        lens_circle_multiplier="0.0",
        lens_k="-1.0",
        lens_kcube="0.0",
        lens_x_size="0.08",
        lens_y_size="0.08",
    ),
}
_FILM: Final = {
    "exposure_mode": _choice("histogram", "manual"),
    **_any(exposure_compensation="0.0", shutter_speed="200.0", iso="100.0", fstop="1.4"),
    "enable_postprocess_effects": _flag("true"),
    **_any(
        gamma="2.2",
        motion_blur_intensity="0.45",
        motion_blur_max_distortion="0.35",
        lens_flare_intensity="0.1",
        bloom_intensity="0.675",
        motion_blur_min_object_screen_size="0.1",
        exposure_min_bright="10.0",
        exposure_max_bright="12.0",
        exposure_speed_up="3.0",
        exposure_speed_down="1.0",
        calibration_constant="16.0",
        focal_distance="1000.0",
        min_fstop="1.2",
    ),
    "blade_count": SensorAttribute("5", int),
    **_any(
        blur_amount="1.0",
        blur_radius="0.0",
        slope="0.88",
        toe="0.55",
        shoulder="0.26",
        black_clip="0.0",
        white_clip="0.04",
        temp="6500.0",
        tint="0.0",
        chromatic_aberration_intensity="0.0",
        chromatic_aberration_offset="0.0",
    ),
}
_EVENTS: Final = {
    **_any(
        positive_threshold="0.3",
        negative_threshold="0.3",
        sigma_positive_threshold="0.0",
        sigma_negative_threshold="0.0",
    ),
    "refractory_period_ns": SensorAttribute("0", int),
    "use_log": _flag("true"),
    "log_eps": SensorAttribute("0.001"),
}
_RAYS: Final = {
    **_TICK,
    "channels": SensorAttribute("32", int, 1, MOST_CHANNELS),
    "range": _distance("10.0"),
    "points_per_second": _points("56000"),
    "rotation_frequency": SensorAttribute("10.0", float, 0.0, 1000.0, "Hz"),
    "upper_fov": _angle("10.0", -90.0, 90.0),
    "lower_fov": _angle("-30.0", -90.0, 90.0),
    "horizontal_fov": _angle("360.0", 0.0, 360.0),
}
_DROPOFF: Final = {
    "atmosphere_attenuation_rate": _positive("0.004"),
    **_SEED,
    "dropoff_general_rate": _share("0.45"),
    "dropoff_intensity_limit": _share("0.8"),
    "dropoff_zero_intensity": _share("0.4"),
    "noise_stddev": _positive("0.0"),
}
_RADAR: Final = {
    **_TICK,
    "horizontal_fov": _angle("30", NARROWEST, WIDEST_RADAR),
    "vertical_fov": _angle("30", NARROWEST, WIDEST_RADAR),
    "range": _distance("100"),
    "points_per_second": _points("1500"),
    **_SEED,
}
_GNSS: Final = {**_TICK, **_SEED, **_position_noise()}
_ACCELERATION_NOISE: Final = _deviations(*(f"noise_accel_stddev_{axis}" for axis in "xyz"))
_IMU: Final = {
    **_TICK,
    **_SEED,
    **_ACCELERATION_NOISE,
    **_deviations(*(f"noise_gyro_stddev_{axis}" for axis in "xyz")),
    **_any(**{f"noise_gyro_bias_{axis}": "0.0" for axis in "xyz"}),
}
_RADIO: Final = {
    **_TICK,
    **_SEED,
    **_any(transmit_power="21.5", receiver_sensitivity="-99.0", frequency_ghz="5.9", combined_antenna_gain="10.0"),
    "scenario": _choice("highway", "rural", "urban"),
    "path_loss_model": _choice("winner", "geometric"),
    **_any(path_loss_exponent="2.7", d_ref="1.0", filter_distance="500.0"),
    "use_etsi_fading": _flag("true"),
    "custom_fading_stddev": _positive("0.0"),
}

# What the Leaderboard 2 gives to its sensors, where that is not CARLA's default
_LEADERBOARD_LIDAR: Final[Mapping[str, Value]] = {"range": 85.0, "channels": 64, "points_per_second": 600_000}
_LEADERBOARD_GNSS: Final[Mapping[str, Value]] = {f"noise_{axis}_stddev": 5e-6 for axis in ("lat", "lon", "alt")}
_LEADERBOARD_IMU: Final[Mapping[str, Value]] = {
    "noise_accel_stddev_x": 0.001,
    "noise_accel_stddev_y": 0.001,
    "noise_accel_stddev_z": 0.015,
    **{f"noise_gyro_stddev_{axis}": 0.001 for axis in "xyz"},
}
LEADERBOARD_CHOICES: Final[Mapping[Kind, tuple[str, ...]]] = MappingProxyType(
    {"camera": ("image_size_x", "image_size_y", "fov"), "radar": ("horizontal_fov", "vertical_fov")}
)
"""The attributes that the Leaderboard takes from an agent, by the kind of sensor; all others are fixed."""


def _camera(image: ImageKind, data: str) -> SensorType:
    return SensorType(f"sensor.camera.{image}", "camera", data, _LENS, image)


_TYPES: Final = (
    SensorType("sensor.camera.rgb", "camera", "images: red, green, blue", {**_LENS, **_FILM}, ImageKind.RGB, leaderboard={}),
    _camera(ImageKind.DEPTH, "the depth along the axis of view in m, infinite for the sky"),
    _camera(ImageKind.SEMANTIC, "CARLA's semantic tags"),
    _camera(ImageKind.INSTANCE, "ids of actors, 0 for the town"),
    _camera(ImageKind.NORMALS, "normals of surfaces, in the axes of the world"),
    _camera(ImageKind.FLOW, "motion since the image before"),
    SensorType(
        "sensor.lidar.ray_cast",
        "lidar",
        "points in m with an intensity",
        {**_RAYS, **_DROPOFF},
        leaderboard=_LEADERBOARD_LIDAR,
    ),
    SensorType(
        "sensor.lidar.ray_cast_semantic",
        "semantic_lidar",
        "points in m with the cosine of the incident angle, the id and the semantic tag of an actor",
        _RAYS,
    ),
    SensorType(
        "sensor.other.radar", "radar", "velocity in m/s, azimuth and altitude in radians, depth in m", _RADAR, leaderboard={}
    ),
    SensorType(
        "sensor.other.gnss", "gnss", "latitude and longitude in degrees, altitude in m", _GNSS, leaderboard=_LEADERBOARD_GNSS
    ),
    SensorType(
        "sensor.other.imu",
        "imu",
        "acceleration in m/s², angular velocity in rad/s, compass in radians",
        _IMU,
        leaderboard=_LEADERBOARD_IMU,
    ),
    SensorType("sensor.speedometer", "speedometer", "the speed in m/s", _TICK, is_actor=False, leaderboard={}),
    SensorType("sensor.opendrive_map", "map", "none: rigs leave it out", _TICK, is_actor=False, leaderboard={}),
)
SENSOR_TYPES: Final[Mapping[str, SensorType]] = MappingProxyType({type.name: type for type in _TYPES})
"""The types of sensors that rigs can have, by their names."""

SENSOR_ATTRIBUTES: Final[Mapping[str, Mapping[str, SensorAttribute]]] = MappingProxyType(
    {
        **{type.name: type.attributes for type in _TYPES if type.is_actor},
        "sensor.camera.cosmos_visualization": _LENS,
        "sensor.camera.dvs": {**_LENS, **_FILM, **_EVENTS},
        "sensor.other.collision": {},
        "sensor.other.lane_invasion": {},
        "sensor.other.obstacle": {
            **_TICK,
            **_any(distance="5.0", hit_radius="0.5"),
            "only_dynamics": _flag("false"),
            "debug_linetrace": _flag("false"),
        },
        "sensor.other.rss": {},
        "sensor.other.v2x": {
            **_RADIO,
            **_any(gen_cam_min="0.1", gen_cam_max="1.0"),
            "fixed_rate": _flag("false"),
            **_position_noise(),
            **_deviations("noise_head_stddev"),
            **_any(noise_head_bias="0.0"),
            **_ACCELERATION_NOISE,
            **_deviations("noise_yawrate_stddev"),
            **_any(noise_yawrate_bias="0.0"),
            **_deviations("noise_vel_stddev_x"),
        },
        "sensor.other.v2x_custom": _RADIO,
    }
)
"""The attributes of all sensors of CARLA, by the names of their types; a rig can have those in `SENSOR_TYPES`."""
