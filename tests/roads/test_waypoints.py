"""Places on lanes, as CARLA's own library has them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from carla_recap.roads.waypoints import FARTHEST, NONE, PARKING
from tests.roads.lane_maps import carla_map, lanes, lanes_of, location, place
from tests.roads.towns import PATHS, lane, road, section

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_the_nearest_place_is_as_near_as_carlas(path: Path) -> None:
    town, theirs = lanes_of(path), carla_map(path)
    random = np.random.default_rng(7)
    near = np.array([random.choice(lane.centre) for lane in random.choice(np.array(town.lanes, object), 300)])
    points = near + random.normal(0, 2.0, (300, 3)) * (1, 1, 0.1)
    at = town.nearest(points)
    for number, point in enumerate(points):
        other = np.linalg.norm(place(theirs.get_waypoint(location(point))) - point)
        own = np.linalg.norm(at.position[number] - point)
        assert other - 0.5 < own < other + 0.02  # CARLA compares longer straight lines


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_poses_and_the_places_ahead_are_carlas(path: Path) -> None:
    town, theirs = lanes_of(path), carla_map(path)
    random = np.random.default_rng(8)
    driving = [number for number, lane in enumerate(town.lanes) if lane.is_driving]
    for number in random.choice(driving, 60).tolist():
        course = town.lanes[number]
        station = float(random.uniform(course.stations[0], course.stations[-1]))
        at = town.at(np.array([number]), np.array([station]))
        waypoint = theirs.get_waypoint_xodr(course.road, course.id, station)
        ahead = waypoint.transform.get_forward_vector()
        assert at.position[0] == pytest.approx(place(waypoint), abs=0.05)
        assert at.ahead[0] == pytest.approx((ahead.x, -ahead.y, ahead.z), abs=0.03)
        assert at.width[0] == pytest.approx(waypoint.lane_width, abs=0.02)
        following, found = waypoint.next(5.0), town.ahead(number, station, 5.0)
        assert bool(following) == (found is not None)
        if found is not None:
            lane = town.lanes[found[0]]
            assert (lane.road, lane.section, lane.id) == (
                following[0].road_id,
                following[0].section_id,
                following[0].lane_id,
            )
            assert found[1] == pytest.approx(following[0].s, abs=0.01)


def test_a_place_beside_a_road_is_on_its_nearest_lane() -> None:
    town = lanes(road(sections=section(0, lane(1), lane(-1) + lane(-2, kind="parking"))))
    at = town.nearest(np.array([(30.0, -9.0, 0.0), (30.0, 9.0, 0.0)]))
    assert [town.lanes[number].id for number in at.lane.tolist()] == [-1, 1]
    assert at.position.tolist() == [[30.0, -1.75, 0.0], [30.0, 1.75, 0.0]]
    assert np.abs(np.cos(at.heading) - (1, -1)).max() < 1e-6
    parked = town.nearest(np.array([(30.0, 9.0, 0.0)]), PARKING)
    assert parked.position[0].tolist() == [30.0, -5.25, 0.0]


def test_the_width_of_a_lane_between_its_stations() -> None:
    town = lanes(road(sections=section(0, right=lane(-1).replace('b="0"', 'b="0.1"'))))
    assert town.at(np.zeros(2, np.int64), np.array([30.0, 30.2])).width == pytest.approx([6.5, 6.52], abs=1e-4)


def test_far_places_and_kinds_without_lanes_have_no_lane() -> None:
    town = lanes(road(sections=section(0, right=lane(-1))))
    far = np.array([(50.0, FARTHEST + 5, 0.0), (np.nan, 0.0, 0.0), (50.0, 40.0, 0.0)])
    assert (town.nearest(far).lane == NONE).tolist() == [True, True, False]
    assert (town.nearest(far, PARKING).lane == NONE).all()


def test_the_lane_beside_is_of_the_same_road() -> None:
    town = lanes(road(sections=section(0, lane(1), lane(-1) + lane(-2) + lane(-3, kind="sidewalk"))))
    one, two, other = (town.number[1, 0, id] for id in (-1, -2, 1))
    assert (town.beside(one, left=False), town.beside(two, left=False)) == (two, None)
    assert (town.beside(one, left=True), town.beside(other, left=True)) == (other, one)
