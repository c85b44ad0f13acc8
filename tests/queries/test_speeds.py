"""Queries agree about the speed of an actor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from carla_recap import ActorKind, Spawn, attributes, create_recording, open_recording
from tests.roads.straight_road import STRAIGHT_ROAD

if TYPE_CHECKING:
    from pathlib import Path

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
