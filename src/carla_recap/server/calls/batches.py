"""Batches of commands."""

from __future__ import annotations

from collections.abc import Awaitable
from dataclasses import dataclass, field
from typing import Any, Final

from carla_recap.server.calls import actors, unsupported, vehicles, world  # noqa: F401  (register the calls)
from carla_recap.server.calls.actors import spawn
from carla_recap.server.calls.session import when_done
from carla_recap.server.host import Client
from carla_recap.server.rpc.codec import DecodeError, decoder
from carla_recap.server.rpc.connection import error_text
from carla_recap.server.rpc.registry import CALLS, Call, bare_call, unregistered_call
from carla_recap.server.rpc.structs import ActorDescription, VehicleLightState
from carla_recap.sim.geometry import Transform


@dataclass(frozen=True, slots=True)
class SpawnCommand:
    """The command that spawns an actor.

    Attributes:
        description: The blueprint and the attributes.
        transform: The transform; relative to the parent, if there is one.
        parent: The id of the parent.
        attachment: The kind of attachment, which has no effect.
        socket: The socket of the parent, which has no effect.
        do_after: Commands for the new actor.
    """

    description: ActorDescription
    transform: Transform
    parent: int | None = None
    attachment: int = 0
    socket: str = ""
    do_after: list[Any] = field(default_factory=list)


def set_light_state(client: Client, id: int, bits: int) -> None:
    """Set the lights of a vehicle."""
    vehicles.set_vehicle_light_state(client, id, VehicleLightState(bits))


_CONSOLE: Final = 20
"""The command for the console of Unreal Engine, which has no effect."""
_COMMANDS: Final[tuple[Call | None, ...]] = (
    None,
    CALLS["destroy_actor"],
    CALLS["apply_control_to_vehicle"],
    CALLS["apply_ackermann_control_to_vehicle"],
    CALLS["apply_control_to_walker"],
    CALLS["apply_physics_control"],
    CALLS["set_actor_transform"],
    unregistered_call(vehicles.set_walker_state),
    CALLS["set_actor_target_velocity"],
    CALLS["set_actor_target_angular_velocity"],
    CALLS["add_actor_impulse"],
    CALLS["add_actor_force"],
    CALLS["add_actor_angular_impulse"],
    CALLS["add_actor_torque"],
    CALLS["set_actor_simulate_physics"],
    CALLS["set_actor_enable_gravity"],
    CALLS["set_actor_autopilot"],
    CALLS["show_vehicle_debug_telemetry"],
    unregistered_call(set_light_state),
    CALLS["set_actor_location"],
    None,
    CALLS["set_traffic_light_state"],
)
"""The commands in the order of their numbers: all but the spawn and the console command are calls."""
_CONTROL: Final = _COMMANDS.index(CALLS["apply_control_to_vehicle"])
_decode_spawn: Final = decoder(SpawnCommand)


@bare_call
def apply_batch(client: Client, commands: list[Any], do_tick: bool = False) -> list[Any] | Awaitable[list[Any]]:
    """Execute commands one after the other; an error of one does not keep the others from being executed.

    Args:
        client: The client.
        commands: The commands, each `[[number, fields]]`.
        do_tick: Whether to tick afterwards, in synchronous mode.

    Returns:
        For each command the id of its actor, or an error, as CARLA's `Response`.
    """
    answers = _apply_controls(client, commands) or [_answer(client, command) for command in commands]
    if not (do_tick and client.host.settings.synchronous_mode):
        return answers

    def tick() -> list[Any]:
        client.host.tick()
        return answers

    return when_done(client.host.sensors.pending(), tick)


def _apply_controls(client: Client, commands: list[Any]) -> list[Any] | None:
    """Execute commands that are all controls of vehicles, as a traffic manager's are; else return None and do nothing."""
    try:
        controls = [
            (id, control) for ((number, (id, control)),) in commands if number.__class__ is int and number == _CONTROL
        ]
    except (TypeError, ValueError):
        return None
    if not controls or len(controls) < len(commands) or not vehicles.apply_controls_to_vehicles(client, controls):
        return None
    return [[[1, id]] for id, _ in controls]


def _answer(client: Client, command: Any, spawned: int | None = None) -> list[Any]:
    """Execute a command, for an actor that was just spawned if there is one; return CARLA's `Response`."""
    try:
        return [[1, _execute(client, command, spawned)]]
    except Exception as error:
        return [[0, [error_text("apply_batch", error)]]]


def _execute(client: Client, command: Any, spawned: int | None) -> int:
    """Execute a command and return the id of its actor."""
    number, fields = _unpacked(command)
    if number == _CONSOLE:
        return 0
    call = _COMMANDS[number]
    if call is None:
        return _spawn(client, _decode_spawn(fields))
    if spawned is not None:
        fields = [spawned, *fields[1:]]
    call(client, fields)
    id: int = fields[0]
    return id


def _spawn(client: Client, command: SpawnCommand) -> int:
    """Spawn an actor and execute the commands for it; their errors are not reported, as in CARLA."""
    parent = None if command.parent is None else client.host.actor(command.parent)
    id = spawn(client, command.description, command.transform, parent).id
    for after in command.do_after:
        _answer(client, after, id)
    return id


def _unpacked(command: Any) -> tuple[int, list[Any]]:
    """Return the number of a command and its fields."""
    try:
        ((number, fields),) = command
    except (TypeError, ValueError):
        number = fields = None
    if number.__class__ is int and fields.__class__ is list and fields:
        if 0 <= number < len(_COMMANDS):
            return number, fields
        raise DecodeError(f"apply_batch: there is no command {number}")
    raise DecodeError("apply_batch: a command of [[number, fields]] was expected")
