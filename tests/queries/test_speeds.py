"""Queries agree about the speed of an actor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carla_recap import ActorKind, Spawn, attributes, create_recording, open_recording
from tests.roads.straight_road import STRAIGHT_ROAD

TICK = 0.05
JUMP = 40  # the frame before which the car jumps by 100 m


@pytest.mark.parametrize("recorded", [False, True])
@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_a_jump_is_no_speed(tmp_path: Path, suffix: str, recorded: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """A car drives at 20 m/s, and jumps; its recorded velocity is 30 m/s."""
    (tmp_path / "Straight.xodr").write_text(STRAIGHT_ROAD, "utf-8")
    monkeypatch.setenv("CARLA_RECAP_MAPS", str(tmp_path))
    car = Spawn(1, ActorKind.VEHICLE, type_id="vehicle.tesla.model3", attributes=attributes(role_name="hero"))
    x = 5.0 + 20.0 * TICK * np.arange(81) + 100.0 * (np.arange(81) >= JUMP)
    with create_recording(tmp_path / f"jump{suffix}", map_name="Straight") as recorder:
        for frame, place in enumerate(x.tolist()):
            more = {"velocities": {"id": [1], "x": [30.0]}} if recorded else {}
            more |= {} if frame else {"spawned": [car]}
            recorder.add_frame(frame * TICK, transforms={"id": [1], "x": [100 * place], "y": [175.0]}, **more)
    speed = 30.0 if recorded else 20.0
    with open_recording(tmp_path / f"jump{suffix}") as recording:
        path = recording.trajectory(1)
        series = recording.time_series(1)
        greatest = {row.measure: row.value for row in recording.measures([1])}
        hero = recording.summary.hero
        assert hero is not None
        assert path.speed == pytest.approx(speed)
        assert series.speed[np.isfinite(series.speed)] == pytest.approx(speed)
        assert (greatest["speed"], hero.top_speed) == (pytest.approx(speed), pytest.approx(speed))
        assert hero.distance == pytest.approx(79.0)
        limits = recording.incidents(kinds=["speeding"])
        assert [row.value for row in limits] == pytest.approx([speed - 50 / 3.6] * len(limits))
        assert limits


def recorded_car(path: Path, frames: dict[float, dict[str, float]]) -> Path:
    """A recording of a car by time: its x in m, and maybe its velocity in m/s; none where it is absent."""
    car = Spawn(1, ActorKind.VEHICLE, type_id="vehicle.tesla.model3", attributes=attributes(role_name="hero"))
    with create_recording(path, map_name="Nowhere") as recorder:
        for time, motion in frames.items():
            more = {"spawned": [car]} if time == 0 else {}
            more |= {"transforms": {"id": [1], "x": [100 * motion["x"]]}} if motion else {}
            more |= {"velocities": {"id": [1], "x": [motion["vx"]]}} if "vx" in motion else {}
            recorder.add_frame(time, **more)
    return path


@pytest.mark.filterwarnings("ignore:.*is unknown; rules of the road")
@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_an_actor_in_every_other_frame_has_a_speed(tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "Straight.xodr").write_text(STRAIGHT_ROAD, "utf-8")
    monkeypatch.setenv("CARLA_RECAP_MAPS", str(tmp_path))
    cars = [Spawn(id, ActorKind.VEHICLE, type_id="vehicle.tesla.model3", attributes=attributes()) for id in (1, 2)]
    with create_recording(tmp_path / f"two{suffix}", map_name="Straight") as recorder:
        for frame in range(100):
            pose = {"id": [1 + frame % 2], "x": [frame * 100.0], "y": [175.0]}
            recorder.add_frame(frame * TICK, transforms=pose, **({} if frame else {"spawned": cars}))
    with open_recording(tmp_path / f"two{suffix}") as recording:
        for id in (1, 2):
            greatest = {row.measure: row.value for row in recording.measures([id])}
            assert recording.trajectory(id).speed == pytest.approx(20.0)
            assert recording.time_series(id).speed == pytest.approx(20.0)
            assert greatest["speed"] == pytest.approx(20.0)
        assert {row.actors for row in recording.incidents(kinds=["speeding"])} == {(1,), (2,)}


@pytest.mark.filterwarnings("ignore:.*is unknown; rules of the road")
@pytest.mark.parametrize("faulty", [np.inf, 1e6, 150.0])
def test_a_faulty_velocity_explains_no_jump(tmp_path: Path, faulty: float) -> None:
    frames = {frame * TICK: {"x": frame * 1.0 + 100 * (frame >= 10), "vx": 20.0} for frame in range(20)}
    frames[10 * TICK]["vx"] = frames[5 * TICK]["vx"] = faulty
    with open_recording(recorded_car(tmp_path / "faulty.mcap", frames)) as recording:
        hero, path = recording.summary.hero, recording.trajectory(1)
        assert hero is not None
        assert path.speed == pytest.approx([20.0] * 20)
        assert path.velocity_recorded.tolist() == [frame not in (5, 10) for frame in range(20)]
        assert (hero.top_speed, hero.distance) == pytest.approx((20.0, 18.0))
        assert not recording.incidents(kinds=["hard braking"])


@pytest.mark.filterwarnings("ignore:.*is unknown; rules of the road")
def test_a_speed_that_nothing_says_is_unknown(tmp_path: Path) -> None:
    path = recorded_car(tmp_path / "slow.mcap", {frame * 2.0: {"x": frame * 20.0} for frame in range(5)})
    with open_recording(path) as recording:
        hero = recording.summary.hero
        assert hero is not None
        assert np.isnan(recording.trajectory(1).speed).all()
        assert np.isnan(hero.top_speed)
