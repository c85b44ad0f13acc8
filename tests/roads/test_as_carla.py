"""Lanes, landmarks and crossings as CARLA's own library has them, in all towns that are here."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from carla_recap.roads.lanes import NO_JUNCTION, TownRoads
from carla_recap.roads.opendrive import read_opendrive
from tests.roads import towns
from tests.roads.towns import PATHS

if TYPE_CHECKING:
    from carla_recap.roads.lanes import LaneGeometry

carla = pytest.importorskip("carla", reason="the extra carla is not installed")

KINDS = {"none": "NONE", "driving": "Driving", "sidewalk": "Sidewalk", "shoulder": "Shoulder", "median": "Median"}


@cache
def loaded(source: Path | str) -> tuple[TownRoads, Any]:
    text = source.read_text() if isinstance(source, Path) else source
    return TownRoads(read_opendrive(text)), carla.Map("", text)


@pytest.fixture(params=PATHS, ids=[path.stem for path in PATHS])
def both(request: pytest.FixtureRequest) -> tuple[TownRoads, Any]:
    return loaded(request.param)


def place(location: Any) -> tuple[float, float, float]:
    return location.x, -location.y, location.z


def at(town: Any, lane: LaneGeometry, index: int) -> Any:
    """CARLA's waypoint at a station of a lane."""
    return town.get_waypoint_xodr(lane.road, lane.id, float(lane.stations[index]))


def assert_equal_waypoints(roads: TownRoads, town: Any) -> None:
    for lane in roads.lanes:
        for index in (*range(0, len(lane.stations), 7), len(lane.stations) - 1):
            waypoint = at(town, lane, index)
            assert (waypoint.road_id, waypoint.section_id, waypoint.lane_id) == (lane.road, lane.section, lane.id)
            assert waypoint.s == lane.stations[index]
            assert place(waypoint.transform.location) == tuple(lane.centre[index].tolist())
            assert np.radians(-waypoint.transform.rotation.yaw) == lane.headings[index]
            assert waypoint.lane_width == pytest.approx(np.linalg.norm(lane.left[index] - lane.right[index]), abs=1e-6)
            assert str(waypoint.lane_type) == KINDS[lane.kind]
            assert (waypoint.junction_id if waypoint.is_junction else NO_JUNCTION) == lane.junction


def test_waypoints_are_equal(both: tuple[TownRoads, Any]) -> None:
    assert_equal_waypoints(*both)


def test_lanes_turn_with_the_offset_of_their_road() -> None:
    lanes = towns.section(0, towns.lane(1), towns.lane(-1))
    road = towns.road(sections=f'<laneOffset s="0" a="0.5" b="0.05" c="1e-3" d="0"/>{lanes}')
    assert_equal_waypoints(*loaded(towns.opendrive(road)))


def test_lanes_are_sampled_to_their_ends(both: tuple[TownRoads, Any]) -> None:
    roads, _ = both
    ends = {(road.number, part.number): (part.start, part.end) for road in roads.content.roads for part in road.sections}
    for lane in roads.lanes:
        start, end = ends[lane.road, lane.section]
        assert 0 <= lane.stations[0] - start < 0.5
        assert 0 < end - lane.stations[-1] < 1 / 2048
        assert all(0 < after - before <= 0.5 for before, after in pairwise(lane.stations.tolist()))


def assert_equal_crossings(roads: TownRoads, theirs: Any) -> None:
    carla = pytest.importorskip("carla", reason="the extra carla is not installed")
    for lane in roads.lanes:
        for row in sorted({0, len(lane.stations) // 4, len(lane.stations) // 2, len(lane.stations) - 1}):
            at = theirs.get_waypoint_xodr(lane.road, lane.id, float(lane.stations[row]))
            if (at.section_id, at.lane_id) != (lane.section, lane.id):
                continue
            sides = (
                (True, at.left_lane_marking, carla.LaneChange.Left),
                (False, at.right_lane_marking, carla.LaneChange.Right),
            )
            for left, marking, side in sides:
                allowed = bool(marking and marking.lane_change & side)
                assert lane.allowed(float(lane.stations[row])).crossings[not left] == allowed


def test_planners_may_cross_the_markings_that_carlas_may(both: tuple[TownRoads, Any]) -> None:
    assert_equal_crossings(*both)


@pytest.mark.parametrize("rule", ["RHT", "LHT"])
def test_markings_that_change_along_a_lane_may_be_crossed_where_carlas_planner_does(rule: str) -> None:
    def lane(id: int, *marks: tuple[float, str]) -> str:
        lines = "".join(f'<roadMark sOffset="{start}" type="solid" laneChange="{changes}"/>' for start, changes in marks)
        return towns.lane(id).replace("</lane>", f"{lines}</lane>")

    left = lane(3, (0, "none")) + lane(2, (0, "both")) + lane(1, (0, "increase"), (60, "decrease"))
    right = lane(-1, (0, "both"), (40, "increase")) + lane(-2, (0, "increase"), (30, "none")) + lane(-3, (30, "none"))
    road = towns.road(sections=towns.section(0, left, right)).replace("<road ", f'<road rule="{rule}" ')
    assert_equal_crossings(*loaded(towns.opendrive(road)))
