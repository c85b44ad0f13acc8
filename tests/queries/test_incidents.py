from __future__ import annotations

import json as stdlib
import math
import re
from collections.abc import Callable, Collection
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click import Context

from carla_recap.cli import cli
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.formats import open_reader
from carla_recap.formats.base import Reader
from carla_recap.model.records import NO_ACTOR, Spawn, attributes
from carla_recap.output.json import json as json_text
from carla_recap.output.table import table
from carla_recap.output.terminal import INCIDENT_STYLES
from carla_recap.output.text import text
from carla_recap.queries.incidents import Incident, IncidentOptions, incidents
from carla_recap.queries.kinds import KINDS, kind_named, kinds_named, kinds_without_roads
from carla_recap.queries.measures import measures_on_roads
from carla_recap.queries.roads import roads_of
from carla_recap.show.page.script import kind_data
from carla_recap.tables import column_names
from tests.queries.conftest import TICK, Make
from tests.queries.measures.conftest import Mover, record, straight
from tests.samples import CROSSING, carla_log, reading

RATE = 20.0


def spawn(id: int, kind: int, type_id: str, **given: str) -> Spawn:
    return Spawn(id, kind, type_id=type_id, attributes=attributes(**given))


CAST = [
    spawn(1, 1, "vehicle.audi.tt", role_name="hero"),
    spawn(2, 2, "walker.a"),
    spawn(3, 1, "vehicle.b"),
    spawn(4, 0, "static.prop.c"),
    spawn(5, 1, "vehicle.d"),
]


def pose(id: int, x: float, y: float = 0.0) -> tuple[float, ...]:
    return (id, x, y, 50.0, 0.0, 0.0, 0.0)


def contact(id1: int, id2: int, hero1: int = 0, hero2: int = 0) -> dict[str, Any]:
    return {"collisions": [(0, id1, id2, hero1, hero2)], "transforms": [pose(1, 100, 200), pose(2, 300), pose(3, 500)]}


# --- the sample, and real recordings -------------------------------------------------------------------


def test_sample(converted: Callable[[Path, str], Path], suffix: str, opened: Callable[[Path], Reader]) -> None:
    answer = incidents(opened(converted(CROSSING, suffix)))
    assert [(row.kind, row.text) for row in answer] == [
        ("blocked", "vehicle.mercedes.sprinter (102) stands still for 39 s"),
        ("collision", "vehicle.bh.crossbike (105) collides with walker.pedestrian.0004 (110)"),
        ("hard braking", "hero brakes hard at 44 km/h"),
        ("collision", "hero collides with vehicle.audi.a2 (101)"),
    ]
    van, cyclist, brake, crash = answer
    assert (van.start, van.stop, van.actors) == (14.1, 53.0, (102,))
    assert (cyclist.start, cyclist.stop, cyclist.actors) == (20.9, 21.7, (105, 110))
    assert cyclist.type_ids == ("vehicle.bh.crossbike", "walker.pedestrian.0004")
    assert (cyclist.x, cyclist.y) == pytest.approx((-2.9, -5.575), abs=1e-3)
    assert brake.start == pytest.approx(24.6 - 1.2, abs=0.15)  # as it is told of in the samples' README
    assert brake.stop < crash.start
    assert (crash.start, crash.stop, crash.actors) == (24.6, 25.1, (100, 101))


@pytest.mark.parametrize("name", ["carla-0.9.10-lane-center.log", "carla-0.9.13-lane-center.log"])
def test_a_calm_drive_has_none(name: str, opened: Callable[[Path], Reader]) -> None:
    assert incidents(opened(carla_log(name)), IncidentOptions(min_time=60)) == []


# --- collisions ----------------------------------------------------------------------------------------


def collided(reader: Reader) -> list[Any]:
    return list(incidents(reader, IncidentOptions(kinds=["collision"])))


@pytest.mark.parametrize(
    ("hit", "actors", "text"),
    [
        ((2, 1, 0, 1), (1, 2), "hero collides with walker.a (2)"),
        ((2, 1, 0, 0), (1, 2), "hero collides with walker.a (2)"),
        ((3, 1, 0, 1), (1, 3), "hero collides with vehicle.b (3)"),
        ((2, 3, 0, 0), (3, 2), "vehicle.b (3) collides with walker.a (2)"),
        ((4, 2, 0, 0), (2, 4), "walker.a (2) collides with static.prop.c (4)"),
        ((3, 5, 0, 0), (3, 5), "vehicle.b (3) collides with vehicle.d (5)"),
        ((99, 4, 0, 0), (4, 99), "static.prop.c (4) collides with actor 99"),
        ((1, NO_ACTOR, 1, 0), (1,), "hero collides with a static object"),
        ((NO_ACTOR, 3, 0, 0), (3,), "vehicle.b (3) collides with a static object"),
        ((3, 0, 0, 0), (3,), "vehicle.b (3) collides with a static object"),
    ],
)
def test_who_comes_first(make: Make, hit: tuple[int, ...], actors: tuple[int, ...], text: str) -> None:
    (row,) = collided(make({"spawned": CAST}, contact(*hit)))
    assert (row.actors, row.text) == (actors, text)
    assert len(row.type_ids) == len(actors)


def test_an_unknown_position(make: Make) -> None:
    answer = incidents(make({"spawned": CAST}, {"collisions": [(0, 4, 99, 0, 0)]}))
    assert math.isnan(answer[0].x)
    assert stdlib.loads("".join(json_text(answer)))["rows"][0]["x"] is None


def test_nothing_that_touches_nothing(make: Make) -> None:
    assert collided(make({"spawned": CAST}, contact(NO_ACTOR, NO_ACTOR))) == []


def test_only_vehicles_and_walkers_are_blocked(make: Make) -> None:
    still = {"transforms": [pose(id, 100.0 * id, 50.0) for id in (2, 3, 4, 99)]}
    options = IncidentOptions(min_time=2.0, kinds=["collision", "blocked"])
    rows = incidents(make({"spawned": CAST, **still}, *[still] * 9), options)
    assert [(row.actors, row.start) for row in rows] == [((2,), TICK), ((3,), TICK)]
    assert (rows[0].x, rows[0].y, rows[0].z) == (2.0, -0.5, 0.5)
    assert rows[1].text.startswith("vehicle.b (3) stands still for ")
    assert (rows[1].measure, rows[1].value, rows[1].unit) == ("duration", rows[1].stop - rows[1].start, "s")
    assert (rows[1].threshold, rows[1].time) == (2.0, rows[1].stop)


# --- hard braking --------------------------------------------------------------------------------------


def braked(path: Path, *, deceleration: float = 10.0, crash: float = math.inf, kind: int = 1, **hits: Any) -> list[Any]:
    """Return when an actor brakes hard that has 20 m/s for 1 s, slows down then, and stops at once where it crashes."""

    def x(t: float) -> float:
        slowing = min(max(min(t, crash) - 1, 0.0), 20 / deceleration)
        return 20 * min(t, 1.0) + 20 * slowing - deceleration / 2 * slowing * slowing

    type_id = "vehicle.b" if kind == 1 else "walker.a"
    movers = [Mover(3, x, kind=kind, type_id=type_id), straight(9, 0, 500, 0)]
    events = {round(time * RATE): {"collisions": [(0, *pair, 0, 0)]} for pair, time in hits.values()}
    with reading(record(path, movers, 4.0, RATE, events)) as reader:
        return list(incidents(reader, IncidentOptions(kinds=["hard braking"])))


def test_the_stop_that_a_collision_causes_is_part_of_it(tmp_path: Path) -> None:
    assert braked(tmp_path / "crash.log", hit=((3, NO_ACTOR), 1.0), again=((3, NO_ACTOR), 1.05)) == []
    assert len(braked(tmp_path / "others.log", hit=((1, 9), 1.0))) == 1
    assert braked(tmp_path / "walker.log", kind=2) == []
    (row,) = braked(tmp_path / "late.log", hit=((3, 9), 2.0))
    assert row.start < row.stop < 2.0
    assert re.fullmatch(r"vehicle.b \(3\) brakes hard at (69|70|71|72) km/h", row.text)


def test_the_value_of_hard_braking_that_a_collision_ends_is_from_before(tmp_path: Path, suffix: str) -> None:
    (row,) = braked(tmp_path / f"crash{suffix}", deceleration=7.0, crash=2.0, hit=((3, NO_ACTOR), 2.0))
    assert row.value == pytest.approx(7.0, abs=0.1)
    assert row.start <= row.time <= row.stop < 2.0


def test_reports(make: Make) -> None:
    answer = incidents(make({"spawned": CAST}, contact(1, NO_ACTOR)))
    (row,) = stdlib.loads("".join(json_text(answer)))["rows"]
    shown = {name: getattr(answer[0], name) for name in column_names(Incident)}
    expected = shown | {"actors": [1], "type_ids": ["vehicle.audi.tt"]}
    assert row == {name: None if value != value else value for name, value in expected.items()}
    assert "    0.50       0.00 collision    hero collides with a static object\n" in "".join(text(answer))
    table(answer)


# --- values --------------------------------------------------------------------------------------------


def test_the_value_of_a_collision_is_the_speed_of_the_actors_relative_to_each_other(make: Make) -> None:
    before = {"spawned": CAST, "velocities": [(1, 3.0, 0, 0, 0, 0, 0), (2, 0, 4.0, 0, 0, 0, 0)]}
    row, unknown = collided(make(before, contact(1, 2), {}, contact(3, 99)))
    assert (row.measure, row.value, row.unit, row.time) == ("relative_speed", 5.0, "m/s", TICK)
    assert math.isnan(unknown.value)
    assert math.isnan(row.threshold)


# --- near misses ---------------------------------------------------------------------------------------


def test_near_misses(tmp_path: Path, suffix: str, opened: Callable[[Path], Reader]) -> None:
    """Car 5 crosses the path of car 3, 0.4 s after it has left."""
    cars = [straight(3, -20, 0, 10, type_id="vehicle.b"), straight(5, 0, -30, 10, yaw=90, type_id="vehicle.d")]
    reader = opened(record(tmp_path / f"crossing{suffix}", cars, 6.0, RATE, {}))
    (row,) = incidents(reader, IncidentOptions(kinds=["near miss"]))
    assert (row.kind, row.actors, row.type_ids) == ("near miss", (5, 3), ("vehicle.d", "vehicle.b"))
    assert row.text == "vehicle.d (5) crosses the path of vehicle.b (3) 0.4 s after it at 2.70 s, at 36 km/h"
    assert (row.start, row.stop) == (pytest.approx(2.3, abs=0.06), pytest.approx(2.7, abs=0.06))
    assert (row.x, row.y) == (pytest.approx(0.0, abs=1e-6), pytest.approx(-3.0, abs=0.6))
    assert (row.measure, row.unit, row.threshold) == ("post_encroachment_time", "s", 1.0)
    assert (row.value, row.time) == (pytest.approx(0.4, abs=0.05), pytest.approx(2.7, abs=0.06))
    assert list(incidents(reader, IncidentOptions(kinds=kinds_without_roads()))) == [row]
    assert incidents(reader) == []


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("required_deceleration", [-0.1, math.inf, math.nan]),
        ("time_to_collision", [-0.1, 60.1, math.inf, math.nan]),
        ("post_encroachment_time", [-0.1, 60.1, math.inf, math.nan]),
        ("deceleration", [0.0, -1.0, 34.4, math.inf, math.nan]),
        ("min_time", [-1.0, math.nan]),
    ],
)
def test_limits_without_a_sense_are_errors(name: str, values: list[float]) -> None:
    for value in values:
        with pytest.raises(RecapError, match=rf"^{name}\b.*{value:g}"):
            IncidentOptions(**{name: value})


@pytest.mark.parametrize(("actor", "found"), [(None, [(1, 2), (3, 5)]), ("hero", [(1, 2)]), (2, [(1, 2)]), (5, [(3, 5)])])
def test_those_of_an_actor(make: Make, actor: Any, found: list[tuple[int, ...]]) -> None:
    source = make({"spawned": CAST}, contact(1, 2, 1), {}, contact(3, 5))
    assert [each.actors for each in incidents(source, IncidentOptions(kinds=("collision",), actor=actor))] == found


def test_an_actor_that_does_not_exist_is_an_error(make: Make) -> None:
    source = make({"spawned": CAST}, contact(1, 2, 1))
    with pytest.raises(RecapError, match="no actor 77; known ids are 1 \\(hero\\)"):
        incidents(source, IncidentOptions(actor=77))


@pytest.mark.parametrize("name", ["near miss", "near-miss", "near_miss", " Near  miss"])
def test_a_name_has_spaces_hyphens_or_underscores(name: str) -> None:
    assert kind_named(name) is KINDS["near miss"]


def test_all_is_a_word_of_lists_and_other_words_beside_it_are_checked() -> None:
    assert kinds_named(["near miss", "all"]) == kinds_named("all") == KINDS.keys()
    with pytest.raises(RecapError, match="'foo' is no kind"):
        kinds_named(["all", "foo"])


@pytest.mark.parametrize(
    ("given", "kinds"),
    [
        ((), None),
        (("--kinds", "near-miss", "--kinds", "blocked,collision"), {"near miss", "blocked", "collision"}),
        (("--kinds", "near_miss", "--kinds", "all"), KINDS.keys()),
        (("--kinds", "near_miss,all"), KINDS.keys()),
    ],
)
def test_kinds_of_options_that_are_repeated_are_joined(given: tuple[str, ...], kinds: Collection[str] | None) -> None:
    command = cli.get_command(Context(cli), "incidents")
    assert command is not None
    assert command.make_context("incidents", ["run.log", *given]).params["kinds"] == kinds


@pytest.mark.parametrize("name", ["", "near misses", "nearmiss"])
def test_another_name_is_an_error_that_lists_the_kinds(name: str) -> None:
    names = ", ".join(kind.option for kind in KINDS.values())
    with pytest.raises(RecapError, match=f"^{name!r} is no kind of incident; there are {names}$"):
        kind_named(name)


def test_icons_and_colours_are_different() -> None:
    for field in ("dark", "light", "plural", "text"):
        assert len({getattr(kind, field) for kind in KINDS.values()}) == len(KINDS)
    assert len({kind["icon"] for kind in kind_data().values()}) == len(KINDS)
    assert INCIDENT_STYLES.keys() == KINDS.keys()


WARNING = "'Crossing' is unknown; rules of the road are left out; --map or CARLA_RECAP_MAPS says where maps are"


@pytest.fixture
def crossing(monkeypatch):
    """A recording of an unknown map."""
    monkeypatch.delenv("CARLA_RECAP_MAPS", raising=False)
    with closing(open_reader(CROSSING)) as reader:
        yield reader


@pytest.mark.parametrize(
    "ask",
    [
        lambda reader: incidents(reader, IncidentOptions(kinds="all")),
        lambda reader: incidents(reader, IncidentOptions(kinds=["collision", "red light"])),
        measures_on_roads,
    ],
)
def test_what_needs_the_road_is_left_out_with_a_warning(crossing, ask):
    with pytest.warns(RecapWarning, match=WARNING) as caught:
        assert ask(crossing)
    assert len(caught) == 1


def test_kinds_of_the_road_alone_are_an_error(crossing):
    with pytest.raises(RecapError, match="is unknown, but its roads are needed; --map or CARLA_RECAP_MAPS"):
        incidents(crossing, IncidentOptions(kinds=["red light", "speeding"]))


@pytest.mark.parametrize("folder", [True, False])
def test_a_given_folder_without_the_map_is_an_error(crossing, tmp_path, folder):
    with pytest.raises(RecapError, match=r"no \.xodr in" if folder else "is unknown, but its roads are needed"):
        roads_of(crossing, str(tmp_path) if folder else None, needed=not folder)
