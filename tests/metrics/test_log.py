"""The log of a recording for ScenarioRunner's metrics: values, units, and how frames are counted."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("carla", reason="the extra `carla` is not installed")

import carla

from carla_recap import ActorKind, RecapError, Spawn, attributes, create_recording, open_recording
from carla_recap.metrics import MetricsLog
from tests.samples import CRASH


def xyz(vector):
    return (vector.x, vector.y, vector.z)


@pytest.fixture(params=[".log", ".mcap"])
def log(tmp_path, request):
    """Four frames: the hero drives, and hits a light; a walker comes in the second frame and is gone in the fourth."""
    path = tmp_path / f"own{request.param}"
    hero = Spawn(
        7, ActorKind.VEHICLE, 100, 200, 300, type_id="vehicle.a.b", attributes=attributes(role_name="hero", color="1,2,3")
    )
    with create_recording(path, map_name="Town01", additional_data=True) as recorder:
        recorder.add_frame(
            0.0,
            spawned=[hero, Spawn(9, ActorKind.TRAFFIC_LIGHT, type_id="traffic.traffic_light")],
            transforms=[(7, 0, 0, 0, 1, 2, 3)],
            velocities=[(7, 1, 2, 3, 4, 5, 6)],
            vehicle_controls=[(7, 0.5, 0.25, 0.75, 1, -1)],
            light_states=[(9, 1, 2.5, 0)],
            light_times=[(9, 10, 3, 7)],
            bounding_boxes=[(7, 10, 0, 70, 200, 100, 75)],
            trigger_volumes=[(9, 1, 2, 3, 100, 200, 300)],
            vehicle_lights=[(7, 1 | 8)],
            platform_time=123.5,
        )
        recorder.add_frame(
            0.1,
            spawned=[Spawn(8, ActorKind.WALKER, type_id="walker.c")],
            transforms=[(7, 100, 0, 0, 0, 0, 170), (8, 0, 0, 0, 0, 0, 0)],
            walker_controls=[(8, 150.5)],
            light_states=[(9, 0, 0, 2)],
            vehicle_lights=[(7, 0)],
        )
        recorder.add_frame(
            0.2,
            transforms=[(7, 300, 0, 0, 0, 0, -170), (8, 50, 0, 0, 0, 0, 0)],
            collisions=[(1, 7, 9, 1, 0), (2, 7, 4294967295, 1, 0)],
        )
        recorder.add_frame(0.3, destroyed=[8], transforms=[(7, 300, 0, 0, 0, 0, -170)])
    with MetricsLog(path) as found:
        yield found


def test_times_and_collisions_are_counted_from_0(log):
    assert log.get_total_frame_count() == 4
    assert [log.get_elapsed_time(frame) for frame in range(5)] == [0, 0.1, 0.2, 0.3, 0.3]
    assert [log.get_delta_time(frame) for frame in range(4)] == [0, 0.1, 0.1, 0.1]
    assert [log.get_platform_time(frame) for frame in range(2)] == [123.5, None]
    with pytest.raises(RecapError, match="no frame -1"):
        log.get_elapsed_time(-1)
    assert (log.get_actor_collisions(7), log.get_actor_collisions(9)) == ({2: [9, 4294967295]}, {})


def test_actors_are_found_by_role_and_by_blueprint(log):
    assert log.get_ego_vehicle_id() == 7
    assert log.get_actor_ids_with_role_name("hero") == [7]
    assert log.get_actor_ids_with_type_id("*.a*") == [7]
    assert log.get_actor_ids_with_type_id("walker.?") == [8]


def test_attributes_are_texts_with_the_frames_of_the_life(log):
    found = log.get_actor_attributes(7)
    assert xyz(found.pop("location")) == pytest.approx((1, 2, 3))
    box = found.pop("bounding_box")
    assert (xyz(box.location), xyz(box.extent)) == (pytest.approx((0.1, 0, 0.7)), pytest.approx((2, 1, 0.75)))
    assert found == {"type_id": "vehicle.a.b", "role_name": "hero", "color": "1,2,3", "created": 1}
    assert log.get_actor_attributes(8)["destroyed"] == 4
    assert log.get_actor_attributes(99) is None
    assert xyz(log.get_actor_bounding_box(7).extent) == xyz(box.extent)
    assert xyz(log.get_traffic_light_trigger_volume(9).extent) == pytest.approx((1, 2, 3))
    assert log.get_actor_bounding_box(8) is log.get_traffic_light_trigger_volume(7) is None


def test_frames_of_a_life_are_counted_from_1(log):
    assert log.get_actor_alive_frames(7) == (1, 4)
    assert log.get_actor_alive_frames(8) == (2, 3)
    assert log.get_actor_alive_frames(99) == (None, None)


def test_transforms_are_carlas(log):
    first = log.get_actor_transform(7, 1)
    assert (first.rotation.roll, first.rotation.pitch, first.rotation.yaw) == (1, 2, 3)
    assert [each and each.location.x for each in log.get_all_actor_transforms(8)] == [None, 0, pytest.approx(0.5), None]
    assert [each.location.x for each in log.get_all_actor_transforms(7, 2, 3)] == pytest.approx([1, 3])
    assert sorted(log.get_actor_transforms_at_frame(4)) == [7]
    assert log.get_actor_transforms_at_frame(1, [7, 8, 9]).keys() == {7, 9}
    assert log.get_actor_transforms_at_frame(1, [9]) == {9: None}


def test_velocities_are_recorded_or_derived(log):
    assert xyz(log.get_actor_velocity(7, 1)) == (1, 2, 3)
    assert [xyz(each) for each in log.get_all_actor_velocities(7, 2, 3)] == [
        pytest.approx((15, 0, 0)),
        pytest.approx((10, 0, 0)),
    ]
    assert log.get_actor_velocities_at_frame(2, [7])[7].x == pytest.approx(15)
    assert log.get_actor_velocity(8, 1) is None


def test_angular_velocities_are_recorded_or_derived_across_half_a_turn(log):
    assert xyz(log.get_actor_angular_velocity(7, 1)) == (4, 5, 6)
    assert log.get_all_actor_angular_velocities(7, 3, 3)[0].z == pytest.approx(100)
    assert log.get_actor_angular_velocities_at_frame(3, [7])[7].z == pytest.approx(100)


def moved(path, poses, times=(0.0, 0.1, 0.2, 0.3), spawns=(0,)):
    """Return the log of an actor with poses (x, y, z, roll, pitch, yaw), which is spawned anew in some frames."""
    with create_recording(path, map_name="Town01") as recorder:
        for number, pose in enumerate(poses):
            spawned = [Spawn(7, ActorKind.VEHICLE, type_id="vehicle.a.b")] if number in spawns else []
            recorder.add_frame(
                times[number], spawned=spawned, destroyed=[7] if spawned and number else [], transforms=[(7, *pose)]
            )
    return MetricsLog(path)


@pytest.mark.parametrize(
    ("roll", "pitch", "yaw", "expected"),
    [
        ([0, 2], [0, 0], [0, 0], (-20, 0, 0)),  # CARLA's roll and pitch turn around the negative axes
        ([0, 0], [0, 2], [0, 0], (0, -20, 0)),
        ([0, 0], [0, 2], [90, 90], (20, 0, 0)),
        ([0, 0], [90, 90], [179, -179], (0, 0, 20)),
    ],
)
def test_angular_velocities_are_along_the_axes_of_the_world(tmp_path, roll, pitch, yaw, expected):
    with moved(tmp_path / "own.log", [(0, 0, 0, *angles) for angles in zip(roll, pitch, yaw, strict=True)]) as log:
        assert xyz(log.get_actor_angular_velocity(7, 2)) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    ("times", "x", "spawns", "expected"),
    [
        ([0.0, 0.1, 0.2], [0, 0, 0], [0], [100, 100, 100]),
        ([0.0, 0.1, 1.2], [0, 0, 0], [0], [100, 100, 0]),
        ([0.0, 0.1, 0.2], [0, 0, 5000], [0], [100, 100, 0]),
        ([0.0, 0.1, 0.2], [0, 0, 0], [0, 2], [100, 100, 0]),
    ],
    ids=["turns", "after a second", "jumps", "another life"],
)
def test_angular_velocities_are_derived_by_the_rule_of_velocities(tmp_path, times, x, spawns, expected):
    poses = [(100 * place, 0, 0, 0, 0, 10 * number) for number, place in enumerate(x)]
    with moved(tmp_path / "own.log", poses, times, spawns) as log:
        assert [log.get_actor_angular_velocity(7, frame).z for frame in (1, 2, 3)] == pytest.approx(expected)


def test_accelerations_are_changes_of_velocities(log):
    assert xyz(log.get_actor_acceleration(7, 1)) == (0, 0, 0)
    assert log.get_all_actor_accelerations(7, 3, 3)[0].x == pytest.approx(-50)
    assert log.get_actor_accelerations_at_frame(3, [7])[7].x == pytest.approx(-50)


def test_the_first_frame_of_an_actor_with_the_id_of_another_has_no_acceleration(tmp_path):
    with moved(tmp_path / "own.log", [(x, 0, 0, 0, 0, 0) for x in (0, 100, 2000, 2200)], spawns=(0, 2)) as log:
        assert [xyz(each) for each in log.get_all_actor_accelerations(7)] == [(0, 0, 0)] * 4


def test_controls_speeds_and_lights(log):
    control = log.get_vehicle_control(7, 1)
    assert (control.steer, control.throttle, control.brake) == (0.5, 0.25, 0.75)
    assert (control.hand_brake, control.reverse, control.gear) == (True, True, -1)
    assert log.get_vehicle_control(7, 2) is None
    assert log.get_walker_speed(8, 2) == "150.5"
    state = carla.VehicleLightState
    assert log.get_vehicle_lights(7, 1) == [state.Position, state.Brake]
    assert log.get_vehicle_lights(7, 2) == [state.NONE]
    assert log.get_vehicle_lights(7, 3) is None
    assert log.is_vehicle_light_active(state.Brake, 7, 1)
    assert not log.is_vehicle_light_active(state.Brake, 7, 3)


def test_traffic_lights(log):
    state = carla.TrafficLightState
    assert [log.get_traffic_light_state(9, frame) for frame in (1, 2, 3)] == [state.Red, state.Green, None]
    assert [log.is_traffic_light_frozen(9, frame) for frame in (1, 2)] == [True, False]
    assert log.get_traffic_light_elapsed_time(9, 1) == 2.5
    assert [log.get_traffic_light_state_time(9, each, 4) for each in (state.Green, state.Yellow, state.Red, state.Off)] == [
        10,
        3,
        7,
        None,
    ]


def test_without_a_hero_the_error_names_the_roles(tmp_path):
    with create_recording(tmp_path / "own.log", map_name="") as recorder:
        recorder.add_frame(0.0, spawned=[Spawn(7, 1, type_id="vehicle.a", attributes=attributes(role_name="ego"))])
    with MetricsLog(tmp_path / "own.log") as log, pytest.raises(RecapError, match="role name hero; there are ego"):
        log.get_ego_vehicle_id()


def test_physics_control_and_scene_lights(tmp_path):
    with open_recording(CRASH) as recording:
        log = MetricsLog(recording)
        hero = recording.heroes[0].id
        control = log.get_vehicle_physics_control(hero, 1)
        recorded = next(each for frame in recording for each in frame["physics"] if each.id == hero)
    assert control.mass == pytest.approx(recorded.mass)
    assert [wheel.radius for wheel in control.wheels] == pytest.approx(recorded.wheels["radius"].tolist())
    assert [wheel.position.x for wheel in control.wheels] == pytest.approx((recorded.wheels["position_x"] / 100).tolist())
    with create_recording(tmp_path / "own.log", map_name="") as recorder:
        recorder.add_frame(0.0, scene_lights=[(3, 500.7, 1, 0.5, 0, 1, 0, 0)])
        recorder.add_frame(0.1)
    with MetricsLog(tmp_path / "own.log") as log:
        light = log.get_scene_light_state(3, 2)
        assert (light.intensity, light.color.r, light.color.g, light.active) == (500, 255, 127, True)
        assert log.get_scene_light_state(4, 2) is None


def test_trajectories_are_those_of_the_recording():
    with open_recording(CRASH) as recording:
        hero = recording.heroes[0].id
        path = recording.trajectory(hero, axes="carla")
        log = MetricsLog(recording)
        found = [xyz(each.location) for each in log.get_all_actor_transforms(hero)]
        speeds = [xyz(each) for each in log.get_all_actor_velocities(hero)]
    assert np.allclose(found, np.stack((path.x, path.y, path.z), axis=1), atol=1e-4)
    assert np.allclose(speeds, np.stack((path.vx, path.vy, path.vz), axis=1), atol=1e-4)
