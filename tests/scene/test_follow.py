"""The followed actor over time."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carla_recap import ActorKind, Player, Spawn, open_recording
from carla_recap.replay.pose import YAW
from carla_recap.scene.ahead import NO_LIGHT, stop_points
from carla_recap.scene.follow import FollowedActor, FollowedSeries, LiveFollow, followed_series
from tests.replay.scripts import light, pose, spawn, velocity, write
from tests.show.video.conftest import SAMPLES


def series(folder: Path, frames: list[dict[str, Any]], tick: float = 0.1) -> FollowedSeries:
    """Return the series of actor 1 in frames, of which the first one spawns it."""
    frames[0].setdefault("spawned", [spawn(1)])
    with open_recording(write(folder / "in.log", frames, tick=tick)) as recording:
        return followed_series(recording, 1, stop_points(recording.reader))


def controls(throttle: float, brake: float, steer: float) -> tuple[float, ...]:
    return (1, steer, throttle, brake, 0, 1)


ATTACHED: list[dict[str, Any]] = [{"transforms": [pose(2, 100.0 * n)]} for n in range(4)]
ATTACHED[0] |= {"spawned": [spawn(2), spawn(1, "static.prop.box")], "parented": [(1, 2)]}


@pytest.mark.parametrize(
    ("frames", "speeds"),
    [
        ([{"transforms": [pose(1)], "velocities": [velocity(1, 7)]} for _ in range(3)], [7, 7, 7]),
        ([{"transforms": [pose(1, x)]} for x in (0.0, 100.0, 300.0)], [10, 15, 20]),
        ([{}, {}, {"transforms": [pose(1, 500)]}, {"transforms": [pose(1, 600)]}], [np.nan, np.nan, 10, 10]),
        (ATTACHED, [np.nan, 10, 10, 10]),
    ],
    ids=["recorded", "between the neighbours", "unknown until there is a pose", "of the parent"],
)
def test_speeds(tmp_path: Path, frames: list[dict[str, Any]], speeds: list[float]) -> None:
    assert series(tmp_path, frames).speed == pytest.approx(speeds, nan_ok=True)


def test_speed_and_pedals_are_held_in_frames_without_the_actor(tmp_path: Path) -> None:
    there = {"transforms": [pose(1)], "velocities": [velocity(1, 7)], "vehicle_controls": [controls(0.5, 0, 0)]}
    found = series(tmp_path, [there, *({} for _ in range(12)), there])
    assert found.speed == pytest.approx([7] * 11 + [math.nan] * 2 + [7], nan_ok=True)
    assert found.pedals[:, 0] == pytest.approx([0.5] * 11 + [math.nan] * 2 + [0.5], nan_ok=True)


def test_pedals_are_not_held_into_another_life(tmp_path: Path) -> None:
    there = {"transforms": [pose(1)], "vehicle_controls": [controls(0.5, 0, 0)]}
    found = series(tmp_path, [there, {"destroyed": [(1,)]}, {"spawned": [spawn(1)], "transforms": [pose(1)]}])
    assert found.pedals[:, 0] == pytest.approx([0.5, math.nan, math.nan], nan_ok=True)


def test_after_a_jump_speed_is_unknown_and_the_camera_turns_at_once(tmp_path: Path) -> None:
    found = series(tmp_path, [{"transforms": [pose(1, 9e5 * n, yaw=90 * n)]} for n in range(2)])
    assert np.isnan(found.speed).all()
    assert found.jumped.tolist() == [True, True]
    assert found.camera[:, YAW].tolist() == [0, 90]


def test_a_fast_drive_is_no_jump(tmp_path: Path) -> None:
    frames = [{"transforms": [pose(1, 1200.0 * n)], "velocities": [velocity(1, 120)]} for n in range(3)]
    assert series(tmp_path, frames).jumped.tolist() == [True, False, False]


def test_the_camera_turns_calmly(tmp_path: Path) -> None:
    yaws = series(tmp_path, [{"transforms": [pose(1, yaw=90.0 * (n > 0))]} for n in range(6)]).camera[:, YAW]
    assert (np.diff(yaws) > 0).all()
    assert yaws[5] == pytest.approx(90 * (1 - math.exp(-1)))


def test_the_camera_waits_while_the_actor_has_no_pose(tmp_path: Path) -> None:
    found = series(tmp_path, [{"transforms": [pose(1, x, yaw=30)]} for x in (500, math.nan, 600)])
    assert found.camera[:, 0].tolist() == [500, 500, 600]
    assert found.known.tolist() == [True, False, True]
    assert found.jumped.tolist() == [True, False, True]


def test_the_heading_between_two_frames(tmp_path: Path) -> None:
    found = series(tmp_path, [{"transforms": [pose(1, yaw=10.0 * (n > 0))]} for n in range(3)])
    first, second = found.camera[1:, YAW]
    assert found.heading_at(0.15) == pytest.approx((first + second) / 2)
    assert found.heading_at(9.0) == second


def test_acceleration_is_the_mean_over_the_last_moments(tmp_path: Path) -> None:
    frames = [{"transforms": [pose(1)], "velocities": [velocity(1, v)]} for v in (0, 0, 0, 0.6, 1.2, 1.8, 1.8)]
    assert series(tmp_path, frames).acceleration == pytest.approx([math.nan, 0, 0, 2, 4, 6, 4], nan_ok=True, abs=1e-6)


def test_a_brake_is_held_at_a_standstill(tmp_path: Path) -> None:
    frames = [
        {"transforms": [pose(1)], "velocities": [velocity(1, 0)], "vehicle_controls": [controls(n % 2, 1 - n % 2, 0.5)]}
        for n in range(4)
    ]
    found = series(tmp_path, frames)
    assert found.controls.tolist() == [[n % 2, 1 - n % 2, 0.5] for n in range(4)]
    assert found.pedals.tolist() == [[0, 1]] * 4


def signal(id: int, x: float, y: float = 0, z: float = 0, yaw: float = 90) -> Spawn:
    """Return a light at a place in m, whose lane has the heading `yaw` - 90."""
    return Spawn(id, ActorKind.TRAFFIC_LIGHT, 100 * x, 100 * y, 100 * z, 0, 0, yaw, 0, "traffic.traffic_light")


def lights_ahead(folder: Path, *lights: Spawn, actor: str = "vehicle.audi.tt", **frame: Any) -> FollowedSeries:
    """Return the series of an actor before lights, whose states are the remainders of their ids by 3."""
    states = [light(each.id, each.id % 3) for each in lights]
    own = {"transforms": [pose(1)], "spawned": [spawn(1, actor), *lights], "light_states": states}
    return series(folder, [own | frame])


def test_the_light_ahead_is_the_nearest_in_front(tmp_path: Path) -> None:
    found = lights_ahead(tmp_path, signal(10, 90), signal(11, 40), signal(12, 30), signal(13, -5))
    assert (found.light.tolist(), found.light_state.tolist()) == ([12], [0])
    assert found.light_distance == pytest.approx([30 - 2.09])  # half the length of the blueprint


@pytest.mark.parametrize(
    ("lights", "frame", "ahead"),
    [
        ([signal(10, 0, 30, yaw=180), signal(11, 0, -30, yaw=180)], {"transforms": [pose(1, yaw=90)]}, 10),
        *(([signal(10, 30, z=height)], {}, 10) for height in (6, -6)),  # a slope of 10% leads 3 m up or down
        *(([signal(10, 30, z=height)], {}, NO_LIGHT) for height in (8, -8)),
        ([signal(10, 30)], {"trigger_volumes": [(10, -150, 0, 0, 100, 100, 100)]}, 10),
        ([signal(10, 30)], {"trigger_volumes": [(10, -250, 0, 0, 100, 100, 100)]}, NO_LIGHT),  # its stop line is behind
        ([signal(10, 30)], {"actor": "walker.pedestrian.0001"}, NO_LIGHT),
    ],
)
def test_the_light_ahead(tmp_path: Path, lights: list[Spawn], frame: dict[str, Any], ahead: int) -> None:
    assert lights_ahead(tmp_path, *lights, **frame).light.tolist() == [ahead]


def test_an_actor_that_appears_in_the_last_scene_of_a_batch_has_the_speed_of_its_next_step(tmp_path: Path) -> None:
    frames = [{"transforms": [pose(2)]}, {"transforms": [pose(2)]}]
    frames += [{"transforms": [pose(1, 100 * n), pose(2), *[pose(3)] * (n > 0)]} for n in range(3)]
    frames[0]["spawned"] = [spawn(2)]
    with open_recording(write(tmp_path / "in.log", frames, tick=0.1)) as recording:
        actor = FollowedActor(1, {})
        speeds = np.concatenate([actor.series(batch).speed for batch in Player(recording).batches()])
    assert speeds == pytest.approx([math.nan, math.nan, 10, 10, 10], nan_ok=True)


def test_a_walker_heeds_no_light(tmp_path: Path) -> None:
    spawned = [spawn(1, "walker.pedestrian.0001"), spawn(10, "traffic.traffic_light", 3000, 90)]
    frame = {"transforms": [pose(1)], "spawned": spawned, "light_states": [light(10, 0)]}
    assert series(tmp_path, [frame]).light.tolist() == [NO_LIGHT]


def test_nothing_depends_on_how_scenes_are_batched() -> None:
    with open_recording(SAMPLES / "crossing.log") as recording:
        stops = stop_points(recording.reader)
        whole = followed_series(recording, 100, stops)
        actor, parts = FollowedActor(100, stops), []
        for batch in Player(recording).batches():
            parts += [actor.series(batch[row : row + 7]) for row in range(0, len(batch), 7)]
    assert np.isfinite(whole.speed).sum() > 500
    for name, column in vars(FollowedSeries.joined(parts)).items():
        np.testing.assert_allclose(column, vars(whole)[name], rtol=1e-12, err_msg=name)


def test_a_running_simulation_is_followed_from_when_on_the_actor_is_there(tmp_path: Path) -> None:
    frames: list[dict[str, Any]] = [{"transforms": [pose(1, 100 * n)]} for n in range(4)]
    frames[0]["spawned"], frames[2]["spawned"] = [spawn(1)], [spawn(7)]
    live, chosen = LiveFollow(7), []
    with open_recording(write(tmp_path / "in.log", frames)) as recording:
        for number, frame in enumerate(recording.frames()):
            scene, followed = live.scene(frame)
            assert scene.poses[0, 0] == 100 * number
            chosen.append((followed, live.followed))
    assert chosen == [(None, None), (None, None), (7, 7), (None, 7)]
