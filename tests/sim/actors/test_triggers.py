"""Friction triggers set the tyre friction of vehicles inside, and restore it when they leave."""

from __future__ import annotations

import gc
import weakref

import pytest

from carla_recap.sim.actors.moving import Vehicle
from carla_recap.sim.world import World
from tests.sim.flat import at, flat_world, spawn_car

TRIGGER = "static.trigger.friction"


def frictions(vehicle: Vehicle) -> list[float]:
    return [wheel.tire_friction for wheel in vehicle.physics_control.wheels]


def trigger(world: World, x: float = 0.0, y: float = 0.0, yaw: float = 0.0, friction: str = "0.5", **extent: str) -> None:
    size = {"extent_x": "1000", "extent_y": "300", "extent_z": "300", **extent}
    world.spawn(TRIGGER, at(x, y, yaw), friction=friction, **size)


def test_friction_is_set_inside_and_restored_outside() -> None:
    world = flat_world()
    vehicle = spawn_car(world, at(0.0))
    control = vehicle.physics_control
    for wheel, friction in zip(control.wheels, (1.0, 2.0, 3.0, 4.0), strict=True):
        wheel.tire_friction = friction
    vehicle.physics_control = control
    trigger(world, 100.0)
    world.tick()
    assert frictions(vehicle) == [1.0, 2.0, 3.0, 4.0]
    vehicle.transform = at(88.0)  # the front bumper is inside
    world.tick()
    assert frictions(vehicle) == [0.5] * 4
    vehicle.transform = at(80.0)
    world.tick()
    assert frictions(vehicle) == [1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize(
    ("x", "y", "z", "yaw", "turned", "is_inside"),
    [
        (0.0, 3.9, 0.0, 0.0, 0.0, True),  # the box is 3 m to each side, and the car 1.08 m
        (0.0, 4.2, 0.0, 0.0, 0.0, False),
        (12.3, 0.0, 0.0, 0.0, 0.0, True),
        (12.5, 0.0, 0.0, 0.0, 0.0, False),
        (0.0, 12.3, 0.0, 90.0, 0.0, False),
        (0.0, 5.3, 0.0, 90.0, 0.0, True),
        (11.5, 5.0, 0.0, 45.0, 0.0, False),  # beside the corner
        (0.0, 0.0, 3.5, 0.0, 0.0, False),
        (0.0, 0.0, -4.6, 0.0, 0.0, False),
        (0.0, 0.0, -4.4, 0.0, 0.0, True),
        (0.0, 9.0, 0.0, 0.0, 90.0, True),
        (9.0, 0.0, 0.0, 0.0, 90.0, False),
    ],
)
def test_the_box_has_a_place_a_rotation_and_a_height(
    x: float, y: float, z: float, yaw: float, turned: float, is_inside: bool
) -> None:
    world = flat_world()
    vehicle = spawn_car(world, at(x, y, yaw, z=z))
    vehicle.set_simulate_physics(False)
    trigger(world, yaw=turned)
    world.tick()
    assert (frictions(vehicle)[0] == 0.5) is is_inside


def test_a_destroyed_trigger_restores_the_friction() -> None:
    world = flat_world()
    vehicle, gone = spawn_car(world, at(0.0)), spawn_car(world, at(8.0))
    area = world.spawn(TRIGGER, at(0.0), friction="1.5", extent_x="1000", extent_y="1000", extent_z="1000")
    world.tick()
    gone.destroy()
    world.tick()
    assert frictions(vehicle) == [1.5] * 4
    area.destroy()
    assert frictions(vehicle) == [3.5] * 4
    world.tick()


@pytest.mark.parametrize(("text", "friction"), [("1.25f", 1.25), ("0", 0.0), ("much", 3.5), ("-1", 3.5), ("nan", 3.5)])
def test_friction_is_read_as_carla_writes_it(text: str, friction: float) -> None:
    world = flat_world()
    vehicle = spawn_car(world, at(0.0))
    trigger(world, friction=text)
    world.tick()
    assert frictions(vehicle) == [friction] * 4


def test_nested_triggers_restore_the_friction_in_any_order() -> None:
    world = flat_world()
    vehicle = spawn_car(world, at(0.0))
    before = frictions(vehicle)
    trigger(world, friction="0.5")
    world.tick()
    trigger(world, friction="2.0")
    world.tick()
    assert frictions(vehicle) == [2.0] * 4
    first, second = (actor for actor in world.actors.values() if actor.type_id == TRIGGER)
    first.destroy()
    assert frictions(vehicle) == [2.0] * 4
    second.destroy()
    assert frictions(vehicle) == before


def test_an_episode_is_freed_after_a_reload_with_a_car_in_a_trigger() -> None:
    world = flat_world()
    spawn_car(world, at(0.0))
    trigger(world)
    world.tick()
    episode = weakref.ref(world.episode)
    world.reload()
    gc.collect()
    assert episode() is None
