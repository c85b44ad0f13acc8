"""Batches of commands, which clients send at once."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

from carla_recap.server.calls import accepted, actors, lights, vehicles, walkers  # noqa: F401  (fill the table of calls)
from carla_recap.server.calls.actors import spawn
from carla_recap.server.client import Client, describe
from carla_recap.server.structs import ActorDescription, VehicleLightState
from carla_recap.server.table import TABLE, Call, bare_call, row
from carla_recap.server.wire import WireError, decoder
from carla_recap.sim.geometry import Transform


@dataclass(frozen=True, slots=True)
class Spawn:
    """The command that lets an actor appear.

    Attributes:
        description: What.
        transform: Where; relative to the parent, if there is one.
        parent: The id of what it is attached to.
        attachment: How.
        socket: Where on the parent.
        do_after: Commands for the new actor.
    """

    description: ActorDescription
    transform: Transform
    parent: int | None = None
    attachment: int = 0
    socket: str = ""
    do_after: list[Any] = field(default_factory=list)


def set_light_state(client: Client, id: int, bits: int) -> None:
    """Switch the lights of a vehicle."""
    vehicles.set_vehicle_light_state(client, id, VehicleLightState(bits))


_CONSOLE: Final = 20
"""A command for the console of Unreal Engine, which there is none of."""
_COMMANDS: Final[tuple[Call | None, ...]] = (
    None,
    TABLE["destroy_actor"],
    TABLE["apply_control_to_vehicle"],
    TABLE["apply_ackermann_control_to_vehicle"],
    TABLE["apply_control_to_walker"],
    TABLE["apply_physics_control"],
    TABLE["set_actor_transform"],
    row(walkers.set_walker_state),
    TABLE["set_actor_target_velocity"],
    TABLE["set_actor_target_angular_velocity"],
    TABLE["add_actor_impulse"],
    TABLE["add_actor_force"],
    TABLE["add_actor_angular_impulse"],
    TABLE["add_actor_torque"],
    TABLE["set_actor_simulate_physics"],
    TABLE["set_actor_enable_gravity"],
    TABLE["set_actor_autopilot"],
    TABLE["show_vehicle_debug_telemetry"],
    row(set_light_state),
    TABLE["set_actor_location"],
    None,
    TABLE["set_traffic_light_state"],
)
"""The commands as they are numbered: each is a call, but for spawning and for what is meant for the console."""
_CONTROL: Final = _COMMANDS.index(TABLE["apply_control_to_vehicle"])
_decode_spawn: Final = decoder(Spawn)


@bare_call
def apply_batch(client: Client, commands: list[Any], do_tick: bool = False) -> list[Any]:
    """Execute commands one after the other; what goes wrong with one is told, and the others are executed all the same.

    Args:
        client: Who has sent them.
        commands: Each `[[number, fields]]`.
        do_tick: Whether a tick passes afterwards, in synchronous mode.

    Returns:
        For each command the id of its actor, or an error, as CARLA's `Response`.
    """
    answers = _driven(client, commands) or [_answer(client, command) for command in commands]
    if do_tick and client.host.settings.synchronous_mode:
        client.host.tick()
    return answers


def _driven(client: Client, commands: list[Any]) -> list[Any] | None:
    """Execute commands that are all controls of vehicles, as a traffic manager's are; None, and nothing is done, if not."""
    try:
        told = [(id, control) for ((number, (id, control)),) in commands if number.__class__ is int and number == _CONTROL]
    except (TypeError, ValueError):
        return None
    if not told or len(told) < len(commands) or not vehicles.apply_controls_to_vehicles(client, told):
        return None
    return [[[1, id]] for id, _ in told]


def _answer(client: Client, command: Any, spawned: int | None = None) -> list[Any]:
    """Execute a command, for an actor that was just spawned perhaps; returns CARLA's `Response`."""
    try:
        return [[1, _execute(client, command, spawned)]]
    except Exception as error:
        return [[0, [describe("apply_batch", error)]]]


def _execute(client: Client, command: Any, spawned: int | None) -> int:
    """Execute a command; returns the id of its actor."""
    number, fields = _opened(command)
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


def _spawn(client: Client, command: Spawn) -> int:
    """Let an actor appear, and execute what is to be done with it then; what goes wrong with that is not told."""
    parent = None if command.parent is None else client.host.actor(command.parent)
    id = spawn(client, command.description, command.transform, parent).id
    for after in command.do_after:
        _answer(client, after, id)
    return id


def _opened(command: Any) -> tuple[int, list[Any]]:
    """The number of a command, and its fields."""
    try:
        ((number, fields),) = command
        if number.__class__ is int and 0 <= number < len(_COMMANDS) and fields.__class__ is list and fields:
            return number, fields
    except (TypeError, ValueError):
        pass
    raise WireError("apply_batch: a command of [[number, fields]] was expected")
