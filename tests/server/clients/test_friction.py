"""Friction triggers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.server.clients.calls import ahead, drive, spawn, straight

if TYPE_CHECKING:
    import carla


def test_a_friction_trigger_changes_tyres_while_a_car_is_in_it(world: carla.World) -> None:
    start = straight(world, 80.0)
    size = {"extent_x": "1000.0", "extent_y": "500.0", "extent_z": "500.0"}
    spawn(world, "static.trigger.friction", ahead(start, 30.0, up=start.location.z), friction="0.25", **size)
    car = spawn(world, "vehicle.tesla.model3", start)
    world.tick()
    before = [wheel.tire_friction for wheel in car.get_physics_control().wheels]
    seen = []
    for _ in range(120):
        drive(world, car, 1, throttle=0.6)
        seen.append((start.location.distance_2d(car.get_location()), car.get_physics_control().wheels[0].tire_friction))
    assert all(friction == pytest.approx(0.25) for way, friction in seen if 25.0 < way < 35.0)
    assert any(25.0 < way < 35.0 for way, _ in seen)
    assert [wheel.tire_friction for wheel in car.get_physics_control().wheels] == before
