"""Roads of generated maps, with right- and left-hand traffic, as CARLA's own library has them."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings

from carla_recap.roads.landmarks import find_landmarks
from carla_recap.roads.lanes import TownRoads
from carla_recap.roads.opendrive import read_opendrive
from carla_recap.roads.surfaces import build_network
from tests.roads.towns import PATHS, lane, opendrive, road, section
from tests.twins.carla_map import CarlaLibrary, differences
from tests.twins.generated_maps import maps

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytest.importorskip("carla", reason="the extra carla is not installed")


@pytest.fixture(scope="module")
def library() -> Iterator[CarlaLibrary]:
    library = CarlaLibrary()
    yield library
    library.close()


def all_differences(text: str, library: CarlaLibrary, **options: Any) -> list[Any]:
    return differences(TownRoads(read_opendrive(text)), text, library, **options) or []


@pytest.mark.parametrize("path", PATHS, ids=[path.stem for path in PATHS])
def test_towns_are_equal(path: Path, library: CarlaLibrary) -> None:
    assert all_differences(path.read_text(), library, far=0.0, turned=1e-9) == []


@pytest.mark.parametrize("path", PATHS, ids=[path.stem for path in PATHS])
def test_lanes_are_sampled_to_their_ends(path: Path) -> None:
    roads = TownRoads(read_opendrive(path.read_text()))
    ends = {(road.number, part.number): (part.start, part.end) for road in roads.content.roads for part in road.sections}
    for course in roads.lanes:
        start, end = ends[course.road, course.section]
        assert 0 <= course.stations[0] - start < 0.5
        assert 0 < end - course.stations[-1] < 1 / 2048
        assert (np.diff(course.stations) > 0).all()
        assert np.diff(course.stations).max() <= 0.5


@settings(deadline=None, suppress_health_check=list(HealthCheck))
@given(text=maps())
@example(text=opendrive(road(sections=section(0, lane(1), lane(-1))).replace('junction="-1"', 'junction="-1" rule="LHT"')))
@example(text=opendrive(road().replace('junction="-1"', "")))
def test_generated_maps_are_equal(text: str, library: CarlaLibrary) -> None:
    assert all_differences(text, library) == []


@pytest.mark.parametrize("rule", ["", ' rule="LHT"'])
@pytest.mark.parametrize("name", ["Sign", "Stencil_STOP"])
def test_signals_on_a_lane_are_moved_beside_the_road(rule: str, name: str, library: CarlaLibrary) -> None:
    offsets = (-9.0, -4.5, -3.6, -1.75, -0.5, 0.1, 1.0, 3.0, 4.0, 9.0)
    places = itertools.product(offsets, (0, 1.9), ("206", "1000001", "1000010"))
    signals = "".join(
        f'<signal name="{name}" id="{number}" s="{20 + number}" t="{offset}" zOffset="{height}" hOffset="0.7" type="{kind}"'
        ' orientation="+" dynamic="no" country="" subtype="-1" value="30"/>'
        for number, (offset, height, kind) in enumerate(places)
    )
    lanes = section(0, lane(2, 1.5, "shoulder") + lane(1), lane(-1) + lane(-2, kind="parking"))
    text = opendrive(road(sections=lanes, inside=f"<signals>{signals}</signals>"))
    assert all_differences(text.replace('junction="-1"', f'junction="-1"{rule}'), library) == []


@pytest.mark.parametrize("y", [1.9, -7.25])  # on a lane, and beside it
@pytest.mark.parametrize("kind", ["206", "1000001", "274"])
def test_signals_are_where_the_file_has_them_in_the_world(kind: str, y: float, library: CarlaLibrary) -> None:
    signal = (
        f'<signals><signal name="" id="7" s="20" t="-6" zOffset="1" hOffset="0.4" orientation="+" type="{kind}" value="30">'
        f'<positionInertial x="12.5" y="{y}" z="3.5" hdg="1.2" pitch="0" roll="0"/></signal></signals>'
    )
    text = opendrive(road(inside=signal))
    assert all_differences(text, library) == []
    (mark,) = find_landmarks(TownRoads(read_opendrive(text)))
    assert (mark.location.tolist(), mark.heading) == ([12.5, y, 3.5], 1.2)
    assert build_network(text).signals[["x", "y", "z"]].tolist() == ([(12.5, y, 3.5)] if kind != "274" else [])


@pytest.mark.parametrize("slope", [0, 0.1, -0.12])
@pytest.mark.parametrize(("offset", "heading"), [(0, 1.5707963), (2, 0.3), (-3, -2)])
def test_crossings_have_the_heights_of_their_corners(
    slope: float, offset: float, heading: float, library: CarlaLibrary
) -> None:
    corners = ((-4, -2, 0), (4, -2, 1.5), (4, 2, 0.2), (-4, 2, 0), (-4, -2, 0))
    outline = "".join(f'<cornerLocal u="{u}" v="{v}" z="{z}"/>' for u, v, z in corners)
    thing = f'<object id="1" type="crosswalk" s="50" t="{offset}" zOffset="0.7" hdg="{heading}"><outline>{outline}</outline>'
    text = opendrive(road(inside=f"<objects>{thing}</object></objects>", slope=slope, heading=0.4))
    facts = library.ask(text, [])
    assert facts is not None
    (found,) = TownRoads(read_opendrive(text)).crossings
    assert found == pytest.approx(np.array(facts["crossings"]), abs=1e-4)
    assert np.ptp(found[:, 2]) > 1


def test_signals_at_the_border_of_sections_are_for_the_lanes_beyond(library: CarlaLibrary) -> None:
    lanes = section(0, lane(1), lane(-1)) + section(50, lane(2) + lane(1), lane(-1) + lane(-2)) + section(75, "", lane(-1))
    signals = "".join(
        f'<signal name="x" id="{number}" s="{station}" t="20" zOffset="0" hOffset="0" orientation="{orientation}" type="206"'
        ' dynamic="no" country="" subtype="-1" value="30"/>'
        for number, (station, orientation) in enumerate(
            itertools.product((0, 49.9, 50, 74.9, 75, 100, 120), ("+", "-", "none"))
        )
    )
    text = opendrive(road(sections=lanes, inside=f"<signals>{signals}</signals>"))
    assert all_differences(text, library) == []
