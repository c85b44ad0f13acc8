"""Queries agree about the speed of an actor, and about who is there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carla_recap import ActorKind, IncidentOptions, Spawn, attributes, check, create_recording, open_recording
from carla_recap.queries.incidents import incidents
from carla_recap.queries.measures import measures, time_series
from carla_recap.roads.surfaces import build_network
from carla_recap.rules.rule_sets import parse_rules
from tests.replay.scripts import light, pose, spawn, write
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


HERO, HIDDEN = 1, 2
SHOWN = 8.0  # s: when the hidden car is set on the road
STEP = 0.1  # s


@pytest.fixture(params=["lights", "no lights"])
def recording(request, tmp_path):
    """The hero drives past a car that is 499 m below the road, and is set on it later."""
    frames = []
    for number in range(120):
        below = number * STEP < SHOWN - STEP / 2
        frames.append({"transforms": [pose(HERO, 100 * number), pose(HIDDEN, 9000, 600, -49900 if below else 0)]})
        if request.param == "lights":
            frames[-1]["light_states"] = [light(9, 2)]
    frames[0]["spawned"] = [spawn(HERO, role_name="hero"), spawn(HIDDEN, x=9000)]
    if request.param == "lights":
        frames[0]["spawned"].append(spawn(9, "traffic.traffic_light", x=4000))
    with open_recording(write(tmp_path / "hidden.mcap", frames, tick=STEP)) as opened:
        yield opened


def test_a_car_below_the_road_is_near_nobody_does_not_stand_and_is_not_off_the_road(recording):
    series, own = (time_series(recording.reader, id) for id in (HERO, HIDDEN))
    hidden = series.time < SHOWN - STEP
    assert set(series.nearest[hidden].tolist()) == {-1}
    assert np.isinf(series.gap[hidden]).all()
    assert set(series.nearest[series.time > SHOWN + 0.6].tolist()) == {HIDDEN}
    assert own.time.min() > SHOWN - STEP
    assert incidents(recording.reader, IncidentOptions(kinds=["blocked"], min_time=5.0)) == []
    assert HIDDEN in [row.id for row in recording.blocked(min_time=5.0)]  # as CARLA's own query has it
    roads = build_network(STRAIGHT_ROAD, "Straight")
    (found,) = (row for row in measures(recording.reader, {HIDDEN}, roads=roads) if row.measure == "distance_off_road")
    assert found.time > SHOWN - STEP


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
@pytest.mark.parametrize(
    ("last", "count"),
    [
        ({}, 1),
        ({"transforms": [pose(HERO, 900), pose(HIDDEN, 9000, 600)]}, 2),
        # Another one with its id is on the road.
        (
            {
                "destroyed": [(HIDDEN,)],
                "spawned": [spawn(HIDDEN)],
                "transforms": [pose(HERO, 900), pose(HIDDEN, 9000)],
            },
            2,
        ),
    ],
)
def test_a_car_counts_for_rules_if_it_is_ever_on_the_road(tmp_path, suffix, last, count):
    frames = [{"transforms": [pose(HERO, 100 * number), pose(HIDDEN, 9000, 600, -49900)]} for number in range(9)]
    frames[0]["spawned"] = [spawn(HERO, role_name="hero"), spawn(HIDDEN, x=9000)]
    frames[-1] |= last
    rules = parse_rules(f'[rules.it]\nactors = {{ of = "vehicle", min = {count}, max = {count} }}', "rules.toml")
    with open_recording(write(tmp_path / f"hidden{suffix}", frames)) as opened:
        (found,) = check(opened, rules)
    assert found.status == "pass", found.message
