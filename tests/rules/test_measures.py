"""Measures over a time, until an occasion, in a place; with a bound on the other side; for some time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from carla_recap import Verdict, check, open_recording
from carla_recap.queries.measures import MEASURES, MeasureSearch
from carla_recap.queries.roads import roads_of
from carla_recap.rules.rule_sets import parse_rules
from carla_recap.rules.values import Selector
from tests.replay.scripts import pose, spawn, velocity
from tests.replay.scripts import write as record
from tests.rules.conftest import HERO, TICK, Judge, straight, write
from tests.samples import SAMPLES

PAIRED = [measure.name for measure in MEASURES.values() if measure.other] + ["post_encroachment_time"]
"""The measures in relation to another actor."""
CAR, WALKER = "vehicle.tesla.model3", "walker.pedestrian.0001"
CARS = spawn(7, CAR, role_name="hero"), spawn(8, CAR)


def drive(*parts: tuple[float, float]) -> np.ndarray:
    """A way along x, of parts with a speed in m/s and a duration in s each."""
    speeds = np.concatenate([np.full(round(seconds / TICK), speed) for speed, seconds in parts])
    x = np.append(0.0, np.cumsum(speeds * TICK))
    return np.stack((x, np.full(len(x), -1.75)), axis=1)


STOP_AND_GO = drive((10, 4), (0, 3), (10, 5))
"""Drives 40 m, stands from 4 s to 7 s, and drives 50 m more, to 12 s."""


@pytest.mark.parametrize(
    ("condition", "status", "message"),
    [
        ('{ max = "11 m/s" }', "pass", "the greatest speed of the hero is 10.00 m/s"),
        ('{ max = "9 m/s", during = ["5 s", "8 s"] }', "fail", "of the hero from 5 s to 8 s exceeds 9 m/s: hero, 10.00"),
        ('{ min = "1 m/s" }', "fail", "the speed of the hero falls below 1 m/s: hero, 0.00 m/s at 4.1"),
        ('{ min = "1 m/s", until = { x = 35, y = 0, within = 5 } }', "pass", "the least speed of the hero until reaching"),
        ('{ min = "1 m/s", after = { x = 50, y = 0, within = 5 } }', "pass", "after reaching the place within 5 m of (50,"),
        ('{ max = "1 m/s", where = { x = 0, y = 99, within = 5 } }', "pass", "no speed of the hero in the place within 5 m"),
        ('{ min = "1 m/s", tolerate = "2.75 s" }', "fail", "falls below 1 m/s: hero, 0.00 m/s, for 2.80 s at 4.1"),
        ('{ min = "1 m/s", tolerate = "2.85 s" }', "pass", "the least speed of the hero"),
        ('{ max = "0.1 m/s", for = "2.75 s" }', "pass", "the speed of the hero is at most 0.1 m/s for 2.80 s"),
        ('{ max = "0.1 m/s", for = "2.85 s" }', "fail", "at most 0.1 m/s for 2.85 s: hero for 2.80 s at 4.1"),
        ('{ min = "9 m/s", for = "8 s", tolerate = "4 s" }', "pass", "is at least 9 m/s for 12.00 s"),
        ('{ min = "5 m/s", max = "15 m/s" }', "fail", "is not at least 5 m/s and at most 15 m/s: hero, 0.00"),
    ],
)
def test_the_speed_over_time(judge: Judge, condition: str, status: str, message: str) -> None:
    found = judge(f"speed = {{ of = 'hero', {condition[1:]}", STOP_AND_GO)
    assert found.status == status
    assert message in found.message


@pytest.mark.parametrize(("most", "status"), [("50 km/h", "pass"), ("49.999 km/h", "fail")])
def test_a_recorded_speed_that_is_the_bound_is_within_it(tmp_path: Path, most: str, status: str) -> None:
    """50 km/h as a number of 32 bits, which is how recordings have it, is greater than 50 / 3.6."""
    motion = {"transforms": [pose(7)], "velocities": [velocity(7, 50 / 3.6)]}
    path = record(tmp_path / "fast.mcap", [{"spawned": [CARS[0]]} | motion, *[motion] * 19], tick=TICK)
    assert judged(path, f'speed = {{ of = "hero", max = "{most}" }}').status == status


def test_each_time_that_breaks_a_rule_is_an_offence_and_the_worst_is_first(judge: Judge) -> None:
    way = drive((10, 3), (20, 2), (10, 3), (30, 1), (10, 2))
    found = judge('speed = { of = "hero", max = "15 m/s", during = ["0 s", "20 s"] }', way)
    assert len(found.details) == 2
    assert "hero, 30.00 m/s" in found.details[0]
    assert "hero, 20.00 m/s" in found.details[1]
    assert (found.time, found.actors) == (pytest.approx(8.5, abs=0.5), (HERO,))


@pytest.mark.parametrize(
    ("condition", "status", "message"),
    [
        ('lateral_offset = { of = "hero", max = "50 cm" }', "fail", "exceeds 50 cm: hero, 100.00 cm"),
        ('lateral_offset = { of = "hero", max = "1.1 m" }', "pass", "the greatest lateral offset of the hero is 1.00 m"),
        ('lateral_offset = { of = "hero", max = "50 cm", until = { x = 60, y = 0, within = 10 } }', "pass", "is 25.00 cm"),
        ('lateral_offset = { of = "hero", max = "50 cm", tolerate = "1 s" }', "fail", "100.00 cm, for 4.80 s at"),
        ('speed_over_limit = { of = "hero", max = 0, during = [0, 3] }', "pass", ""),
    ],
)
def test_measures_of_the_road(judge: Judge, condition: str, status: str, message: str) -> None:
    way = straight(10, 10)
    way[:, 1] = np.where(way[:, 0] > 50, -0.75, -1.5)
    found = judge(condition, way)
    assert (found.status, message in found.message) == (status, True), found.message


@pytest.mark.parametrize(("sample", "within_limits"), [("crash.mcap", {"speed_over_limit"}), ("junction.mcap", set())])
def test_the_extremes_of_values_over_time_are_those_of_the_recording(sample: str, within_limits: set[str]) -> None:
    with open_recording(SAMPLES / sample) as recording:
        roads, ids = roads_of(recording.reader), {actor.id for actor in recording.actors.values() if actor.kind == "vehicle"}
        search = MeasureSearch(recording.reader, ids, roads=roads, over_time=dict.fromkeys(MEASURES, ids))
        rows = search.find()
    assert {row.measure for row in rows} >= MEASURES.keys() - within_limits - {
        "distance_off_road",
        "distance_against_lane",
        "post_encroachment_time",
        "driving_efficiency",
    }
    for row in rows:
        (values,) = (found for (name, id, _), found in search.values.items() if (name, id) == (row.measure, row.actor))
        assert (np.diff(values.time) >= 0).all()
        worst = np.nanmin(values.value) if MEASURES[row.measure].extreme == "least" else np.nanmax(values.value)
        assert worst == pytest.approx(row.value), row.measure
        at = values.time[values.value == worst]
        assert at.min() - 1e-6 <= row.time <= at.max() + 1e-6


def judged(path: Path, rule: str) -> Verdict:
    with open_recording(path) as recording:
        return check(recording, parse_rules(f"[rules.it]\n{rule}", "rules.toml"))[0]


@pytest.mark.parametrize(
    ("rule", "status", "message"),
    [
        ('gap = { of = "hero", with = "walker", min = 0 }', "pass", "the least gap of the hero with walkers is 0.00 m"),
        ('gap = { of = "hero", with = "walker", min = 1, during = [0, 5] }', "pass", "hero with walkers from 0 s to 5 s"),
        ('ttc = { of = "hero", with = "vehicle.mercedes.sprinter", min = 1 }', "fail", "falls below 1 s: hero and vehicle."),
        ('pet = { of = "hero", with = "role:ego", min = 1 }', "pass", "nothing to judge: no post encroachment time of "),
        ('ttc = { of = "hero", min = "0.5 s", until = "collision" }', "fail", "0.02 s at 12.05 s"),
        ('ttc = { of = "hero", min = "0.5 s", during = ["0 s", "5 s"] }', "pass", ""),
        ('speed = { of = "hero", max = "40 km/h", after = "collision" }', "fail", "at 12."),
    ],
)
def test_a_measure_in_relation_to_some_others(rule: str, status: str, message: str) -> None:
    found = judged(SAMPLES / "crash.mcap", rule)
    assert (found.status, message in found.message) == (status, True), found.message


def measured(path: Path, ids: list[int], subject: int, with_: str = "any") -> str:
    """The measures of an actor in relation to others, of which those of several actors are computed."""
    with open_recording(path) as recording:
        search = MeasureSearch(recording.reader, ids, over_time=dict.fromkeys(PAIRED, ids), others=Selector(with_).matches)
        rows = [(row.measure, row.value, row.time) for row in search.find() if row.actor == subject]
    values = {key[0]: (each.time.tolist(), each.value.tolist()) for key, each in search.values.items() if key[1] == subject}
    return str([row for row in rows if row[0] in PAIRED] + [values.get(name) for name in PAIRED])


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(st.lists(st.tuples(*[st.floats(-30, 30)] * 2, *[st.floats(-12, 12)] * 2, st.booleans()), min_size=2, max_size=5))
def test_measures_in_relation_to_walkers_are_those_of_a_recording_without_other_actors(
    tmp_path: Path, actors: list[tuple[float, float, float, float, bool]]
) -> None:
    time = np.arange(40)[:, None] * TICK
    ways = [np.array((x, y)) + time * (vx, vy) for x, y, vx, vy, _ in actors]
    walkers = {number for number, (*_, walks) in enumerate(actors) if walks}
    write(tmp_path / "all.log", ways, {}, walkers)
    for subject in range(len(ways)):
        kept = [subject, *sorted(walkers - {subject})]
        again = {number for number, each in enumerate(kept) if each in walkers}
        write(tmp_path / "some.log", [ways[each] for each in kept], {}, again)
        ids = [HERO + number for number in range(len(ways))]
        found = measured(tmp_path / "all.log", ids, HERO + subject, "walker")
        assert found == measured(tmp_path / "some.log", [HERO], HERO)


def test_a_vehicle_with_the_id_of_an_earlier_walker_is_no_walker(tmp_path: Path) -> None:
    """The walker is 30 m beside the hero for 4 s; from 8 s on, a car with its id stands 1 m ahead."""
    frames = [{"transforms": [pose(7), pose(8, y=3000)]}] * 40 + [{"transforms": [pose(7)]}] * 40
    frames += [{"transforms": [pose(7), pose(8, 600)]}] * 80
    frames[0] = {"spawned": [CARS[0], spawn(8, WALKER)]} | frames[0]
    frames[40] = {"destroyed": [(8,)]} | frames[40]
    frames[80] = {"spawned": [CARS[1]]} | frames[80]
    path = record(tmp_path / "again.log", frames, tick=TICK)
    for more in ("", ', tolerate = "0.1 s"'):
        assert judged(path, f'gap = {{ of = "hero", with = "walker", min = "5 m"{more} }}').status == "pass"


@pytest.mark.parametrize(
    ("rule", "applies"),
    [
        ('speed = { of = "hero", max = 50, where = { x = 0, y = 99, within = 5 } }', False),
        ('speed = { of = "hero", max = 50, during = ["90 s", "99 s"] }', False),
        ('speed = { of = "role:heroo", max = 50 }', False),
        ('speed = { of = "hero", max = 50, where = { x = 20, y = 0, within = 5 } }', True),
        ('time_to_collision = { of = "hero", min = 1 }', True),
        ('collisions = { of = "role:heroo", max = 0 }', False),
        ('collisions = { of = "hero", with = "role:heroo", max = 0 }', False),
        ('collisions = { of = "hero", max = 0, after = "hard-braking" }', False),
        ('collisions = { of = "hero", max = 0, during = ["90 s", "99 s"] }', False),
        ('collisions = { of = "hero", max = 0, where = { x = 0, y = 99, within = 5 } }', False),
        ('collisions = { of = "hero", max = 0, until = "collision" }', True),
        ('collisions = { of = "hero", max = 0, where = { x = 20, y = 0, within = 5 } }', True),
        ('stays_out_of = { of = "hero", x = 0, y = 99, within = 5 }', True),
        ('stays_in = { of = "hero", lanes = "driving", where = { x = 0, y = 99, within = 5 } }', False),
        ('distance = { of = "hero", max = 9, where = { x = 0, y = 99, within = 5 } }', False),
        ('distance = { of = "role:heroo", max = 9 }', False),
        ('blocked = { of = "role:heroo", max = 9 }', False),
    ],
)
def test_a_rule_with_nothing_to_judge_says_so(judge: Judge, rule: str, applies: bool) -> None:
    found = judge(rule, straight(10, 5))
    assert (found.status, found.applies) == ("pass", applies)
    assert found.message.startswith("nothing to judge: ") != applies


def test_a_crossing_counts_though_the_first_one_is_gone_by_then(tmp_path: Path) -> None:
    """The hero passes the origin at 2.5 s, and is destroyed at 3.2 s; another car passes there at 4 s."""
    frames = [{"transforms": [pose(8, y=4000 - 50 * n, yaw=-90), *[pose(7, 50 * n - 2500)] * (n < 64)]} for n in range(120)]
    frames[0]["spawned"], frames[64]["destroyed"] = list(CARS), [7]
    path = record(tmp_path / "gone.mcap", frames, tick=0.05)
    verdict = judged(path, 'pet = { of = "hero", min = "2 s", during = ["0 s", "9 s"] }')
    assert (verdict.status, verdict.actors) == ("fail", (7, 8)), verdict.message


def test_values_of_another_actor_with_the_id_do_not_count(tmp_path: Path) -> None:
    """From 1 s on, a car at 40 m/s has the id of the hero, which drives at 10 m/s; in that frame, the hero is gone."""
    speeds = [10.0] * 20 + [40.0] * 20
    frames = [{"transforms": [pose(7, 5 * v * n)], "velocities": [velocity(7, v)]} for n, v in enumerate(speeds)]
    frames[0]["spawned"] = [CARS[0]]
    frames[20] |= {"destroyed": [7], "spawned": [spawn(7, CAR)]}
    verdict = judged(
        record(tmp_path / "again.mcap", frames, tick=0.05), 'speed = { of = "hero", max = "20 m/s", tolerate = "0 s" }'
    )
    assert (verdict.status, verdict.message) == ("pass", "the greatest speed of the hero is 10.00 m/s")
