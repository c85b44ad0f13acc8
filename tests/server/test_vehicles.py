"""Calls about vehicles: driving, lights, doors, physics controls and telemetry."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import carla
import pytest

from carla_recap.errors import RecapError
from carla_recap.sim.geometry import Vector
from tests.server.client import FAR, MODEL, spawn, ticks
from tests.server.inside import Inside

if TYPE_CHECKING:
    from carla_recap.sim.actors.moving import Vehicle


WHEEL = {
    *("max_brake_torque", "radius", "tire_friction", "lat_stiff_value"),
    *("wheel_radius", "friction_force_multiplier", "cornering_stiffness"),  # as in 0.10
}


@pytest.fixture
def car(world: carla.World) -> carla.Vehicle:
    return spawn(world, at=FAR)


@pytest.mark.parametrize("speed", [8.0, -3.0, 0.0])
def test_a_car_comes_to_the_speed_that_it_is_told(world: carla.World, car: carla.Vehicle, speed: float) -> None:
    car.set_target_velocity(carla.Vector3D(4.0, 0.0, 0.0))
    car.apply_ackermann_control(carla.VehicleAckermannControl(speed=speed))
    ticks(world, 100)
    assert car.get_velocity().x == pytest.approx(speed, abs=0.15)


@pytest.mark.parametrize("type_id", ["vehicle.tesla.model3", "vehicle.lincoln.mkz_2020"])
def test_acceleration_and_steering_have_limits(world: carla.World, type_id: str) -> None:
    car = spawn(world, type_id, at=FAR)
    told = carla.VehicleAckermannControl(steer=0.2, steer_speed=0.1, speed=20.0, acceleration=1.0)
    car.apply_ackermann_control(told)
    ticks(world, 20)
    assert car.get_wheel_steer_angle(carla.VehicleWheelLocation.FL_Wheel) == pytest.approx(math.degrees(0.1), abs=0.5)
    assert car.get_wheel_steer_angle(carla.VehicleWheelLocation.BL_Wheel) == 0.0
    ticks(world, 80)  # it starts in neutral
    assert 2.0 < car.get_velocity().length() < 5.1


def test_the_physics_control_of_every_blueprint_comes_back_as_it_was_sent(world: carla.World) -> None:
    for blueprint in world.get_blueprint_library().filter("vehicle.*"):
        vehicle = world.spawn_actor(blueprint, FAR)
        control = vehicle.get_physics_control()
        for name in {"mass", "final_ratio", "gear_switch_time", "gear_change_time"}.intersection(dir(control)):
            setattr(control, name, getattr(control, name) + 0.25)
        control.use_sweep_wheel_collision = True
        control.center_of_mass = carla.Vector3D(0.1, 0.0, 0.2)
        if hasattr(control, "forward_gears"):  # not in 0.10, where the greatest torque scales the curve
            control.torque_curve = [carla.Vector2D(x=at.x + 1.0, y=at.y + 2.0) for at in control.torque_curve]
            control.forward_gears = [
                carla.GearPhysicsControl(gear.ratio + 0.25, 0.125, 0.5) for gear in control.forward_gears
            ]
        wheels = control.wheels
        for wheel in wheels:
            place = wheel.position if hasattr(wheel, "position") else wheel.location
            assert place.y / 100 == pytest.approx(FAR.location.y, abs=10)
            for name in WHEEL.intersection(dir(wheel)):
                setattr(wheel, name, getattr(wheel, name) + 1.5)
        control.wheels = wheels
        vehicle.apply_physics_control(control)
        assert str(vehicle.get_physics_control()) == str(control), blueprint.id
        assert vehicle.destroy()


def test_a_physics_control_with_fewer_wheels_changes_the_first_ones(inside: Inside) -> None:
    truck = inside.world.place("vehicle.carlamotors.european_hgv", inside.world.town.spawn_points[0])
    before = inside.call("get_physics_control", truck.id)
    assert len(before[15]) == 6
    sent = inside.call("get_physics_control", truck.id)
    for wheel in sent[15]:
        wheel[0] = 1.5
    inside.call("apply_physics_control", truck.id, [*sent[:15], sent[15][:4], *sent[16:]])
    after = inside.call("get_physics_control", truck.id)
    assert [wheel[0] for wheel in after[15]] == [1.5] * 4 + [before[15][0][0]] * 2
    assert [wheel[1:] for wheel in after[15]] == [wheel[1:] for wheel in before[15]]
    with pytest.raises(RecapError, match="1 to 6 wheels were expected, found 7"):
        inside.call("apply_physics_control", truck.id, [*sent[:15], [*sent[15], sent[15][0]], *sent[16:]])
    truck.destroy()


def test_doors_open_and_close(inside: Inside, parked: Vehicle) -> None:
    inside.call("open_vehicle_door", parked.id, 6)
    inside.call("close_vehicle_door", parked.id, 0)
    assert parked.open_doors == {1, 2, 3, 4, 5}
    with pytest.raises(RecapError, match="a door: expected 0 to 6, found 7"):
        inside.call("open_vehicle_door", parked.id, 7)


def test_telemetry_is_of_the_motion(world: carla.World, car: carla.Vehicle) -> None:
    car.apply_control(carla.VehicleControl(throttle=1.0))
    ticks(world, 40)
    telemetry = car.get_telemetry_data()
    assert telemetry.speed == pytest.approx(car.get_velocity().length(), abs=1e-3)
    assert (telemetry.throttle, telemetry.gear, len(telemetry.wheels)) == (1.0, 1, 4)
    assert telemetry.wheels[0].omega == pytest.approx(telemetry.speed / 0.37, rel=1e-3)
    assert telemetry.engine_rpm == pytest.approx(telemetry.wheels[0].omega * 60 / math.tau * 9.0, rel=1e-3)
    assert telemetry.drag > 0


def test_the_road_tells_the_car_its_limit_and_its_light(world: carla.World) -> None:
    light = next(iter(world.get_actors().filter("traffic.traffic_light")))
    stop = light.get_affected_lane_waypoints()[0]
    back = stop.previous(2.0)[0].transform
    car = spawn(world, at=carla.Transform(back.location + carla.Location(z=0.3), back.rotation))
    world.tick()
    assert car.is_at_traffic_light()
    assert car.get_traffic_light().id == light.id
    assert car.get_traffic_light_state() == light.state
    assert car.get_speed_limit() in (30.0, 50.0)
    assert car.get_failure_state() == carla.VehicleFailureState.NONE


def test_only_vehicles_are_driven(inside: Inside) -> None:
    spectator = inside.world.spectator.id
    with pytest.raises(RecapError, match=f"actor {spectator} is a spectator; a Vehicle was expected"):
        inside.call("apply_control_to_vehicle", spectator, [0.0, 0.0, 0.0, False, False, False, 0])


def test_vehicles_in_a_lane_are_not_exactly_in_line(world: carla.World) -> None:
    """CARLA's `BasicAgent` takes an angle of 0 between its direction and a vehicle for one that is not ahead."""
    model = world.get_blueprint_library().find(MODEL)
    for start in world.get_map().get_spawn_points()[:10]:
        ahead = carla.Transform(start.transform(carla.Location(x=15.0)), start.rotation)
        first, second = (world.try_spawn_actor(model, place) for place in (start, ahead))
        if first is None or second is None:
            continue
        world.tick()
        place, forward = first.get_location(), first.get_transform().get_forward_vector()
        offset = second.get_location() - place
        aside = abs(forward.x * offset.y - forward.y * offset.x)
        assert 0 < aside < 0.005
        assert place.distance_2d(start.location) < 0.0025
        first.destroy()
        second.destroy()


def test_telemetry_of_a_recorded_gear_that_the_blueprint_lacks_is_that_of_its_highest(
    inside: Inside, parked: Vehicle
) -> None:
    parked.set_target_velocity(Vector(10.0, 10.0))
    rows, row = parked.rows, parked.row
    told = []
    for gear in (parked.gears, 9):
        rows.gear[row] = gear
        told.append(inside.call("get_telemetry_data", parked.id))
    assert told[1][5] == 9
    assert told[1][4] == told[0][4] > 0


def test_what_raises_in_a_tick_costs_that_action_alone(caplog: pytest.LogCaptureFixture) -> None:
    inside = Inside()
    first, second = (inside.world.place("vehicle.tesla.model3", place) for place in inside.world.town.spawn_points[:2])
    called = []
    inside.world.listeners[:0] = [lambda: [][1]]  # raises
    inside.world.listeners.append(lambda: called.append(1))
    for car in (first, second):
        inside.call("enable_actor_constant_velocity", car.id, [5.0, 0.0, 0.0])
    velocities = inside.host.constant_velocity._velocities
    velocities[next(iter(velocities))].x = 1e6  # as if its parts were too much once turned
    frames = [inside.host.tick() for _ in range(3)]
    assert frames == [frames[0], frames[0] + 1, frames[0] + 2]
    assert called == [1, 1, 1]
    assert list(velocities) == [second]
    assert second.velocity.length() == pytest.approx(5.0, abs=1e-6)
    assert len(caplog.records) == 2
