"""GNSS receivers and IMUs: the geo-reference is that of the client, and noise is that of the attributes."""

from __future__ import annotations

from collections import defaultdict
from math import pi, radians

import numpy as np
import pytest

from carla_recap.sensors.position import GeoReference, Gnss, Imu, acceleration_at
from tests.roads.towns import opendrive, road

ROAD = opendrive(road()).replace('Minor="4"/>', 'Minor="4">{}</header>', 1)
REFERENCES = [
    "",
    "+proj=tmerc +lat_0=0 +lon_0=0 +k=1",
    "+proj=tmerc +lat_0=49.5 +lon_0=-8.25 +k=0.9996 +x_0=500 +y_0=100",
    "+proj=utm +zone=32",
    "+lat_0=-3.3e1 +lon_0=151 ",
    "+lat_0=49",
]


@pytest.mark.parametrize("reference", REFERENCES)
@pytest.mark.parametrize("tag", ["<geoReference>{}</geoReference>", "<geoReference><![CDATA[{} ]]></geoReference>"])
def test_geolocations_are_those_of_the_client(reference: str, tag: str) -> None:
    text = ROAD.format(tag.format(reference))
    carla = pytest.importorskip("carla", reason="the extra `carla` is not installed")
    there = carla.Map("Flat", text)
    for x, y, z in ((0.0, 0.0, 0.0), (1000.0, -2000.0, 3.0), (-350.5, 20.25, -1.0)):
        expected = there.transform_to_geolocation(carla.Location(x, y, z))
        found = GeoReference.of(text).locate((x, y, z))
        assert found == pytest.approx((expected.latitude, expected.longitude, expected.altitude), abs=1e-10)


@pytest.mark.parametrize("text", ["", ROAD.format(""), "<geoReference>+lat_0=x +lon_0=1</geoReference>"])
def test_a_map_without_a_reference_has_the_default_one(text: str) -> None:
    assert GeoReference.of(text) == GeoReference(42.0, 2.0)


def test_a_gnss_receiver_has_the_errors_of_its_attributes() -> None:
    numbers = defaultdict(float, noise_seed=3.0, noise_lat_stddev=0.01, noise_alt_bias=-2.0)
    one, other = (Gnss(numbers.__getitem__, GeoReference(0.0, 0.0)) for _ in range(2))
    found = np.array([one.measure((0.0, 0.0, 5.0)) for _ in range(500)])
    assert (found == [other.measure((0.0, 0.0, 5.0)) for _ in range(500)]).all()
    assert found[:, 0].std() == pytest.approx(0.01, rel=0.1)
    assert (found[:, 1:] == [0.0, 3.0]).all()


def test_an_imu_measures_in_its_own_axes() -> None:
    imu = Imu(defaultdict(float).__getitem__)
    south = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # forward is y, right is -x
    felt, turning, compass = imu.measure(south, 90.0, np.array([1.0, 2.0, 0.0]), np.array([0.0, 90.0, 180.0]))
    assert felt == pytest.approx([2.0, -1.0, 9.81])
    assert turning == pytest.approx([radians(90), 0.0, pi])
    assert compass == pytest.approx(pi)


def test_a_point_beside_the_origin_has_the_acceleration_of_a_rigid_body() -> None:
    found = acceleration_at(
        np.array([2.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), np.degrees([0, 0, 3]), np.degrees([0, 0, 5])
    )
    assert found == pytest.approx([1 - 2 * 9, 2 * 5, 0])


def test_the_errors_of_acceleration_and_rotation_are_different_ones() -> None:
    keys = [f"noise_{kind}_stddev_{axis}" for kind in ("accel", "gyro") for axis in "xyz"]
    imu = Imu(defaultdict(float, dict.fromkeys(keys, 1.0)).__getitem__)
    rest = np.eye(3), 0.0, np.array([0.0, 0.0, -9.81]), np.zeros(3)
    found = np.array([np.concatenate(imu.measure(*rest)[:2]) for _ in range(500)])
    assert found.std(axis=0) == pytest.approx(np.ones(6), rel=0.15)
    assert np.abs(np.corrcoef(found.T) - np.eye(6)).max() < 0.2
