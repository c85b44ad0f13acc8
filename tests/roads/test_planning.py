"""Routes along lanes, as CARLA's global route planner finds them."""

from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.errors import RecapWarning
from carla_recap.queries.score.route_files import read_routes
from carla_recap.roads.planning import RoutePlanner
from tests.roads.lane_maps import carla_map, lanes, lanes_of, location, place
from tests.roads.towns import lane, road, section, town
from tests.twins.planning import PlainRoad, changes, shortest

if TYPE_CHECKING:
    from collections.abc import Iterator

PEER = Path(__file__).parents[3] / "shared" / "peer"
ROUTES = sorted((PEER / "leaderboard" / "routes").glob("*.xml"))


@pytest.fixture
def carlas_planner(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """CARLA's `GlobalRoutePlanner`, which is no part of its package."""
    path = PEER / "carla" / "PythonAPI" / "carla"
    if not path.exists():
        pytest.skip(f"{path} is not here: it is data that is not part of the repository")
    for name in ("carla", "networkx"):
        pytest.importorskip(name)
    monkeypatch.syspath_prepend(str(path))
    from agents.navigation.global_route_planner import GlobalRoutePlanner

    yield GlobalRoutePlanner
    for name in [name for name in sys.modules if name.partition(".")[0] == "agents"]:
        del sys.modules[name]


def apart(points: Any, line: Any) -> Any:
    return np.array([np.linalg.norm(line - point, axis=1).min() for point in points])


@pytest.mark.parametrize("path", ROUTES, ids=lambda path: path.stem)
def test_the_routes_of_the_leaderboard_are_carlas(path: Path, carlas_planner: Any) -> None:
    (route,) = read_routes(path)
    map_path = town(route.town)
    theirs = carlas_planner(carla_map(map_path), 1.0)
    expected: list[Any] = []
    for start, stop in zip(route.positions, route.positions[1:], strict=False):
        expected += [place(point) for point, _ in theirs.trace_route(location(start), location(stop))]
    found = RoutePlanner(lanes_of(map_path)).route(route.positions).position
    assert abs(len(found) - len(expected)) <= 2
    assert apart(found, np.array(expected)).max() <= 1.0
    lengths = [np.linalg.norm(np.diff(points, axis=0), axis=1).sum() for points in (found, np.array(expected))]
    assert lengths[0] == pytest.approx(lengths[1], abs=0.1)


def linked(number: int, x: float, before: int | None, after: int | None, lanes: str) -> str:
    ends = (("predecessor", before), ("successor", after))
    links = "".join(f'<{name} elementType="road" elementId="{id}"/>' for name, id in ends if id is not None)
    return road(number, x=x, sections=section(0, right=lanes)).replace("<planView>", f"<link>{links}</link><planView>")


def following(id: int, *marks: tuple[float, str]) -> str:
    """Return a lane that goes on in the next road, with the markings to its right."""
    link = f'<link><predecessor id="{id}"/><successor id="{id}"/></link>'
    lines = "".join(f'<roadMark sOffset="{start}" type="solid" laneChange="{changes}"/>' for start, changes in marks)
    return lane(id).replace("</lane>", f"{link}{lines}</lane>")


@pytest.mark.parametrize("way", [1, -1])  # -1: back, on lanes to the left
def test_a_route_has_a_point_each_metre(way: int) -> None:
    roads = [linked(1, 0, None, 2, following(-way)), linked(2, 100, 1, None, following(-way))]
    if way < 0:
        roads = [text.replace("<left></left>", "").replace("right>", "left>") for text in roads]
    at = RoutePlanner(lanes(*roads)).route(np.array([(10.0, -way, 0.0), (150.0, 0.0, 0.0)])[::way])
    x, y, _ = at.position.T if way > 0 else np.array((160.0, 0.0, 0.0))[:, None] - at.position.T
    assert (x[0], x[-1]) == pytest.approx((10.0, 149.0), abs=1.01)
    assert np.diff(x).max() <= 2.0 + 1e-6  # at the end of a lane
    assert (np.diff(x) >= 0).all()
    assert y == pytest.approx(-1.75)
    assert at.ahead == pytest.approx(np.tile((way, 0.0, 0.0), (len(x), 1)), abs=1e-6)


def test_lanes_that_are_shorter_than_the_spacing_have_a_point_at_most() -> None:
    two = following(-1, (0, "both")) + following(-2, (0, "both"))
    short, shorter = linked(1, 0, None, 2, two), linked(2, 0.9, 1, None, two)
    town = lanes(short.replace('length="100"', 'length="0.9"'), shorter.replace('length="100"', 'length="0.5"'))
    at = RoutePlanner(town).route(np.array([(0.1, -1.75, 0.0), (0.8, -1.75, 0.0)]))
    assert at.position == pytest.approx(np.array([(0.0, -1.75, 0.0)]))


def test_a_lane_for_driving_can_lead_to_one_for_parking() -> None:
    parking = following(-2).replace('type="driving"', 'type="parking"')
    town = lanes(linked(1, 0, None, 2, following(-1) + following(-2)), linked(2, 100, 1, None, following(-1) + parking))
    at = RoutePlanner(town).route(np.array([(10.0, -1.75, 0.0), (150.0, -1.75, 0.0)]))
    assert at.position[-1] == pytest.approx((149.0, -1.75, 0.0), abs=1.01)


def test_where_lanes_part_the_route_takes_the_shortest() -> None:
    """Roads 3 and 2 begin as one, and only road 2 leads on to the last position."""
    lane_of = following(-1, (0, "none"))
    before = linked(1, 0, None, None, lane_of).replace("<link>", '<link><successor elementType="junction" elementId="9"/>')
    after = linked(4, 160, 2, None, lane_of)
    inside = [
        linked(number, 100, 1, following, lane_of).replace('length="100"', f'length="{length}"').replace('"-1">', '"9">', 1)
        for number, length, following in ((3, 50, None), (2, 60, 4))
    ]
    links = "".join(
        f'<connection id="{number}" incomingRoad="1" connectingRoad="{number}" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection>'
        for number in (3, 2)
    )
    town = lanes(before, *inside, after, f'<junction id="9" name="">{links}</junction>')
    at = RoutePlanner(town).route(np.array([(110.0, -1.75, 0.0), (200.0, -1.75, 0.0)]))
    assert {town.lanes[lane].road for lane in at.lane.tolist()} == {2, 4}


def test_a_leg_that_is_a_detour_warns() -> None:
    """Around a square of 100 m, and back to a position that is near."""
    lane_of = following(-1, (0, "none"))
    corners = [(0, 0, 0.0), (100, 0, np.pi / 2), (100, 100, np.pi), (0, 100, -np.pi / 2)]
    roads = [
        linked(number, x, (number - 2) % 4 + 1, number % 4 + 1, lane_of)
        .replace(f'x="{x}" y="0"', f'x="{x}" y="{y}"')
        .replace('hdg="0"', f'hdg="{heading}"', 1)
        for number, (x, y, heading) in enumerate(corners, 1)
    ]
    planner = RoutePlanner(lanes(*roads))
    with pytest.warns(RecapWarning, match=r"^route '7': 36\d m from position 2 to position 3, which is 31 m away$"):
        planner.route(np.array([(10.0, -1.75, 0.0), (20.0, -1.75, 0.0), (-1.75, 20.0, 0.0)]), "route '7'")


WORDS = st.sampled_from(["none", "both", "increase", "decrease"])


@st.composite
def plain_roads(draw: st.DrawFn) -> list[PlainRoad]:
    roads = []
    for _ in range(draw(st.integers(1, 4))):
        length = draw(st.integers(2, 60)) + 0.5  # a shorter lane has no point inside, as in CARLA's planner
        starts = st.lists(st.integers(0, 60).map(lambda metre: metre + 0.25 if metre else 0.0), max_size=4, unique=True)
        marks = starts.flatmap(lambda found: st.tuples(*(st.tuples(st.just(start), WORDS) for start in sorted(found))))
        roads.append(PlainRoad(length, draw(st.lists(marks.map(list), min_size=1, max_size=4))))
    return roads


@given(roads=plain_roads(), data=st.data())
def test_ways_are_those_of_the_twin(roads: list[PlainRoad], data: st.DataObject) -> None:
    begins = np.cumsum([0.0, *(road.length for road in roads)]).tolist()
    places = [(row, number) for row, each_road in enumerate(roads) for number in range(len(each_road.lanes))]
    start, stop = data.draw(st.sampled_from(places)), data.draw(st.sampled_from(places))
    town = lanes(
        *(
            linked(
                row + 1,
                begins[row],
                row or None,
                row + 2 if row + 1 < len(roads) else None,
                "".join(following(-number, *marks) for number, marks in enumerate(each_road.lanes, 1)),
            ).replace('length="100"', f'length="{each_road.length}"')
            for row, each_road in enumerate(roads)
        )
    )
    ends = [
        (begins[row] + data.draw(st.integers(1, int(roads[row].length) - 1)), -1.75 - 3.5 * number, 0.0)
        for row, number in (start, stop)
    ]
    expected = shortest(roads, start, stop)
    planner = RoutePlanner(town)
    if expected is None:
        with pytest.raises(ValueError, match="no lanes lead from position 1 to position 2"):
            planner.route(np.array(ends))
        return
    at = planner.route(np.array(ends))
    visited = [(town.lanes[number].road - 1, -town.lanes[number].id - 1) for number in at.lane.tolist()]
    assert visited[0] == start
    assert visited[-1] == stop
    for before, after in pairwise(visited):
        if before != after:
            is_change = before[0] == after[0] and after[1] in changes(roads[before[0]], before[1])
            assert is_change or after == (before[0] + 1, before[1])
    assert sum(roads[row].length for row in range(start[0], stop[0])) == pytest.approx(expected)


def test_far_positions_are_errors() -> None:
    planner = RoutePlanner(lanes(road()))
    with pytest.raises(ValueError, match="position 2 is far from all lanes for cars"):
        planner.route(np.array([(10.0, -1.75, 0.0), (5000.0, 0.0, 0.0)]))
