"""A world: spawning, destroying, ticks and episodes."""

from __future__ import annotations

from dataclasses import replace

import pytest

from carla_recap.model.records import ActorKind
from carla_recap.sim.actors.moving import Vehicle, VehicleControl, WalkerControl
from carla_recap.sim.errors import DeadActor, SimError, SpawnError
from carla_recap.sim.geometry import Vector
from carla_recap.sim.settings import seeded_date
from carla_recap.sim.town.junctions import SignalKind
from carla_recap.sim.world import World
from tests.sim.flat import at, flat_town, flat_world, light, spawn_car


def vehicle(world: World, x: float = 0.0) -> Vehicle:
    return spawn_car(world, at(x), "vehicle.audi.tt")


def test_an_occupied_place_is_an_error() -> None:
    world = flat_world()
    vehicle(world, 0.0)
    with pytest.raises(SpawnError, match=r"vehicle.audi.a2 cannot be spawned at \(3\.0, 0\.0, 0\.0\): Vehicle\(2"):
        world.spawn("vehicle.audi.a2", at(3.0))
    assert world.try_spawn("vehicle.audi.a2", at(3.0)) is None
    assert world.try_spawn("walker.pedestrian.0001", at(1.0)) is None
    assert world.try_spawn("vehicle.audi.a2", at(5.0)) is not None
    assert world.try_spawn("vehicle.audi.a2", at(0.0, 2.5)) is not None
    assert world.try_spawn("sensor.camera.rgb", at(0.0)) is not None
    assert world.place("vehicle.audi.a2", at(3.0)).is_alive


def test_a_place_is_free_again_when_its_actor_is_destroyed_or_moved() -> None:
    world = flat_world()
    first = vehicle(world)
    first.transform = at(20.0)
    second = vehicle(world)
    second.destroy()
    assert world.try_spawn("vehicle.audi.a2", at(0.0)) is not None
    assert world.try_spawn("vehicle.audi.a2", at(20.0)) is None


def test_using_a_destroyed_actor_is_an_error() -> None:
    world = flat_world()
    car = vehicle(world, 7.0)
    assert car.destroy()
    assert not car.destroy()
    assert not car.is_alive
    assert car.transform == at(7.0)
    with pytest.raises(DeadActor, match=r"actor 2 \(vehicle.audi.tt\) has been destroyed"):
        car.apply_control(VehicleControl())
    with pytest.raises(DeadActor):
        car.transform = at(0.0)
    with pytest.raises(DeadActor):
        world.spawn("sensor.camera.rgb", at(0.0), parent=car)


def test_actors_of_the_town_cannot_be_destroyed() -> None:
    world = flat_world(signals=[light(0, (0,))])
    with pytest.raises(SimError, match="belongs to the town"):
        world.spectator.destroy()
    with pytest.raises(SimError, match="belongs to the town"):
        world.traffic_lights[0].destroy()


def test_controllers_come_first_and_listeners_last() -> None:
    world = flat_world()
    told: list[object] = []

    class Hurry:
        def step(self, delta: float) -> None:
            told.append((delta, world.frame))

    world.controllers.append(Hurry())
    world.listeners.append(lambda: told.append(world.frame))
    assert world.tick() == 1
    assert world.tick(0.1) == 2
    assert told == [(0.05, 0), 1, (0.1, 1), 2]
    assert world.elapsed == pytest.approx(0.15)
    assert world.delta == 0.1


def test_run_and_realtime_simulate_the_given_time() -> None:
    world = flat_world()
    world.run(1.0)
    assert world.frame == 20
    world.run_realtime(0.5, factor=100.0)
    assert world.frame == 30


def test_a_walker_walks_in_the_direction_of_its_control() -> None:
    world = flat_world()
    walker = world.spawn("walker.pedestrian.0001", at(0.0))
    walker.apply_control(WalkerControl(Vector(0.0, -2.0), 1.5))
    world.run(2)
    assert walker.transform.location.y == pytest.approx(-3)
    assert walker.transform.rotation.yaw == -90
    assert walker.velocity.y == pytest.approx(-1.5)
    assert walker.control.direction == Vector(0.0, -1.0)
    walker.apply_control(WalkerControl(speed=0.0))
    world.run(1)
    assert walker.velocity.length() == 0
    assert walker.transform.location.y == pytest.approx(-3)
    walker.apply_control(WalkerControl(Vector(0.0, -2.0), 1.5))
    world.run(1)
    walker.set_simulate_physics(False)
    world.run(1)
    assert (walker.velocity, walker.transform.location.y) == (Vector(), pytest.approx(-4.5))


def test_signs_and_lights_of_the_town_are_actors() -> None:
    stop, limit = light(1, (0,)), light(2, (0,))
    object.__setattr__(stop, "kind", SignalKind.STOP)
    object.__setattr__(limit, "kind", SignalKind.SPEED_LIMIT)
    object.__setattr__(limit, "speed_limit", 50 / 3.6)
    world = flat_world(signals=[light(0, (0,)), stop, limit])
    kinds = {actor.type_id: actor.kind for actor in world.actors.values()}
    assert kinds == {
        "spectator": ActorKind.OTHER,
        "traffic.traffic_light": ActorKind.TRAFFIC_LIGHT,
        "traffic.stop": ActorKind.TRAFFIC_SIGN,
        "traffic.speed_limit.50": ActorKind.TRAFFIC_SIGN,
    }


@pytest.mark.parametrize("number", [float("nan"), 1e39])
def test_what_is_no_value_is_an_error_and_changes_nothing(number: float) -> None:
    world = flat_world(signals=[light(0, (0,))])
    car, walker = vehicle(world), world.spawn("walker.pedestrian.0001", at(20.0))
    prop = world.spawn("static.prop.barrel", at(40.0))
    control, signal = car.physics_control, world.traffic_lights[0]
    wheel = replace(control.wheels[0], radius=number)
    attempts = [
        lambda: world.spawn("vehicle.audi.tt", at(number)),
        lambda: setattr(car, "transform", at(0.0, number)),
        lambda: setattr(prop, "transform", at(0.0, yaw=number)),
        lambda: setattr(world.spectator, "transform", at(number)),
        lambda: car.set_target_velocity(Vector(number)),
        lambda: car.add_impulse(Vector(0.0, number)),
        lambda: car.add_force(Vector(number)),
        lambda: car.add_impulse(Vector(1.1e4 * control.mass)),
        lambda: car.add_force(Vector(1.1e4 * control.mass / world.delta)),
        lambda: setattr(car, "physics_control", replace(control, mass=number)),
        lambda: setattr(car, "physics_control", replace(control, wheels=[])),
        lambda: setattr(car, "physics_control", replace(control, wheels=[wheel])),
        lambda: setattr(car, "physics_control", replace(control, forward_gears=control.forward_gears * 13)),
        lambda: car.apply_control(VehicleControl(manual_gear_shift=True, gear=99)),
        lambda: car.apply_control(VehicleControl(throttle=float("nan"))),
        lambda: setattr(car, "light_state", -1),
        lambda: car.set_door(9, True),
        lambda: walker.apply_control(WalkerControl(Vector(number), 1.0)),
        lambda: setattr(signal, "green_time", number),
        lambda: setattr(signal, "state", 5),
        lambda: setattr(world, "weather", replace(world.weather, wetness=number)),
        lambda: setattr(world, "weather", "HardRainNoon"),
        lambda: World(flat_town(), seed=-1),
        *(lambda seconds=seconds: world.tick(seconds) for seconds in (0.0, -1.0, 11.0, number, float("inf"))),
        *(lambda seconds=seconds: world.run(seconds) for seconds in (-1.0, float("nan"), float("inf"))),
        *(lambda factor=factor: world.run_realtime(1.0, factor) for factor in (0.0, -1.0, float("nan"))),
        *(lambda value=value: setattr(world.settings, "fixed_delta_seconds", value) for value in (0.0, 10.1)),
        *(lambda value=value: setattr(world.settings, "max_substep_delta_time", value) for value in (0.0, number)),
        lambda: setattr(world.settings, "collisions_of", "everybody"),
    ]
    settings = replace(world.settings)
    for attempt in attempts:
        with pytest.raises(SimError, match="expected"):
            attempt()
    assert (world.frame, world.settings) == (0, settings)
    world.tick()
    assert car.transform == at(0.0)
    car.apply_control(VehicleControl(throttle=7.0, steer=-7.0, gear=99))
    assert (car.control.throttle, car.control.steer) == (1.0, -1.0)


def test_a_new_episode_has_no_actors_of_the_old_one() -> None:
    world = flat_world()
    car = vehicle(world)
    world.run(1)
    world.reload(flat_town(signals=[light(0, (0,))]))
    assert not car.is_alive
    assert len(world.vehicles) == 0
    assert (world.frame, world.elapsed) == (0, 0)
    assert len(world.traffic_lights) == 1
    world.tick()
    assert [actor.type_id for actor in world.events.spawned] == ["spectator", "traffic.traffic_light"]


def test_the_date_is_that_of_source_date_epoch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1234567")
    assert World(flat_town()).recorder.date == 1234567
    assert World(flat_town(), date=7).recorder.date == 7


def test_parked_vehicles_cost_no_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    world = flat_world()
    cars = [vehicle(world, 10.0 * number) for number in range(50)]
    world.run(1)
    steps: list[float] = []
    monkeypatch.setattr(world.episode.plane, "step", lambda seconds: steps.append(seconds) or [])
    world.run(5)
    assert not steps
    cars[0].apply_control(VehicleControl(throttle=1.0))
    world.tick()
    assert steps == [0.05]


def test_fast_vehicles_are_simulated_in_small_steps() -> None:
    world = flat_world()
    car = vehicle(world)
    for speed, steps in ((10.0, 1), (45.0, 3), (400.0, 10)):
        car.set_target_velocity(Vector(speed))
        world.tick()
        assert world.episode.plane.space.current_time_step == pytest.approx(0.05 / steps)
    world.settings.substepping = False
    world.tick()
    assert world.episode.plane.space.current_time_step == pytest.approx(0.05)


def test_an_attribute_that_the_blueprint_does_not_have_is_an_error() -> None:
    with pytest.raises(SpawnError, match=r"vehicle.audi.tt has no attribute 'rolename'; it has role_name"):
        flat_world().spawn("vehicle.audi.tt", at(0.0), rolename="hero")


def test_a_source_date_that_is_no_number_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "abc")
    for date in (lambda: World(flat_town()).recorder.date, seeded_date):
        with pytest.raises(SimError, match="SOURCE_DATE_EPOCH: expected whole Unix seconds, found 'abc'"):
            date()
