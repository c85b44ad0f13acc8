"""The renderer, by geometry: what the images of boxes on a plane must be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from carla_recap.errors import RecapError
from carla_recap.rendering.buffers import Halos
from carla_recap.rendering.camera import Camera
from carla_recap.rendering.renderer import Renderer
from carla_recap.rendering.sky import Sky
from carla_recap.scene.instances import Instances
from carla_recap.scene.materials import Material, Tag
from carla_recap.scene.mesh import Mesh
from tests.rendering.shapes import (
    ALL,
    DEPTH,
    FLOW,
    INSTANCE,
    NORMALS,
    PLANE,
    RGB,
    SEMANTIC,
    Plane,
    boxes,
    camera,
    create,
    cube,
    shape,
    square,
)


@pytest.fixture(scope="module")
def renderer() -> Iterator[Renderer]:
    with create() as renderer:
        yield renderer


def metres(image: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the depths of a depth image in m."""
    blue, green, red = np.moveaxis(image[..., :3].astype(np.float64), -1, 0)
    found: NDArray[np.float64] = (red + 256 * green + 65536 * blue) / (2**24 - 1) * 1000
    return found


def ids(image: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the ids of an instance image."""
    return image[..., 1].astype(np.int64) + 256 * image[..., 0].astype(np.int64)


def extent(mask: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """Return the left, top, right and bottom edge of the pixels of a mask."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def pixel_rays(seen: Camera) -> NDArray[np.float64]:
    """Return the view ray of each pixel's centre, of length 1 along the view axis, (height, width, 3)."""
    x = np.arange(seen.width) + 0.5 - seen.width / 2
    y = np.arange(seen.height) + 0.5 - seen.height / 2
    across, down = np.meshgrid(x / seen.focal_length, y / seen.focal_length)
    return np.stack((np.ones_like(across), -across, -down), axis=-1) @ seen.rotation.T


# --- depth and shape ----------------------------------------------------------------------------------------------------


def test_depth_of_the_ground_and_of_the_sky(renderer: Renderer) -> None:
    seen = camera(pitch=-10, roll=20)
    depths = metres(renderer.draw(seen, None, [DEPTH])[DEPTH])
    rays = pixel_rays(seen)
    with np.errstate(divide="ignore"):
        expected = np.where(rays[..., 2] < 0, -2 / rays[..., 2], np.inf)
    near = expected < 100
    assert near.sum() > 8000
    np.testing.assert_allclose(depths[near], expected[near], rtol=2e-4)
    assert (depths[rays[..., 2] > 0] == 1000).all()


@pytest.mark.parametrize("distance", [2.0, 300.0])
def test_a_box_fills_its_projection_within_a_pixel(renderer: Renderer, distance: float) -> None:
    seen = camera(width=640, height=480, fov=60)
    box = boxes((distance + 1, 0.3, 2.2), half=(1, 0.6, 0.5))
    mask = ids(renderer.draw(seen, box, [INSTANCE])[INSTANCE]) == 0x1234
    corners = np.array([(distance, 0.3 + y, 2.2 + z) for y in (-0.6, 0.6) for z in (-0.5, 0.5)])
    points = seen.project(corners)
    expected = (*points[:, :2].min(axis=0), *points[:, :2].max(axis=0))
    np.testing.assert_allclose(extent(mask), expected, atol=1)
    left, top, right, bottom = extent(mask)
    assert mask[top:bottom, left:right].all()


@pytest.mark.parametrize("distance", [0.11, 0.3, 4000.0])
def test_what_is_as_near_as_a_dash_camera_sees_or_far_away_is_drawn(renderer: Renderer, distance: float) -> None:
    size = distance / 4
    box = boxes((distance + size, 0, 2), half=(size, size, size))
    assert (ids(renderer.draw(camera(), box, [INSTANCE])[INSTANCE]) == 0x1234)[59, 80]


def test_angles_are_those_of_carla(renderer: Renderer) -> None:
    carla = pytest.importorskip("carla", reason="carla is not installed")
    for roll, pitch, yaw in ((0, 0, 30), (0, 25, 0), (15, -10, 40), (-30, 20, -100)):
        transform = carla.Transform(carla.Location(0, 0, 50), carla.Rotation(pitch=pitch, yaw=yaw, roll=roll))
        seen = camera((0, 0, 50), roll=roll, pitch=pitch, yaw=yaw, width=400, height=300)
        point = transform.transform(carla.Location(20, 4, 2))  # 4 m to the right, 2 m up
        box = boxes((point.x, -point.y, point.z), half=(0.2, 0.2, 0.2))
        left, top, right, bottom = extent(ids(renderer.draw(seen, box, [INSTANCE])[INSTANCE]) == 0x1234)
        focal = 400 / 2 / np.tan(np.radians(45))
        assert (left + right) / 2 == pytest.approx(200 + focal * 4 / 20, abs=1.5)
        assert (top + bottom) / 2 == pytest.approx(150 - focal * 2 / 20, abs=1.5)


# --- tags, ids, normals -------------------------------------------------------------------------------------------------


def test_tags_and_ids_are_those_of_what_is_seen(renderer: Renderer) -> None:
    images = renderer.draw(camera(), boxes((10, 0, 2)), [SEMANTIC, INSTANCE])
    for kind in (SEMANTIC, INSTANCE):
        tags = images[kind][..., 2]
        assert (tags[60, 80], tags[110, 80], tags[5, 80]) == (Tag.CAR, Tag.ROADS, Tag.SKY)
        assert (images[kind][..., 3] == 255).all()
    assert not images[SEMANTIC][..., :2].any()
    assert images[INSTANCE][60, 80].tolist() == [0x12, 0x34, Tag.CAR, 255]


def test_edges_of_all_kinds_coincide() -> None:
    with create(quality="low") as renderer:
        box = replace(boxes((10, 1, 2), (16, -3, 1)), colors=np.uint8([(255, 0, 255)] * 2))
        images = renderer.draw(camera(width=320, height=240), box, ALL)
    mask = images[SEMANTIC][..., 2] == Tag.CAR
    assert (mask == (ids(images[INSTANCE]) > 0)).all()
    blue, green, red = np.moveaxis(images[RGB][..., :3].astype(int), -1, 0)
    assert (mask == (np.minimum(blue, red) > green + 40)).all()
    depths = metres(images[DEPTH])
    assert np.where(mask, depths, 1000).min() == pytest.approx(9, abs=0.01)
    sky = images[SEMANTIC][..., 2] == Tag.SKY
    assert (sky == (depths >= 999)).all()


def test_normals_are_in_the_axes_of_the_world_as_carla_has_them(renderer: Renderer) -> None:
    seen = camera((0, -4, 4), yaw=-20, pitch=-10)  # it sees the back, the side to the right (+y of CARLA) and the top
    image = renderer.draw(seen, boxes((8, 0, 1)), [NORMALS, SEMANTIC])
    car = image[SEMANTIC][..., 2] == Tag.CAR
    found = {tuple(each) for each in image[NORMALS][car][:, 2::-1].tolist()}
    sides = ((0, 127.5, 127.5), (127.5, 255, 127.5), (127.5, 127.5, 255))
    nearest = [[np.abs(np.subtract(each, side)).max() <= 1 for side in sides] for each in found]
    assert np.any(nearest, axis=0).all()
    assert np.any(nearest, axis=1).all()
    ground = image[NORMALS][image[SEMANTIC][..., 2] == Tag.ROADS][:, 2::-1]
    assert (np.abs(ground.astype(int) - (127.5, 127.5, 255)) <= 1).all()


# --- optical flow -------------------------------------------------------------------------------------------------------


def flow_in_pixels(image: NDArray[np.float32]) -> NDArray[np.float64]:
    height, width = image.shape[:2]
    return image.astype(np.float64) * (width / 2, -height / 2)


def test_flow_of_a_moving_camera_is_the_motion_of_the_ground_and_the_sky(renderer: Renderer) -> None:
    before, now = camera((0, 0, 2), pitch=-10), camera((0.5, 0.1, 2.1), pitch=-9, yaw=2)
    images = renderer.draw(now, None, [FLOW, DEPTH, SEMANTIC], previous=(before, None))
    depths, rays = metres(images[DEPTH]), pixel_rays(now)
    ground = (images[SEMANTIC][..., 2] == Tag.ROADS) & (depths < 80)
    points = now.location + rays[ground] * depths[ground][:, None]
    expected = (now.project(points) - before.project(points))[:, :2]
    np.testing.assert_allclose(flow_in_pixels(images[FLOW])[ground], expected, atol=0.05)
    sky = images[SEMANTIC][..., 2] == Tag.SKY
    far = now.location + rays[sky] * 1e7
    expected = (now.project(far) - before.project(far))[:, :2]
    np.testing.assert_allclose(flow_in_pixels(images[FLOW])[sky], expected, atol=0.05)


def test_flow_without_a_previous_image_or_of_a_new_actor_is_that_of_the_camera_alone(renderer: Renderer) -> None:
    seen = camera()
    assert np.abs(renderer.draw(seen, boxes((11, 0, 2)), [FLOW])[FLOW]).max() < 1e-5
    known = boxes((30, 20, 2)).take(np.array([0]))
    new = replace(boxes((11, 0, 2)), ids=np.array([7], np.uint32))
    assert np.abs(renderer.draw(seen, new, [FLOW], previous=(seen, known))[FLOW]).max() < 1e-5


# --- what is drawn, and what is not -------------------------------------------------------------------------------------


def test_culled_tiles_and_instances_change_nothing(renderer: Renderer, monkeypatch: pytest.MonkeyPatch) -> None:
    centres = [(float(x), float(y), 1.0) for x in range(-60, 61, 20) for y in range(-60, 61, 20)]
    seen = camera((3, 4, 5), yaw=35, pitch=-12, roll=8)
    culled = renderer.draw(seen, boxes(*centres), ALL)
    view = "carla_recap.rendering.camera_view.CameraView"
    monkeypatch.setattr(f"{view}.sees_boxes", lambda _, bounds: np.ones(len(bounds), np.bool_))
    monkeypatch.setattr(f"{view}.sees_spheres", lambda _, offsets, radii: np.ones(len(offsets), np.bool_))
    whole = renderer.draw(seen, boxes(*centres), ALL)
    assert all((culled[kind] == whole[kind]).all() for kind in ALL)


def test_poses_that_are_not_finite_are_left_out(renderer: Renderer) -> None:
    several = boxes((10, 0, 2), (np.nan, 0, 2), (20, 0, 2), (np.inf, 1, 1))
    several.rotations[2] = np.nan
    images = renderer.draw(camera(), several, ALL, previous=(camera(), several))
    assert set(np.unique(ids(images[INSTANCE]))) == {0, 0x1234}
    nowhere = replace(camera(), location=np.full(3, np.nan))
    assert renderer.draw(nowhere, several, [RGB])[RGB].shape == (120, 160, 4)


def test_a_camera_within_an_actor_sees_what_is_around_it(renderer: Renderer) -> None:
    images = renderer.draw(camera(), boxes((0.5, 0, 2), (10, 0, 2)), [INSTANCE, DEPTH])
    assert ids(images[INSTANCE])[60, 80] == 0x1235
    assert metres(images[DEPTH])[60, 80] == pytest.approx(9, abs=0.01)


def test_without_a_town_there_is_only_sky() -> None:
    for town in (None, Plane([]), Plane([Mesh.empty()])):
        with create(town) as renderer:
            assert (renderer.draw(camera(), boxes(), [SEMANTIC])[SEMANTIC][..., 2] == Tag.SKY).all()


def test_what_can_be_seen_through_shows_what_is_behind(renderer: Renderer) -> None:
    both = boxes((10, 0, 2), (20, 0, 2))
    both.colors[1] = (20, 40, 220)
    alone = renderer.draw(camera(), both, [RGB], without=[0x1234])[RGB][60, 80].astype(int)
    front = renderer.draw(camera(), both, [RGB])[RGB][60, 80].astype(int)
    both.opacity[0] = 0.25
    images = renderer.draw(camera(), both, [RGB, INSTANCE])
    np.testing.assert_allclose(images[RGB][60, 80], 0.75 * alone + 0.25 * front, atol=2)
    assert ids(images[INSTANCE])[60, 80] == 0x1235
    assert (images[RGB][..., 3] == 255).all()


@pytest.mark.parametrize("height", [20, 100])
def test_what_lies_on_a_mark_of_a_collision_is_seen_from_above(renderer: Renderer, height: float) -> None:
    ring = shape(cube(Material.COLLISION_MARK))
    body = boxes((0, 0, 0.2), half=(0.9, 0.3, 0.1))
    mark = replace(boxes((0, 0, 0.03), half=(3, 3, 0.001)), ids=np.array([1], np.uint32), models=np.array([1], np.uint8))
    both = Instances(*(np.concatenate((getattr(body, name), getattr(mark, name))) for name in vars(body)))
    above = camera((0, 0, height), pitch=-90, fov=10)
    with Renderer(PLANE.tiles, models=[shape(cube()), ring]) as with_ring:
        assert ids(with_ring.draw(above, both, [INSTANCE])[INSTANCE])[60, 80] == 0x1234


def test_lit_lamps_light_up_what_is_around_them_but_not_through_what_is_in_front(renderer: Renderer) -> None:
    lamp = replace(boxes((10, 0, 2), half=(0.2, 0.2, 0.2)), models=np.ones(1, np.uint8))
    lit = replace(lamp, lamps=np.array([1 << Material.TAIL_LIGHT], np.uint64))
    night = Sky(sun_altitude=-60)
    dark, glowing = (renderer.draw(camera(), each, [RGB], night)[RGB][..., 2].astype(int) for each in (lamp, lit))
    assert (glowing >= dark).all()
    assert dark[60, 80] < 90 < 200 < glowing[60, 80]
    assert glowing[60, 80 - 3] > dark[60, 80 - 3] + 10
    wall = boxes((5, 0, 2))
    covered = replace(lit, ids=np.array([1], np.uint32))
    both = Instances(*(np.concatenate((a, b)) for a, b in zip(vars(covered).values(), vars(wall).values(), strict=True)))
    alone = renderer.draw(camera(), wall, [RGB], night)[RGB]
    assert (renderer.draw(camera(), both, [RGB], night)[RGB] == alone).all()


def test_a_lamp_that_is_a_closed_body_shines_out_of_its_end_of_the_model() -> None:
    whole = cube(Material.BRAKE_LIGHT)
    lamp = Mesh(0.05 * whole.vertices - np.float32((0.9, 0, 0)), whole.normals, whole.materials, whole.triangles)
    lit = replace(boxes((0, 0, 0)), lamps=np.array([1 << Material.BRAKE_LIGHT], np.uint64))
    halos = Halos([shape(lamp)])
    assert len(halos.around(lit, np.array([(10.0, 0, 0)]), 1.0)) == 1
    assert len(halos.around(lit, np.array([(-10.0, 0, 0)]), 1.0)) == 0


def test_steered_parts_turn_to_the_left_by_a_positive_angle(renderer: Renderer) -> None:
    wheel = replace(boxes((0, 0, 2), half=(1, 0.1, 0.1)), models=np.full(1, 2, np.uint8))
    wheel = replace(wheel, steering=np.array([0.5], np.float32))
    above = camera((0, 0, 12), pitch=-90)  # forward is up in the image, left is left
    mask = ids(renderer.draw(above, wheel, [INSTANCE])[INSTANCE]) == 0x1234
    rows, columns = np.nonzero(mask)
    top = columns[rows == rows.min()].mean()
    assert top < 80 - 2
    assert np.polyfit(-(rows - 60.0), columns - 80.0, 1)[0] == pytest.approx(-np.tan(0.5), abs=0.15)


@pytest.mark.parametrize("quality", ["low", "epic"])
def test_markings_are_seen_far_away_although_they_are_flat(quality: str) -> None:
    line = square(-400, -3, 6, 0.004, Material.WHITE_LINE)
    line.vertices[1:3, 0] = 400
    tiles = [square(x, y, 50) for x in range(-400, 400, 50) for y in (-50, 0)]
    with create(Plane([*tiles, line]), quality=quality) as renderer:
        image = renderer.draw(camera((0, 0, 1.5), width=640, height=480), None, [SEMANTIC])[SEMANTIC][..., 2]
    column = image[:, 320]
    rows = np.flatnonzero(column == Tag.ROAD_LINES)
    assert rows[0] <= 240 + 320 * 1.5 / 300
    assert (column[rows[0] :] == Tag.ROAD_LINES).all()


@pytest.mark.parametrize(("width", "height"), [(0, 10), (10, 9000)])
def test_images_of_impossible_sizes_are_refused(renderer: Renderer, width: int, height: int) -> None:
    with pytest.raises(RecapError, match="along each side"):
        renderer.draw(replace(camera(), width=width, height=height))


def test_an_unknown_quality_is_refused() -> None:
    with pytest.raises(RecapError, match="quality 'high'"):
        Renderer(PLANE.tiles, quality="high")  # type: ignore[arg-type]


def test_supersampling_smooths_the_rgb_image_alone() -> None:
    seen, box = camera(roll=20), boxes((10, 0, 2))
    with create(supersampling=1) as other:
        plain = other.draw(seen, box, ALL)
    with create(supersampling=(3, 1)) as other:
        smooth = other.draw(seen, box, ALL)
    assert all((plain[kind] == smooth[kind]).all() for kind in ALL[1:])
    assert (plain[RGB] != smooth[RGB]).any()
    assert np.abs(plain[RGB].astype(int) - smooth[RGB]).mean() < 3


# --- light --------------------------------------------------------------------------------------------------------------


def test_shadows_are_where_the_sun_does_not_reach() -> None:
    seen, box = camera((0, 0, 30), pitch=-90, width=320, height=240), boxes((0, 0, 1), half=(2, 2, 1))
    sky = Sky(sun_azimuth=90, sun_altitude=45)  # to the right of the image, so that shadows of 2 m fall to the left
    images = {}
    for quality in ("low", "epic"):
        with create(quality=quality) as renderer:
            images[quality] = renderer.draw(seen, box, [RGB], sky)[RGB][120].astype(int).sum(axis=-1)
    pixels = seen.focal_length / 30  # of a metre on the ground
    left, right = (int(160 + side * 3 * pixels) for side in (-1, 1))
    assert images["epic"][left] < 0.85 * images["low"][left]
    assert images["epic"][right] == pytest.approx(images["low"][right], rel=0.2)


def test_a_shadow_is_seen_of_what_is_out_of_view() -> None:
    seen, box = camera((0, 0, 3), width=320, height=240), boxes((8, 10.5, 3), half=(0.5, 0.5, 3))
    sky = Sky(sun_azimuth=-90, sun_altitude=45)  # from the left, where the box is
    with create() as renderer:
        images = renderer.draw(seen, box, ALL, sky)
        assert not ids(images[INSTANCE]).any()
        assert (images[RGB] != renderer.draw(seen, None, [RGB], sky)[RGB]).any()


def test_fog_hides_what_is_far_away(renderer: Renderer) -> None:
    box = boxes((200, 0, 2), half=(20, 20, 20))
    clear, foggy = (renderer.draw(camera(), box, [RGB], Sky(fog=fog))[RGB][56, [80, 0]].astype(int) for fog in (0.0, 1.0))
    assert np.abs(clear[0] - clear[1]).max() > 60
    assert np.abs(foggy[0] - foggy[1]).max() < 12
