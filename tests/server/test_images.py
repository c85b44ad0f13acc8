"""Images of cameras on their way from what draws them to their subscribers."""

from __future__ import annotations

import asyncio
import struct
import threading
from concurrent.futures import wait
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.rendering.camera import ImageKind
from carla_recap.scene.materials import Material, Tag
from carla_recap.server.host import Host
from carla_recap.server.rpc.structs import EpisodeSettings
from carla_recap.server.sensors import dispatch, surfaces
from carla_recap.server.sensors.drawn_actors import WorldActors
from carla_recap.server.sensors.images import ImagesUnavailable, blank_images
from carla_recap.server.sensors.surfaces import TownSurfaces
from carla_recap.sim.actors.moving import Vehicle, VehicleControl
from carla_recap.sim.geometry import Transform
from carla_recap.sim.world import World
from carla_recap.town.mesh import TownMesh
from tests.server.inside import client_inside
from tests.server.listening import sensor, vehicle
from tests.sim.flat import at, flat_town, flat_world
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from carla_recap.server.sensors.images import View
    from carla_recap.sim.town.loading import Town

SMALL = {"image_size_x": "32", "image_size_y": "16", "fov": "70"}
SYNCHRONOUS = EpisodeSettings(synchronous_mode=True, fixed_delta_seconds=0.05)


class Painter:
    """Draws images in which each pixel is the number of the image; it can be held up."""

    missing: Exception | None = None  # why it cannot be opened

    def __init__(self) -> None:
        self.views: list[View] = []  # that it has drawn
        self.go = threading.Event()  # while it is not set, nothing is drawn
        self.go.set()
        self.errors: list[Exception] = []  # of the next images
        self.closed = False

    def draw(self, view: View) -> Mapping[ImageKind, Any]:
        assert self.go.wait(PATIENCE)
        if self.errors:
            raise self.errors.pop(0)
        self.views.append(view)
        images = {kind: image.copy() for kind, image in blank_images(view).items()}
        if ImageKind.RGB in images:
            images[ImageKind.RGB][...] = len(self.views)
        return images

    def close(self) -> None:
        self.closed = True


class Served:
    """A host in synchronous mode whose cameras are drawn by a painter; it needs an event loop."""

    def __init__(self) -> None:
        self.host = Host(flat_world())
        self.host.apply_settings(SYNCHRONOUS)

    async def tick(self) -> int:
        """Tick as a client does."""
        if pending := self.host.sensors.pending():
            await asyncio.wait(pending)
        return self.host.tick()

    async def settle(self) -> None:
        """Wait until all images have been sent."""
        async with asyncio.timeout(PATIENCE):
            while self.host.sensors._images.is_busy:
                await asyncio.sleep(0.005)

    async def draw(self, ticks: int = 1) -> int:
        """Tick some times, each time waiting until all images have been sent; return the last frame."""
        for _ in range(ticks):
            frame = await self.tick()
            await self.settle()
        return frame


@pytest.fixture
def painter() -> Painter:
    return Painter()


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch, painter: Painter) -> Iterator[Served]:
    def opened(*_: object) -> Painter:
        if painter.missing is not None:
            raise painter.missing
        return painter

    monkeypatch.setattr(dispatch, "DrawnImages", opened)
    served = Served()
    yield served
    served.host.close()


@pytest.mark.parametrize(
    ("camera", "number", "pixel"),
    [
        ("rgb", 13, bytes((128, 128, 128, 255))),
        ("depth", 1, bytes((255, 255, 255, 255))),
        ("semantic_segmentation", 14, bytes((0, 0, 0, 255))),
        ("optical_flow", 8, bytes(8)),
        ("cosmos_visualization", 16, bytes((128, 128, 128, 255))),
        ("dvs", 3, b""),
    ],
)
async def test_without_the_extra_images_are_blank_and_the_log_says_why_once(
    camera: str, number: int, pixel: bytes, served: Served, painter: Painter, caplog: pytest.LogCaptureFixture
) -> None:
    painter.missing = MissingExtra("images of cameras", "cameras")
    images = sensor(served.host, f"camera.{camera}", **SMALL)
    await served.draw(3)
    first, *others = images.take()
    assert first[0][0] == number
    assert struct.unpack("<IIf", first[1][:12]) == (32, 16, 70.0)
    assert first[1][12:] == pixel * 512
    assert len(others) == 2
    assert caplog.messages == ([] if camera == "cosmos_visualization" else [f"cameras are blank: {painter.missing}"])


async def test_each_tick_has_its_image_with_its_frame_time_and_transform(served: Served) -> None:
    car = vehicle(served.host)
    images = sensor(served.host, "camera.rgb", car, at(1.0, z=2.0), **SMALL)
    expected = []
    for step in range(50):
        car.transform = at(float(step), 3.0, 90.0)
        frame = await served.tick()
        expected.append((frame, served.host.world.elapsed, step))
    await served.settle()
    found = images.take()
    assert [(header[1], header[2]) for header, _ in found] == [(frame, time) for frame, time, _ in expected]
    for (header, payload), (_, _, step) in zip(found, expected, strict=True):
        assert header[3:] == pytest.approx((step, 4.0, 2.0, 0.0, 90.0, 0.0), abs=1e-4)
        assert payload[12] == step + 1


async def test_a_tick_waits_for_the_images_of_the_ones_before(served: Served, painter: Painter) -> None:
    sensor(served.host, "camera.rgb", **SMALL)
    await served.tick()
    painter.go.clear()
    await served.tick()
    await served.tick()
    pending = served.host.sensors.pending()
    assert pending
    painter.go.set()
    await asyncio.wait_for(asyncio.wait(pending), PATIENCE)
    await served.settle()
    assert not served.host.sensors.pending()


async def test_in_asynchronous_mode_images_are_left_out_while_others_are_drawn(served: Served, painter: Painter) -> None:
    served.host.apply_settings(EpisodeSettings())
    often = sensor(served.host, "camera.rgb", **SMALL)
    seldom = sensor(served.host, "camera.depth", **SMALL, sensor_tick="0.15")
    await served.draw()
    begin = await served.draw()
    often.take(), seldom.take()
    painter.go.clear()
    for _ in range(4):  # the second camera ticks in one of them
        served.host.tick(0.05)
    painter.go.set()
    await served.settle()
    last = served.host.tick(0.05)
    await served.settle()
    assert [header[1] for header, _ in often.take()] == [begin + 1, last]
    assert [header[1] for header, _ in seldom.take()] == [last]  # late, but not lost


async def test_cameras_of_one_pose_are_drawn_together(served: Served, painter: Painter) -> None:
    car = vehicle(served.host)
    same = [sensor(served.host, f"camera.{kind}", car, at(3.0), **SMALL) for kind in ("rgb", "depth", "optical_flow")]
    other = sensor(served.host, "camera.depth", car, at(3.5), **SMALL)
    wide = sensor(served.host, "camera.depth", car, at(3.0), **{**SMALL, "fov": "71"})
    await served.draw(3)
    assert [len(listener.take()) for listener in (*same, other, wide)] == [3] * 5
    kinds = [set(view.kinds) for view in painter.views]
    assert len(kinds) == 9
    assert kinds.count({ImageKind.RGB, ImageKind.DEPTH, ImageKind.FLOW}) == 3
    flows = [view for view in painter.views if ImageKind.FLOW in view.kinds]
    assert [view.previous for view in flows] == [None, flows[0].scene, flows[1].scene]


@pytest.mark.parametrize(("side", "closed"), [(16, False), (2500, True)])
async def test_what_has_drawn_large_images_is_closed_with_the_last_camera(
    served: Served, painter: Painter, side: int, closed: bool
) -> None:
    car = vehicle(served.host)
    size = {"image_size_x": str(side), "image_size_y": str(side)}
    for _ in range(2):
        sensor(served.host, "camera.depth", car, **size)
    for _ in range(2):
        await served.draw()
        assert not painter.closed
        car.children[0].destroy()
    await served.tick()
    images = sensor(served.host, "camera.rgb", car, **SMALL)
    await served.draw()
    assert painter.closed == closed
    assert len(images.take()) == 1


async def test_nothing_is_drawn_without_rendering_and_without_subscribers(served: Served, painter: Painter) -> None:
    served.host.world.spawn("sensor.camera.rgb", Transform(), **SMALL)
    images, blank = (sensor(served.host, f"camera.{kind}", **SMALL) for kind in ("rgb", "cosmos_visualization"))
    served.host.apply_settings(EpisodeSettings(no_rendering_mode=True, synchronous_mode=True, fixed_delta_seconds=0.05))
    await served.draw()
    assert not painter.views + images.take() + blank.take()
    served.host.apply_settings(SYNCHRONOUS)
    await served.draw()
    assert (len(painter.views), len(images.take()), len(blank.take())) == (1, 1, 1)


async def test_a_view_that_cannot_be_drawn_is_blank_and_others_go_on(
    served: Served, painter: Painter, caplog: pytest.LogCaptureFixture
) -> None:
    images = sensor(served.host, "camera.rgb", **SMALL)
    painter.errors = [RecapError("the process has ended")]
    await served.draw()
    painter.errors = [RecapError("no memory")] * 3
    await served.draw(3)
    other = sensor(served.host, "camera.rgb", image_size_x="8", image_size_y="8")
    await served.draw()
    assert [payload[12] for _, payload in images.take()] == [1, 128, 128, 128, 128]
    assert [payload[12] for _, payload in other.take()] == [2]
    served.host.close()
    assert painter.closed
    text = "an image of 32 x 16 pixels cannot be drawn: "
    assert caplog.messages == [
        text + "the process has ended",
        "images are drawn again",
        text + "no memory",
        "images of 32 x 16 pixels are blank from now on: no memory",
    ]


async def test_while_nothing_can_be_drawn_no_size_is_given_up_and_the_log_has_a_line(
    served: Served, painter: Painter, caplog: pytest.LogCaptureFixture
) -> None:
    images = sensor(served.host, "camera.rgb", **SMALL)
    painter.errors = [ImagesUnavailable("not started again yet")] * 8
    await served.draw(9)
    assert [payload[12] for _, payload in images.take()] == [128] * 8 + [1]
    assert caplog.messages == ["an image of 32 x 16 pixels cannot be drawn: not started again yet", "images are drawn again"]


@pytest.mark.parametrize(("fov", "drawn"), [("360", 175.0), ("0", 0.1), ("-10", 0.1), ("70", 70.0)])
async def test_images_carry_the_field_of_view_that_is_drawn(
    fov: str, drawn: float, served: Served, painter: Painter
) -> None:
    images = sensor(served.host, "camera.rgb", **{**SMALL, "fov": fov})
    await served.draw()
    ((_, payload),) = images.take()
    assert struct.unpack("<IIf", payload[:12]) == (32, 16, pytest.approx(drawn))
    assert painter.views[0].scene.camera.fov == drawn


async def test_a_camera_that_is_destroyed_while_it_is_drawn_is_no_harm(served: Served, painter: Painter) -> None:
    gone, there = sensor(served.host, "camera.rgb", **SMALL), sensor(served.host, "camera.rgb", **SMALL)
    painter.go.clear()
    served.host.tick()
    served.host.world.actors[gone.stream - there.stream + max(served.host.world.actors)].destroy()
    served.host.streams.remove(gone.stream, gone)
    served.host.tick()
    painter.go.set()
    await served.settle()
    assert (len(gone.take()), len(there.take())) == (0, 2)


async def test_a_camera_inside_its_carrier_does_not_see_it(served: Served, painter: Painter) -> None:
    car = vehicle(served.host)
    sensor(served.host, "camera.rgb", car, at(0.5, z=1.0), **SMALL)
    sensor(served.host, "camera.rgb", car, at(-5.0, z=1.0), **SMALL)
    await served.draw()
    assert {view.hidden for view in painter.views} == {frozenset((car.id,)), frozenset()}


def test_without_embree_rays_meet_boxes_and_the_log_says_why_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def missing(_: object) -> None:
        raise MissingExtra("rays that meet the ground", "cameras")

    monkeypatch.setattr(surfaces, "_ray_scene", missing)
    monkeypatch.setattr(surfaces, "_load", lambda _: TownMesh("", []))
    town, loader = replace(flat_town(), opendrive="<OpenDRIVE/>"), TownSurfaces()
    for _ in range(2):
        wait([loader.rays(town)], PATIENCE)
        assert loader.ready_rays(town) is None
    reason = str(MissingExtra("rays that meet the ground", "cameras"))
    assert caplog.messages == [f"lidars, radars and obstacle sensors meet the boxes of actors alone: {reason}"]


def test_the_surfaces_of_each_map_are_loaded_ahead_if_that_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def load(town: Town) -> TownMesh:
        loaded.append(town.name)
        return TownMesh("", [])

    loaded: list[str] = []
    monkeypatch.setattr(surfaces, "_load", load)
    monkeypatch.setattr(dispatch, "find_spec", lambda _: True)
    first, second, third = (replace(flat_town().renamed(name), opendrive="<OpenDRIVE/>") for name in ("A", "B", "C"))
    host = Host(World(first))
    client = client_inside(host)
    host.begin_episode(second, client)
    host.load_ahead()
    wait([host.sensors._surfaces.mesh(second)], PATIENCE)
    host.begin_episode(third, client)
    wait([host.sensors._surfaces.mesh(third)], PATIENCE)
    assert loaded == ["B", "C"]


def test_instances_follow_the_actors_of_the_world() -> None:
    host = Host(flat_world())
    car, prop = vehicle(host, 5.0, 3.0, 90.0), host.world.spawn("static.prop.container", at(20.0))
    walker = host.world.spawn("walker.pedestrian.0001", at(8.0, z=0.9))
    assert isinstance(car, Vehicle)
    car.apply_control(VehicleControl(throttle=0.5, brake=1.0, steer=0.5))
    host.tick()
    found = host.sensors.instances()
    assert found.ids.tolist() == [car.id, prop.id, walker.id]
    assert found.tags.tolist() == [Tag.CAR, Tag.STATIC, Tag.PEDESTRIANS]
    assert found.locations[0, :2] == pytest.approx((5.0, -3.0), abs=0.05)
    assert found.rotations[0, :, 0] == pytest.approx((0.0, -1.0, 0.0), abs=1e-2)
    assert found.half_extents[0] == pytest.approx((car.box.extent.x, car.box.extent.y, car.box.extent.z))
    assert found.lamps[0] & np.uint64(1 << Material.TAIL_LIGHT)
    assert found.steering[0] < 0  # to the right
    prop.transform = at(30.0)
    host.tick()
    assert host.sensors.instances().locations[1, 0] == pytest.approx(30.0, abs=0.5)
    car.destroy()
    host.tick()
    assert host.sensors.instances().ids.tolist() == [prop.id, walker.id]


def test_a_vehicle_that_is_hidden_below_the_ground_is_not_there() -> None:
    world = flat_world()
    hero, hidden = world.spawn("vehicle.tesla.model3", at(0.0), role_name="hero"), world.spawn("vehicle.audi.tt", at(20.0))
    actors = WorldActors(world)
    hidden.set_simulate_physics(False)
    hidden.transform = at(20.0, z=-499.0)
    world.tick()
    assert actors.instances().ids.tolist() == [hero.id]
    hidden.transform = at(20.0)
    world.tick()
    assert actors.instances().ids.tolist() == [hero.id, hidden.id]
