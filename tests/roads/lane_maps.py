"""Maps of lanes, ours and those of CARLA's own library."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from carla_recap.roads.lanes import TownRoads
from carla_recap.roads.opendrive import read_opendrive
from carla_recap.roads.waypoints import LaneMap
from tests.roads.towns import opendrive

if TYPE_CHECKING:
    from pathlib import Path


@cache
def lanes_of(path: Path) -> LaneMap:
    return LaneMap(TownRoads(read_opendrive(path.read_text())))


def lanes(*roads: str) -> LaneMap:
    return LaneMap(TownRoads(read_opendrive(opendrive(*roads))))


def carla_map(path: Path) -> Any:
    carla = pytest.importorskip("carla", reason="the extra carla is not installed")
    return carla.Map("", path.read_text())


def location(point: np.ndarray[Any, Any]) -> Any:
    carla = pytest.importorskip("carla", reason="the extra carla is not installed")
    return carla.Location(float(point[0]), -float(point[1]), float(point[2]))


def place(waypoint: Any) -> np.ndarray[Any, Any]:
    where = waypoint.transform.location
    return np.array((where.x, -where.y, where.z))
