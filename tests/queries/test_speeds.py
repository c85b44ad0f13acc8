"""Queries agree about the speed of an actor."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carla_recap import ActorKind, Spawn, attributes, create_recording, open_recording
from tests.roads.straight_road import STRAIGHT_ROAD

TICK = 0.05


CARS = [
    Spawn(id, ActorKind.VEHICLE, type_id="vehicle.tesla.model3", attributes=attributes(role_name=role))
    for id, role in ((1, "hero"), (2, ""))
]


@pytest.fixture
def record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Return a function that records cars on a straight road: the x in m of one in each frame, and velocities in m/s."""
    (tmp_path / "Straight.xodr").write_text(STRAIGHT_ROAD, "utf-8")
    monkeypatch.setenv("CARLA_RECAP_MAPS", str(tmp_path))

    def recorded(suffix: str, x: Any, speeds: Any = None, ids: Any = None) -> Path:
        path = tmp_path / f"cars{suffix}"
        ids = np.ones(len(x), int) if ids is None else ids
        with create_recording(path, map_name="Straight") as recorder:
            for frame, (id, place) in enumerate(zip(ids.tolist(), x.tolist(), strict=True)):
                more = {} if frame else {"spawned": CARS}
                more |= {} if speeds is None else {"velocities": {"id": [id], "x": [speeds[frame]]}}
                recorder.add_frame(frame * TICK, transforms={"id": [id], "x": [100 * place], "y": [175.0]}, **more)
        return path

    return recorded


@pytest.mark.parametrize("recorded", [False, True])
@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_a_jump_is_no_speed(record: Callable[..., Path], suffix: str, recorded: bool) -> None:
    """A car drives at 20 m/s, and jumps by 100 m before frame 40; its recorded velocity is 30 m/s."""
    x = 5.0 + 20.0 * TICK * np.arange(81) + 100.0 * (np.arange(81) >= 40)
    speed = 30.0 if recorded else 20.0
    with open_recording(record(suffix, x, np.full(81, 30.0) if recorded else None)) as recording:
        series = recording.time_series(1)
        greatest = {row.measure: row.value for row in recording.measures([1])}
        hero = recording.summary.hero
        assert hero is not None
        assert recording.trajectory(1).speed == pytest.approx(speed)
        assert series.speed[np.isfinite(series.speed)] == pytest.approx(speed)
        assert (greatest["speed"], hero.top_speed) == (pytest.approx(speed), pytest.approx(speed))
        assert hero.distance == pytest.approx(79.0)
        limits = [row.value for row in recording.incidents(kinds=["speeding"])]
        assert limits
        assert limits == pytest.approx([speed - 50 / 3.6] * len(limits))


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_an_actor_in_every_other_frame_has_a_speed(record: Callable[..., Path], suffix: str) -> None:
    with open_recording(record(suffix, np.arange(100.0), ids=1 + np.arange(100) % 2)) as recording:
        for id in (1, 2):
            greatest = {row.measure: row.value for row in recording.measures([id])}
            for speed in (recording.trajectory(id).speed, recording.time_series(id).speed, greatest["speed"]):
                assert speed == pytest.approx(20.0)
        assert {row.actors for row in recording.incidents(kinds=["speeding"])} == {(1,), (2,)}


@pytest.mark.parametrize("faulty", [np.inf, 1e6, 150.0])
def test_a_faulty_velocity_explains_no_jump(record: Callable[..., Path], faulty: float) -> None:
    speeds = np.where(np.isin(np.arange(20), (5, 10)), faulty, 20.0)
    with open_recording(record(".mcap", np.arange(20) + 100.0 * (np.arange(20) >= 10), speeds)) as recording:
        hero, path = recording.summary.hero, recording.trajectory(1)
        assert hero is not None
        assert path.speed == pytest.approx([20.0] * 20)
        assert path.velocity_recorded.tolist() == [frame not in (5, 10) for frame in range(20)]
        assert (hero.top_speed, hero.distance) == pytest.approx((20.0, 18.0))
        assert not recording.incidents(kinds=["hard braking"])
