"""Roads of generated maps, with right- and left-hand traffic, as CARLA's own library has them."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import HealthCheck, example, given, settings

from carla_recap.roads.lanes import TownRoads
from carla_recap.roads.opendrive import read_opendrive
from tests.roads.test_as_carla import PATHS
from tests.roads.towns import lane, opendrive, road, section
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


def all_differences(text: str, library: CarlaLibrary) -> list[Any]:
    return differences(TownRoads(read_opendrive(text)), text, library) or []


@pytest.mark.parametrize("path", PATHS, ids=[path.stem for path in PATHS])
def test_towns_are_equal(path: Path, library: CarlaLibrary) -> None:
    assert all_differences(path.read_text(), library) == []


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
