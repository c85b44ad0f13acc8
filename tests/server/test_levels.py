"""A town with two levels, through CARLA's client."""

from __future__ import annotations

from typing import TYPE_CHECKING

import carla
import pytest

from carla_recap.server import running
from tests.server.client import SYNCHRONOUS, connect
from tests.sim.two_levels import BRIDGE, two_levels

if TYPE_CHECKING:
    from collections.abc import Iterator


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[carla.World]:
    folder = tmp_path_factory.mktemp("levels")
    with running(str(two_levels(folder)), recordings=folder) as port:
        world = connect(port, folder).get_world()
        world.apply_settings(SYNCHRONOUS)
        yield world


def test_rays_spawns_and_sensors_know_the_level(world: carla.World) -> None:
    library = world.get_blueprint_library()
    model = library.find("vehicle.tesla.model3")
    lower = world.spawn_actor(model, carla.Transform(carla.Location(0, 1.75, 0.3)))
    upper = world.spawn_actor(model, carla.Transform(carla.Location(0, 1.75, BRIDGE + 0.3), carla.Rotation(yaw=90)))
    lidar = library.find("sensor.lidar.ray_cast")
    lidar.set_attribute("upper_fov", "60")
    lidar.set_attribute("range", "50")
    sensor = world.spawn_actor(lidar, carla.Transform(carla.Location(x=10, z=1)), attach_to=lower)
    heights: list[float] = []
    sensor.listen(lambda data: heights.extend(point.point.z for point in data))
    hidden = world.spawn_actor(model, carla.Transform(carla.Location(0, 1.75, -50)))
    for _ in range(20):
        world.tick()
    sensor.stop()
    assert max(heights) > BRIDGE - 1.2  # it sees the car on the bridge from 1 m above the road below
    height = lower.bounding_box.extent.z * 2
    assert lower.get_location().z == pytest.approx(0.0, abs=0.05)
    assert upper.get_location().z == pytest.approx(BRIDGE, abs=0.05)
    assert hidden.get_location().z == pytest.approx(-50)
    for top, expected in ((12.0, [BRIDGE + height, BRIDGE]), (5.0, [height, 0.0])):
        met = world.cast_ray(carla.Location(0, 1.75, top), carla.Location(0, 1.75, expected[-1] - 1))
        assert [point.location.z for point in met] == pytest.approx(expected, abs=0.05)
        assert [point.label for point in met] == [carla.CityObjectLabel.Car, carla.CityObjectLabel.Roads]
    assert world.ground_projection(carla.Location(20, 1.75, 3.0), 10.0).location.z == pytest.approx(0.0, abs=0.02)
    with pytest.raises(RuntimeError, match="collision"):
        world.spawn_actor(model, carla.Transform(carla.Location(0, 1.75, BRIDGE + 0.8)))


def test_spawn_points_are_on_both_levels(world: carla.World) -> None:
    heights = [point.location.z for point in world.get_map().get_spawn_points()]
    assert min(heights) < 1
    assert max(heights) > BRIDGE
