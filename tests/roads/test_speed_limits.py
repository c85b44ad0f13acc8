from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.recording import open_recording
from carla_recap.roads.surfaces import build_network
from tests.roads.towns import lane, opendrive, road, section, town
from tests.samples import carla_log
from tests.twins.speed_limits import Said, limit_at

KMH = 3.6
SIDES = {"+": 1, "-": -1}
"""The side of the road for which CARLA takes a sign that is an object, by its orientation."""


def thing(name: str, station: float, orientation: str = "-", id: int = 5) -> str:
    return (
        f'<object id="{id}" name="{name}" type="-1" s="{station}" t="-4" zOffset="0" hdg="0" pitch="0" roll="0"'
        f' orientation="{orientation}" width="0" length="0" height="0"/>'
    )


def signal(value: str, station: float, orientation: str = "+", id: int = 6) -> str:
    return f'<signal id="{id}" s="{station}" t="-4" type="274" orientation="{orientation}" value="{value}"/>'


def straight(*, objects: str = "", signals: str = "", types: str = "", left: str = "", right: str = "") -> str:
    """A road of 100 m along x with a lane on each side, of which each may have records of speeds."""
    lanes = (lane(id).replace("</lane>", f"{speeds}</lane>") for id, speeds in ((1, left), (-1, right)))
    inside = f"<objects>{objects}</objects><signals>{signals}</signals>"
    return opendrive(road(sections=section(0, *lanes), inside=inside).replace("<planView>", f"{types}<planView>"))


def offline(text: str, stations: list[float], *, is_left: bool = False) -> list[float]:
    """What queries take for the limits at stations, in km/h."""
    points = np.array([(station, 1.75 if is_left else -1.75) for station in stations])
    limits: list[float] = np.round(build_network(text).lanes_at(points).limit * KMH, 6).tolist()
    return limits


def served(text: str, stations: list[float], *, is_left: bool = False) -> list[float]:
    """What the simulator takes for them."""
    loading = pytest.importorskip("carla_recap.sim.town.loading")
    place = loading.make_town(text, Path("map.xodr"))
    index = next(one.index for one in place.lanes if (one.lane_id > 0) == is_left)
    s = [100 - station if is_left else station for station in stations]
    limits: list[float] = np.round(place.index.limit(np.full(len(s), index), np.array(s)) * KMH, 6).tolist()
    return limits


@pytest.mark.parametrize(
    ("name", "limit"),
    [
        ("Speed_90", 90),
        ("speed_90", 90),
        ("Speed_STATIC_40", 40),
        ("Speed_4.5", 4.5),
        ("Speed_30 (2)", 30),
        ("SPEED_90", None),
        ("Sign_Speed_90", None),
        ("Speed_", None),
    ],
)
def test_objects_with_the_names_of_carla_are_signs_in_kilometres_per_hour(name: str, limit: float | None) -> None:
    text = straight(objects=thing(name, 50))
    assert offline(text, [45, 55]) == pytest.approx([np.nan, np.nan if limit is None else limit], nan_ok=True)
    assert served(text, [45, 55]) == [30, limit or 30]


@pytest.mark.parametrize(
    ("lanes", "left", "right"), [((-2, -1), 50, 72), ((1, 2), 72, 50), ((-1, 1), 72, 72), ((2, 9), 50, 50)]
)
def test_a_sign_is_for_the_range_of_its_lanes(lanes: tuple[int, int], left: int, right: int) -> None:
    validity = f'><validity fromLane="{lanes[1]}" toLane="{lanes[0]}"/></signal>'
    types = '<type s="0"><speed max="50" unit="km/h"/></type>'
    text = straight(signals=signal("72", 50).replace("/>", validity), types=types)
    found = offline(text, [40], is_left=True), offline(text, [60])
    assert found == ([left], [right]) == (served(text, [40], is_left=True), served(text, [60]))


def test_the_value_of_a_sign_is_in_kilometres_per_hour_whatever_its_unit_says() -> None:
    text = straight(signals=signal("55", 50).replace("/>", ' unit="mph"/>'))
    assert offline(text, [55]) == served(text, [55]) == [55]


def test_a_reference_to_a_sign_of_another_road_applies() -> None:
    reference = '<signalReference id="6" s="30" t="0" orientation="+"/>'
    far = road(id=2, y=50, inside=f"<signals>{signal('70', 10)}</signals>")
    text = straight(signals=reference).replace("</OpenDRIVE>", f"{far}</OpenDRIVE>")
    assert offline(text, [35]) == served(text, [35]) == [70]


def test_the_signs_of_town01_are_those_that_carla_records() -> None:
    loading = pytest.importorskip("carla_recap.sim.town.loading")
    world = pytest.importorskip("carla_recap.sim.world").World(loading.load_town(town("Town01")))
    served = [(one.type_id, one.transform.location) for one in world.actors.values() if "speed_limit" in one.type_id]
    with open_recording(carla_log("carla-0.9.13-lane-center.log")) as recording:
        recorded = [one.spawn for one in recording.actors.values() if "speed_limit" in one.type_id]
    assert len(recorded) == 21
    for sign in recorded:
        _, type_id = min((np.hypot(place.x - sign.x / 100, place.y - sign.y / 100), kind) for kind, place in served)
        assert type_id == sign.type_id
    assert {kind for kind, _ in served} == {sign.type_id for sign in recorded}


SIGNS = st.lists(
    st.tuples(
        st.sampled_from(("Speed_", "speed_", "Speed_STATIC_", "signal")),
        st.integers(0, 100),
        st.sampled_from(("+", "-", "none")),
        st.integers(5, 130),
    ),
    max_size=4,
    unique_by=lambda sign: sign[1],
)
RECORDS = st.lists(
    st.tuples(st.integers(0, 99), st.one_of(st.none(), st.integers(5, 130))), max_size=3, unique_by=lambda record: record[0]
)


def speed(limit: int | None) -> str:
    return "undefined" if limit is None else str(limit)


@given(SIGNS, RECORDS, RECORDS, RECORDS, st.booleans())
def test_queries_and_the_simulator_have_the_limits_that_are_found_by_hand(
    signs: list[tuple[str, int, str, int]],
    types: list[tuple[int, int | None]],
    left: list[tuple[int, int | None]],
    right: list[tuple[int, int | None]],
    is_left: bool,
) -> None:
    own = left if is_left else right
    changes = sorted({0, 100, *(sign[1] for sign in signs), *(each[0] for each in (*own, *types))})
    stations = [(before + after) / 2 for before, after in pairwise(changes)]
    is_long = np.diff(changes) > 3
    text = straight(
        objects="".join(
            thing(f"{kind}{value}", s, way, id) for id, (kind, s, way, value) in enumerate(signs) if kind != "signal"
        ),
        signals="".join(
            signal(f"{value}", s, way, id) for id, (kind, s, way, value) in enumerate(signs) if kind == "signal"
        ),
        types="".join(f'<type s="{s}"><speed max="{speed(limit)}" unit="km/h"/></type>' for s, limit in types),
        left="".join(f'<speed sOffset="{s}" max="{speed(limit)}" unit="km/h"/>' for s, limit in left),
        right="".join(f'<speed sOffset="{s}" max="{speed(limit)}" unit="km/h"/>' for s, limit in right),
    )
    mine = [
        Said(s, value)
        for kind, s, way, value in signs
        if way == "none" or (SIDES[way] > 0) == (is_left if kind != "signal" else not is_left)
    ]
    by_hand = [
        limit_at(station, is_left=is_left, signs=mine, own=[Said(*one) for one in own], road=[Said(*one) for one in types])
        for station in stations
    ]
    expected = np.array([np.nan if limit is None else limit for limit in by_hand])
    assert np.array(offline(text, stations, is_left=is_left))[is_long] == pytest.approx(expected[is_long], nan_ok=True)
    last, way = 30.0, slice(None, None, -1 if is_left else 1)
    for number, limit in list(enumerate(expected))[way]:
        expected[number] = last = last if np.isnan(limit) else limit  # what the map does not say is as before
    assert np.array(served(text, stations, is_left=is_left))[is_long] == pytest.approx(expected[is_long])
