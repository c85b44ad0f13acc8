"""Engine, clutch, gearbox, brakes and tyres against calculations by hand, and drives of CARLA driven again."""

from __future__ import annotations

from dataclasses import replace
from math import exp, pi
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from benchmarks.simulator import DRIVES, drive_again_tool
from carla_recap.sim.actors.moving import Vehicle, VehicleControl
from carla_recap.sim.blueprints import standard_library
from carla_recap.sim.geometry import Vector
from carla_recap.sim.physics.physics_control import WHEEL, Gear, parameters
from carla_recap.sim.world import World
from tests.samples import carla_log
from tests.sim.flat import at, flat_world, spawn_car

RADIUS = 0.37  # m, of the Tesla's wheels
WHEELS = 4 * 0.5 * 20.0  # kg: what the inertia of four wheels of 20 kg adds to the mass


def tesla(**changes: Any) -> tuple[World, Vehicle]:
    """Return a world with short ticks, and a Tesla with changes of its physics."""
    world = flat_world()
    world.settings.fixed_delta_seconds = 0.01
    car = spawn_car(world, at(10.0))
    change(car, changes)
    return world, car


def change(car: Vehicle, changes: dict[str, Any]) -> None:
    """Change the physics of a car: of its wheels what begins with wheel_."""
    wheels = {name.removeprefix("wheel_"): value for name, value in changes.items() if name.startswith("wheel_")}
    control = replace(car.physics_control, **{name: changes[name] for name in changes if not name.startswith("wheel_")})
    control.wheels = [replace(wheel, **wheels) for wheel in control.wheels]
    car.physics_control = control


def test_in_neutral_the_engine_is_revved_by_its_torque() -> None:
    world, car = tesla(torque_curve=((0.0, 300.0),), moi=2.0, damping_rate_full_throttle=0.0)
    car.apply_control(VehicleControl(throttle=1.0))
    world.run(0.5)
    assert world.vehicles.engine[0] == pytest.approx(300.0 / 2.0 * (0.5 - 1 / 12), rel=0.02)  # the throttle takes 1/6 s
    assert car.control.gear == 0
    assert car.velocity.length() == 0


def test_without_throttle_the_engine_slows_down_by_its_damping() -> None:
    world, _ = tesla(damping_rate_zero_throttle_clutch_disengaged=0.7, moi=1.0)
    world.vehicles.engine[0] = 100.0
    world.run(1.0)
    assert world.vehicles.engine[0] == pytest.approx(100.0 * exp(-0.7), rel=0.01)


def test_the_clutch_gives_its_strength_times_its_slip() -> None:
    world, car = tesla(torque_curve=((0.0, 400.0),), forward_gears=[Gear(1.0, 0.0, 0.0)], drag_coefficient=2.0)
    world.settings.fixed_delta_seconds = 0.05
    car.set_target_velocity(Vector(40.0))
    car.apply_control(VehicleControl(throttle=0.8, manual_gear_shift=True, gear=1))
    world.run(40.0)
    fleet, control = world.vehicles, car.physics_control
    slip = fleet.engine[0] - control.final_ratio * fleet.omega[0].mean()
    damping = 0.8 * control.damping_rate_full_throttle + 0.2 * control.damping_rate_zero_throttle_clutch_engaged
    assert car.acceleration.length() < 0.02
    assert control.clutch_strength * slip == pytest.approx(0.8 * 400.0 - damping * fleet.engine[0], rel=0.02)


def test_a_shift_begins_at_its_revolutions_and_takes_its_time() -> None:
    gears = [Gear(3.0, 0.1, 0.3), Gear(2.0, 0.1, 0.3), Gear(1.0, 0.1, 0.3)]
    world, car = tesla(forward_gears=gears, gear_switch_time=0.3, final_ratio=4.0)
    car.apply_control(VehicleControl(throttle=1.0))
    most, seen = car.physics_control.max_rpm * 2 * pi / 60, [(0.0, 0, 0.0)]
    while world.elapsed < 12.0 and car.control.gear != 3:
        engine = world.vehicles.engine[0]
        world.tick()
        if car.control.gear != seen[-1][1]:
            seen.append((world.elapsed, car.control.gear, engine / most))
    assert [gear for _, gear, _ in seen] == [0, 1, 0, 2, 0, 3]
    for (begun, _, turns), (done, _, _) in ((seen[2], seen[3]), (seen[4], seen[5])):
        assert turns == pytest.approx(0.3, abs=0.02)
        assert done - begun == pytest.approx(0.3, abs=0.025)


def test_brakes_slow_it_by_their_torques() -> None:
    world, car = tesla(drag_coefficient=0.0, wheel_max_brake_torque=400.0, wheel_damping_rate=0.0)
    car.set_target_velocity(Vector(30.0))
    car.apply_control(VehicleControl(brake=1.0))
    world.run(0.5)
    fast = car.velocity.x
    world.run(0.5)
    assert fast - car.velocity.x == pytest.approx(0.5 * 4 * 400.0 / RADIUS / (1845.0 + WHEELS), rel=0.01)


def test_in_neutral_air_and_wheels_slow_it() -> None:
    world, car = tesla(drag_coefficient=0.5, wheel_damping_rate=1.0)
    car.set_target_velocity(Vector(30.0))
    world.run(1.0)
    force = 0.5 * 1.25 * 0.5 * 2.52 * 29.5**2 + 4 * 1.0 * 29.5 / RADIUS**2
    assert 30.0 - car.velocity.x == pytest.approx(force / (1845.0 + WHEELS), rel=0.03)


def test_in_a_gear_the_engine_slows_it_by_its_damping() -> None:
    world, car = tesla(drag_coefficient=0.0, wheel_damping_rate=0.0, final_ratio=4.0)
    car.set_target_velocity(Vector(30.0))
    world.vehicles.engage(0)
    assert car.control.gear == 1
    world.run(1.0)
    fast, engine = car.velocity.x, world.vehicles.engine[0]
    world.run(0.5)
    braking = 2.0 * (engine + world.vehicles.engine[0]) / 2 * 4.0 / RADIUS
    assert fast - car.velocity.x == pytest.approx(0.5 * braking / (1845.0 + WHEELS + (4.0 / RADIUS) ** 2), rel=0.03)


def in_gear(car: Vehicle) -> tuple[int, int, float]:
    fleet, row = car.rows, car.row
    return fleet.gear[row].item(), fleet.target_gear[row].item(), fleet.engine[row].item()


@pytest.mark.parametrize(
    "change", [lambda car: car.set_enable_gravity(True), lambda car: setattr(car, "physics_control", car.physics_control)]
)
def test_a_shift_goes_on_when_the_physics_change(change: Any) -> None:
    world = flat_world()
    car = spawn_car(world, at(10.0), "vehicle.lincoln.mkz_2017", speed=20.0)
    car.rows.gear[0], car.rows.target_gear[0] = 0, 4
    change(car)
    assert in_gear(car)[:2] == (0, 4)
    world.run(0.5)
    assert car.control.gear in (3, 4)


@pytest.mark.parametrize("speed", [8.0, 20.0, 60.0])
def test_the_gear_at_a_speed_does_not_depend_on_the_order_of_calls(speed: float) -> None:
    world = flat_world()
    calls = [lambda car: car.set_autopilot(), lambda car: car.set_target_velocity(Vector(speed))]
    cars = [spawn_car(world, at(10.0, 10.0 * number), "vehicle.lincoln.mkz_2017") for number in range(2)]
    for car, order in zip(cars, (calls, calls[::-1]), strict=True):
        for call in order:
            call(car)
    gear, target, engine = in_gear(cars[0])
    assert in_gear(cars[1]) == (gear, target, engine)
    assert gear == target > 0
    ratio = cars[0].physics_control.forward_gears[gear - 1].ratio * 3.21
    assert engine == pytest.approx(ratio * speed / 0.355)
    assert engine <= 6500.0 * 2 * pi / 60


def test_a_vehicle_that_is_too_fast_for_its_gears_rolls_in_neutral() -> None:
    car = spawn_car(flat_world(), at(10.0), speed=80.0)
    car.set_autopilot()
    assert in_gear(car) == (0, 0, 0.0)


def test_a_vehicle_that_is_shifting_is_not_put_in_another_gear() -> None:
    car = spawn_car(flat_world(), at(10.0), "vehicle.lincoln.mkz_2017", speed=20.0)
    car.rows.target_gear[0] = 3
    car.set_autopilot()
    assert in_gear(car)[:2] == (0, 3)


@pytest.mark.parametrize("gear", [0, 2])
def test_physics_begins_anew_after_it_was_off_but_for_a_manual_gear(gear: int) -> None:
    world = flat_world()
    car = spawn_car(world, at(10.0), "vehicle.lincoln.mkz_2017")
    car.apply_control(VehicleControl(throttle=1.0, steer=0.5, manual_gear_shift=gear > 0, gear=gear))
    world.run(3.0)
    assert in_gear(car)[2] > 100
    for on in (False, True):
        car.set_simulate_physics(on)
    fleet = world.vehicles
    assert in_gear(car) == (gear, gear, 0.0)
    assert not np.any([fleet.throttle_input[0], fleet.steer_input[0], *fleet.omega[0]])


@pytest.mark.parametrize("delta", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("blueprint", ["vehicle.yamaha.yzf", "vehicle.ford.mustang"])
def test_the_autopilot_sets_off_evenly_in_ticks_of_any_length(blueprint: str, delta: float) -> None:
    world = flat_world()
    world.settings.substepping = False
    spawn_car(world, at(100.0), blueprint).set_autopilot(True)
    speeds = []
    for _ in range(round(4 / delta)):
        world.tick(delta)
        speeds.append(world.vehicles.speed[0])
    changes = np.diff(speeds)
    swings = (np.minimum(np.abs(changes[1:]), np.abs(changes[:-1])) > 0.2) & (changes[1:] * changes[:-1] < 0)
    assert swings.sum() <= 2  # down and up again, as it sets off
    assert speeds[-1] > 5


@pytest.mark.parametrize("autopilot", [False, True])
def test_a_vehicle_without_physics_stands_and_forgets_its_motion(autopilot: bool) -> None:
    world = flat_world()
    car = spawn_car(world, at(10.0), speed=12.0)
    car.apply_control(VehicleControl(throttle=0.5, steer=0.01))
    world.run(1.0)
    car.set_simulate_physics(False)
    assert (car.velocity, world.vehicles.turning[0]) == (Vector(), 0.0)
    car.set_target_velocity(Vector(20.0, 0.0, 0.0))
    car.set_autopilot(autopilot)
    car.set_simulate_physics(True)
    np.testing.assert_allclose(world.vehicles.omega[0] * 0.355, 20.0, rtol=0.1)
    assert bool(in_gear(car)[0]) == autopilot


def test_the_wheels_of_a_car_that_stands_alone_steer() -> None:
    world = flat_world()
    car = spawn_car(world, at(10.0))
    world.run(1.0)
    car.apply_control(VehicleControl(steer=1.0, hand_brake=True))
    world.run(1.0)
    assert world.vehicles.steer_input[0] == 1.0


@pytest.mark.parametrize("driven_by", ["client", "autopilot"])
@pytest.mark.parametrize("drag", [3e4, 1e9])
def test_air_may_stop_a_vehicle_but_not_throw_it_back(drag: float, driven_by: str) -> None:
    world = flat_world()
    car = spawn_car(world, at(10.0), speed=20.0)
    change(car, {"drag_coefficient": drag})
    car.set_autopilot(driven_by == "autopilot")
    for _ in range(20):
        world.tick()
        assert -1e-9 < world.vehicles.speed[0] < 20.0


@pytest.mark.parametrize(("given", "corners"), [(1, [0, 0, 0, 0]), (2, [0, 0, 1, 1]), (4, [0, 1, 2, 3])])
def test_each_wheel_acts_at_its_own_corners(given: int, corners: list[int]) -> None:
    control = spawn_car(flat_world(), at(10.0)).physics_control
    wheels = [replace(wheel, damping_rate=float(number)) for number, wheel in enumerate(control.wheels)]
    box = standard_library().get("vehicle.tesla.model3").box
    row = parameters(replace(control, wheels=wheels[:1] + wheels[5 - given :] if given < 4 else wheels), box)
    named = dict(zip(WHEEL, row["wheels"], strict=True))
    numbers = [0, 3] if given == 2 else range(4)
    assert named["damping"].tolist() == [float(numbers[corner]) for corner in corners]
    assert (named["x"][:2] > 0).all()
    assert (named["x"][2:] < 0).all()


BAD: list[dict[str, Any]] = [
    {"torque_curve": ()},
    {"torque_curve": ((1000.0, 300.0),)},
    {"torque_curve": ((5000.0, 300.0), (0.0, -10.0), (2000.0, 400.0))},
    {"forward_gears": []},
    {"forward_gears": [Gear(0.0, 0.0, 0.0), Gear(-2.0, 2.0, -1.0)]},
    {"final_ratio": 0.0},
    {"final_ratio": -1e6},
    {"mass": 0.0},
    {"mass": 1e6},
    {"moi": 0.0, "clutch_strength": 1e6},
    {"moi": -1.0, "clutch_strength": -1.0, "damping_rate_full_throttle": -5.0},
    {"max_rpm": 0.0},
    {"max_rpm": 1e9},
    {"gear_switch_time": -1.0},
    {"drag_coefficient": -1.0},
    {"steering_curve": ()},
    {"steering_curve": ((100.0, 5.0), (0.0, -1.0))},
    {"center_of_mass": Vector(1e6)},
    {"wheel_tire_friction": 0.0},
    {"wheel_radius": 0.0},
    {"wheel_radius": 1e6},
    {"wheel_lat_stiff_value": 0.0, "wheel_long_stiff_value": 0.0},
    {"wheel_lat_stiff_max_load": 0.0},
    {"wheel_lat_stiff_value": 1e6, "wheel_long_stiff_value": 1e9},
    {"wheel_lat_stiff_value": 1e6, "wheel_long_stiff_value": 1e9, "wheel_tire_friction": 1e6},
    {"wheel_lat_stiff_value": 1e4, "wheel_tire_friction": 1e4},
    {"wheel_max_steer_angle": 180.0},
    {"wheel_max_steer_angle": 0.0},
    {"wheel_max_brake_torque": -1.0, "wheel_damping_rate": -1.0},
    {"wheel_position": Vector()},
]


@pytest.mark.parametrize("driven_by", ["client", "autopilot"])
def test_no_value_of_a_physics_control_makes_a_tick_fail(driven_by: str) -> None:
    world = flat_world()
    cars = [spawn_car(world, at(4000.0, 400.0 * number), speed=20.0) for number in range(len(BAD))]
    for car, changes in zip(cars, BAD, strict=True):
        change(car, changes)
    with np.errstate(all="raise", under="ignore"):
        for control in (VehicleControl(1.0, 0.5), VehicleControl(brake=1.0), VehicleControl(1.0, reverse=True)):
            for car in cars:
                car.apply_control(control)
                car.set_autopilot(driven_by == "autopilot")
            for _ in range(40):
                world.tick()
                assert np.hypot(world.vehicles.speed, world.vehicles.sideways).max() < 200.0
    fleet = world.vehicles
    for values in (fleet.position, fleet.rotation, fleet.velocity, fleet.engine, fleet.omega):
        bad = ~np.isfinite(values.reshape(len(BAD), -1)).all(axis=1)
        assert [BAD[row] for row in np.flatnonzero(bad)] == []


@pytest.mark.parametrize("speed", [0.015, 0.03])
def test_speed_and_body_come_to_rest_together(speed: float) -> None:
    world = flat_world()
    car = spawn_car(world, at(100.0), speed=speed)
    other = spawn_car(world, at(100.0, 50.0), speed=20.0)
    for _ in range(60):
        world.tick()
        assert world.vehicles.bodies[0].velocity[0] == pytest.approx(car.velocity.x, abs=1e-3)
    assert car.velocity.length() == 0
    assert other.velocity.length() > 0


@pytest.fixture(scope="module")
def tool() -> ModuleType:
    return drive_again_tool()


@pytest.mark.parametrize("drive", DRIVES)
def test_recorded_controls_give_the_recorded_drive(drive: str, tool: Any) -> None:
    name, actor, start, duration = DRIVES[drive]
    *_, theirs, ours, _ = tool.drive_again(carla_log(f"{name}.log"), actor, start, duration)
    speed, place, heading = tool.off_by(theirs, ours)
    after = tool.soon(theirs)
    assert np.sqrt(np.mean(speed**2)) < 0.25
    assert place[after] < 0.7
    assert abs(heading[after]) < 1.0
    assert tool.same_gear(theirs, ours, 0.1) > 0.95
