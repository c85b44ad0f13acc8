"""The surfaces of towns, by their areas, heights and materials."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carla_recap
import carla_recap.town.mesh as town_module
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.model.records import ActorKind, Spawn
from carla_recap.roads import RoadMap
from carla_recap.scene.materials import Material
from carla_recap.scene.mesh import Mesh
from carla_recap.town.building import TriangleGrid
from carla_recap.town.mesh import TownMesh, build_town, load_town_of, town_mesh_of, town_of_map
from carla_recap.util import cache
from tests.roads.towns import crossing, crossing_by_road, lane, opendrive, painted_stop, road, stop_sign
from tests.roads.towns import section as plain_section
from tests.roads.towns import town as carla_town


def section(s: float, left: str = "", right: str = "", centre: str = "none") -> str:
    mark = (
        f'<lane id="0" type="none" level="false"><roadMark sOffset="0" type="{centre}" color="white" width="0.12"/></lane>'
    )
    return plain_section(s, left, right).replace('<lane id="0" type="none" level="false"/>', mark)


def built(*roads: str) -> TownMesh:
    return TownMesh("", *build_town(opendrive(*roads)))


def faces(town: TownMesh, *materials: Material) -> np.ndarray:
    """Return the triangles of materials: (triangles, 3, 3)."""
    mesh = Mesh.concatenate(town.tiles)
    return mesh.vertices[mesh.triangles[np.isin(mesh.materials[mesh.triangles[:, 0]], materials)]].astype(np.float64)


def area(triangles: np.ndarray) -> float:
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return float(np.linalg.norm(across, axis=1).sum() / 2)


YELLOW = lane(-1).replace("</lane>", '<roadMark sOffset="0" type="solid" color="yellow" width="0.2"/></lane>')
JOINED = [
    road(1, junction=9, sections=section(0, right=lane(-1), centre="solid solid")),
    road(2, junction=9, sections=section(0, lane(1), centre="solid solid")),
]


@pytest.mark.parametrize(
    ("roads", "material", "expected"),
    [
        (
            [road(length=20 * np.pi, shape='<arc curvature="0.05"/>', sections=section(0, right=lane(-1)))],
            Material.ROAD,
            np.pi / 2 * (23.5**2 - 20**2),
        ),
        ([road(sections=section(0, right=YELLOW + lane(-2)))], Material.YELLOW_LINE, 100 * 0.2),
        ([road(sections=section(0, right=YELLOW + lane(-2)))], Material.WHITE_LINE, 0),
        (JOINED, Material.WHITE_LINE, 2 * 100 * 0.12),
        ([road(inside=painted_stop(80, -1.75, 3.0) + stop_sign(82, -1, -1))], Material.STOP_LINE, 2.8 * 0.4),
    ],
    ids=["a bend", "yellow", "not white", "between two roads of a junction, once", "a stop line that is painted, once"],
)
def test_surfaces_and_lines_have_their_areas(roads: list[str], material: Material, expected: float) -> None:
    assert area(faces(built(*roads), material)) == pytest.approx(expected, rel=2e-3)


def test_a_sidewalk_is_above_the_road():
    walk = built(road(height=3, sections=section(0, right=lane(-1) + lane(-2, 2, "sidewalk"))))
    assert walk.ground_height(np.array([[50, -1.75], [50, -4.5]])) == pytest.approx([3, 3.12], abs=1e-4)


def test_the_ground_around_is_just_below_the_road():
    town = built(road(height=3))
    around = town.ground_height(np.array([[50.0, 40.0], [50.0, -200.0]]))
    assert ((around > 2.8) & (around < 3)).all()


def test_all_faces_are_seen_from_the_side_of_their_normals():
    right = lane(-1) + lane(-2, 1, "shoulder") + lane(-3, 2, "sidewalk")
    mesh = Mesh.concatenate(built(road(sections=section(0, lane(1) + lane(2, 2, "sidewalk"), right))).tiles)
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles].astype(np.float64), 1, 0)
    normals = mesh.normals[mesh.triangles].mean(axis=1)
    assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), normals) > 0).all()


def test_a_road_with_invalid_numbers_is_an_error():
    with pytest.raises(ValueError, match="road '2': geometry: x: expected a number below 1,000,000,000, found 'nan'"):
        built(road(1), road(2, x="nan"))


def test_the_same_map_gives_the_same_bytes():
    text = opendrive(road(shape='<arc curvature="0.01"/>'))
    (first, _), (second, _) = build_town(text), build_town(text)
    for one, other in zip(first, second, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(vars(one).values(), vars(other).values(), strict=True))


@pytest.mark.parametrize("text", ["", "no map", "<html/>", opendrive()])
def test_what_is_no_map_is_refused(text: str):
    with pytest.raises(RecapError, match="an OpenDRIVE map was expected"):
        town_mesh_of(text)


def test_dashes_are_a_third_of_a_line_and_every_nine_metres():
    dashes = faces(built(road(length=90, sections=section(0, lane(1), lane(-1), "broken"))), Material.WHITE_LINE)
    stations = dashes[..., 0].ravel()
    starts = [stations[stations // 9 == number].min() for number in range(10)]
    assert stations.max() == pytest.approx(87, abs=0.01)
    assert area(dashes) == pytest.approx(10 * 3 * 0.12, rel=1e-3)
    assert starts == pytest.approx(3 + 9 * np.arange(10), abs=0.01)


def test_a_double_line_is_two_lines_around_the_border():
    lines = faces(built(road(sections=section(0, lane(1), lane(-1), "solid solid"))), Material.WHITE_LINE)
    assert area(lines) == pytest.approx(2 * 100 * 0.12, rel=1e-3)
    assert np.unique(np.round(lines[..., 1], 2)).tolist() == [-0.18, -0.06, 0.06, 0.18]


def test_the_broken_half_of_a_double_line_is_on_its_side():
    lines = faces(built(road(length=90, sections=section(0, lane(1), lane(-1), "solid broken"))), Material.WHITE_LINE)
    left = lines[lines[..., 1].mean(axis=1) > 0]
    assert area(left) == pytest.approx(90 * 0.12, rel=1e-3)
    assert area(lines) - area(left) == pytest.approx(30 * 0.12, rel=1e-3)


def test_a_crossing_may_have_corners_along_the_road():
    by_road, local = (faces(built(road(inside=made(50))), Material.CROSSING) for made in (crossing_by_road, crossing))
    assert len(by_road) == len(local)
    assert np.sort(by_road.reshape(-1, 3), axis=0) == pytest.approx(np.sort(local.reshape(-1, 3), axis=0), abs=1e-4)


def test_a_crossing_is_bars_in_the_direction_of_cars():
    bars = faces(built(road(inside=crossing(50))), Material.CROSSING)
    assert area(bars) == pytest.approx(5 * 0.5 * 4, rel=1e-3)  # and one at each end that is not on the road as a whole
    assert np.ptp(bars[..., 0]) == pytest.approx(4, abs=0.01)


def test_a_stop_sign_has_a_line_before_it():
    lines = faces(built(road(inside=stop_sign(80, -1, -1))), Material.STOP_LINE)
    assert lines[..., 0].max() == pytest.approx(79.7, abs=0.01)
    assert (lines[..., 1] < 0).all()


def test_gaps_in_a_junction_are_filled():
    one_way = section(0, right=lane(-1))
    town = built(
        road(2, x=100, length=20, junction=9, sections=one_way),
        road(3, x=100, length=20.05, junction=9, shape='<arc curvature="0.01"/>', sections=one_way),
        road(4, x=120.0, y=-8.0, heading=np.pi / 2, length=16, junction=9, sections=one_way),
    )
    x, y = np.meshgrid(np.linspace(101, 123, 60), np.linspace(-3, -1, 10))
    heights = town.ground_height(np.stack((x.ravel(), y.ravel()), axis=1))
    assert heights.min() > -0.02


def test_a_bridge_is_above_the_road_that_it_crosses():
    town = built(road(1, height=6), road(2, x=50, y=-50, heading=np.pi / 2))
    point = np.array([[51.75, 1.75]])
    assert town.ground_height(point) == pytest.approx([6], abs=1e-4)
    assert town.ground_height(np.column_stack((point, [1.0]))) == pytest.approx([0], abs=1e-4)
    assert faces(town, Material.BRIDGE)[..., 2].min() == pytest.approx(5.2, abs=0.01)


def test_a_sidewalk_around_a_sharp_corner_faces_up():
    """Its inner border is the middle of the bend."""
    around = '<laneOffset s="0" a="4" b="0" c="0" d="0"/>' + section(0, right=lane(-1).replace("driving", "sidewalk"))
    bend = road(length=2 * np.pi, shape='<arc curvature="0.25"/>', sections=around)
    town = built(bend.replace('b="0" c="0" d="0"/></elevationProfile>', 'b="0.02" c="0" d="0"/></elevationProfile>'))
    mesh = Mesh.concatenate(town.tiles)
    normals = mesh.normals[mesh.materials == Material.SIDEWALK]
    assert len(normals)
    assert normals[:, 2].min() > 0.999


def test_slopes_do_not_reach_onto_roads():
    slope = '<elevation s="0" a="0" b="0.08" c="0" d="0"/>'
    hilly = road().replace('<elevation s="0" a="0" b="0" c="0" d="0"/>', slope)
    town = built(hilly, road(2, y=-9, sections=section(0, right=lane(-1))))
    stations = np.linspace(0.5, 99.5, 200)
    for offset in (-3.3, -1.75, 0.3, 3.3):
        points = np.column_stack((stations, np.full(200, offset)))
        assert np.abs(town.ground_height(points) - 0.08 * stations).max() < 0.02


def test_a_speed_limit_stands_beside_the_road_and_shows_its_number():
    signal = (
        '<signals><signal name="" id="3" s="50" t="-5" zOffset="2" hOffset="0" orientation="+" dynamic="no"'
        ' country="" type="274" subtype="-1" value="30"/></signals>'
    )
    town = built(road(inside=signal))
    ring = faces(town, Material.SIGN_RED)
    assert area(ring) == pytest.approx(np.pi * 0.38**2, rel=0.05)
    assert ring[..., 0].max() < 50  # towards cars that come along the road
    assert ring[..., 1].mean() == pytest.approx(-5, abs=0.1)
    assert len(faces(town, Material.SIGN_BLACK)) == 2 * (5 + 6)  # two triangles for each stroke


@pytest.mark.parametrize(
    "place",
    ['s="50" t="-5" hOffset="0"/>', 's="9" t="9" hOffset="1"><positionInertial x="50" y="-5" z="3" hdg="0"/></signal>'],
)
def test_a_traffic_light_has_its_foot_on_the_ground_and_faces_the_cars(place):
    signal = (
        '<signals><signal name="" id="77" zOffset="-0.5" orientation="+" dynamic="yes"'
        f' country="" type="1000001" subtype="-1" value="-1" {place}</signals>'
    )
    walk = section(0, right=lane(-1) + lane(-2, 3, "sidewalk"))
    (light,) = built(road(height=2, sections=walk, inside=signal)).lights
    assert light.id == "77"
    assert light.location == pytest.approx([50, -5, 2.12], abs=1e-3)
    assert light.heading % (2 * np.pi) == pytest.approx(np.pi)


@pytest.mark.parametrize(
    "roads",
    [
        [road(length=4e4)],
        [road(x=1e300)],
        [road(sections=section(0, right=lane(-1, 1e8)))],
        [road(1), road(2, x=9e5)],
        [road(sections=section(0, right="".join(lane(-n) for n in range(1, 300))))],
        [road(shape='<arc curvature="1e6"/>')],
        [road(inside=crossing(1e9))],
    ],
)
@pytest.mark.filterwarnings("ignore:of a map of:carla_recap.RecapWarning")
def test_hostile_maps_end_soon(roads: list[str]):
    start = time.process_time()
    with suppress(ValueError):  # numbers of no road
        built(*roads)
    assert time.process_time() - start < 20


def test_a_town_is_made_once_and_read_from_the_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made = []
    make = town_module.build_town

    def counted(text: str) -> Any:
        made.append(text)
        return make(text)

    monkeypatch.setattr(town_module, "build_town", counted)
    monkeypatch.setenv(cache.FOLDER, str(tmp_path))
    text = opendrive(road())
    meshes = []
    for _ in range(2):
        town_module._town_mesh.cache_clear()
        meshes.append(town_mesh_of(text, "small"))
    assert len(made) == 1
    assert town_mesh_of(text, "small") is meshes[1]
    assert meshes[1].name == "small"
    assert [len(tile.triangles) for tile in meshes[0].tiles] == [len(tile.triangles) for tile in meshes[1].tiles]
    (entry,) = tmp_path.iterdir()
    entry.write_bytes(entry.read_bytes()[:-1])
    town_module._town_mesh.cache_clear()
    assert town_mesh_of(text).tiles
    assert len(made) == 2


def test_trees_stand_clear_of_roads_and_junctions():
    walk = section(0, lane(1) + lane(2, 3, "sidewalk"), lane(-1))
    town = built(
        road(1, length=400, sections=walk),
        road(2, x=400, length=20, junction=9, sections=walk),
        road(3, x=420, length=300, sections=walk),
    )
    trees = faces(town, Material.FOLIAGE, Material.TRUNK).reshape(-1, 3)
    assert len(trees)
    beyond = np.maximum(-trees[:, 0], trees[:, 0] - 720)
    beside = np.maximum(trees[:, 1] - 6.5, -3.5 - trees[:, 1])
    assert np.maximum(beyond, beside).min() > 4
    assert beside[np.abs(trees[:, 0] - 410) < 10].min(initial=np.inf) > 15
    grass = town.ground_height(trees[:, :2])
    assert (trees[:, 2] - grass).min() > -1


def test_corridors_have_no_trees(tmp_path):
    path = tmp_path / "driven.mcap"
    with carla_recap.create_recording(path, map_name="Nowhere", date=0) as recording:
        for frame in range(300):
            spawned = [Spawn(1, ActorKind.VEHICLE, type_id="vehicle.audi.tt")] if frame == 0 else []
            recording.add_frame(frame / 10, spawned=spawned, transforms=[{"id": 1, "x": 150.0 * frame}])
    with carla_recap.open_recording(path) as recording:
        town = load_town_of(recording)
    assert not len(faces(town, Material.FOLIAGE))
    assert area(faces(town, Material.ROAD)) == pytest.approx((1.5 * 299 + 8) * 3.5, rel=0.01)


@pytest.mark.parametrize("name", ["Town01", "Town10HD"])
def test_the_lanes_of_carlas_towns_have_road_beneath_them_and_lines_upon_them(name: str):
    carla = pytest.importorskip("carla", reason="the extra carla is not installed")
    text = carla_town(name).read_text()
    waypoints = carla.Map("", text).generate_waypoints(2.0)
    points = np.array([(w.transform.location.x, -w.transform.location.y, w.transform.location.z) for w in waypoints])
    town = TownMesh(name, *build_town(text))
    assert np.abs(town.ground_height(points) - points[:, 2]).max() < 0.05
    paved = surface(town, Material.ROAD, Material.JUNCTION, Material.SHOULDER, Material.MEDIAN, Material.SIDEWALK)
    painted = faces(town, Material.WHITE_LINE, Material.YELLOW_LINE, Material.CROSSING, Material.STOP_LINE).mean(axis=1)
    above = painted[:, 2] - paved.highest(painted, 0.0)
    assert not np.isnan(above).any()
    assert np.quantile(above, 0.99) < 0.03


def surface(town: TownMesh, *materials: Material) -> TriangleGrid:
    triangles = faces(town, *materials)
    return TriangleGrid(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))


def test_roads_far_apart_have_ground_around_them_alone():
    with pytest.warns(RecapWarning, match="the ground is known to"):
        town = built(*(road(number, x=4e3 * number, y=-4e3 * number) for number in range(1, 61)))
    assert len(town.tiles) < 2000
    grass = faces(town, Material.GRASS)
    assert len(grass) < 20_000
    assert np.isfinite(town.ground_height(np.array([(4e3 * number + 50, -4e3 * number - 50) for number in (1, 60)]))).all()


def test_a_map_without_lanes_has_no_surfaces():
    roads = RoadMap("odd", [], [], [], [], [], opendrive="<OpenDRIVE></OpenDRIVE>")
    with pytest.warns(RecapWarning, match="the roads have no surfaces"):
        assert town_of_map(roads) is None
    assert town_of_map(None) is None


def test_what_stops_cars_is_seen():
    """Fences are behind sidewalks, and guard rails beside roads without one."""
    town = built(road(sections=section(0, lane(2).replace("driving", "sidewalk") + lane(1), lane(-1))))
    fence, rail = faces(town, Material.FENCE), faces(town, Material.GUARD_RAIL)
    assert fence[..., 1] == pytest.approx(7 + 0.75, abs=0.1)
    assert rail[..., 1] == pytest.approx(-3.5 - 4, abs=0.1)
    assert np.ptp(fence[..., 0]) == pytest.approx(100, abs=3)
    assert 0.7 < rail[..., 2].max() < 0.8
    assert 1.0 < fence[..., 2].max() < 1.1
