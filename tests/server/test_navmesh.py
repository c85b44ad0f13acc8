from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

import carla
import numpy as np
import pytest

from carla_recap.server import navmesh
from carla_recap.server.navmesh import mesh_bytes, navigation_files, navigation_mesh
from carla_recap.server.walkways import CORNERS, CROSSWALK, ROAD, SIDEWALK, WalkwayEditor, walkable_surface
from carla_recap.sim.town.loading import BUILT_IN, Town, load_town
from carla_recap.sim.town.sidewalks import WalkwayGraph
from tests.roads.towns import opendrive, road, town
from tests.sim.flat import flat_town

if TYPE_CHECKING:
    from collections.abc import Iterable


pytest.importorskip("carla", reason="the extra carla is not installed")

FROM_THE_MIDDLE = 3.0  # m: so far from the middle of a sidewalk the mesh may be, at corners


@dataclass
class Mesh:
    """A navigation mesh, read back in the way of `dtNavMesh::addTile`."""

    corners: np.ndarray
    polygons: np.ndarray
    details: np.ndarray
    triangles: np.ndarray

    def outline(self, number: int) -> np.ndarray:
        """The corners of a polygon in CARLA's axes."""
        polygon = self.polygons[number]
        return self.corners[polygon["corners"][: polygon["count"]]][:, (0, 2, 1)].astype(float)

    def neighbours(self, number: int, areas: Iterable[int] = (SIDEWALK, CROSSWALK, ROAD)) -> list[int]:
        polygon = self.polygons[number]
        beyond = [int(other) - 1 for other in polygon["neighbours"][: polygon["count"]] if other]
        return [other for other in beyond if self.polygons[other]["area"] in areas]

    def of(self, *areas: int) -> list[int]:
        return np.flatnonzero(np.isin(self.polygons["area"], areas)).tolist()

    def components(self, *areas: int) -> list[set[int]]:
        left, found = set(self.of(*areas)), []
        while left:
            queue = [left.pop()]
            for number in queue:
                new = left & set(self.neighbours(number, areas))
                left -= new
                queue += sorted(new)
            found.append(set(queue))
        return found


def read(data: bytes) -> Mesh:
    place = 0

    def take(dtype: np.dtype, count: int = 1) -> Any:
        nonlocal place
        rows = np.frombuffer(data, dtype, count, place)
        place += rows.nbytes
        assert rows.nbytes % 4 == 0
        return rows

    take(navmesh.SET_HEADER)
    (tile_header,) = take(navmesh.TILE_HEADER)
    assert tile_header["size"] == len(data) - place
    (header,) = take(navmesh.MESH_HEADER)
    corners, polygons = take(navmesh.CORNER, header["corners"]), take(navmesh.POLYGON, header["polygons"])
    take(navmesh.LINK, header["links"])
    details, triangles = take(navmesh.DETAIL, header["details"]), take(navmesh.TRIANGLE, header["triangles"])
    take(navmesh.BOX, header["boxes"])
    assert place == len(data)
    return Mesh(corners, polygons, details, triangles)


@cache
def loaded(name: str) -> Town:
    return load_town() if name == BUILT_IN else load_town(town(name))


@cache
def mesh_of(name: str) -> Mesh:
    return read(navigation_mesh(loaded(name)))


@pytest.fixture(params=(BUILT_IN, "Town01", "Town02", "Town10HD"))
def name(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture
def mesh(name: str) -> Mesh:
    return mesh_of(name)


def graph(
    nodes: list[tuple[float, ...]], *edges: tuple[int, int], crossings: Iterable[tuple[int, int]] = ()
) -> WalkwayGraph:
    pairs = [*edges, *crossings]
    crossing = np.arange(len(pairs)) >= len(edges)
    places = np.array([(*node, 0.0)[:3] for node in nodes], float).reshape(-1, 3)
    return WalkwayGraph(places, np.array(pairs, np.int64).reshape(-1, 2), crossing)


def built(walks: WalkwayGraph) -> Mesh:
    ways = WalkwayEditor(walks)
    ways.loosen()
    ways.straighten()
    return read(mesh_bytes(walkable_surface(ways)))


def turns(outline: np.ndarray) -> np.ndarray:
    """The sines of the angles at the corners of a polygon, times the lengths of its sides."""
    ahead = np.roll(outline, -1, axis=0)[:, :2] - outline[:, :2]
    behind = np.roll(ahead, 1, axis=0)
    return behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0]


def distance(outline: np.ndarray, place: np.ndarray) -> float:
    """How far a place is from a convex polygon, seen from above."""
    start, end = outline[:, :2], np.roll(outline, -1, axis=0)[:, :2]
    side, away = end - start, place[:2] - start
    if (side[:, 0] * away[:, 1] - side[:, 1] * away[:, 0] <= 0).all():
        return 0.0
    share = np.clip((away * side).sum(axis=1) / (side**2).sum(axis=1), 0, 1)
    return float(np.hypot(*(away - share[:, None] * side).T).min())


def test_polygons_are_convex_turn_as_detour_wants_and_are_filled_with_triangles(mesh: Mesh) -> None:
    assert (mesh.polygons["flags"] == 1 << mesh.polygons["area"]).all()
    for number, (polygon, detail) in enumerate(zip(mesh.polygons, mesh.details, strict=True)):
        assert 3 <= polygon["count"] <= CORNERS
        assert (turns(mesh.outline(number)) < 1e-3).all()
        rows = mesh.triangles[detail["triangle"] : detail["triangle"] + detail["triangles"]]
        outline = mesh.outline(number)[:, :2]
        around = np.roll(outline, -1, axis=0)
        area = sum(np.linalg.det(outline[row[1:3]] - outline[row[0]]) for row in rows)
        assert area == pytest.approx((outline[:, 0] * around[:, 1] - outline[:, 1] * around[:, 0]).sum(), rel=1e-3)
        assert sum(int(row[3]) >> shift & 1 for row in rows for shift in (0, 2, 4)) == polygon["count"]


def test_neighbours_share_a_side(mesh: Mesh) -> None:
    for number, polygon in enumerate(mesh.polygons):
        corners = polygon["corners"][: polygon["count"]].tolist()
        for side, other in zip(pairwise([*corners, corners[0]]), polygon["neighbours"], strict=False):
            if other:
                beyond = mesh.polygons[other - 1]
                around = beyond["corners"][: beyond["count"]].tolist()
                assert side[::-1] in pairwise([*around, around[0]])
                assert number in mesh.neighbours(other - 1)


def test_all_of_the_walks_is_there_and_hangs_together(name: str, mesh: Mesh) -> None:
    walks = loaded(name).walks
    assert len(mesh.components(SIDEWALK, CROSSWALK)) == 1
    outlines = [mesh.outline(number) for number in mesh.of(SIDEWALK, CROSSWALK)]
    middles = np.array([outline.mean(axis=0) for outline in outlines])
    reach = np.array(
        [np.linalg.norm(outline - middle, axis=1).max() for outline, middle in zip(outlines, middles, strict=True)]
    )
    for node in walks.nodes:
        near = np.flatnonzero(np.linalg.norm(middles - node, axis=1) < reach + FROM_THE_MIDDLE)
        best = min(near, key=lambda number: distance(outlines[number], node))
        assert distance(outlines[best], node) < FROM_THE_MIDDLE
        assert outlines[best][:, 2].min() - 0.5 < node[2] < outlines[best][:, 2].max() + 0.5


def test_crossings_join_both_sides(name: str, mesh: Mesh) -> None:
    crossings = mesh.of(CROSSWALK)
    assert len(crossings) == loaded(name).walks.crossing.sum()
    assert all(len(set(mesh.neighbours(number))) >= 2 for number in crossings)
    assert len(mesh.components(SIDEWALK)) > 1  # each block of houses has its own sidewalk


def test_ways_over_roads_lead_over_lanes(name: str, mesh: Mesh) -> None:
    roads, where = mesh.of(ROAD), loaded(name)
    assert len(roads) > 20
    for number in roads:
        assert len(mesh.neighbours(number, (SIDEWALK,))) == 2
        a, b = mesh.outline(number)[[0, 2]]
        line = a + np.linspace(0, 1, 21)[:, None] * (b - a)
        lanes, s = where.nearest_lane(*line[:, :2].T)
        _, aside = where.project(lanes, *line[:, :2].T, s)
        assert (np.abs(aside) < 2).mean() > 0.25


def test_file_is_named_after_what_is_in_it() -> None:
    ((name, data),) = navigation_files(loaded(BUILT_IN)).items()
    path = PurePosixPath(name)
    assert data == navigation_mesh(loaded(BUILT_IN))
    assert not path.is_absolute()
    assert path.parts[0] == "carla-recap"  # the client's folder of files is that of CARLA's own maps as well
    ((other, _),) = navigation_files(loaded("Town01")).items()
    assert other != name


def test_town_without_sidewalks_has_no_mesh(tmp_path: Any) -> None:
    path = tmp_path / "plain.xodr"
    path.write_text(opendrive(road()))
    plain = load_town(path)
    assert navigation_mesh(plain) == b""
    assert navigation_files(plain) == {}


def test_more_than_a_tile_can_hold_has_no_mesh() -> None:
    count = navmesh.MOST // 2 + 2
    nodes = [(4.0 * number, float(number % 2)) for number in range(count)]
    assert mesh_bytes(walkable_surface(WalkwayEditor(graph(nodes, *pairwise(range(count)))))) == b""
    flat = flat_town()
    flat.walks = graph(nodes * 2, *pairwise(range(2 * count)))
    assert navigation_mesh(flat) == b""


def test_straight_way_is_one_strip() -> None:
    mesh = built(graph([(5.0 * number, 0) for number in range(21)], *pairwise(range(21))))
    (outline,) = (mesh.outline(number) for number in range(len(mesh.polygons)))
    assert np.abs(outline[:, 1]) == pytest.approx(np.ones(4))
    assert np.sort(outline[:, 0]) == pytest.approx([0, 0, 100, 100], abs=1e-4)


def test_slope_is_kept() -> None:
    mesh = built(graph([(0, 0, 0), (20, 0, 0), (40, 0, 2), (60, 0, 2)], (0, 1), (1, 2), (2, 3)))
    assert len(mesh.polygons) == 3
    assert sorted({round(float(height), 3) for height in mesh.corners[:, 1]}) == [0, 2]


@pytest.mark.parametrize("ways", [3, 4, 6, 7, 12])
def test_meetings_of_many_ways(ways: int) -> None:
    angles = np.arange(ways) * 2 * np.pi / ways
    nodes = [(0.0, 0.0), *((30 * np.cos(angle), 30 * np.sin(angle)) for angle in angles)]
    mesh = read(mesh_bytes(walkable_surface(WalkwayEditor(graph(nodes, *((0, number + 1) for number in range(ways)))))))
    assert len(mesh.components(SIDEWALK)) == 1
    assert sum(len(mesh.neighbours(number)) == 1 for number in range(len(mesh.polygons))) == ways
    assert all((turns(mesh.outline(number)) < 1e-3).all() for number in range(len(mesh.polygons)))


def test_sharp_bends_and_places_that_are_one_stay_convex() -> None:
    zigzag = [(0, 0), (10, 0), (1, 3), (10, 6), (0, 6), (0, 6), (0, 6.1), (-9, 6)]
    mesh = built(graph(zigzag, *pairwise(range(len(zigzag)))))
    assert len(mesh.components(SIDEWALK)) == 1
    assert all((turns(mesh.outline(number)) < 1e-3).all() for number in range(len(mesh.polygons)))


# --- walkers of the official client ----------------------------------------------------------------------------------------


WALKERS = 8
SPEED = 1.4  # m/s
SECONDS = 12


@pytest.fixture
def steered(world: carla.World) -> list[carla.Walker]:
    """Walkers on their way to random places."""
    world.set_pedestrians_seed(1)
    world.set_pedestrians_cross_factor(0.0)
    blueprints = world.get_blueprint_library()
    kinds = blueprints.filter("walker.pedestrian.*")
    walkers = []
    while len(walkers) < WALKERS:
        place = world.get_random_location_from_navigation()
        place.z += 1
        walker = world.try_spawn_actor(kinds[len(walkers)], carla.Transform(place))
        if walker is not None:
            walkers.append(walker)
    world.tick()
    controller = blueprints.find("controller.ai.walker")
    controllers = [world.spawn_actor(controller, carla.Transform(), attach_to=walker) for walker in walkers]
    world.tick()
    for each in controllers:
        each.start()
        each.go_to_location(world.get_random_location_from_navigation())
        each.set_max_speed(SPEED)
    return walkers


def test_walkers_walk_on_sidewalks_and_crossings(world: carla.World, steered: list[carla.Walker]) -> None:
    tracks = []
    for _ in range(20 * SECONDS):
        world.tick()
        tracks.append([(place.x, place.y, place.z) for place in (walker.get_location() for walker in steered)])
    places = np.array(tracks)
    town = load_town()
    walks = town.walks
    starts, ends = walks.nodes[walks.edges].transpose(1, 0, 2)[..., :2]
    for number, walker in enumerate(steered):
        track = places[20:, number]
        walked = np.linalg.norm(np.diff(track, axis=0), axis=1)
        assert walked.max() < 1.2 * SPEED / 20
        assert walked.sum() > SPEED * SECONDS / 4  # they wait before crossings
        for x, y, _ in track[::20]:
            share = ((x, y) - starts) * (ends - starts)
            share = np.clip(share.sum(axis=1) / ((ends - starts) ** 2).sum(axis=1), 0, 1)
            assert np.hypot(*((x, y) - starts - share[:, None] * (ends - starts)).T).min() < FROM_THE_MIDDLE
        ground = town.height(track[:, 0], track[:, 1])
        assert np.abs(track[:, 2] - ground - walker.bounding_box.extent.z).max() < 0.5
    assert np.linalg.norm(places[-1] - places[0], axis=1).max() > SPEED * SECONDS / 3
