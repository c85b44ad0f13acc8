"""Velocities and accelerations of replayed actors, which recordings do not contain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carla_recap
from carla_recap.errors import RecapWarning
from carla_recap.model.records import ActorKind, Spawn
from carla_recap.replay import Player
from carla_recap.sim.town.loading import load_town
from carla_recap.sim.world import World
from tests.roads.towns import town
from tests.samples import carla_log
from tests.sim.flat import flat_world
from tests.sim.recordings import written

CAR = 7
POSE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def speeding_up(time: float) -> tuple[float, ...]:
    """Return a pose in cm of a car that accelerates at 2 m/s²."""
    return (10_000.0 + 100.0 * time**2, *POSE[1:])


def car(path: Path, pose: Callable[[float], Any], interval: float = 0.05, first: float = 0.0) -> Path:
    """Write 4 s of a car, which appears at a time, with x, y, z in cm and roll, pitch, yaw in degrees at each time."""
    times = [number * interval for number in range(round(4.0 / interval) + 1)]
    frames: list[Any] = [{"transforms": [(CAR, *pose(time))] if time >= first else []} for time in times]
    begin = next(number for number, time in enumerate(times) if time >= first)
    frames[begin]["spawned"] = [Spawn(CAR, ActorKind.VEHICLE, type_id="vehicle.audi.tt")]
    return written(path, *frames, interval=interval)


def replayed(path: Path, delta: float = 0.05, factor: float = 1.0) -> World:
    world = flat_world()
    world.settings.fixed_delta_seconds = delta
    world.replayer.time_factor = factor
    world.replay_file(path)
    return world


def accelerations(world: World, ticks: int) -> list[float]:
    """Return the acceleration of the car along x in each of the next ticks; NaN without the car."""
    found = []
    for _ in range(ticks):
        world.tick()
        actor: Any = world.actors.get(CAR)
        found.append(np.nan if actor is None else actor.acceleration.x)
    return found


@pytest.mark.parametrize("interval", [0.05, 0.1, 0.08])
@pytest.mark.parametrize("delta", [0.05, 0.02, 0.1])
def test_the_acceleration_is_that_of_the_recording_whatever_the_ticks(tmp_path: Path, interval: float, delta: float) -> None:
    world = replayed(car(tmp_path / "car.mcap", speeding_up, interval), delta)
    found = accelerations(world, round(3.0 / delta))
    assert found[0] == 0.0
    settled = found[10:]
    assert np.mean(settled) == pytest.approx(2.0, rel=0.02)
    is_even = max(interval, delta) / min(interval, delta) % 1 == 0
    assert settled == pytest.approx([2.0] * len(settled), abs=0.02 if is_even else 0.8)


def test_a_slow_replay_accelerates_less(tmp_path: Path) -> None:
    world = replayed(car(tmp_path / "car.mcap", speeding_up), factor=0.5)
    assert accelerations(world, 40)[10:] == pytest.approx([0.5] * 30, abs=0.01)
    world.replayer.time_factor = 0.0
    assert accelerations(world, 3) == [0.0] * 3
    world.replayer.time_factor = 1.0
    assert accelerations(world, 10) == pytest.approx([2.0] * 10, abs=0.02)


def test_a_jump_is_no_acceleration(tmp_path: Path) -> None:
    path = car(tmp_path / "car.mcap", lambda time: (10_000.0 * (1 + (time > 2.0)), *POSE[1:]))
    assert accelerations(replayed(path), 70) == [0.0] * 70


def test_an_actor_that_appears_has_no_acceleration_yet(tmp_path: Path) -> None:
    path = car(tmp_path / "car.mcap", lambda time: (10_000.0 + 1_000.0 * time, *POSE[1:]), first=1.0)
    found = accelerations(replayed(path), 60)
    assert np.isnan(found[:19]).all()
    assert found[20:] == pytest.approx([0.0] * 40, abs=0.01)


def test_an_actor_without_a_pose_stands_still(tmp_path: Path) -> None:
    def pose(time: float) -> tuple[float, ...]:
        return speeding_up(time) if time < 1.0 else (np.nan, *POSE[1:])

    world = replayed(car(tmp_path / "car.mcap", pose))
    assert accelerations(world, 15)[-1] == pytest.approx(2.0, abs=0.02)
    with pytest.warns(RecapWarning, match="its recorded pose at .* is out of range"):
        accelerations(world, 15)
    actor: Any = world.actors[CAR]
    assert (actor.acceleration.x, actor.velocity.x) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("yaw", "pitch_rate", "roll_rate", "expected"),
    [
        (0.0, 10.0, 0.0, (0.0, -10.0, 0.0)),
        (90.0, 10.0, 0.0, (10.0, 0.0, 0.0)),
        (0.0, 0.0, 10.0, (-10.0, 0.0, 0.0)),
        (90.0, 0.0, 10.0, (0.0, -10.0, 0.0)),
    ],
)
def test_pitch_and_roll_turn_around_axes_of_the_car(
    tmp_path: Path, yaw: float, pitch_rate: float, roll_rate: float, expected: tuple[float, ...]
) -> None:
    path = car(tmp_path / "car.mcap", lambda time: (*POSE[:3], roll_rate * time, pitch_rate * time, yaw))
    world = replayed(path)
    for _ in range(3):
        world.tick()
    assert world.vehicles.angular_velocity[0].tolist() == pytest.approx(expected, abs=0.3)
    world.stop_replayer(keep_actors=True)
    world.tick()
    assert world.vehicles.angular_velocity[0, :2].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(("name", "spectator", "hero"), [("0.9.10", 86, 259), ("0.9.13", 1, 234)])
def test_recordings_of_carla_replay_in_their_town_as_they_move(name: str, spectator: int, hero: int) -> None:
    path = carla_log(f"carla-{name}-lane-center.log")
    with carla_recap.open_recording(path) as recording:
        rows = [(scene.time, row) for scene in Player(recording).scenes() for row in scene.velocities if row["id"] == hero]
        lights = {id for id, actor in recording.actors.items() if actor.kind == "traffic_light"}
        way = recording.trajectory(hero, axes="carla")
    recorded = np.array([[row[key] for key in ("x", "y", "angular_x", "angular_y", "angular_z")] for _, row in rows])
    time = [time for time, _ in rows]
    world = World(load_town(), date=0, maps=town("Town01").parent)
    world.replayer.ignore_spectator = False
    assert world.replay_file(path).loaded
    assert (world.town.name, len(lights)) == ("Town01", 36)
    assert lights | {spectator, hero} <= world.replayer.mapping.keys()
    actor: Any = world.actors[world.replayer.mapping[hero]]
    found, elapsed = [], np.arange(0.025, time[-1] - 0.1, 0.05)  # the middle of each tick
    for middle in elapsed:
        world.tick()
        place, velocity, turning, change = (
            getattr(actor, name) for name in ("transform", "velocity", "angular_velocity", "acceleration")
        )
        there = [np.interp(middle + 0.025, way.time, along) for along in (way.x, way.y, way.z)]
        assert astuple(place.location) == pytest.approx(there, abs=1e-3)
        found.append((velocity.x, velocity.y, turning.x, turning.y, turning.z, change.x, change.y))
    expected = np.array([np.interp(elapsed, time, column) for column in recorded.T])
    expected = np.concatenate((expected, np.diff(expected[:2], prepend=np.nan) / 0.05))[:, 20:]
    moved = np.array(found)[20:].T
    assert np.abs(moved[:2] - expected[:2]).mean() < 0.15  # m/s
    for mine, others in zip(moved[2:], expected[2:], strict=True):
        assert np.corrcoef(mine, others)[0, 1] > 0.8
