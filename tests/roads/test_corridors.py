"""Corridors that vehicles have driven, as maps."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import carla_recap
from carla_recap.errors import RecapWarning
from carla_recap.model.records import ActorKind, Spawn
from carla_recap.replay.recorded_map import corridors_of, opendrive_of_corridors
from carla_recap.roads.corridors import LANE_WIDTH, fresh_parts
from carla_recap.roads.opendrive import read_opendrive

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from carla_recap import Recording
    from carla_recap.roads.opendrive import Road


@pytest.fixture
def driven(tmp_path: Path) -> Iterator[Callable[..., Any]]:
    """Open a recording of vehicles that are at points in m, right-handed, 0.1 s apart."""
    with ExitStack() as stack:

        def driven(*paths: Sequence[tuple[float, float, float]], map_name: str = "Nowhere") -> Recording:
            path = tmp_path / "driven.mcap"
            with carla_recap.create_recording(path, map_name=map_name, date=0) as recording:
                for frame in range(max(map(len, paths), default=1)):
                    here = [(id, way[frame]) for id, way in enumerate(paths, 1) if frame < len(way)]
                    poses = [{"id": id, "x": 100 * x, "y": -100 * y, "z": 100 * z} for id, (x, y, z) in here]
                    spawned = [Spawn(id, ActorKind.VEHICLE, type_id="vehicle.audi.tt") for id, _ in here] * (not frame)
                    recording.add_frame(frame / 10, spawned=spawned, transforms=poses)
            return stack.enter_context(carla_recap.open_recording(path))

        yield driven


@pytest.fixture
def roads(driven: Callable[..., Any]) -> Callable[..., list[Road]]:
    return lambda *paths: read_opendrive(opendrive_of_corridors(driven(*paths))).roads


def straight(length: float = 60.0, y: float = 0.0, z: float = 0.0, slope: float = 0.0) -> list[tuple[float, float, float]]:
    return [(x, y, z + slope * x) for x in np.arange(0.0, length + 0.1, 1.5)]


def points(road: Road) -> np.ndarray:
    return road.reference(np.linspace(0, road.length, 200))[0]


def test_a_path_is_a_road_of_one_lane_with_a_bit_more_at_its_ends(roads):
    (road,) = roads(straight())
    course = points(road)
    assert course[:, 0].min() == pytest.approx(-4, abs=0.01)
    assert course[:, 0].max() == pytest.approx(64, abs=0.01)
    assert np.abs(course[:, 1:]).max() < 0.01
    (section,) = road.sections
    borders = section.borders(np.array([10.0]))[:, 0] + road.lane_offset(np.array([10.0]))
    assert borders[1:3] == pytest.approx([LANE_WIDTH / 2, -LANE_WIDTH / 2])
    assert [lane.kind for lane in (*section.left, *section.right)] == ["shoulder", "driving", "shoulder"]


def test_heights_are_followed_with_few_points(roads):
    (road,) = roads(straight(600.0, z=10.0, slope=0.05))
    course = points(road)
    assert len(road.curves) < 70
    inside = (course[:, 0] > 5) & (course[:, 0] < 595)
    assert np.abs(course[inside, 2] - 10 - 0.05 * course[inside, 0]).max() < 0.05


def test_what_is_driven_twice_is_one_road(roads):
    assert len(roads(straight(), straight(y=0.2, length=64.0))) == 1  # the rest is too short to be one
    assert len(roads(straight(), straight(y=10.0))) == 2


def test_a_jump_is_no_road(roads):
    found = roads([*straight(), *((x + 500.0, y, z) for x, y, z in straight())])
    assert len(found) == 2
    assert sum(road.length for road in found) == pytest.approx(2 * 68, abs=1)


def test_a_vehicle_that_turns_back_ends_its_road(roads):
    there = straight()
    assert all(road.length < 75 for road in roads([*there, *there[::-1]]))


def test_invalid_poses_are_left_out(roads):
    (road,) = roads([*straight(), (np.nan, 0, 0), (1e30, 0, 0)], [(np.nan, 0, 0)] * 9)
    assert road.length == pytest.approx(68, abs=0.1)


def test_where_no_vehicle_moves_there_is_a_road_at_the_first(roads):
    (road,) = roads([(30.0, 40.0, 2.0)] * 20)
    course = points(road)
    assert np.linalg.norm(course - (30, 40, 2), axis=1).min() < 0.3
    assert road.length == pytest.approx(40)


def test_an_empty_recording_has_a_road_at_the_origin(roads):
    (road,) = roads()
    assert np.linalg.norm(points(road), axis=1).min() < 0.3


def test_parts_stop_at_the_most_points():
    paths = [np.stack((np.arange(100.0), np.full(100, 5.0 * i)), axis=1) for i in range(10)]
    with pytest.warns(RecapWarning, match="driven paths from 4 of 10 on are left out: those before have 250 points"):
        assert sum(len(part) for part in fresh_parts(paths, 1.5, 250)) == 300


def test_a_corridor_map_has_lines_and_surfaces(driven):
    found = corridors_of(driven(straight(), map_name="Carla/Maps/Nowhere"))
    assert found is not None
    assert found.name == "Nowhere"
    assert len(found.centre_lines) == 1
    assert sorted(round(line[0, 1], 2) for line in found.lane_borders) == [-1.75, 1.75]
    assert read_opendrive(found.opendrive).roads


def test_roads_are_of_the_time_that_is_asked_for(driven):
    (road,) = read_opendrive(corridors_of(driven(straight(600.0)), 10.0, 20.0).opendrive).roads
    course = points(road)
    assert course[:, 0].min() == pytest.approx(150 - 4, abs=2)
    assert course[:, 0].max() == pytest.approx(300 + 4, abs=2)
