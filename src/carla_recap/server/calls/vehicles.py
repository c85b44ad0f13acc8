"""Calls about vehicles: driving them, their lights and doors, how they are built and how they move."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from math import degrees, pi
from typing import Any, Final, get_type_hints

import numpy as np

from carla_recap.server.ackermann import AckermannControl, AckermannSettings
from carla_recap.server.calls.actors import expect
from carla_recap.server.client import Client
from carla_recap.server.ghosts import Ghost
from carla_recap.server.structs import Telemetry, VehicleLightState, WheelTelemetry
from carla_recap.server.table import CallError, call
from carla_recap.sim.actors.actors import Vehicle
from carla_recap.sim.actors.control import VehicleControl
from carla_recap.sim.geometry import Location, Transform, Vector
from carla_recap.sim.physics.drivetrain import GRAVITY
from carla_recap.sim.physics.physics_control import PhysicsControl

_CM: Final = 100.0  # in a m
_CONTROL: Final = list(get_type_hints(VehicleControl).values())
_FRONT_WHEELS: Final = (0, 1)
_LIGHT_BITS: Final = 0xFFFFFFFF


@call
def apply_control_to_vehicle(client: Client, id: int, control: VehicleControl) -> None:
    """Tell the driver of a vehicle what to do from now on."""
    vehicle = expect(client, id, Vehicle)
    client.host.ackermann.release(vehicle)
    control.gear = min(max(control.gear, -1), vehicle.gears)
    vehicle.apply_control(control)


def apply_controls_to_vehicles(client: Client, told: list[tuple[Any, Any]]) -> bool:
    """Tell many drivers at once what to do from now on, as `apply_control_to_vehicle` would one by one, but faster.

    Args:
        client: Who tells it.
        told: Ids of vehicles, and the fields of their controls, as they came over the wire.

    Returns:
        Whether it is done. It is not, and nothing is, where something is not as usual: a gear that is shifted by hand, or
        what is no control, or no vehicle.
    """
    fleet = client.host.world.vehicles
    try:
        rows = [fleet.row(id) for id, _ in told]
        usual = all(id.__class__ is int and [part.__class__ for part in control] == _CONTROL for id, control in told)
    except (KeyError, TypeError):
        return False
    if not usual:
        return False
    *pedals, hand_brake, reverse, manual, _ = zip(*(control for _, control in told), strict=True)
    values = np.array(pedals)
    if any(manual) or not np.isfinite(values).all():
        return False
    for row in rows:
        client.host.ackermann.release(fleet.actors[row])
    fleet.drive(rows, values, hand_brake, reverse)
    return True


@call
def apply_ackermann_control_to_vehicle(client: Client, id: int, control: AckermannControl) -> None:
    """Tell how fast a vehicle shall go, and where its wheels shall point, until it is told controls."""
    client.host.ackermann.drive(expect(client, id, Vehicle), control)


@call
def get_ackermann_controller_settings(client: Client, id: int) -> AckermannSettings:
    """The gains that a client has set."""
    return client.host.ackermann.settings(expect(client, id, Vehicle))


@call
def apply_ackermann_controller_settings(client: Client, id: int, settings: AckermannSettings) -> None:
    """Keep gains; the simulator's own controller needs none."""
    client.host.ackermann.set_settings(expect(client, id, Vehicle), settings)


@call
def get_physics_control(client: Client, id: int) -> PhysicsControl:
    """How a vehicle is built; where its wheels are is told in the world and in cm, as by CARLA."""
    control, there = _built(client, id)
    for wheel in control.wheels:
        at = wheel.position
        place = there.transform(Location(at.x / _CM, at.y / _CM, at.z / _CM))
        wheel.position = Vector(place.x * _CM, place.y * _CM, place.z * _CM)
    return control


@call
def apply_physics_control(client: Client, id: int, control: PhysicsControl) -> None:
    """Build a vehicle anew; its wheels stay where they are, as in CARLA."""
    vehicle = expect(client, id, Vehicle)
    mine = vehicle.physics_control.wheels
    if len(control.wheels) != len(mine):
        raise CallError(f"a physics control of {vehicle!r}: {len(mine)} wheels were expected, found {len(control.wheels)}")
    wheels = [replace(wheel, position=old.position) for wheel, old in zip(control.wheels, mine, strict=True)]
    vehicle.physics_control = replace(control, wheels=wheels)


@call
def get_vehicle_light_state(client: Client, id: int) -> VehicleLightState:
    """The lights of a vehicle."""
    return VehicleLightState(expect(client, id, Vehicle).light_state)


@call
def get_vehicle_light_states(client: Client) -> list[tuple[int, int]]:
    """The lights of all vehicles, by their ids."""
    vehicles = client.host.world.vehicles
    return list(zip(vehicles.id.tolist(), vehicles.light_state.tolist(), strict=True))


@call
def set_vehicle_light_state(client: Client, id: int, state: VehicleLightState) -> None:
    """Switch the lights of a vehicle."""
    expect(client, id, Vehicle).light_state = state.bits & _LIGHT_BITS


@call
def open_vehicle_door(client: Client, id: int, door: int) -> None:
    """Open a door, or all."""
    expect(client, id, Vehicle).set_door(door, open=True)


@call
def close_vehicle_door(client: Client, id: int, door: int) -> None:
    """Close a door, or all."""
    expect(client, id, Vehicle).set_door(door, open=False)


@call
def get_wheel_steer_angle(client: Client, id: int, wheel: int) -> float:
    """How far a wheel is turned, in degrees."""
    vehicle = expect(client, id, Vehicle)
    return degrees(vehicle.rows.steer_angle[vehicle.row].item()) if wheel in _FRONT_WHEELS else 0.0


@call
def get_telemetry_data(client: Client, id: int) -> Telemetry:
    """How a vehicle moves; its wheels roll, and carry the same."""
    vehicle = expect(client, id, Vehicle)
    rows, row, control, built = vehicle.rows, vehicle.row, vehicle.control, vehicle.physics_control
    speed = rows.speed[row].item()
    gear = built.forward_gears[max(abs(control.gear), 1) - 1] if built.forward_gears else None
    load = built.mass * GRAVITY / max(len(built.wheels), 1)
    wheels = [
        WheelTelemetry(wheel.tire_friction, omega=speed / (wheel.radius / _CM), tire_load=load, normalized_tire_load=1.0)
        for wheel in built.wheels
        if wheel.radius > 0
    ]
    turns = max((abs(wheel.omega) for wheel in wheels), default=0.0) * 60 / (2 * pi)
    rpm = min(turns * abs(built.final_ratio * gear.ratio), built.max_rpm) if gear and control.gear else 0.0
    drag = rows.air[row].item() * speed * speed
    return Telemetry(speed, control.steer, control.throttle, control.brake, rpm, control.gear, drag, wheels)


def _built(client: Client, id: int) -> tuple[PhysicsControl, Transform]:
    """How a vehicle is built, and where it is; of one that has been destroyed, what its model is like, and where it was."""
    actor = client.host.actor_or_ghost(id)
    if isinstance(actor, Ghost) and actor.blueprint.physics is not None:
        return deepcopy(actor.blueprint.physics), actor.transform
    vehicle = actor if isinstance(actor, Vehicle) else expect(client, id, Vehicle)
    return vehicle.physics_control, vehicle.transform
