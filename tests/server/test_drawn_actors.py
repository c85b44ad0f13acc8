"""What cameras and rays of a server meet: the actors that are there, and their lamps."""

from __future__ import annotations

from carla_recap.scene.materials import Material
from carla_recap.server.sensors.drawn_actors import WorldActors
from carla_recap.sim import VehicleControl
from tests.sim.flat import at, flat_world


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


def test_brake_lamps_stay_lit_for_half_a_second() -> None:
    world = flat_world()
    car, lit = world.spawn("vehicle.tesla.model3", at(0.0)), []
    actors = WorldActors(world)
    for number in range(30):
        car.apply_control(VehicleControl(brake=0.5 * (number == 0)))
        world.tick()
        if int(actors.instances().lamps[0]) >> Material.BRAKE_LIGHT & 1:
            lit.append(world.elapsed)
    assert 0.4 < lit[-1] - lit[0] < 0.51
