from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from carla_recap.errors import RecapError
from carla_recap.formats import open_reader
from carla_recap.formats.base import Reader
from carla_recap.model.records import Spawn, attributes
from carla_recap.output.text import text
from carla_recap.queries.incidents import IncidentOptions, incidents
from carla_recap.queries.measures import (
    Measures,
    MeasureSearch,
    measures,
    measures_over_time,
    motion_table,
    pairs,
    time_series,
)
from tests.queries.measures.conftest import Drive, Mover, straight
from tests.samples import CRASH


def of(found: Measures, actor: int = 1) -> dict[str, Any]:
    return {row.measure: row for row in found if row.actor == actor}


def values(found: Measures, actor: int = 1) -> dict[str, float]:
    return {name: row.value for name, row in of(found, actor).items()}


def test_a_part_begins_and_ends_at_frames_whose_times_are_sums_of_steps() -> None:
    """In the sample, the frame at 5 s is at 4.99999999999999 s."""
    with closing(open_reader(CRASH)) as reader:
        assert time_series(reader, 41, start=5.0, stop=5.15).time == pytest.approx([5.0, 5.05, 5.1])


def test_the_efficiency_in_a_part_has_the_traffic_that_the_hero_met_before(drive: Drive) -> None:
    """A car at 15 m/s, which counts with the speed that it had near the hero, is near it in the first 4 s alone."""
    car = straight(2, 60, 5, 15, 180, role_name="background", has_velocity=False)
    reader = drive([straight(1, 0, 0, 10, role_name="hero"), car], seconds=30)
    for start in (-math.inf, 10.0):
        assert values(measures(reader, start=start))["driving_efficiency"] == pytest.approx(100 * 10 / 15, abs=0.01)


def test_times_to_collision_over_time_are_those_of_all_frames(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    """The hero stops 11 m before a car after 4.5 s, and goes on at 2 m/s from 6 s on: longer times than before."""
    monkeypatch.setattr(pairs, "ELEMENTS", 64)
    hero = Mover(1, lambda t: 10 * min(t, 4.5) + 2 * max(t - 6, 0), role_name="hero")
    search = MeasureSearch(drive([hero, Mover(2, lambda _: 60.0)], seconds=9), "all", over_time={"time_to_collision": [1]})
    search.find()
    found = search.values["time_to_collision", 1, 0.0]
    late = found.value[found.time > 6.01]
    assert late == pytest.approx((11 - 2 * (found.time[found.time > 6.01] - 6)) / 2, abs=0.01)
    assert len(late) == 60


def test_a_measure_names_the_other_and_the_time(drive: Drive) -> None:
    cars = [straight(1, 0, 0, 10, role_name="hero"), straight(7, 40, 0, 0, type_id="vehicle.b"), straight(8, 0, 30, 0)]
    row = of(measures(drive(cars, seconds=2.0)))["time_to_collision"]
    assert (row.actor, row.type_id, row.hero) == (1, "vehicle.audi.tt", True)
    assert (row.other, row.other_type_id, row.unit) == (7, "vehicle.b", "s")
    assert (row.value, row.time) == (pytest.approx(1.6, abs=1e-3), pytest.approx(2.0))


@pytest.mark.parametrize(
    ("x", "expected"),
    [
        # A jerk of 2 m/s³ for 3 s, then an acceleration that falls at once.
        (lambda t: t**3 / 3, {"speed": 9.0, "acceleration": 6.0, "jerk": 2.0, "driving_smoothness": 0.0}),
        (lambda t: 20 * t - 2.5 * t * t, {"speed": 20.0, "deceleration": 5.0, "jerk": 0.0, "driving_smoothness": 0.0}),
    ],
)
def test_motion_of_one_actor(drive: Drive, x: Callable[[float], float], expected: dict[str, float]) -> None:
    found = values(measures(drive([Mover(1, x, role_name="hero")], seconds=3.0)))
    assert found == pytest.approx(expected, rel=0.05, abs=0.1)


def test_the_impact_itself_is_no_braking(drive: Drive) -> None:
    hero = Mover(1, lambda t: min(10 * t, 20.0), role_name="hero")
    reader = drive([hero, straight(2, 24, 0, 0)], seconds=4.0, events={40: {"collisions": [(0, 1, 2, 1, 0)]}})
    found = values(measures(reader))
    assert found["time_to_collision"] == pytest.approx(0, abs=1e-6)
    assert found.get("deceleration", 0) < 1
    assert found.get("jerk", 0) < 1


# --- of which actors ------------------------------------------------------------------------------------


@pytest.fixture
def street(drive: Drive) -> Reader:
    walker = straight(9, 5, 5, 1, kind=2, type_id="walker.a", size=(0.5, 0.5))
    return drive([straight(3, 0, 0, 10), straight(4, 20, 0, 5), walker], seconds=0.5)


@pytest.mark.parametrize("hero", [1, 2])
def test_of_an_id_that_is_used_again_each_actor_is_measured(drive: Drive, hero: int) -> None:
    """A car stands for 5 s; another one that gets its id drives at 10 m/s; the first or the second one is the hero."""
    name = {"role_name": "hero"}
    again = Spawn(7, 1, type_id="vehicle.mini.cooper_s", attributes=attributes(**(name if hero == 2 else {})))
    cars = [Mover(7, lambda t: max(t - 5, 0) * 10, role_name="hero" if hero == 1 else ""), Mover(9, lambda _: 500.0)]
    source = drive(cars, seconds=9.95, events={100: {"destroyed": [(7,)], "spawned": [again]}})

    def speeds(actors: Any) -> list[tuple[int, bool, float]]:
        found = measures(source, actors)
        return [(row.actor, row.hero, row.value) for row in found if row.measure == "speed"]

    one, other = (7, hero == 1, pytest.approx(0)), (7, hero == 2, pytest.approx(10))
    assert speeds("hero") == speeds(None) == [one if hero == 1 else other]
    assert speeds(7) == speeds([7]) == [one, other]
    assert [len(time_series(source, name)) for name in ("hero", 7)] == [100, 200]
    stops = incidents(source, IncidentOptions(kinds=["blocked"], min_time=3, actor="hero"))
    assert [each.text for each in stops] == (["hero stands still for 5 s"] if hero == 1 else [])
    assert len(incidents(source, IncidentOptions(kinds=["blocked"], min_time=3, actor=7))) == 1


@pytest.mark.parametrize(("actors", "found"), [(None, {3, 4}), ("all", {3, 4, 9}), ([9], {9})])
def test_the_actors_that_are_asked_for_are_measured(street: Reader, actors: Any, found: set[int]) -> None:
    assert {row.actor for row in measures(street, actors)} == found


@pytest.mark.parametrize(("actors", "error"), [([5], "no vehicle or walker 5"), ("hero", "no hero")])
def test_actors_that_do_not_exist_are_an_error(street: Reader, actors: Any, error: str) -> None:
    with pytest.raises(RecapError, match=error):
        measures(street, actors)


def test_output(street: Reader) -> None:
    assert "time_to_collision           2.700 s          4 vehicle.audi.tt" in "".join(text(measures(street, [3])))


# --- hostile recordings ---------------------------------------------------------------------------------


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e30])
def test_poses_that_are_no_positions(drive: Drive, value: float) -> None:
    cars = [Mover(1, lambda t: value if 1 < t < 2 else 10 * t, role_name="hero"), straight(2, 80, 0, 0)]
    found = values(measures(drive(cars, seconds=4.0, rate=10)))
    assert found["speed"] == pytest.approx(10, abs=0.1)


@pytest.mark.filterwarnings("error")
def test_nothing_to_measure(drive: Drive) -> None:
    assert measures(drive([], seconds=1.0)) == []
    assert measures(drive([Mover(1, present=lambda _: False, role_name="hero")], seconds=1.0)) == []


# --- over time ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pair", "error"),
    [
        (("hero", "hero"), "hero and hero are one actor; expected two"),
        (("hero", 1), "hero and 1 are one actor; expected two"),
        ((3, 3), "3 and 3 are one actor; expected two"),
        ((3, 4), "expected a vehicle and another actor, found two walkers, 3 and 4"),
    ],
)
def test_a_pair_is_two_different_actors_and_one_a_vehicle(drive: Drive, pair: tuple[Any, Any], error: str) -> None:
    walkers = [straight(id, id, 0, 1, kind=2, type_id="walker.a") for id in (3, 4)]
    reader = drive([straight(1, 0, 0, 15, role_name="hero"), *walkers], seconds=0.5)
    for ask in (lambda: measures_over_time(reader, pair=pair), lambda: time_series(reader, *pair)):
        with pytest.raises(RecapError, match=error):
            ask()


def test_of_a_pair_there_are_all_frames_of_the_first_one(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(motion_table, "_FRAMES", 20)
    series = time_series(drive([straight(1, 0, 0, 5), straight(2, 50, 20, 0, present=lambda t: t < 1)], seconds=20), 1, 2)
    assert (len(series), series.time[-1], np.count_nonzero(series.gap < math.inf)) == (401, pytest.approx(20), 20)


def test_a_near_miss_is_where_it_happens(drive: Drive) -> None:
    """Of the hero, which is named first, and a car that crosses its path: where the one that comes second arrives."""
    (found,) = incidents(
        drive([straight(1, -10, 0, 5, role_name="hero"), straight(2, 0, -34, 15, yaw=90)], seconds=4),
        IncidentOptions(kinds=["near miss"]),
    )
    assert (found.actors, found.x, found.y) == ((1, 2), pytest.approx(0), pytest.approx(-34 + 15 * found.time))


@pytest.mark.parametrize("start", [3.0, 3.5, 3.6])
def test_a_part_has_what_began_before_it(drive: Drive, start: float) -> None:
    """The paths of two cars cross 0.2 s apart: one is there until 3.4 s, and the other one from 3.65 s on."""
    reader = drive([straight(1, -31.3, 0, 10, role_name="hero"), straight(2, 0, -39.3, 10, yaw=90)], seconds=8)
    near = IncidentOptions(kinds=["near miss"])
    least = [values(measures(reader, "hero", start=each))["post_encroachment_time"] for each in (-math.inf, start)]
    (whole,), (part,) = incidents(reader, near), incidents(reader, replace(near, start=start))
    assert least[0] == least[1] < 0.3
    assert part == whole


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_an_encounter_that_ends_in_a_collision_behind_a_part_is_no_near_miss(drive: Drive, suffix: str) -> None:
    cars = [Mover(1, lambda t: min(10 * t, 26), role_name="hero"), straight(2, 30, 0, 0)]
    reader = drive(cars, events={52: {"collisions": [(0, 1, 2, 1, 0)]}}, suffix=suffix)
    for stop in (2.5, 2.65, math.inf):
        found = incidents(reader, IncidentOptions(kinds=["near miss", "collision"], stop=stop))
        assert [each.kind for each in found] == ([] if stop == 2.5 else ["collision"])


def test_the_time_of_a_value_is_the_first_that_has_it(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    """The boxes of 2 and 3 overlap; that of 1, whose pairs are computed before theirs, reaches them at 2 s."""
    monkeypatch.setattr("carla_recap.queries.measures.pairs.ELEMENTS", 64)
    reader = drive([Mover(1, lambda t: 8 * t - 20), Mover(2), Mover(3, lambda _: 1.0)], seconds=3)
    rows = [row for row in measures(reader, "all") if row.measure == "time_to_collision"]
    assert [(row.actor, row.value, row.time, row.other) for row in rows] == [
        (1, 0.0, pytest.approx(2.0), 2),
        (2, 0.0, 0.0, 3),
        (3, 0.0, 0.0, 2),
    ]
