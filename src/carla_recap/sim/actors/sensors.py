"""The sensors of CARLA 0.9.16 and their attributes: the first value of each is the default, all are recommended."""

from __future__ import annotations

from typing import Final

Values = dict[str, tuple[str, ...]]

COLLISION_SENSOR: Final = "sensor.other.collision"
V2X_SENSOR: Final = "sensor.other.v2x"
CUSTOM_V2X_SENSOR: Final = "sensor.other.v2x_custom"

_SIDES: Final = ("front", "back", "left", "right", "front_left", "front_right", "back_left", "back_right")


def _values(role: tuple[str, ...] = _SIDES, /, **defaults: str) -> Values:
    """Return the values of attributes that have no other recommended value than the default, after the role names."""
    return {"role_name": role, **{key: (default,) for key, default in defaults.items()}}


def _zeros(*keys: str) -> dict[str, str]:
    return dict.fromkeys(keys, "0.0")


_DEFAULT: Final = ("default",)
_TICK: Final = {"sensor_tick": "0.0"}
_SEED: Final = {"noise_seed": "0"}
_LENS: Final = {
    **_TICK,
    "image_size_x": "800",
    "image_size_y": "600",
    "fov": "90.0",
    "lens_circle_falloff": "5.0",
    "lens_circle_multiplier": "0.0",
    "lens_k": "-1.0",
    "lens_kcube": "0.0",
    "lens_x_size": "0.08",
    "lens_y_size": "0.08",
}
_FILM: Final = {
    "exposure_mode": "histogram",
    "exposure_compensation": "0.0",
    "shutter_speed": "200.0",
    "iso": "100.0",
    "fstop": "1.4",
    "enable_postprocess_effects": "true",
    "gamma": "2.2",
    "motion_blur_intensity": "0.45",
    "motion_blur_max_distortion": "0.35",
    "lens_flare_intensity": "0.1",
    "bloom_intensity": "0.675",
    "motion_blur_min_object_screen_size": "0.1",
    "exposure_min_bright": "10.0",
    "exposure_max_bright": "12.0",
    "exposure_speed_up": "3.0",
    "exposure_speed_down": "1.0",
    "calibration_constant": "16.0",
    "focal_distance": "1000.0",
    "min_fstop": "1.2",
    "blade_count": "5",
    "blur_amount": "1.0",
    "blur_radius": "0.0",
    "slope": "0.88",
    "toe": "0.55",
    "shoulder": "0.26",
    "black_clip": "0.0",
    "white_clip": "0.04",
    "temp": "6500.0",
    "tint": "0.0",
    "chromatic_aberration_intensity": "0.0",
    "chromatic_aberration_offset": "0.0",
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
    **_TICK,
    "channels": "32",
    "range": "10.0",
    "points_per_second": "56000",
    "rotation_frequency": "10.0",
    "upper_fov": "10.0",
    "lower_fov": "-30.0",
    "horizontal_fov": "360.0",
}
_DROPOFF: Final = {
    "atmosphere_attenuation_rate": "0.004",
    **_SEED,
    "dropoff_general_rate": "0.45",
    "dropoff_intensity_limit": "0.8",
    "dropoff_zero_intensity": "0.4",
    "noise_stddev": "0.0",
}
_POSITION_NOISE: Final = _zeros(*(f"noise_{axis}_{kind}" for axis in ("lat", "lon", "alt") for kind in ("stddev", "bias")))
_ACCELERATION_NOISE: Final = _zeros(*(f"noise_accel_stddev_{axis}" for axis in "xyz"))
_ROTATION_NOISE: Final = _zeros(*(f"noise_gyro_{kind}_{axis}" for kind in ("stddev", "bias") for axis in "xyz"))
_RADIO: Final = {
    **_TICK,
    **_SEED,
    "transmit_power": "21.5",
    "receiver_sensitivity": "-99.0",
    "frequency_ghz": "5.9",
    "combined_antenna_gain": "10.0",
    "scenario": "highway",
    "path_loss_model": "winner",
    "path_loss_exponent": "2.7",
    "d_ref": "1.0",
    "filter_distance": "500.0",
    "use_etsi_fading": "true",
    "custom_fading_stddev": "0.0",
}
_SCENARIOS: Final = {"scenario": ("highway", "rural", "urban"), "path_loss_model": ("winner", "geometric")}
_EXPOSURE: Final = {"exposure_mode": ("histogram", "manual")}

SENSORS: Final[dict[str, Values]] = {
    **dict.fromkeys(
        (
            f"sensor.camera.{kind}"
            for kind in ("cosmos_visualization", "depth", "instance_segmentation", "normals", "optical_flow")
        ),
        _values(**_LENS),
    ),
    "sensor.camera.semantic_segmentation": _values(**_LENS),
    "sensor.camera.rgb": _values(**_LENS, **_FILM) | _EXPOSURE,
    "sensor.camera.dvs": _values(**_LENS, **_FILM, **_EVENTS) | _EXPOSURE,
    "sensor.lidar.ray_cast": _values(**_RAYS, **_DROPOFF),
    "sensor.lidar.ray_cast_semantic": _values(**_RAYS),
    COLLISION_SENSOR: _values(),
    "sensor.other.gnss": _values(_DEFAULT, **_TICK, **_SEED, **_POSITION_NOISE),
    "sensor.other.imu": _values(_DEFAULT, **_TICK, **_SEED, **_ACCELERATION_NOISE, **_ROTATION_NOISE),
    "sensor.other.lane_invasion": _values(),
    "sensor.other.obstacle": _values(
        **_TICK, distance="5.0", hit_radius="0.5", only_dynamics="false", debug_linetrace="false"
    ),
    "sensor.other.radar": _values(
        _DEFAULT, **_TICK, horizontal_fov="30", vertical_fov="30", range="100", points_per_second="1500", **_SEED
    ),
    "sensor.other.rss": _values(),
    V2X_SENSOR: _values(
        _DEFAULT,
        **_RADIO,
        gen_cam_min="0.1",
        gen_cam_max="1.0",
        fixed_rate="false",
        **_POSITION_NOISE,
        **_zeros("noise_head_stddev", "noise_head_bias"),
        **_ACCELERATION_NOISE,
        **_zeros("noise_yawrate_stddev", "noise_yawrate_bias", "noise_vel_stddev_x"),
    )
    | _SCENARIOS,
    CUSTOM_V2X_SENSOR: _values(_DEFAULT, **_RADIO) | _SCENARIOS,
}
"""The sensors by name, with the values of their attributes, without those that all actors have."""
