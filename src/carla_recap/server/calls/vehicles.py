"""Calls about vehicles, their controls, lights, doors, physics and telemetry, and about walkers."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from math import degrees, pi
from typing import Final

from carla_recap.model.motion import GRAVITY
from carla_recap.model.records import CM_PER_M
from carla_recap.server.actor_records import DestroyedActor
from carla_recap.server.calls.actors import expect
from carla_recap.server.controllers import AckermannControl, AckermannSettings
from carla_recap.server.host import Client
from carla_recap.server.rpc.registry import CallError, call
from carla_recap.server.rpc.structs import Telemetry, VehicleLightState, WheelTelemetry
from carla_recap.sim.actors.moving import LIGHT_BITS, Vehicle, VehicleControl, Walker, WalkerControl
from carla_recap.sim.geometry import Location, Transform, Vector
from carla_recap.sim.physics.physics_control import Gear, PhysicsControl
from carla_recap.sim.validation import expect_velocity

_FRONT_WHEELS: Final = (0, 1)


@call
def apply_control_to_vehicle(client: Client, id: int, control: VehicleControl) -> None:
    """Apply a control to a vehicle."""
    vehicle = expect(client, id, Vehicle)
    client.host.takeover.take(vehicle)
    client.host.ackermann.release(vehicle)
    control.gear = min(max(control.gear, -1), vehicle.gears)
    vehicle.apply_control(control)


@call
def apply_ackermann_control_to_vehicle(client: Client, id: int, control: AckermannControl) -> None:
    """Drive a vehicle to a speed and a steering angle, until it gets a control."""
    vehicle = expect(client, id, Vehicle)
    client.host.takeover.take(vehicle)
    client.host.ackermann.drive(vehicle, control)


@call
def set_actor_autopilot(client: Client, id: int, enabled: bool) -> None:
    """End the server's own autopilot of a vehicle; the autopilot to start or stop is the client's traffic manager."""
    vehicle = client.host.world.actors.get(id)
    if isinstance(vehicle, Vehicle) and client.host.takeover.take(vehicle):
        vehicle.apply_control(VehicleControl())


@call
def get_ackermann_controller_settings(client: Client, id: int) -> AckermannSettings:
    """Return the gains of a vehicle's Ackermann controller."""
    return client.host.ackermann.settings(expect(client, id, Vehicle))


@call
def apply_ackermann_controller_settings(client: Client, id: int, settings: AckermannSettings) -> None:
    """Set the gains of a vehicle's Ackermann controller; they have no effect."""
    client.host.ackermann.set_settings(expect(client, id, Vehicle), settings)


@call
def get_physics_control(client: Client, id: int) -> PhysicsControl:
    """Return the physics of a vehicle; the positions of the wheels are in the world and in cm, as in CARLA."""
    control, transform = _physics(client, id)
    for wheel in control.wheels:
        local = wheel.position
        position = transform.transform(Location(local.x / CM_PER_M, local.y / CM_PER_M, local.z / CM_PER_M))
        wheel.position = Vector(position.x * CM_PER_M, position.y * CM_PER_M, position.z * CM_PER_M)
    return control


@call
def apply_physics_control(client: Client, id: int, control: PhysicsControl) -> None:
    """Set the physics of a vehicle; its wheels keep their positions, and those beyond the given ones do not change."""
    vehicle = expect(client, id, Vehicle)
    before = vehicle.physics_control
    mine, given = before.wheels, control.wheels
    if not 1 <= len(given) <= len(mine):
        raise CallError(f"a physics control of {vehicle!r}: 1 to {len(mine)} wheels were expected, found {len(given)}")
    control = client.release.completed(control, before)
    changed = [replace(wheel, position=old.position) for wheel, old in zip(control.wheels, mine, strict=False)]
    vehicle.physics_control = replace(control, wheels=changed + mine[len(given) :])


@call
def get_vehicle_light_state(client: Client, id: int) -> VehicleLightState:
    """Return the lights of a vehicle."""
    return VehicleLightState(expect(client, id, Vehicle).light_state)


@call
def get_vehicle_light_states(client: Client) -> list[tuple[int, int]]:
    """Return the lights of all vehicles with their ids."""
    vehicles = client.host.world.vehicles
    return list(zip(vehicles.id.tolist(), vehicles.light_state.tolist(), strict=True))


@call
def set_vehicle_light_state(client: Client, id: int, state: VehicleLightState) -> None:
    """Set the lights of a vehicle."""
    expect(client, id, Vehicle).light_state = state.bits & LIGHT_BITS


@call
def open_vehicle_door(client: Client, id: int, door: int) -> None:
    """Open a door, or all doors."""
    expect(client, id, Vehicle).set_door(door, open=True)


@call
def close_vehicle_door(client: Client, id: int, door: int) -> None:
    """Close a door, or all doors."""
    expect(client, id, Vehicle).set_door(door, open=False)


@call
def get_wheel_steer_angle(client: Client, id: int, wheel: int) -> float:
    """Return the steering angle of a wheel, in degrees."""
    vehicle = expect(client, id, Vehicle)
    return degrees(vehicle.rows.wheel_angle[vehicle.row].item()) if wheel in _FRONT_WHEELS else 0.0


@call
def get_telemetry_data(client: Client, id: int) -> Telemetry:
    """Return the telemetry of a vehicle, whose wheels roll without slip under equal loads."""
    vehicle = expect(client, id, Vehicle)
    rows, row, control, built = vehicle.rows, vehicle.row, vehicle.control, vehicle.physics_control
    speed = rows.speed[row].item()
    # a replayed vehicle has the gear that was recorded, which can be one that its blueprint lacks
    gears = built.forward_gears or [Gear(0.0)]
    gear = gears[min(max(abs(control.gear), 1), len(gears)) - 1]
    load = built.mass * GRAVITY / max(len(built.wheels), 1)
    wheels = [
        WheelTelemetry(
            wheel.tire_friction, omega=speed / (wheel.radius / CM_PER_M), tire_load=load, normalized_tire_load=1.0
        )
        for wheel in built.wheels
        if wheel.radius > 0
    ]
    turns = max((abs(wheel.omega) for wheel in wheels), default=0.0) * 60 / (2 * pi)
    rpm = min(turns * abs(built.final_ratio * gear.ratio), built.max_rpm) if control.gear else 0.0
    drag = rows.air[row].item() * speed * speed
    return Telemetry(speed, control.steer, control.throttle, control.brake, rpm, control.gear, drag, wheels)


def _physics(client: Client, id: int) -> tuple[PhysicsControl, Transform]:
    """Return the physics and the transform of a vehicle; for a destroyed one, its blueprint's and its last."""
    actor = client.host.known_actor(id)
    if isinstance(actor, DestroyedActor) and actor.blueprint.physics is not None:
        return deepcopy(actor.blueprint.physics), actor.transform
    vehicle = actor if isinstance(actor, Vehicle) else expect(client, id, Vehicle)
    return vehicle.physics_control, vehicle.transform


@call
def apply_control_to_walker(client: Client, id: int, control: WalkerControl) -> None:
    """Apply a control to a walker."""
    expect(client, id, Walker).apply_control(control)


def set_walker_state(client: Client, id: int, transform: Transform, speed: float) -> None:
    """Set the transform and speed of a walker, as the client's pedestrian navigation does in batches.

    A walker without physics does not move by itself; its speed is only reported.
    """
    walker = expect(client, id, Walker)
    expect_velocity("the speed", Vector(speed), of=walker)
    transform.location.z += walker.box.extent.z  # the client sends the location of its feet
    walker.transform = transform
    ahead = transform.forward()
    if walker.simulates_physics:
        walker.apply_control(WalkerControl(ahead, speed))
    else:
        walker.set_target_velocity(Vector(ahead.x * speed, ahead.y * speed, ahead.z * speed))
