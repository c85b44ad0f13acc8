"""Where actors drive: reaching, leaving, staying, the order of places, distances. A hero drives at 10 m/s from x = 0 on."""

from __future__ import annotations

import datetime
import functools
from pathlib import Path

import numpy as np
import pytest

from carla_recap import ActorKind, RecapWarning, Spawn, attributes, create_recording, open_recording
from carla_recap.roads.surfaces import build_network
from carla_recap.rules.places import Lanes, Polygon
from carla_recap.rules.reading import keys_of
from carla_recap.rules.rule_sets import RulesError, check, make_rules, parse_rules
from carla_recap.rules.table import CONDITIONS
from tests.roads.straight_road import STRAIGHT_ROAD
from tests.rules.conftest import HERO, Judge, straight
from tests.samples import SAMPLES
from tests.waiting import time_limit

DRIVE = straight(10, 12)


@pytest.mark.parametrize(
    ("condition", "status", "message"),
    [
        ('reaches = { of = "hero", x = 50, y = 0, within = "5 m" }', "pass", "hero reaches … at 4.55 s"),
        ('reaches = { of = "hero", x = 50, y = 0, within = "5 m", before = "4 s" }', "fail", ": hero reaches it at 4.55 s"),
        ('reaches = { of = "hero", x = 50, y = 20, within = "5 m" }', "fail", "hero is 16.75 m away at 5.00 s, when"),
        ('reaches = { of = "hero", x = 50, y = -1, z = 9, within = "5 m" }', "fail", "hero is 4.03 m away at 5.00 s"),
        ('reaches = { of = "hero", polygon = [[40, -5], [60, -5], [60, 5], [40, 5]] }', "pass", "at 4.00 s"),
        ('reaches = { of = "hero", junction = 9 }', "pass", "the hero reaches junction 9 at 10.00 s"),
        ('reaches = { of = "hero", junction = "any" }', "pass", "the hero reaches junctions at 10.00 s"),
        ('reaches = { of = "hero", lanes = "shoulder" }', "fail", "the shoulder lanes: hero is 1.75 m away at"),
        ('reaches = { of = "hero", lanes = "sidewalk" }', "fail", "the sidewalk lanes: hero is never near it"),
        ('reaches = { of = "hero", road = 7 }', "error", "the map Straight has no road 7"),
        ('reaches = { of = "role:ego", junction = 9 }', "fail", "no actor to reach junction 9 (it has no role:ego)"),
        ('leaves = { of = "hero", x = 50, y = 0, within = "5 m" }', "pass", " at 5.50 s"),
        ('leaves = { of = "hero", x = 50, y = 0, within = "5 m", before = "5 s" }', "fail", "hero leaves it at 5.50 s"),
        ('leaves = { of = "hero", x = 50, y = 0, within = "90 m" }', "fail", "hero is in it to the end at 12.00 s"),
        ('stays_in = { of = "hero", lanes = "driving" }', "pass", "the hero stays in the driving lanes"),
        ('stays_in = { of = "hero", road = [1, 3], lanes = "driving", during = [0, 11] }', "pass", " from 0 s to 11 s"),
        ('stays_in = { of = "hero", road = 1 }', "fail", "hero is outside for 1.95 s at 10.05 s"),
        ('stays_in = { of = "hero", x = 0, y = 0, within = "100 m" }', "fail", "outside for 2.00 s, by up to 20.01 m at"),
        ('stays_in = { of = "hero", road = 1, until = { junction = 9 } }', "pass", " until reaching junction 9"),
        ('stays_out_of = { of = "hero", junction = 9 }', "fail", "hero is in it for 2.00 s at 10.00 s"),
        ('stays_out_of = { of = "role:ego", junction = 9 }', "pass", "no actor to stay out of junction 9 (it has"),
        ('distance = { of = "hero", min = "0.1 km" }', "pass", "the distance of the hero is 0.120 km"),
        ('distance = { of = "hero", max = "100 m" }', "fail", "is not at most 100 m: hero, 120.00 m at 10.05 s"),
        ('distance = { of = "hero", min = 200 }', "fail", "is not at least 200 m: hero, 120.00 m at 12.00 s"),
        ('distance = { of = "hero", min = 79, max = 80.1, during = ["2 s", "10 s"] }', "pass", "is 80.00 m"),
        ('distance = { of = "hero", max = 11, where = { x = 50, y = -1.75, within = 5 } }', "pass", "is 10.00 m"),
        ('distance = { of = "role:ego", min = 1 }', "fail", "no distance of the actor of the role ego was measured"),
    ],
)
def test_a_condition(judge: Judge, condition: str, status: str, message: str) -> None:
    found = judge(condition, DRIVE)
    assert found.status == status
    for part in message.split("…"):
        assert part in found.message


@pytest.mark.parametrize(
    ("places", "status", "message"),
    [
        ('["a", "b"]', "pass", "the hero passes the place a, then the place b before 20 s at 7.00 s"),
        ('["b", "a"]', "fail", "hero does not pass the place a after the place b, but before at 7.00 s"),
        ('["a", "away"]', "fail", "hero does not pass the place away after the place a at 2.00 s"),
        ('["away", "a"]', "fail", "hero does not pass the place away"),
        ('["a", "a", { x = 90, y = 0, within = 3 }]', "pass", "then the place within 3 m of (90, 0)"),
    ],
)
def test_the_order_of_places(judge: Judge, places: str, status: str, message: str) -> None:
    text = f"""
        [places]
        a = {{ polygon = [[20, -5], [30, -5], [30, 5], [20, 5]] }}
        b = {{ polygon = [[70, -5], [80, -5], [80, 5], [70, 5]] }}
        away = {{ x = 0, y = 99, within = 5 }}
        [rules.it]
        passes = {{ of = "hero", places = {places}, before = "20 s" }}
    """
    found = judge(text, DRIVE)
    assert found.status == status
    assert message in found.message


def test_each_of_several_actors_has_to(judge: Judge) -> None:
    ways = DRIVE, straight(10, 12), straight(2, 12)
    found = judge('reaches = { of = "vehicle", x = 50, y = 0, within = "5 m" }', *ways)
    assert found.message == (
        "1 of 3 vehicles does not reach the place within 5 m of (50, 0): vehicle.tesla.model3 (3) is 21.06 m away at "
        "12.00 s, when it is nearest"
    )
    assert (found.time, found.actors) == (pytest.approx(12), (HERO + 2,))
    found = judge('reaches = { x = 20, y = 0, within = "5 m" }', *ways)
    assert found.message.startswith("3 vehicles and walkers reach the place within 5 m of (20, 0), the last at 7.7")


@pytest.mark.parametrize(
    ("step", "speed", "x", "reached"),
    [(0.1, 50.0, 52.5, "at 1.05 s"), (1.0, 90.0, 14.77, ""), (1.0, 90.0, 45.0, ""), (1.0, 90.0, 89.3, "")],
)
def test_a_place_is_reached_between_two_frames(tmp_path: Path, step: float, speed: float, x: float, reached: str) -> None:
    """Frames are 5 m or 90 m apart."""
    times = (step * np.arange(20 if step < 1 else 3)).tolist()
    with open_recording(fast_drive(tmp_path, times, speed)) as recording:
        rule = f"[rules.it]\nreaches = {{ x = {x}, y = 0, within = '30 cm' }}"
        (verdict,) = check(recording, parse_rules(rule, "rules.toml"))
    assert (verdict.status, reached in verdict.message) == ("pass", True)


def test_steps_that_are_too_long_for_places_in_between_are_said(tmp_path: Path) -> None:
    rules = parse_rules("[rules.it]\nreaches = { x = 14.77, y = 0, within = '30 cm' }", "rules.toml")
    said = "hero moves 900 m from 0.00 to 10.00 s; of steps of more than 128 m, some places in between are not judged"
    with open_recording(fast_drive(tmp_path, [0.0, 10.0, 20.0], 90.0)) as recording, pytest.warns(RecapWarning, match=said):
        check(recording, rules)


FAR_APART, TICKS = np.arange(0.0, 21.0, 2.0).tolist(), np.cumsum(np.append(0.0, np.full(200, 0.05))).tolist()


@pytest.mark.parametrize(
    ("times", "rule", "status", "applies"),
    [
        (FAR_APART, 'stays_in = { x = 50, y = 0, within = 5, tolerate = "10 s" }', "fail", True),
        (FAR_APART, 'stays_in = { x = 50, y = 0, within = 5, tolerate = "20 s" }', "pass", True),
        (FAR_APART, 'stays_in = { x = 50, y = 0, within = 5, during = ["3 s", "3.5 s"] }', "pass", False),
        (FAR_APART, "speed = { max = 1 }", "pass", False),  # which has no value
        (FAR_APART, "gap = { max = 1 }", "pass", False),
        (FAR_APART, "gap = { min = 1 }", "pass", True),
        (TICKS, 'duration = { min = "10 s", max = "10 s" }', "pass", True),
        (TICKS, 'speed = { min = 1, for = "0 s" }', "fail", True),
        (TICKS, 'speed = { max = 1, for = "10 s" }', "pass", True),
    ],
)
def test_an_actor_that_stands(tmp_path: Path, times: list[float], rule: str, status: str, applies: bool) -> None:
    with open_recording(fast_drive(tmp_path, times, 0.0)) as recording:
        (verdict,) = check(recording, parse_rules(f"[rules.it]\n{rule}", "rules.toml"))
    assert (verdict.status, verdict.applies) == (status, applies)


def fast_drive(folder: Path, times: list[float], speed: float) -> Path:
    """Write a recording of the hero, which drives along x at a speed in m/s."""
    hero = Spawn(1, ActorKind.VEHICLE, type_id="vehicle.a", attributes=attributes(role_name="hero"))
    with create_recording(folder / "fast.mcap", map_name="Straight") as recorder:
        for time in times:
            transforms = {"id": [1], "x": [100 * speed * time], "y": [0.0], "z": [0.0]}
            recorder.add_frame(time, transforms=transforms, **({} if time else {"spawned": [hero]}))
    return folder / "fast.mcap"


def test_a_jump_is_no_drive(judge: Judge) -> None:
    way = np.concatenate((straight(10, 5), straight(10, 5, x=400)))
    assert judge('distance = { of = "hero", max = "101 m", min = "99 m" }', way).status == "pass"
    assert judge('reaches = { of = "hero", x = 200, y = 0, within = "90 m" }', way).status == "fail"


def test_the_axes_of_a_file_are_those_of_its_places(judge: Judge) -> None:
    for axes, status in (("", "fail"), ('axes = "right-handed"', "fail"), ('axes = "carla"', "pass")):
        circle = f'{axes}\n[rules.it]\nreaches = {{ of = "hero", x = 50, y = 1.75, within = "1 m" }}'
        polygon = f'{axes}\n[rules.it]\nreaches = {{ of = "hero", polygon = [[40, 1], [60, 1], [60, 4], [40, 4]] }}'
        assert judge(circle, DRIVE).status == status
        assert judge(polygon, DRIVE).status == status


def test_incidents_count_within_a_scope(judge: Judge) -> None:
    ways = DRIVE, straight(10, 12, x=4)
    for scope, status in (
        ("", "fail"),
        (', during = ["0 s", "3 s"]', "pass"),
        (', during = ["4 s", "6 s"]', "fail"),
        (", where = { x = 50, y = 0, within = 5 }", "fail"),
        (", where = { junction = 9 }", "pass"),
        (", until = { x = 40, y = 0, within = 5 }", "pass"),
        (", after = { x = 40, y = 0, within = 5 }", "fail"),
    ):
        found = judge(f'collisions = {{ of = "hero", max = 0{scope} }}', *ways, hits={50: HERO + 1})
        assert (scope, found.status) == (scope, status)
    found = judge('distance = { of = "hero", min = 50, until = "collision" }', *ways, hits={50: HERO + 1})
    assert (found.status, found.message) == ("pass", "the distance of the hero until the first collision is 50.00 m")
    found = judge('stays_out_of = { of = "hero", junction = 9, until = "collision" }', *ways, hits={50: HERO + 1})
    assert found.status == "pass"
    assert found.message == "the hero stays out of junction 9 until the first collision"


def test_an_actor_that_is_there_at_no_time_does_not_count(judge: Judge) -> None:
    below = np.column_stack((straight(0, 12), np.full(121, -500.0)))
    found = judge('reaches = { of = "vehicle", x = 50, y = 0, within = "5 m" }', DRIVE, below, straight(10, 12))
    assert found.message.startswith("2 vehicles reach")


def test_rules_from_python_have_axes_and_places() -> None:
    with open_recording(SAMPLES / "junction.mcap") as recording:
        start = recording.trajectory("hero", axes="carla")
        places = {"start": {"x": float(start.x[0]), "y": float(start.y[0]), "within": "1 m"}}
        leaves = {"of": "hero", "place": "start"}
        (found,) = check(recording, make_rules(axes="carla", places=places, leaves=leaves))
    assert found.status == "pass"
    assert found.message.startswith("the hero leaves the place start at ")


def test_conditions_in_words() -> None:
    place = {"junction": 9}
    rules = make_rules(
        places={"a": place},
        reaches={"of": "hero", "before": "20 s", **place},
        leaves={"of": "vehicle", "place": "a"},
        stays_in={"lanes": "driving", "until": "collision", "during": [0, "9 s"], "tolerate": "1 min"},
        stays_out_of={"of": "role:ego", "x": 1, "y": -2.5, "z": 0, "within": "3 m", "after": "a"},
        passes={"of": "walker", "places": ["a", {"polygon": [[0, 0], [1, 0], [1, 1]]}]},
        distance={"of": "hero", "min": "1 km", "where": "a"},
    )
    assert [rule.description for rule in rules] == [
        "the hero reaches junction 9 before 20 s",
        "vehicles leave the place a",
        "vehicles and walkers stay in the driving lanes from 0 s to 9 s until the first collision, except for up to 1 min "
        "at a time",
        "the actor of the role ego stays out of the place within 3 m of (1, -2.5, 0) after reaching the place a",
        "walkers pass the place a, then the polygon of 3 corners",
        "distance of the hero in the place a: at least 1 km",
    ]
    assert [rule.kind for rule in rules] == ["reaches", "leaves", "stays_in", "stays_out_of", "passes", "distance"]


HOLLOW = ((0, 0), (10, 0), (10, 10), (6, 10), (6, 4), (4, 4), (4, 10), (0, 10))


def roads(types):
    return build_network(STRAIGHT_ROAD, "Straight", types)


def test_how_far_points_are_outside_a_polygon():
    points = np.array([(5, 2, 0), (5, 7, 0), (5, 4.5, 99), (1, 9, 0), (-3, -4, 0), (12, 5, 0), (5, 10, 0)], np.float64)
    assert Polygon(HOLLOW).outside(points, roads) == pytest.approx([0, 1, 0.5, 0, 5, 2, 1])
    assert Polygon(HOLLOW[::-1]).outside(points, roads) == pytest.approx([0, 1, 0.5, 0, 5, 2, 1])
    assert Polygon(HOLLOW).area == 88


def test_sides_of_a_polygon_that_cross():
    assert Polygon(HOLLOW).crossing() is None
    assert Polygon(((0, 0), (10, 0), (0, 10), (10, 10))).crossing() == (2, 4)


@pytest.mark.parametrize(
    ("lanes", "outside"),
    [
        (Lanes(types=("driving",)), [0, 0, 0.5, 0, 1.5]),
        (Lanes(types=("shoulder",)), [1.75, 5.25, 0, 10.15, 0.5]),
        (Lanes(types=("driving", "shoulder")), [0, 0, 0, 0, 0.5]),
        (Lanes(roads=("1",)), [0, 0, 0, 10, 0.5]),
        (Lanes(roads=("1", "3")), [0, 0, 0, 0, 0.5]),
        (Lanes(junctions=("9",)), [np.inf, np.inf, np.inf, 0, np.inf]),
        (Lanes(types=("sidewalk",)), [np.inf] * 5),
    ],
)
def test_how_far_points_are_outside_lanes(lanes, outside):
    points = np.array([(50, -1.75, 0), (50, 1.75, 0), (50, -4, 0), (110, -1.75, 0), (50, -5, 0)], np.float64)
    assert lanes.outside(points, roads) == pytest.approx(outside, abs=0.05)


def test_lanes_in_words():
    assert str(Lanes(("driving", "parking"), ("1", "2"))) == "the driving and parking lanes of road 1 or 2"
    assert str(Lanes(junctions=("any",))) == "junctions"


REACHES, DISTANCE, USED, BESIDE = (
    "[rules.it]\nreaches = {}",
    "[rules.it]\ndistance = {{ min = 1, {} }}",
    "{}\n[rules.it]\nreaches = {{ place = 'a' }}\n[rules.other]\nspeed = {{ max = 1 }}",
    "{}\n[rules.it]\nframes = {{ min = 1 }}",
)


@pytest.mark.parametrize(
    ("form", "value", "fault"),
    [
        (REACHES, "{}", "reaches: expected place, or x, y and within, or polygon, "),
        (REACHES, "{ x = 1, y = 2 }", "reaches.within: is missing; x, y and within make a place"),
        (REACHES, "{ x = 1, y = 2, within = 0 }", "reaches.within: expected a distance above 0, found 0"),
        (REACHES, "{ x = 1, y = 2, within = '3 s' }", "reaches.within: expected a number in m, or a text"),
        (REACHES, "{ x = nan, y = 2, within = 1 }", "reaches.x: expected a number in m, or a text"),
        (REACHES, "{ x = 1, y = 2, within = 1, before = '-3 s' }", "reaches.before: expected a time of 0 or more, "),
        (REACHES, "{ x = 1, y = 2, within = 1, road = 3 }", "reaches: expected place, or x, y and within, or polygon, "),
        (REACHES, "{ place = 'nowhere' }", "reaches.place: expected the name of a table [places.NAME], found 'nowhere'"),
        (REACHES, "{ wihtin = 3 }", "unknown key 'wihtin'; did you mean within? The keys are of, place, "),
        (REACHES, "{ polygon = [[0, 0], [1, 1]] }", "reaches.polygon: expected a list of 3 to 1000 points [x, y] in m"),
        (REACHES, "{ polygon = [[0, 0], [1, 0], [1, 1e300]] }", "expected a list of 3 to 1000 points [x, y] in m"),
        (REACHES, "{ polygon = [[0, 0], [1, 0], [2, 0]] }", "reaches.polygon: expected a polygon around an area"),
        (REACHES, "{ polygon = [[0, 0], [9, 0], [0, 9], [9, 9]] }", "a polygon that does not cross itself, found sides 2"),
        (REACHES, "{ lanes = 'drivng' }", "reaches.lanes: expected one or a list of driving, entry, "),
        (REACHES, "{ road = 1.5 }", "reaches.road: expected an id in the map, or a list of ids, found 1.5"),
        (BESIDE, "axes = 'left'", "axes: expected one of right-handed, carla, found 'left'"),
        (BESIDE, "places = 3", "places: expected tables of the form [places.NAME], found 3"),
        (USED, "[places]\na = 3", "place 'a': expected a table, as [places.NAME], found 3"),
        (USED, "[places.a]\nx = 1", "place 'a'.y: is missing; x, y and within make a place"),
        (USED, "[places.a]\nz = []", "place 'a'.z: expected a number in m, or "),
        (USED, "[places.a]\nplace = 'b'", "place 'a'.place: expected the name of a table [places.NAME], found 'b'"),
        (BESIDE, "[places.near-miss]\nroad = 1", "place 'near-miss': expected a name that is no kind of incidents, found"),
        (DISTANCE, "during = ['9 s', '2 s']", "during: expected two times in their order"),
        (DISTANCE, "during = [-1, 2]", "during: expected a time of 0 or more, found [-1, 2]"),
        (DISTANCE, "during = '3 s'", "during: expected two times in their order"),
        (DISTANCE, "until = 'crash'", "until: expected one of collision, red-light, wrong-way, "),
        (DISTANCE, "after = 3", "after: expected the name of a table [places.NAME], found 3"),
        (DISTANCE, "where = { x = 3 }", "where.y: is missing; x, y and within make a place"),
        (DISTANCE, "where = 'here'", "where: expected the name of a table [places.NAME], found 'here'"),
    ],
)
def test_a_wrong_place_or_scope_is_a_fault_in_one_line(form, value, fault):
    with pytest.raises(RulesError) as caught:
        parse_rules(form.format(value), "rules.toml")
    line, *others = caught.value.faults
    assert fault in line
    assert line.startswith("rules.toml: ")
    assert len(others) == fault.startswith("place 'a': ")


def test_a_polygon_of_many_points_is_refused_at_once():
    points = [[float(index), 0.0] for index in range(100_000)]
    with time_limit(), pytest.raises(RulesError) as caught:
        make_rules(reaches={"of": "hero", "polygon": points})
    assert "expected a list of 3 to 1000 points [x, y] in m" in str(caught.value)
    assert len(str(caught.value)) < 400


DEEP = functools.reduce(lambda inner, _: [inner], range(5000), [])
ODD = (
    [],
    {},
    float("nan"),
    -1,
    "",
    "x" * 100_000,
    True,
    datetime.date(2026, 1, 1),
    10**400,
    DEEP,
    {1: 2},
    {"\x1b": 3},
    "\0:a",
)


@pytest.mark.parametrize("kind", CONDITIONS.values(), ids=CONDITIONS)
def test_whatever_the_value_of_a_key_the_faults_are_a_line_each(kind):
    for value in (*ODD, *({key.name: value} for key in keys_of(kind.parts) for value in ODD)):
        try:
            make_rules(**{kind.name: value})
        except RulesError as error:
            for fault in error.faults:
                assert fault.startswith(f"rules: rule '{kind.name}': {kind.name}")
                assert fault.isprintable()
                assert len(fault) < 500
