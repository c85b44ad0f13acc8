"""Tests of road networks made of OpenDRIVE files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from carla_recap.roads import find_map, load_map, surfaces
from carla_recap.roads.drawing import draw
from carla_recap.roads.lanes import TownRoads
from carla_recap.roads.network import LIGHT, NONE, STOP, RoadNetwork
from carla_recap.roads.opendrive import read_opendrive
from carla_recap.roads.surfaces import build_network, find_road_network, load_road_network, road_network_of
from carla_recap.util import cache

from .straight_road import STRAIGHT_ROAD
from .towns import lane, mirrored, opendrive, road, section
from .towns import town as map_of


@pytest.fixture(scope="module")
def roads() -> RoadNetwork:
    return build_network(STRAIGHT_ROAD, "Straight")


@pytest.mark.parametrize("lane_types", [None, frozenset({"driving", "sidewalk"})])
def test_a_network_and_lines_in_the_cache_are_those_that_were_made(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, lane_types: frozenset[str] | None
) -> None:
    monkeypatch.setenv(cache.FOLDER, str(tmp_path))
    path = find_map("Brickfield")
    assert path is not None
    made = build_network(path.read_text(), "Brickfield", lane_types)
    lines = draw(TownRoads(read_opendrive(path.read_text())))
    for _ in range(2):
        surfaces._network.cache_clear()
        network, road_map = load_road_network(path, lane_types), load_map(path)
        for name, values in vars(made).items():
            found = getattr(network, name)
            assert type(found) is type(values)
            assert np.asarray(found).tobytes() == np.asarray(values).tobytes(), name  # limits are NaN where there are none
        for name, parts in lines.items():
            assert len(parts) == len(getattr(road_map, name))
            assert all(map(np.array_equal, getattr(road_map, name), parts)), name


def test_points_are_to_the_left_and_right_of_their_lane_in_driving_direction(roads: RoadNetwork) -> None:
    found = roads.lanes_at(np.array([(20.0, -1.75), (20.0, -1.0), (20.0, 1.0), (180.0, 2.75)]))
    assert roads.lanes["id"][found.lane].tolist() == [-1, -1, 1, 1]
    assert found.offset == pytest.approx([0.0, 0.75, 0.75, -1.0], abs=1e-6)
    assert np.cos(found.heading) == pytest.approx([1, 1, -1, -1])


def test_a_point_beyond_the_reach_of_all_roads_has_no_lane(roads: RoadNetwork) -> None:
    found = roads.lanes_at(np.array([(20.0, -70.0), (np.nan, 0.0), (np.inf, 1e300)]))
    assert found.lane.tolist() == [NONE] * 3
    assert np.isnan(found.heading).all()
    assert np.isinf(found.outside).all()


def test_a_lane_may_be_as_wide_as_a_square() -> None:
    square = road_network_of(opendrive(road(sections=section(0, right=lane(-1, 80)))))
    found = square.lanes_at(np.array([(20.0, -70.0), (20.0, -83.0), (20.0, 1.0)]))
    assert found.outside == pytest.approx([0.0, 3.0, 1.0], abs=1e-3)
    assert found.offset[0] == pytest.approx(-30.0)


def test_lights_and_stop_signs_have_a_stop_line_each(roads: RoadNetwork) -> None:
    assert roads.signal_ids == ("11", "12")
    assert roads.signals["kind"].tolist() == [LIGHT, STOP]
    assert roads.stop_lines["signal"].tolist() == [0, 1]


def test_left_hand_traffic_is_right_hand_traffic_in_a_mirror(roads: RoadNetwork) -> None:
    other = build_network(mirrored(STRAIGHT_ROAD), "Mirrored")
    x, y = np.meshgrid(np.arange(0.5, 220.0, 7.0), np.arange(-6.0, 6.0, 0.7))
    points = np.stack((x.ravel(), y.ravel()), axis=1)
    found, seen = roads.lanes_at(points), other.lanes_at(points * (1, -1))
    assert np.cos(found.heading) == pytest.approx(np.cos(seen.heading))
    assert found.offset == pytest.approx(-seen.offset)
    assert found.limit == pytest.approx(seen.limit, nan_ok=True)
    assert (found.outside == seen.outside).all()
    assert roads.signals["heading"] == pytest.approx(other.signals["heading"])
    for end, opposite in (("0", "1"), ("1", "0")):  # the left end is the right one of the mirror
        assert roads.stop_lines[f"x{end}"] == pytest.approx(other.stop_lines[f"x{opposite}"])
        assert roads.stop_lines[f"y{end}"] == pytest.approx(-other.stop_lines[f"y{opposite}"])


def test_a_network_of_some_lanes_alone(roads: RoadNetwork) -> None:
    points = np.array([(50, -1.75), (110, -1.75), (150, -1.75)])
    in_junction = roads.only(roads.lanes["junction"] != NONE)
    assert in_junction.on_road(points).tolist() == [False, True, False]
    assert roads.only(np.zeros(len(roads.lanes), np.bool_)).on_road(points).tolist() == [False] * 3
    assert roads.on_road(points).all()


def test_a_network_of_lanes_of_a_type() -> None:
    points = np.array([(50, -1.75), (50, -4.0), (150, -4.0)])
    for types, expected in (
        ({"driving"}, [True, False, False]),
        ({"shoulder"}, [False, True, True]),
        ({"median"}, [False] * 3),
    ):
        assert build_network(STRAIGHT_ROAD, "", frozenset(types)).on_road(points).tolist() == expected


def test_networks_of_one_map_with_other_lanes_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "Straight.xodr"
    path.write_text(STRAIGHT_ROAD, "utf-8")
    assert load_road_network(path) is load_road_network(path)
    assert len(load_road_network(path, frozenset({"shoulder"})).lanes) == 2
    assert len(load_road_network(path).lanes) > 2


@pytest.mark.parametrize(("radius", "is_road"), [(6.0, True), (16.0, False)])
def test_what_the_lanes_of_a_junction_enclose_is_road_but_for_the_island_of_a_roundabout(
    radius: float, is_road: bool
) -> None:
    shape, lanes = f'<arc curvature="{1 / radius}"/>', section(0, lane(1, 2), lane(-1, 2))
    ring = road(y=-radius, length=2 * np.pi * radius, shape=shape, sections=lanes, junction=5)
    found = build_network(opendrive(ring)).lanes_at(np.array([(0.0, 0.0), (0.0, radius), (2 * radius, 2 * radius)]))
    assert found.on_road.tolist() == [is_road, True, False]


def test_the_built_in_town_is_found_by_name() -> None:
    roads = find_road_network("Carla/Maps/Brickfield")
    assert roads is not None
    assert (roads.signals["kind"] == LIGHT).sum() == 17
    assert find_road_network("Nowhere") is None
    path = find_map("Brickfield")
    assert path is not None
    again = road_network_of(path.read_text(), "again")
    assert np.array_equal(again.stop_lines, roads.stop_lines)


@pytest.mark.parametrize(("town", "lights", "lines"), [("Town01", 36, 36), ("Town02", 24, 24), ("Town10HD", 17, 36)])
def test_carla_towns_have_a_stop_line_for_each_light(town: str, lights: int, lines: int) -> None:
    roads = load_road_network(map_of(town))
    assert (roads.signals["kind"] == LIGHT).sum() == lights
    assert len(roads.stop_lines) == lines
    assert set(roads.stop_lines["signal"].tolist()) >= set(np.flatnonzero(roads.signals["kind"] == LIGHT).tolist())
