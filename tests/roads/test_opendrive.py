"""What OpenDRIVE files say: the course of roads by formulas, and sections, borders and heights by station."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np
import pytest

from carla_recap.errors import RecapWarning
from carla_recap.roads.curves import Profile
from carla_recap.roads.landmarks import find_landmarks
from carla_recap.roads.lanes import TownRoads
from carla_recap.roads.opendrive import (
    borders_at,
    in_metres_per_second,
    read_opendrive,
    road_number,
    sparse_sections,
    whole_number,
)
from tests.roads.towns import crossing, lane, opendrive, section
from tests.roads.towns import road as written_road
from tests.waiting import time_limit

if TYPE_CHECKING:
    from carla_recap.roads.opendrive import Road

X, Y, HEADING = 7.0, -3.0, 0.6
ONE_LANE = section(0, right=lane(-1, 3))


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


def test_a_profile_is_a_cubic_from_each_of_its_stations() -> None:
    profile = Profile([(10.0, (1.0, 2.0, 3.0, 4.0)), (0.0, (5.0, -1.0, 0.5, -0.25))])
    stations = np.array([-1.0, 0.0, 2.0, 9.999, 10.0, 11.0, 12.0])
    s, t = stations[:4], stations[4:] - 10
    assert profile(stations) == pytest.approx([*(5 - s + 0.5 * s**2 - 0.25 * s**3), *(1 + 2 * t + 3 * t**2 + 4 * t**3)])
    assert profile.slope(stations) == pytest.approx([*(-1 + s - 0.75 * s**2), *(2 + 6 * t + 12 * t**2)])
    assert Profile([])(stations).tolist() == Profile([]).slope(stations).tolist() == [0] * 7


def test_borders_are_to_the_left_and_right_of_the_shifted_middle() -> None:
    right = lane(-1, 4).replace('b="0"', 'b="0.1"') + lane(-2, 2)
    sections = section(0) + section(10, lane(2, 1) + lane(1, 3), right)
    road = road_of("<line/>", lanes=f'<laneOffset s="0" a="0.5" b="0" c="0" d="0"/>{sections}')
    first, second = road.sections
    assert (first.start, first.end, second.start, second.end) == (0, 10, 10, 40)
    assert [lane.id for lane in second.lanes] == [2, 1, -1, -2]
    borders = borders_at(road, second, np.array([10.0, 20.0]))
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
    with pytest.warns(RecapWarning, match="the lanes have 100 straight parts"):
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
        (None, None, None),
        ("-5", None, None),
    ],
)
def test_limits_have_units(value: str | None, unit: str | None, limit: float | None) -> None:
    assert in_metres_per_second(value, unit) == (None if limit is None else pytest.approx(limit))


@pytest.mark.parametrize(("length", "count"), [("", 0), ('length="x"', 0), ('length="0.01"', 0), ('length="0.02"', 1)])
def test_a_road_has_a_length(length: str, count: int) -> None:
    geometry = '<geometry s="0" x="0" y="0" hdg="0" length="9"><line/></geometry>'
    road = f'<road id="1" {length}><planView>{geometry}</planView><lanes>{ONE_LANE}</lanes></road>'
    assert len(read_opendrive(f"<OpenDRIVE>{road}</OpenDRIVE>").roads) == count


# --- attributes as CARLA's library reads them ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "number"), [("12.5", 12.5), (" 2 m", 2.0), ("3abc", 3.0), ("-.5e1x", -5.0), ("abc", 0.0), ("", 0.0)]
)
def test_a_number_is_what_a_text_begins_with(text: str, number: float) -> None:
    road = road_of(f'<line/><arc curvature="0"/></geometry><geometry s="{text}" x="{text}" y="0" hdg="0" length="1"><line/>')
    assert [curve.x for curve in road.curves if curve.x != X] == [number]


@pytest.mark.parametrize(
    ("text", "road", "other"),
    [
        ("7", 7, 7),
        ("Junction4", 0, 0),
        ("4b", 4, 4),
        ("", 0, 0),
        ("-5", 0, -5),
        ("4294967295", 4294967295, 2147483647),
        ("9" * 5000, 4294967295, 2147483647),
        ("٣", 0, 0),
    ],
)
def test_an_id_is_the_whole_number_that_a_text_begins_with(text: str, road: int, other: int) -> None:
    assert (road_number(text), whole_number(text)) == (road, other)


@pytest.mark.parametrize("begin", ["\n", "<!-- licence -->\n", "<!-- a --><!-- b -->\n <!-- c -->", "<!------------>"])
def test_a_declaration_may_follow_comments(begin: str) -> None:
    assert read_opendrive(f'{begin}<?xml version="1.0"?><OpenDRIVE/>').roads == []


def test_comments_without_a_declaration_cost_no_time() -> None:
    with time_limit():
        assert read_opendrive("<!-- a -->" * 30_000 + "<OpenDRIVE/>").roads == []


def joined(id: int, junction: str, link: str, x: float, inside: str = "", shape: str = "<line/>") -> str:
    """A road of 50 m with a lane on each side that goes on from and to those of other roads."""
    lanes = (
        lane(number).replace(
            "</lane>",
            f'<link><predecessor id="{number}"/><successor id="{number}"/></link><speed sOffset="0" max="40" unit="km/h"/>'
            '<roadMark sOffset="0" type="solid" weight="bold" color="yellow" width="0.1" laneChange="none"/></lane>',
        )
        for number in (1, -1)
    )
    parts = '<laneOffset s="0" a="0.1" b="0" c="0" d="0"/>' + section(0, *lanes)
    whole = written_road(id, x=x, length=50, sections=parts, inside=inside, shape=shape)
    whole = whole.replace('junction="-1"', f'junction="{junction}" rule="RHT"')
    return whole.replace(
        "<planView>", f'<link>{link}</link><type s="0" type="town"><speed max="9" unit="mph"/></type><planView>'
    )


def follows(road: int, end: str, other: str, kind: str = "road") -> str:
    return (
        f'<{"predecessor" if end == "end" else "successor"} elementType="{kind}" elementId="{other}" contactPoint="{end}"/>'
    )


def three_roads(junction: str) -> str:
    """Three roads in a row, the one in the middle in a junction."""
    sign = (
        '<signal id="3" s="40" t="-4" zOffset="1" hOffset="0" orientation="+" type="274" value="30" unit="km/h">'
        '<validity fromLane="-1" toLane="-1"/></signal><signalReference id="3" s="5" t="0" orientation="-"/>'
    )
    thing = (
        '<object id="4" name="Speed_30" s="9" t="-4" zOffset="0" hdg="0" orientation="-" type="-1" width="1" length="1"/>'
    )
    inside = crossing(20).replace("</objects>", f"{thing}</objects>") + f"<signals>{sign}</signals>"
    through = follows(2, "end", "1") + follows(2, "start", "3")
    cubic = '<paramPoly3 pRange="normalized" aU="0" bU="50" cU="0" dU="0" aV="0" bV="0" cV="1" dV="0"/>'
    return opendrive(
        joined(1, "-1", follows(1, "start", junction, "junction"), 0, inside, '<arc curvature="0.001"/>'),
        joined(2, junction, through, 50, shape='<spiral curvStart="0.001" curvEnd="0.002"/>'),
        joined(3, "-1", follows(3, "end", junction, "junction"), 100, shape=cubic),
        f'<junction name="" id="{junction}"><connection id="0" incomingRoad="1" connectingRoad="2" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection><priority high="1" low="2"/></junction>'
        '<controller id="8" sequence="1"><control signalId="3" type=""/></controller>',
    )


def test_ids_may_be_texts() -> None:
    carla = pytest.importorskip("carla")
    text = three_roads("Junction4")
    roads = TownRoads(read_opendrive(text))
    pairs = {(lane.road, following) for lane in roads.lanes for following, _, _ in lane.successors}
    assert {(1, 2), (2, 3)} <= pairs
    assert {lane.junction for lane in roads.lanes if lane.road == 2} == {0}
    assert pairs <= {(one.road_id, two.road_id) for one, two in carla.Map("", text).get_topology()}


EVERYTHING = three_roads("7")
NO_NUMBERS = ("nan", "inf", "-inf", "1e300", "9" * 400)


@pytest.mark.parametrize("value", ["text", "", "-3", "0x10", "1_0", *NO_NUMBERS])
def test_any_value_of_any_attribute_is_read_or_refused_in_a_line(value: str) -> None:
    tag, places = "", {}
    for found in re.finditer(r'<(\w+)|(\w+)="([^"]*)"', EVERYTHING):
        tag = found[1] or tag
        places[tag, found[2]] = found
    assert len(places) > 100
    for found in (found for (_, name), found in places.items() if name):
        text = EVERYTHING[: found.start(3)] + value + EVERYTHING[found.end(3) :]
        message = refusal(text)
        assert message == "" or value in (*NO_NUMBERS, "-3", "1_0")
        assert message == "" or re.fullmatch(r"(road|junction|controller) '.*': [a-zA-Z0-9]+: .*expected .*", message)


def refusal(text: str) -> str:
    """Return why a map is refused; nothing if it is read."""
    try:
        with np.errstate(all="ignore"):
            roads = TownRoads(read_opendrive(text))
            assert (roads.lanes, find_landmarks(roads), roads.crossings) is not None
    except ValueError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("text", "is_part"), [("-1", False), (" -1", False), ("-1.0", False), ("-01", False), ("0", True)])
def test_a_road_is_part_of_a_junction_by_its_number(text: str, is_part: bool) -> None:
    town = read_opendrive(opendrive(written_road().replace('junction="-1"', f'junction="{text}"')))
    assert [each.in_junction for each in town.roads] == [is_part]
