"""Sensors as CARLA's own tests ask about them."""

from __future__ import annotations

import carla
import pytest

from tests.server.clients.calls import ahead, eventually, spawn, straight


@pytest.mark.parametrize("blueprint", ["sensor.other.radar", "sensor.other.gnss"])
def test_sensors_repeat_their_noise_in_every_episode(client: carla.Client, blueprint: str) -> None:
    told = []
    for _ in range(2):
        world = client.reload_world(False)
        start = straight(world, 60.0)
        car = spawn(world, "vehicle.tesla.model3", start)
        spawn(world, "vehicle.tesla.model3", ahead(start, 15.0, up=start.location.z))
        model = world.get_blueprint_library().find(blueprint)
        model.set_attribute("noise_seed", "54283")
        if blueprint.endswith("gnss"):
            model.set_attribute("noise_lat_stddev", "0.001")
        sensor = world.spawn_actor(model, carla.Transform(carla.Location(z=1.0)), car)
        data: list[carla.SensorData] = []
        sensor.listen(data.append)
        for _ in range(5):
            world.tick()
        assert eventually(lambda data=data: len(data) >= 5)
        told.append([bytes(datum.raw_data) if blueprint.endswith("radar") else datum.latitude for datum in data[:5]])
    assert told[0] == told[1]
    assert len(set(told[0])) > 1
