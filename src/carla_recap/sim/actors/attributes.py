"""The attributes of blueprints: their types, who may change them, and those of sensors with CARLA's defaults.

Names and defaults are those of CARLA 0.9.16 (its reference of sensors, and `ActorBlueprintFunctionLibrary`).
"""

from __future__ import annotations

from typing import Final

_BOOL, _INT, _FLOAT, _STRING, _COLOUR = range(5)

_FIXED: Final = frozenset(
    (
        "number_of_wheels",
        "generation",
        "base_type",
        "special_type",
        "object_type",
        "has_lights",
        "has_dynamic_doors",
        "gender",
        "age",
        "size",
        "can_use_wheelchair",
    )
)
_RESTRICTED: Final = frozenset(("driver_id", "use_wheelchair", "exposure_mode"))

_LENS: Final = {
    "image_size_x": "800",
    "image_size_y": "600",
    "fov": "90.0",
    "lens_circle_falloff": "5.0",
    "lens_circle_multiplier": "0.0",
    "lens_k": "-1.0",
    "lens_kcube": "0.0",
    "lens_x_size": "0.08",
    "lens_y_size": "0.08",
    "sensor_tick": "0.0",
}
_FILM: Final = {
    "enable_postprocess_effects": "true",
    "bloom_intensity": "0.675",
    "black_clip": "0.0",
    "blade_count": "5",
    "blur_amount": "1.0",
    "blur_radius": "0.0",
    "calibration_constant": "16.0",
    "chromatic_aberration_intensity": "0.0",
    "chromatic_aberration_offset": "0.0",
    "exposure_compensation": "0.0",
    "exposure_max_bright": "12.0",
    "exposure_min_bright": "10.0",
    "exposure_mode": "histogram",
    "exposure_speed_down": "1.0",
    "exposure_speed_up": "3.0",
    "focal_distance": "1000.0",
    "fstop": "1.4",
    "gamma": "2.2",
    "iso": "100.0",
    "lens_flare_intensity": "0.1",
    "min_fstop": "1.2",
    "motion_blur_intensity": "0.45",
    "motion_blur_max_distortion": "0.35",
    "motion_blur_min_object_screen_size": "0.1",
    "shoulder": "0.26",
    "shutter_speed": "200.0",
    "slope": "0.88",
    "temp": "6500.0",
    "tint": "0.0",
    "toe": "0.55",
    "white_clip": "0.04",
}
_EVENTS: Final = {
    "positive_threshold": "0.3",
    "negative_threshold": "0.3",
    "sigma_positive_threshold": "0.0",
    "sigma_negative_threshold": "0.0",
    "refractory_period_ns": "0",
    "use_log": "true",
    "log_eps": "0.001",
}
_RAYS: Final = {
    "channels": "32",
    "range": "10.0",
    "points_per_second": "56000",
    "rotation_frequency": "10.0",
    "upper_fov": "10.0",
    "lower_fov": "-30.0",
    "horizontal_fov": "360.0",
    "sensor_tick": "0.0",
}
_ECHOES: Final = {
    "atmosphere_attenuation_rate": "0.004",
    "dropoff_general_rate": "0.45",
    "dropoff_intensity_limit": "0.8",
    "dropoff_zero_intensity": "0.4",
    "noise_stddev": "0.0",
    "noise_seed": "0",
}
_NOISE: Final = {"noise_seed": "0", "sensor_tick": "0.0"}

SENSORS: Final[dict[str, dict[str, str]]] = {
    "sensor.camera.depth": _LENS,
    "sensor.camera.dvs": {**_LENS, **_FILM, **_EVENTS},
    "sensor.camera.instance_segmentation": _LENS,
    "sensor.camera.normals": _LENS,
    "sensor.camera.optical_flow": _LENS,
    "sensor.camera.rgb": {**_LENS, **_FILM},
    "sensor.camera.semantic_segmentation": _LENS,
    "sensor.lidar.ray_cast": {**_RAYS, **_ECHOES},
    "sensor.lidar.ray_cast_semantic": _RAYS,
    "sensor.other.collision": {},
    "sensor.other.gnss": {
        **{f"noise_{axis}_{kind}": "0.0" for axis in ("alt", "lat", "lon") for kind in ("bias", "stddev")},
        **_NOISE,
    },
    "sensor.other.imu": {
        **{f"noise_{kind}_{axis}": "0.0" for kind in ("accel_stddev", "gyro_bias", "gyro_stddev") for axis in "xyz"},
        **_NOISE,
    },
    "sensor.other.lane_invasion": {},
    "sensor.other.obstacle": {
        "distance": "5.0",
        "hit_radius": "0.5",
        "only_dynamics": "false",
        "debug_linetrace": "false",
        "sensor_tick": "0.0",
    },
    "sensor.other.radar": {
        "horizontal_fov": "30.0",
        "vertical_fov": "30.0",
        "points_per_second": "1500",
        "range": "100.0",
        "sensor_tick": "0.0",
    },
    "sensor.other.rss": {},
}
"""The sensors, and what each has besides its role name."""

CHOICES: Final = {
    "enable_postprocess_effects": ("true", "false"),
    "exposure_mode": ("manual", "histogram"),
}
"""What attributes of sensors are meant to be."""

_TYPES: Final = {
    "number_of_wheels": _INT,
    "generation": _INT,
    "sticky_control": _BOOL,
    "has_lights": _BOOL,
    "has_dynamic_doors": _BOOL,
    "is_invincible": _BOOL,
    "can_use_wheelchair": _BOOL,
    "use_wheelchair": _BOOL,
    "speed": _FLOAT,
    "color": _COLOUR,
    "driver_id": _INT,
    "image_size_x": _INT,
    "image_size_y": _INT,
    "blade_count": _INT,
    "refractory_period_ns": _INT,
    "channels": _INT,
    "points_per_second": _INT,
    "noise_seed": _INT,
    "enable_postprocess_effects": _BOOL,
    "use_log": _BOOL,
    "only_dynamics": _BOOL,
    "debug_linetrace": _BOOL,
    "exposure_mode": _STRING,
}
_OF_SENSORS: Final = frozenset(key for attributes in SENSORS.values() for key in attributes)


def attribute_type(key: str) -> int:
    """The type code of an attribute in a recording: 0 bool, 1 int, 2 float, 3 string, 4 colour."""
    return _TYPES.get(key, _FLOAT if key in _OF_SENSORS else _STRING)


def is_modifiable(key: str) -> bool:
    """Whether who spawns an actor says what this attribute is."""
    return key not in _FIXED


def is_restricted(key: str) -> bool:
    """Whether an attribute is meant to have none but the recommended values."""
    return key in _RESTRICTED
