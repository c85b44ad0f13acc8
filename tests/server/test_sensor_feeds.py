"""The frames of sensors, byte by byte; `test_sensors` reads them with the official client."""

from __future__ import annotations

import struct
from dataclasses import replace
from math import exp, radians, sqrt
from typing import TYPE_CHECKING

import msgpack
import numpy as np
import pytest

from carla_recap.server.host import Host
from carla_recap.server.sensors import SENSOR_KINDS, Support, dispatch
from carla_recap.sim.actors.moving import Vehicle, VehicleControl
from carla_recap.sim.blueprints import standard_library
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector
from tests.server.listening import HERE, Listener, sensor, served, vehicle
from tests.sim.flat import at, flat_world

if TYPE_CHECKING:
    from collections.abc import Sequence

    from carla_recap.server.sensors.feeds import Feed, FeedContext
    from carla_recap.sim.episode import Actor


def test_each_sensor_of_the_library_is_in_the_table() -> None:
    assert {blueprint.id for blueprint in standard_library().filter("sensor.*")} == set(SENSOR_KINDS)
    assert {kind.support for kind in SENSOR_KINDS.values()} == set(Support)


def test_a_frame_begins_with_kind_frame_time_and_transform() -> None:
    host = served()
    gnss = sensor(host, "other.gnss", vehicle(host, 10.0, 5.0, 90.0), at(1.0, z=2.0))
    host.tick()
    frame = host.tick()
    (_, ((kind, number, seconds, *place), _)) = gnss.take()
    assert (kind, number, seconds) == (4, frame, host.world.elapsed)
    assert place == pytest.approx([10.0, 6.0, 2.0, 0.0, 90.0, 0.0], abs=1e-4)


def test_a_stream_ends_with_its_sensor() -> None:
    host = served()
    car = vehicle(host)
    imu, lone = sensor(host, "other.imu", car), sensor(host, "other.imu")
    host.tick()
    car.destroy()
    host.tick()
    assert imu.closed
    assert not lone.closed
    assert (len(imu.take()), len(lone.take())) == (1, 2)


def test_a_feed_ends_with_its_last_subscriber() -> None:
    host = served()
    imu = sensor(host, "other.imu", vehicle(host))
    host.tick()
    assert list(host.sensors._feeds) == [imu.stream]
    host.streams.remove(imu.stream, imu)
    host.tick()
    assert host.sensors._feeds == {}


@pytest.mark.parametrize(
    ("interval", "delta", "expected"),
    [
        *((interval, 0.05, range(20)) for interval in ("0", "0.05", "0.01", "1e-320", "x")),
        ("0.1", 0.05, range(0, 20, 2)),
        ("0.25", 0.05, [0, 5, 10, 15]),
        ("0.3", 0.05, [0, 6, 12, 18]),
        ("1.0", 0.05, [0]),
        ("0.1", 1 / 15, [0, 2, 3, 5, 6, 8, 9, 11, 12, 14, 15, 17, 18]),  # in the mean
    ],
)
def test_sensor_tick_is_the_interval_between_frames_from_the_first_tick_of_a_sensor(
    interval: str, delta: float, expected: Sequence[int]
) -> None:
    host = served()
    host.tick(0.07)
    gnss = sensor(host, "other.gnss", sensor_tick=interval)
    begin = host.tick(delta)
    late = Listener(host, host.world.actors[gnss.id])
    for _ in range(19):
        host.tick(delta)
    assert [header[1] - begin for header, _ in gnss.take()] == list(expected)
    assert [header[1] - begin for header, _ in late.take()] == list(expected)[1:]


def test_a_collision_has_both_actors_and_the_impulse() -> None:
    host = served()
    car, other = vehicle(host), vehicle(host, 12.0)
    collision = sensor(host, "other.collision", car)
    silent = sensor(host, "other.collision", vehicle(host, 100.0))
    car.set_target_velocity(Vector(10.0))
    before = 10.0
    while not collision.frames:
        before = car.velocity.x
        host.tick()
    own, their, impulse = msgpack.unpackb(collision.payload())
    assert (own[0], their[0]) == (car.id, other.id)
    assert (own[2][1], their[2][1]) == (car.type_id, other.type_id)
    assert impulse[0] == pytest.approx(1845 * (car.velocity.x - before), rel=0.1)
    assert impulse[0] < -1000
    assert silent.take() == []


def test_a_barrier_is_static_and_no_actor() -> None:
    wall = np.array([(20.0, -10.0, 0.0), (20.0, 10.0, 0.0)])
    host = Host(flat_world(barriers=[wall]))
    car = vehicle(host)
    collision = sensor(host, "other.collision", car)
    car.set_target_velocity(Vector(15.0))
    while not collision.frames:
        host.tick()
    _, other, impulse = msgpack.unpackb(collision.payload())
    assert other[0] == 0
    assert other[2][1] == "static.wall"
    assert impulse[0] < 0


def test_an_imu_measures_in_its_own_axes() -> None:
    host = served()
    car = vehicle(host, yaw=90.0)
    imu = sensor(host, "other.imu", car)
    turned = sensor(host, "other.imu", car, Transform(rotation=Rotation(yaw=90.0)))
    car.set_target_velocity(Vector(0.0, 10.0))
    car.apply_control(VehicleControl(throttle=0.6, steer=0.3))
    for _ in range(20):
        host.tick()
    felt, turning, compass = msgpack.unpackb(imu.take()[-1][1])
    aside, _, _ = msgpack.unpackb(turned.take()[-1][1])
    yaw, pushed = radians(car.transform.rotation.yaw), car.acceleration
    assert felt[0] == pytest.approx(pushed.x * np.cos(yaw) + pushed.y * np.sin(yaw), abs=1e-3)
    assert felt[1] > 1.0  # to the right, into the bend
    assert felt[1] == pytest.approx(aside[0], abs=1e-3)
    assert turning[2] == pytest.approx(radians(car.angular_velocity.z))
    assert turning[2] > 0.1
    assert compass == pytest.approx(yaw + radians(90.0), abs=1e-6)


def test_an_imu_on_another_sensor_measures_as_one_at_that_place() -> None:
    host = served()
    car = vehicle(host)
    mast = host.world.spawn("sensor.other.gnss", at(2.0, 1.0), parent=car)
    attached, direct = sensor(host, "other.imu", mast, HERE), sensor(host, "other.imu", car, at(2.0, 1.0))
    middle = sensor(host, "other.imu", car, HERE)
    car.set_target_velocity(Vector(10.0))
    car.apply_control(VehicleControl(throttle=0.6, steer=0.3))
    for _ in range(20):
        before = car.angular_velocity.z
        host.tick()
    felt, same, (x, y, z) = (msgpack.unpackb(imu.take()[-1][1])[0] for imu in (attached, direct, middle))
    turning, change = radians(car.angular_velocity.z), radians(car.angular_velocity.z - before) / 0.05
    assert felt == pytest.approx(same)
    assert felt == pytest.approx([x - change - 2 * turning**2, y + 2 * change - turning**2, z], abs=1e-3)


def test_a_failing_feed_does_not_fail_the_tick(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    def failing(sensor: Actor, context: FeedContext) -> Feed:
        raise ZeroDivisionError("no way")

    host = served()
    kinds = {**SENSOR_KINDS, "sensor.other.gnss": replace(SENSOR_KINDS["sensor.other.gnss"], make=failing)}
    monkeypatch.setattr(dispatch, "SENSOR_KINDS", kinds)
    first, second = sensor(host, "other.gnss"), sensor(host, "other.gnss")
    other = sensor(host, "other.imu", vehicle(host))
    for _ in range(3):
        host.tick()
    assert len(other.take()) == 3
    assert not first.take() + second.take()
    assert caplog.messages == ["a sensor.other.gnss has failed, and sends nothing more: ZeroDivisionError('no way')"] * 2


def radar_rows(listener: Listener) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    return np.frombuffer(listener.payload(), "<f4").reshape(-1, 4)


def test_a_radar_measures_distance_and_speed() -> None:
    host = served()
    car = vehicle(host)
    ahead = vehicle(host, 30.0)
    radar = sensor(host, "other.radar", car, at(2.5, z=0.8), points_per_second="20000")
    short = sensor(host, "other.radar", car, at(2.5, z=0.8), range="20")
    ahead.set_target_velocity(Vector(4.0))
    car.set_target_velocity(Vector(1.0))
    host.tick()
    found = radar_rows(radar)
    assert 10 < len(found) < 500
    assert len(radar_rows(short)) == 0
    back = ahead.transform.location.x - car.transform.location.x - 4.79 / 2 - 2.5
    assert found[:, 3] * np.cos(found[:, 1]) * np.cos(found[:, 2]) == pytest.approx(np.full(len(found), back), abs=0.01)
    assert found[:, 0] == pytest.approx(np.full(len(found), ahead.velocity.x - car.velocity.x), rel=0.01)
    assert np.abs(np.tan(found[:, 1]) * back).max() <= 2.16 / 2 + 0.01


LIDAR = {"channels": "4", "points_per_second": "80000", "upper_fov": "6", "lower_fov": "-3", "range": "50"}


def test_a_lidar_sees_boxes_in_its_own_axes_channel_by_channel() -> None:
    host = served()
    car = vehicle(host, yaw=90.0)
    vehicle(host, 0.0, 20.0, yaw=90.0)
    lidar = sensor(host, "lidar.ray_cast", car, at(0.0, z=1.0), rotation_frequency="20", **LIDAR)
    host.tick()
    payload = lidar.payload()
    _, channels = struct.unpack("<fI", payload[:8])
    counts = np.frombuffer(payload[8:24], "<u4")
    points = np.frombuffer(payload[24:], "<f4").reshape(-1, 4)
    assert channels == 4
    assert counts.sum() == len(points)
    assert (counts > 10).tolist() == [False, False, True, True]  # the upper ones look over it
    assert points[:, 0] == pytest.approx(np.full(len(points), 20.0 - 4.79 / 2), abs=0.01)
    assert np.abs(points[:, 1]).max() <= 2.16 / 2 + 0.01
    assert points[0, 3] == pytest.approx(exp(-0.004 * np.linalg.norm(points[0, :3])), abs=1e-4)


def test_a_semantic_lidar_has_ids_and_tags() -> None:
    host = served()
    walker = host.world.spawn("walker.pedestrian.0001", at(8.0, z=0.9))
    lidar = sensor(host, "lidar.ray_cast_semantic", vehicle(host), at(0.0, z=1.0), rotation_frequency="20", **LIDAR)
    host.tick()
    point = np.dtype([("place", "<3f4"), ("cosine", "<f4"), ("id", "<u4"), ("tag", "<u4")])
    rows = np.frombuffer(lidar.payload()[24:], point)
    assert set(rows[["id", "tag"]].tolist()) == {(walker.id, 12)}
    assert rows["cosine"].min() > 0.95


def test_measurements_are_the_same_for_a_seed() -> None:
    payloads = []
    for seed in ("5", "5", "6"):
        host = served()
        car = vehicle(host)
        for _ in range(len(payloads)):
            host.world.spawn("static.prop.gnome", at(0.0, 100.0)).destroy()  # other ids
        vehicle(host, 15.0)
        seeded = {"noise_seed": seed}
        lidar = sensor(host, "lidar.ray_cast", car, at(0.0, z=1.0), noise_stddev="0.1", **seeded, **LIDAR)
        radar = sensor(host, "other.radar", car, at(2.5, z=0.8), **seeded)
        gnss = sensor(host, "other.gnss", car, noise_lat_stddev="0.1", **seeded)
        imu = sensor(host, "other.imu", car, noise_accel_stddev_x="0.5", **seeded)
        host.tick()
        payloads.append([listener.payload() for listener in (lidar, radar, gnss, imu)])
    assert payloads[0] == payloads[1]
    assert all(one != other for one, other in zip(payloads[0], payloads[2], strict=True))


def test_a_slanting_obstacle_detector_ignores_barriers_below_and_above_its_line() -> None:
    walls = [np.array([(x, -10.0, z), (x, 10.0, z)]) for x, z in ((8.0, 20.0), (15.0, 0.0), (30.0, 28.0))]
    host = Host(flat_world(barriers=walls))
    up = Transform(Location(2.5, 0.0, 0.8), Rotation(pitch=45.0))
    detector = sensor(host, "other.obstacle", vehicle(host), up, distance="60")
    host.tick()
    _, _, distance = msgpack.unpackb(detector.payload())
    assert distance / sqrt(2) == pytest.approx(30.0 - 2.5 - 0.5 - 0.1, abs=0.05)


def test_an_obstacle_detector_can_be_limited_to_what_moves() -> None:
    wall = np.array([(20.0, -10.0, 0.0), (20.0, 10.0, 0.0)])
    host = Host(flat_world(barriers=[wall]))
    car = vehicle(host)
    container = host.world.spawn("static.prop.container", at(12.0, 1.0))
    everything, moving, short, beside = (
        sensor(host, "other.obstacle", car, at(2.5, y, z=0.8), distance=distance, only_dynamics=only)
        for y, distance, only in ((0.0, "50", "False"), (0.0, "50", "True"), (0.0, "3", "False"), (-5.0, "50", "false"))
    )
    host.tick()
    own, other, distance = msgpack.unpackb(everything.payload())
    assert (own[0], other[2][1]) == (car.id, "static.prop.container")
    assert distance == pytest.approx(12.0 - container.box.extent.x - 2.5 - 0.5, abs=0.01)
    assert moving.take() + short.take() == []
    _, other, distance = msgpack.unpackb(beside.payload())
    assert other[2][1] == "static.wall"
    assert distance == pytest.approx(20.0 - 2.5 - 0.5 - 0.1, abs=0.01)


@pytest.mark.parametrize("kind", sorted(SENSOR_KINDS))
def test_invalid_attributes_fall_back_to_the_default(kind: str) -> None:
    host = served()
    keys = ("image_size_x", "image_size_y", "fov", "channels", "range", "points_per_second", "distance", "noise_seed")
    for value in ("nan", "", "-1", "1e300", "0"):
        values = {key: value for key in keys if key in host.world.blueprints.get(kind).attributes}
        listener = sensor(host, kind.removeprefix("sensor."), vehicle(host), HERE, **values)
        host.tick()
        assert len(listener.frames) <= 1
        for actor in list(host.world.actors.values()):
            if isinstance(actor, Vehicle):
                actor.destroy()


def test_a_warning_says_once_for_each_sensor_what_is_capped(caplog: pytest.LogCaptureFixture) -> None:
    host = served()
    car = vehicle(host)
    lidar = sensor(host, "lidar.ray_cast", car, channels="1000000", points_per_second="5000000", range="30")
    radar = sensor(host, "other.radar", car, points_per_second="3000000")
    sensor(host, "lidar.ray_cast_semantic", car, channels="512", points_per_second="4000000")
    for _ in range(3):
        host.tick()
    told = [
        (f"lidar.ray_cast {lidar.id}", "channels"),
        (f"lidar.ray_cast {lidar.id}", "points_per_second"),
        (f"other.radar {radar.id}", "points_per_second"),
    ]
    assert [message.split(" is ")[0] for message in caplog.messages] == [f"sensor.{which}: {key}" for which, key in told]
