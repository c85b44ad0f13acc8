"""Surfaces of roads: the pieces of lanes, where stop lines and crossings are, and what junctions enclose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from carla_recap.errors import RecapWarning
from carla_recap.roads import barriers, lanes, stop_lines, surfaces
from carla_recap.roads.lanes import TownRoads
from carla_recap.roads.opendrive import read_opendrive
from carla_recap.roads.surfaces import build_network
from tests.roads import towns
from tests.roads.straight_road import STRAIGHT_ROAD

if TYPE_CHECKING:
    from types import ModuleType

    from carla_recap.roads.network import RoadNetwork


def with_light(s: float, lanes: tuple[int, int] | None = (-1, -1), orientation: str = "+", road: int = 1) -> RoadNetwork:
    """Return the straight road whose light is at a station of a road."""
    start = STRAIGHT_ROAD.index('<signal id="11"')
    end = STRAIGHT_ROAD.index("</signal>", start) + len("</signal>")
    validity = "" if lanes is None else f'<validity fromLane="{lanes[0]}" toLane="{lanes[1]}"/>'
    light = f'<signal id="11" s="{s}" t="-4.5" type="1000001" orientation="{orientation}" zOffset="0">{validity}</signal>'
    text = STRAIGHT_ROAD[:start] + STRAIGHT_ROAD[end:]
    place = text.index("<signals>", text.index(f'<road id="{road}"')) + len("<signals>")
    return build_network(text[:place] + light + text[place:])


def lines_of(network: RoadNetwork) -> list[tuple[float, ...]]:
    """Return the x of the stop lines of the light, the y of their left and right ends, and their direction."""
    light = network.signal_ids.index("11")
    lines = network.stop_lines[network.stop_lines["signal"] == light]
    for line in lines:
        assert line["x0"] == pytest.approx(line["x1"], abs=1e-6)
    return [tuple(np.round(line[["x0", "y0", "y1", "heading"]].tolist(), 1).tolist()) for line in lines]


EAST, WEST = (0.0, -3.5, 0.0), (0.0, 3.5, 3.1)


@pytest.mark.parametrize(
    ("s", "lanes", "road", "expected"),
    [
        (99, (-1, -1), 1, [(100.0, *EAST)]),  # at the border of the junction
        (20, (-1, -1), 1, [(20.0, *EAST)]),  # far from it
        (20, (1, 1), 1, [(20.0, *WEST)]),
        (99, (1, 1), 1, [(99.0, *WEST)]),  # behind the junction
        (1, (1, 1), 2, [(120.0, *WEST)]),
        (1, (-1, -1), 2, [(121.0, *EAST)]),
        (99, (-1, -1), 2, [(219.0, *EAST)]),  # no junction follows
        (10, (-1, -1), 3, [(100.0, *EAST)]),  # in the junction
        (10, (1, 1), 3, [(120.0, *WEST)]),
        (20, (-1, 1), 1, [(20.0, *WEST), (20.0, *EAST)]),
        (20, (-2, -2), 1, [(20.0, *EAST)]),  # for the shoulder, so that it is for the lanes that it faces
        (-3, (-1, -1), 1, []),
        (-0.3, (-1, -1), 1, [(0.0, *EAST)]),
    ],
)
def test_a_stop_line_is_across_each_lane_of_a_light(
    s: float, lanes: tuple[int, int], road: int, expected: list[tuple[float, ...]]
) -> None:
    assert lines_of(with_light(s, lanes, road=road)) == expected


@pytest.mark.parametrize(("orientation", "expected"), [("+", [EAST]), ("-", [WEST]), ("none", [WEST, EAST])])
def test_a_light_without_lanes_is_for_its_direction(orientation: str, expected: list[tuple[float, ...]]) -> None:
    assert lines_of(with_light(20, None, orientation)) == [(20.0, *line) for line in expected]


def test_pieces_follow_each_other_in_the_direction_of_their_lane() -> None:
    network = build_network(STRAIGHT_ROAD)
    for number, lane in enumerate(network.lanes):
        pieces = network.pieces[network.pieces["lane"] == number]
        way = -1 if lane["id"] > 0 else 1
        assert (pieces["x1"] * way > pieces["x0"] * way).all()
        assert pieces["x0"][1:] == pytest.approx(pieces["x1"][:-1])
        middle = {1: 1.75, -1: -1.75, -2: -4.0}[int(lane["id"])]
        assert pieces["y0"] == pytest.approx(middle)
        assert np.concatenate((pieces["half0"], pieces["half1"])) == pytest.approx(0.5 if lane["id"] == -2 else 1.75)
        assert pieces["left_y0"] == pytest.approx(way)


@pytest.mark.parametrize(("width", "count"), [(0.021, 2), (0.019, 1)])
def test_a_lane_of_two_centimetres_is_none(width: float, count: int) -> None:
    shoulder = 'type="shoulder"><width sOffset="0" a="1.0"'
    text = STRAIGHT_ROAD.replace(shoulder, shoulder.replace("1.0", str(width)), 1)
    assert (build_network(text).lanes["id"] == -2).sum() == count


def test_what_the_lanes_of_a_junction_enclose_is_road() -> None:
    """It is a square from 0 to 8 m."""
    sides = [(-1, 0, 0), (8, -1, np.pi / 2), (9, 8, np.pi), (0, 9, -np.pi / 2)]
    lanes = [
        towns.road(id, x=x, y=y, heading=turn, length=10, junction=9, sections=towns.section(0, right=towns.lane(-1)))
        for id, (x, y, turn) in enumerate(sides)
    ]
    network = build_network(towns.opendrive(*lanes))
    assert network.on_road(np.array([(4, 4), (7.5, 7.5), (-4, 4)])).tolist() == [True, True, False]


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ((surfaces, "_MOST_POINTS", 50), "0 km of roads are examined at 50 points, more than 1 m apart"),
        ((surfaces, "_MOST_PIECES", 15), "the lanes have 15 straight parts: .* times as many would follow their bends"),
        ((surfaces, "_COARSEST", 0.1), "junction 9: gaps between its lanes are no road: cells of 0.5 m"),
        ((surfaces, "_MOST_GAPS", -1), "junction 9: gaps between its lanes are no road: 0 pieces before"),
        ((lanes, "_MOST_POINTS", 300), "1 km of lanes have 300 points, 2.1 m apart and not 0.5"),
        ((barriers, "_MOST_CELLS", 100), "of a map of 0.2 km, the ground is known to 2.2 m and not 0.5 m"),
    ],
)
def test_a_limit_that_makes_a_large_map_less_exact_warns(
    monkeypatch: pytest.MonkeyPatch, limits: tuple[ModuleType, str, float], message: str
) -> None:
    monkeypatch.setattr(*limits)
    with pytest.warns(RecapWarning, match=message):
        build_network(STRAIGHT_ROAD), barriers.barriers(TownRoads(read_opendrive(STRAIGHT_ROAD)).lanes)


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


@pytest.mark.parametrize(
    ("limit", "roads", "message"),
    [
        (
            "_MOST_LINES",
            [towns.road(id, y=50 * id, inside=towns.painted_stop(50, -1.75, 3.5)) for id in (1, 2)],
            "of 2 painted stop lines, 1 are drawn",
        ),
        (
            "_MOST_LINES",
            [towns.road(id, y=50 * id, inside=towns.stop_sign(50, -1, -1).replace("7", str(id))) for id in (7, 8)],
            "signals from 8 on are left out: those before have 1 stop lines",
        ),
        (
            "_MOST_PLACES",
            [towns.road(id, y=50 * id, inside=towns.stop_sign(50, -1, -1)) for id in (1, 2)],
            "of 2 places of signal 7, 1 are looked at",
        ),
    ],
)
def test_stop_lines_beyond_a_limit_warn(monkeypatch: pytest.MonkeyPatch, limit: str, roads: list[str], message: str) -> None:
    monkeypatch.setattr(stop_lines, limit, 1)
    with pytest.warns(RecapWarning, match=message):
        painted, others = stop_lines.drawn_stop_lines(read_opendrive(towns.opendrive(*roads)).roads)
    assert len(painted) + len(others) == 1
