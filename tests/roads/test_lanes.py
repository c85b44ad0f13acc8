"""The lanes of a town as CARLA samples them, on a small map; `test_as_carla.py` compares whole towns with CARLA."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.roads.lanes import LaneGeometry, TownRoads
from carla_recap.roads.opendrive import read_opendrive
from tests.roads import towns
from tests.roads.straight_road import STRAIGHT_ROAD


@pytest.fixture(scope="module")
def lanes() -> dict[tuple[int, int], LaneGeometry]:
    """The lanes of the straight road, whose junction is 1, by road and number."""
    text = STRAIGHT_ROAD.replace('junction="9"', 'junction="1"').replace('<junction id="9"', '<junction id="1"')
    text = text.replace('elementId="9"', 'elementId="1"')
    return {(lane.road, lane.id): lane for lane in TownRoads(read_opendrive(text)).lanes}


def test_roads_outside_a_junction_are_in_none(lanes: dict[tuple[int, int], LaneGeometry]) -> None:
    assert {road: lane.junction == 1 for (road, _), lane in lanes.items()} == {1: False, 2: False, 3: True}


def test_stations_lead_from_the_start_to_just_before_the_end(lanes: dict[tuple[int, int], LaneGeometry]) -> None:
    for (road, _), lane in lanes.items():
        length = 20 if road == 3 else 100
        assert 0 <= lane.stations[0] < 0.1
        assert length - 0.1 < lane.stations[-1] < length
        assert (np.diff(lane.stations) > 0).all()


def test_borders_are_half_a_width_beside_the_centre(lanes: dict[tuple[int, int], LaneGeometry]) -> None:
    for (road, number), lane in lanes.items():
        start = {1: 0, 2: 120, 3: 100}[road]
        assert lane.centre[:, 0] == pytest.approx(start + lane.stations, abs=1e-3)
        middle, half = {1: (1.75, 1.75), -1: (-1.75, 1.75), -2: (-4.0, 0.5)}[number]
        ahead = 1 if number < 0 else -1
        assert lane.centre[:, 1] == pytest.approx(middle, abs=1e-4)
        assert lane.left[:, 1] == pytest.approx(middle + ahead * half, abs=1e-4)
        assert lane.right[:, 1] == pytest.approx(middle - ahead * half, abs=1e-4)
        assert np.cos(lane.headings) == pytest.approx(ahead)


def test_limits_are_of_signs_of_the_lane_or_of_the_road() -> None:
    """The limits of the first road change before and behind the sign in its middle."""
    town = '<type s="0" type="town"><speed max="50" unit="km/h"/></type>'
    changed = "".join(
        f'<type s="{s}" type="town"><speed max="{limit}" unit="km/h"/></type>' for s, limit in ((0, 50), (49, 36), (51, 72))
    )
    lanes = TownRoads(read_opendrive(STRAIGHT_ROAD.replace(town, changed, 1))).lanes
    limits = {(lane.road, lane.id): np.unique(np.round(lane.limits * 3.6, 6)) for lane in lanes}
    assert limits[1, -1].tolist() == [36, 50, 72]
    assert limits[1, 1].tolist() == [36, 50, 72]
    assert (limits[2, -1].tolist(), limits[2, 1].tolist()) == ([50], [30])
    assert np.isnan(limits[3, -1]).all()


@pytest.mark.parametrize("shape", ["<line/>", '<arc curvature="0.02"/>'])
def test_the_corners_of_a_crossing_may_be_along_the_road(shape: str) -> None:
    offset = '<laneOffset s="0" a="1.5" b="0" c="0" d="0"/>'  # the corners are beside the reference line
    sections = offset + towns.section(0, towns.lane(1), towns.lane(-1))
    content = read_opendrive(towns.opendrive(towns.road(shape=shape, sections=sections, inside=towns.crossing_by_road(50))))
    (along,), (outline,) = content.roads, TownRoads(content).crossings
    corners = ((48, -4), (52, -4), (52, 4), (48, 4), (48, -4))
    assert outline == pytest.approx(np.array([along.at(*corner)[0] for corner in corners]))


def test_all_corners_of_a_crossing_are_read() -> None:
    turns = np.linspace(0, 2 * np.pi, 150)
    corners = "".join(f'<cornerLocal u="{3 * np.cos(turn)}" v="{3 * np.sin(turn)}" z="0"/>' for turn in turns)
    thing = f'<object id="1" type="crosswalk" s="50" t="0" hdg="0"><outline>{corners}</outline></object>'
    inside = f"<objects>{thing}</objects>"
    (outline,) = TownRoads(read_opendrive(towns.opendrive(towns.road(inside=inside)))).crossings
    assert len(outline) == 150
