"""Routes along lanes, as CARLA's global route planner finds them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from carla_recap.queries.score.route_files import read_routes
from carla_recap.roads.planning import RoutePlanner
from tests.roads.test_waypoints import carla_map, lanes, lanes_of, location, place
from tests.roads.towns import TOWNS, lane, road, section, town

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


@pytest.mark.parametrize("name", ["Town01", "Town10HD"])
def test_the_graph_is_carlas(name: str, carlas_planner: Any) -> None:
    """The edges of both planners have the same ends, in the same order, and the same lengths but for 1 by rounding."""
    path = TOWNS / f"{name}.xodr"
    if not path.exists():
        pytest.skip(f"{path} is not here: it is data that is not part of the repository")
    theirs = carlas_planner(carla_map(path), 1.0)
    vertices = {number: (x, 0.0 - y, z + 0.0) for (x, y, z), number in theirs._id_map.items()}
    ours = RoutePlanner(lanes_of(path))._edges
    assert [vertices[number] for number in theirs._graph.nodes if number >= 0] == list(ours)
    differences = []
    for node, edges in ours.items():
        number = next(number for number, vertex in vertices.items() if vertex == node)
        assert [vertices[other] for other in theirs._graph.successors(number)] == list(edges)
        differences += [
            abs(theirs._graph.edges[number, other]["length"] - edges[vertices[other]].length)
            for other in theirs._graph.successors(number)
        ]
    assert np.count_nonzero(differences) <= 5
    assert max(differences) <= 1


def linked(number: int, x: float, before: int | None, after: int | None, lanes: str) -> str:
    ends = (("predecessor", before), ("successor", after))
    links = "".join(f'<{name} elementType="road" elementId="{id}"/>' for name, id in ends if id is not None)
    return road(number, x=x, sections=section(0, right=lanes)).replace("<planView>", f"<link>{links}</link><planView>")


def following(id: int) -> str:
    link = f'<link><predecessor id="{id}"/><successor id="{id}"/></link>'
    return lane(id).replace("</lane>", f"{link}</lane>")


def test_a_route_has_a_point_each_metre() -> None:
    two = lanes(linked(1, 0, None, 2, following(-1)), linked(2, 100, 1, None, following(-1)))
    at = RoutePlanner(two).route(np.array([(10.0, -1.0, 0.0), (150.0, 0.0, 0.0)]))
    x, y, _ = at.position.T
    assert (x[0], x[-1]) == pytest.approx((10.0, 149.0), abs=1.01)
    assert np.diff(x).max() <= 2.0 + 1e-6  # at the end of a lane
    assert (np.diff(x) >= 0).all()
    assert y == pytest.approx(-1.75)
    assert at.ahead == pytest.approx(np.tile((1.0, 0.0, 0.0), (len(x), 1)), abs=1e-6)


def test_a_route_changes_to_the_lane_beside() -> None:
    both = following(-1) + following(-2)
    two = lanes(linked(1, 0, None, 2, both), linked(2, 100, 1, None, both))
    at = RoutePlanner(two).route(np.array([(10.0, -1.75, 0.0), (150.0, -5.25, 0.0)]))
    assert at.position[0, 1] == pytest.approx(-1.75)
    assert at.position[-1, 1] == pytest.approx(-5.25)
    assert set(np.round(at.position[:, 1], 2).tolist()) == {-1.75, -5.25}


def test_far_positions_and_roads_that_are_not_connected_are_errors() -> None:
    planner = RoutePlanner(lanes(road(1), road(2, y=200)))
    with pytest.raises(ValueError, match="position 2 is far from all lanes for cars"):
        planner.route(np.array([(10.0, -1.75, 0.0), (5000.0, 0.0, 0.0)]))
    with pytest.raises(ValueError, match="no lanes lead from position 1 to position 2"):
        planner.route(np.array([(10.0, -1.75, 0.0), (10.0, 198.25, 0.0)]))
