"""The lanes of a town as CARLA samples them, on a small map; `test_as_carla.py` compares whole towns with CARLA."""

from __future__ import annotations

import numpy as np
import pytest

from carla_recap.roads.lanes import TownRoads
from carla_recap.roads.opendrive import read_opendrive
from tests.roads import towns


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
