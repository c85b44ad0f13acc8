"""Roads of generated maps, with right- and left-hand traffic, as CARLA's own library has them."""

from __future__ import annotations

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

MOVED_SIGNS = "landmark"
"""Signs that are on a lane are moved aside by the library."""


@pytest.fixture(scope="module")
def library() -> Iterator[CarlaLibrary]:
    library = CarlaLibrary()
    yield library
    library.close()


def all_differences(text: str, library: CarlaLibrary) -> list[Any]:
    found = differences(TownRoads(read_opendrive(text)), text, library)
    return [difference for difference in found or [] if difference[0] != MOVED_SIGNS]


@pytest.mark.parametrize("path", PATHS, ids=[path.stem for path in PATHS])
def test_towns_are_equal(path: Path, library: CarlaLibrary) -> None:
    assert all_differences(path.read_text(), library) == []


@settings(deadline=None, suppress_health_check=list(HealthCheck))
@given(text=maps())
@example(text=opendrive(road(sections=section(0, lane(1), lane(-1))).replace('junction="-1"', 'junction="-1" rule="LHT"')))
def test_generated_maps_are_equal(text: str, library: CarlaLibrary) -> None:
    assert all_differences(text, library) == []
