"""Places: circles, polygons, lanes; wrong ones are faults of the file."""

from __future__ import annotations

import datetime
import functools

import numpy as np
import pytest

from carla_recap.roads.surfaces import build_network
from carla_recap.rules.places import Lanes, Polygon
from carla_recap.rules.reading import keys_of
from carla_recap.rules.rule_sets import RulesError, make_rules, parse_rules
from carla_recap.rules.table import CONDITIONS
from tests.roads.straight_road import STRAIGHT_ROAD
from tests.waiting import time_limit

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


@pytest.mark.parametrize(
    ("place", "fault"),
    [
        ("{}", "reaches: expected place, or x, y and within, or polygon, or lanes, road and junction, found no place"),
        ("{ x = 1, y = 2 }", "reaches.within: is missing; x, y and within make a place"),
        ("{ x = 1, y = 2, within = 0 }", "reaches.within: expected a distance above 0, found 0"),
        ("{ x = 1, y = 2, within = '3 s' }", "reaches.within: expected a number in m, or a text"),
        ("{ x = nan, y = 2, within = 1 }", "reaches.x: expected a number in m, or a text"),
        ("{ x = 1, y = 2, within = 1, before = '-3 s' }", "reaches.before: expected a time of 0 or more, found '-3 s'"),
        ("{ x = 1, y = 2, within = 1, road = 3 }", "reaches: expected place, or x, y and within, or polygon, "),
        ("{ place = 'nowhere' }", "reaches.place: expected the name of a table [places.NAME], found 'nowhere'"),
        ("{ wihtin = 3 }", "unknown key 'wihtin'; did you mean within? The keys are of, place, x, y, z, within, polygon, "),
        ("{ polygon = [[0, 0], [1, 1]] }", "reaches.polygon: expected a list of 3 to 1000 points [x, y] in m"),
        ("{ polygon = [[0, 0], [1, 0], [1, 1e300]] }", "expected a list of 3 to 1000 points [x, y] in m"),
        ("{ polygon = [[0, 0], [1, 0], [2, 0]] }", "reaches.polygon: expected a polygon around an area, found none"),
        ("{ polygon = [[0, 0], [9, 0], [0, 9], [9, 9]] }", "expected a polygon that does not cross itself, found sides 2"),
        ("{ lanes = 'drivng' }", "reaches.lanes: expected one or a list of driving, entry, "),
        ("{ road = 1.5 }", "reaches.road: expected an id in the map, or a list of ids, found 1.5"),
    ],
)
def test_a_wrong_place_is_a_fault_in_one_line(place, fault):
    with pytest.raises(RulesError) as caught:
        parse_rules(f"[rules.it]\nreaches = {place}", "rules.toml")
    (line,) = caught.value.faults
    assert fault in line
    assert line.startswith("rules.toml: rule 'it': reaches")


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("axes = 'left'", "axes: expected one of right-handed, carla, found 'left'"),
        ("places = 3", "places: expected tables of the form [places.NAME], found 3"),
        ("[places]\na = 3", "place 'a': expected a table, as [places.NAME], found 3"),
        ("[places.a]\nx = 1", "place 'a'.y: is missing; x, y and within make a place"),
        ("[places.a]\nz = []", "place 'a'.z: expected a number in m, or "),
        ("[places.a]\nplace = 'b'", "place 'a'.place: expected the name of a table [places.NAME], found 'b'"),
        ("[places.near-miss]\nroad = 1", "place 'near-miss': expected a name that is no kind of incidents, found"),
    ],
)
def test_a_wrong_place_with_a_name_is_one_fault_wherever_it_is_used(text, fault):
    rules = (
        "[rules.it]\nreaches = { place = 'a' }\n[rules.other]\nspeed = { max = 1 }"
        if "'a'" in fault
        else "[rules.it]\nframes = { min = 1 }"
    )
    with pytest.raises(RulesError) as caught:
        parse_rules(f"{text}\n{rules}", "rules.toml")
    assert fault in caught.value.faults[0]
    assert len(caught.value.faults) == 1 + fault.startswith("place 'a': ")


@pytest.mark.parametrize(
    ("scope", "fault"),
    [
        ("during = ['9 s', '2 s']", 'during: expected two times in their order, such as ["10 s", "20 s"], found [\'9'),
        ("during = [-1, 2]", "during: expected a time of 0 or more, found [-1, 2]"),
        ("during = '3 s'", "during: expected two times in their order"),
        ("until = 'crash'", "until: expected one of collision, red-light, wrong-way, "),
        ("after = 3", "after: expected the name of a table [places.NAME], found 3"),
        ("where = { x = 3 }", "where.y: is missing; x, y and within make a place"),
        ("where = 'here'", "where: expected the name of a table [places.NAME], found 'here'"),
    ],
)
def test_a_wrong_scope_is_a_fault(scope, fault):
    with pytest.raises(RulesError) as caught:
        parse_rules(f"[rules.it]\ndistance = {{ min = 1, {scope} }}", "rules.toml")
    (line,) = caught.value.faults
    assert f"rule 'it': distance.{fault}" in line


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
