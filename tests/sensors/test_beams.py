"""The rays of lidars and radars, and what they measure."""

from __future__ import annotations

from math import exp, pi, radians
from typing import Any

import numpy as np
import pytest

from carla_recap.rendering.rays import SurfaceHits
from carla_recap.sensors import SensorRig, SensorSpec
from carla_recap.sensors.beams import LidarBeams, LidarReturns, RadarBeams, detections


def spec(type: str = "sensor.lidar.ray_cast", **attributes: Any) -> SensorSpec:
    (found,) = SensorRig.of([{"type": type, "id": "a", "x": 0, "y": 0, "z": 0, **attributes}])
    return found


def quiet(message: str) -> None:
    raise AssertionError(message)


def hits_at(distance: float, count: int) -> SurfaceHits:
    zeros = np.zeros(count, np.int64)
    return SurfaceHits(np.arange(count), zeros, np.full(count, distance), np.ones(count), zeros)


def test_a_lidar_sweeps_channel_by_channel_from_above_and_to_the_right() -> None:
    beams = LidarBeams(spec(channels=4, points_per_second=1600, rotation_frequency=10).number, quiet)
    rays = beams.rays(0.1)
    assert rays.shape == (160, 3)
    assert np.linalg.norm(rays, axis=1) == pytest.approx(1.0)
    channels = rays.reshape(4, 40, 3)
    assert np.degrees(np.arcsin(channels[:, :, 2])) == pytest.approx(
        np.repeat([[10.0], [-10 / 3], [-50 / 3], [-30.0]], 40, axis=1)
    )
    yaw = np.unwrap(np.arctan2(channels[0, :, 1], channels[0, :, 0]))
    assert np.diff(yaw) == pytest.approx(2 * pi / 40)  # clockwise from above: y is to the right
    assert beams.angle == pytest.approx(0.0, abs=1e-9)


def test_a_lidar_goes_on_where_the_frame_before_has_ended() -> None:
    whole, parts = (LidarBeams(spec(channels=1, points_per_second=800).number, quiet) for _ in range(2))
    expected = whole.rays(0.1)
    assert np.concatenate([parts.rays(0.025) for _ in range(4)]) == pytest.approx(expected)
    assert parts.angle == pytest.approx(whole.angle, abs=1e-9)


def test_a_lidar_can_see_a_sector_alone() -> None:
    rays = LidarBeams(spec(channels=2, horizontal_fov=90).number, quiet).rays(0.1)
    assert np.abs(np.arctan2(rays[:, 1], rays[:, 0])).max() == pytest.approx(radians(45))


def test_hits_are_counted_by_channel() -> None:
    beams = LidarBeams(spec(channels=3, points_per_second=300).number, quiet)
    rays = beams.rays(0.1)
    hits = hits_at(1.0, 30).take(np.array([0, 9, 10, 29]))
    assert beams.points_of_channels(hits, rays).tolist() == [2, 1, 1]
    assert beams.points_of_channels(hits_at(1.0, 0), rays).tolist() == [0, 0, 0]


def test_too_many_channels_and_rays_are_capped_with_one_warning_each() -> None:
    found: list[str] = []
    values = {**spec().attributes, "channels": 1e6, "points_per_second": 1e7}
    beams = LidarBeams(lambda key: float(values[key]), found.append)
    assert beams.channels == 512
    for _ in range(2):
        assert len(beams.rays(0.1)) == 200_000 // 512 * 512
    assert found == [
        "channels is 1000000: 512 are simulated",
        "points_per_second is 10000000: of 1000000 rays in a frame, 200000 are cast",
    ]


def test_a_return_has_an_intensity_and_is_dropped_at_random() -> None:
    returns = LidarReturns(spec(atmosphere_attenuation_rate=0.01, noise_stddev=0.1, noise_seed=3).number)
    hits = hits_at(20.0, 20_000)
    kept, intensity = returns.of(hits)
    assert intensity == pytest.approx(exp(-0.2))
    assert len(kept.ray) == len(intensity) == pytest.approx(0.55 * 20_000, rel=0.03)
    assert kept.distance.mean() == pytest.approx(20.0, abs=0.01)
    assert kept.distance.std() == pytest.approx(0.1, rel=0.05)
    again, _ = LidarReturns(spec(atmosphere_attenuation_rate=0.01, noise_stddev=0.1, noise_seed=3).number).of(hits)
    assert (kept.ray == again.ray).all()
    assert (kept.distance == again.distance).all()


@pytest.mark.parametrize(
    ("distance", "limit", "kept"), [(1.0, 0.8, 1.0), (40.0, 0.8, 0.6 + 0.5 * exp(-2.0)), (40.0, 0.0, 1.0)]
)
def test_returns_weaker_than_a_limit_are_dropped_more_often(distance: float, limit: float, kept: float) -> None:
    values = {"atmosphere_attenuation_rate": 0.05, "dropoff_general_rate": 0.0, "dropoff_intensity_limit": limit}
    found = len(LidarReturns(spec(**values).number).of(hits_at(distance, 20_000))[0].ray) / 20_000
    assert found == pytest.approx(kept, rel=0.03 if kept < 1 else 1e-9)


def test_a_radar_scatters_its_rays_in_a_cone() -> None:
    beams = RadarBeams(
        spec("sensor.other.radar", horizontal_fov=60, vertical_fov=20, points_per_second=20_000).number, quiet
    )
    rays = beams.rays(0.1)
    assert rays.shape == (2000, 3)
    assert np.linalg.norm(rays, axis=1) == pytest.approx(1.0)
    azimuth, slope = np.arctan2(rays[:, 1], rays[:, 0]), rays[:, 2] / rays[:, 0]
    assert radians(28) < np.abs(azimuth).max() <= radians(30)
    assert np.tan(radians(9)) < np.abs(slope).max() <= np.tan(radians(10))
    assert (rays != beams.rays(0.1)).any()


def test_a_detection_is_positive_if_the_target_moves_away() -> None:
    rays = np.array([[1.0, 0.0, 0.0], [0.8, 0.6, 0.0], [0.8, 0.0, -0.6]])
    east_to_south = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # a radar that looks along y
    hits = hits_at(15.0, 3).take(np.array([0, 1]))
    found = detections(hits, rays, east_to_south, np.array([[3.0, -4.0, 0.0], [-5.0, 0.0, 0.0]]))
    assert found == pytest.approx(np.array([[-4.0, 0.0, 0.0, 15.0], [3.0, np.arctan2(0.6, 0.8), 0.0, 15.0]]))
    down = detections(hits_at(2.0, 3), rays, np.eye(3), np.zeros((3, 3)))[2]
    assert down == pytest.approx([0.0, 0.0, np.arcsin(-0.6), 2.0])
