"""What OpenDRIVE files say: the course of roads by formulas, and sections, borders and heights by station."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from carla_recap.roads.opendrive import Profile, borders_at, in_metres_per_second, read_opendrive, sparse_sections

if TYPE_CHECKING:
    from carla_recap.roads.opendrive import Road

X, Y, HEADING = 7.0, -3.0, 0.6
ONE_LANE = (
    '<laneSection s="0"><center><lane id="0" type="none"/></center>'
    '<right><lane id="-1" type="driving"><width sOffset="0" a="3" b="0" c="0" d="0"/></lane></right></laneSection>'
)


def road_of(course: str, length: float = 40.0, lanes: str = ONE_LANE, profiles: str = "") -> Road:
    """Return a road with a reference line, given as the pieces in its geometry elements, which are equally long."""
    pieces = course.split("|")
    part = length / len(pieces)
    plan = "".join(
        f'<geometry s="{number * part}" x="{X}" y="{Y}" hdg="{HEADING}" length="{part}">{piece}</geometry>'
        for number, piece in enumerate(pieces)
    )
    (road,) = read_opendrive(
        f'<OpenDRIVE><road id="1" length="{length}" junction="-1"><planView>{plan}</planView>{profiles}'
        f"<lanes>{lanes}</lanes></road></OpenDRIVE>"
    ).roads
    return road


def along(road: Road) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return stations, and the points there from the start of the road, along and to the left of its first heading."""
    stations = np.linspace(0, road.length, 401)
    points, headings = road.reference(stations)
    dx, dy = points[:, 0] - X, points[:, 1] - Y
    cos, sin = math.cos(HEADING), math.sin(HEADING)
    return stations, np.stack((dx * cos + dy * sin, dy * cos - dx * sin)), headings - HEADING


def test_a_line() -> None:
    stations, (u, v), turns = along(road_of("<line/>"))
    assert u == pytest.approx(stations)
    assert v == pytest.approx(0, abs=1e-9)
    assert turns == pytest.approx(0)


@pytest.mark.parametrize("curvature", [0.05, -0.05])
def test_an_arc(curvature: float) -> None:
    stations, (u, v), turns = along(road_of(f'<arc curvature="{curvature}"/>'))
    assert u == pytest.approx(np.sin(stations * curvature) / curvature)
    assert v == pytest.approx((1 - np.cos(stations * curvature)) / curvature)
    assert turns == pytest.approx(stations * curvature)


@pytest.mark.parametrize(("first", "last"), [(0.0, 0.05), (0.05, -0.02), (-0.03, -0.03)])
def test_a_spiral(first: float, last: float) -> None:
    stations, points, turns = along(road_of(f'<spiral curvStart="{first}" curvEnd="{last}"/>'))
    assert turns == pytest.approx(first * stations + (last - first) * stations**2 / 80)
    directions = np.stack((np.cos(turns), np.sin(turns)))
    course = np.cumsum((directions[:, 1:] + directions[:, :-1]) / 2, axis=1) * 0.1
    assert points[:, 1:] == pytest.approx(course, abs=2e-3)


def test_a_cubic() -> None:
    stations, (u, v), turns = along(road_of('<poly3 a="0.5" b="0.1" c="-0.02" d="0.0004"/>'))
    assert v == pytest.approx(0.5 + 0.1 * u - 0.02 * u**2 + 0.0004 * u**3)
    assert np.tan(turns) == pytest.approx(0.1 - 0.04 * u + 0.0012 * u**2)
    inside = u[1:] < 39  # its argument ends where the road does
    assert np.hypot(np.diff(u), np.diff(v))[inside] == pytest.approx(np.diff(stations)[inside], abs=1e-4)


@pytest.mark.parametrize(("given", "scale"), [("arcLength", 1.0), ("normalized", 40.0)])
def test_a_parametric_cubic(given: str, scale: float) -> None:
    factors = {"aU": 0.5, "bU": 0.9, "cU": 0.01, "dU": -0.0001, "aV": -0.5, "bV": 0.2, "cV": -0.01, "dV": 0.0002}
    written = " ".join(f'{name}="{value * scale ** "abcd".index(name[0])}"' for name, value in factors.items())
    p, (u, v), turns = along(road_of(f'<paramPoly3 pRange="{given}" {written}/>'))
    assert u == pytest.approx(0.5 + 0.9 * p + 0.01 * p**2 - 0.0001 * p**3)
    assert v == pytest.approx(-0.5 + 0.2 * p - 0.01 * p**2 + 0.0002 * p**3)
    assert np.tan(turns) == pytest.approx((0.2 - 0.02 * p + 0.0006 * p**2) / (0.9 + 0.02 * p - 0.0003 * p**2))


def test_a_piece_begins_at_its_station() -> None:
    _, (u, _), turns = along(road_of('<line/>|<arc curvature="0.01"/>'))
    assert u[[0, 199, 200]] == pytest.approx([0, 19.9, 0])
    assert turns[[199, 200, 300]] == pytest.approx([0, 0, 0.1])


def test_a_profile_is_a_cubic_from_each_of_its_stations() -> None:
    profile = Profile([(10.0, (1.0, 2.0, 3.0, 4.0)), (0.0, (5.0, -1.0, 0.5, -0.25))])
    stations = np.array([-1.0, 0.0, 2.0, 9.999, 10.0, 11.0, 12.0])
    s, t = stations[:4], stations[4:] - 10
    assert profile(stations) == pytest.approx([*(5 - s + 0.5 * s**2 - 0.25 * s**3), *(1 + 2 * t + 3 * t**2 + 4 * t**3)])
    assert profile.slope(stations) == pytest.approx([*(-1 + s - 0.75 * s**2), *(2 + 6 * t + 12 * t**2)])
    assert Profile([])(stations).tolist() == Profile([]).slope(stations).tolist() == [0] * 7


def test_borders_are_to_the_left_and_right_of_the_shifted_middle() -> None:
    def lane(id: int, width: float, more: float = 0.0) -> str:
        return f'<lane id="{id}" type="driving"><width sOffset="0" a="{width}" b="{more}" c="0" d="0"/></lane>'

    lanes = (
        '<laneOffset s="0" a="0.5" b="0" c="0" d="0"/><laneSection s="0"><center><lane id="0"/></center></laneSection>'
        f'<laneSection s="10"><left>{lane(2, 1)}{lane(1, 3)}</left><center><lane id="0"/></center>'
        f"<right>{lane(-1, 4, 0.1)}{lane(-2, 2)}</right></laneSection>"
    )
    road = road_of("<line/>", lanes=lanes)
    first, section = road.sections
    assert (first.start, first.end, section.start, section.end) == (0, 10, 10, 40)
    assert [lane.id for lane in section.lanes] == [2, 1, -1, -2]
    borders = borders_at(road, section, np.array([10.0, 20.0]))
    assert borders.offsets[:, 0] == pytest.approx([4.5, 3.5, 0.5, -3.5, -5.5])
    assert borders.offsets[:, 1] == pytest.approx([4.5, 3.5, 0.5, -4.5, -6.5])
    left = np.array((-math.sin(HEADING), math.cos(HEADING)))
    middle = np.array((X + 20 * math.cos(HEADING), Y + 20 * math.sin(HEADING)))
    assert borders.points[0, 1, :2] == pytest.approx(middle + 4.5 * left)
    assert borders.points[-1, 1, :2] == pytest.approx(middle - 6.5 * left)


def test_a_point_beside_a_road_is_to_the_left_of_its_heading() -> None:
    road = road_of("<line/>", profiles='<elevationProfile><elevation s="10" a="2" b="0.5" c="0" d="0"/></elevationProfile>')
    point, heading = road.at(20, 3)
    cos, sin = math.cos(HEADING), math.sin(HEADING)
    assert (*point, heading) == pytest.approx((X + 20 * cos - 3 * sin, Y + 20 * sin + 3 * cos, 7, HEADING))
    assert road.at(-5, 0)[0][:2] == pytest.approx((X, Y))
    assert road.at(99, 0)[0][:2] == pytest.approx((X + 40 * cos, Y + 40 * sin))


def test_few_points_of_a_road_are_near_its_course() -> None:
    straight, bent = road_of("<line/>"), road_of('<arc curvature="0.05"/>')
    few, stations = (part.stations for part in sparse_sections((straight, bent), 1.0, 1000, 1000))
    assert len(few) == 5  # 12 m apart at most
    sagitta = np.diff(stations) ** 2 * (0.05 / (1 - 3 * 0.05)) / 8
    assert 0.008 < sagitta.max() < 0.04
    assert (stations[0], stations[-1]) == pytest.approx((0, 40), abs=0.1)


def test_many_roads_have_fewer_points_each() -> None:
    bent = road_of('<arc curvature="0.05"/>')
    parts = sparse_sections([bent] * 20, 1.0, 1000, 100)
    assert sum(len(part.stations) - 1 for part in parts) <= 100
    assert all((part.stations[0], part.stations[-1]) == pytest.approx((0, 40), abs=0.1) for part in parts)


@pytest.mark.parametrize(
    ("value", "unit", "limit"),
    [
        ("36", "km/h", 10),
        ("10", "m/s", 10),
        ("10", None, 10),
        ("10", "mph", 4.4704),
        ("undefined", "km/h", None),
        ("", "km/h", None),
        (None, None, None),
        ("nan", None, None),
        ("-5", None, None),
        ("0", None, None),
    ],
)
def test_limits_have_units(value: str | None, unit: str | None, limit: float | None) -> None:
    assert in_metres_per_second(value, unit) == (None if limit is None else pytest.approx(limit))


@pytest.mark.parametrize(("length", "count"), [("", 0), ('length="x"', 0), ('length="0.01"', 0), ('length="0.02"', 1)])
def test_a_road_has_a_length(length: str, count: int) -> None:
    geometry = '<geometry s="0" x="0" y="0" hdg="0" length="9"><line/></geometry>'
    road = f'<road id="1" {length}><planView>{geometry}</planView><lanes>{ONE_LANE}</lanes></road>'
    assert len(read_opendrive(f"<OpenDRIVE>{road}</OpenDRIVE>").roads) == count
