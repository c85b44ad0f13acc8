"""Batches of commands."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Generator
from dataclasses import dataclass, field
from typing import Any, Final

from carla_recap.server.calls import actors, unsupported, vehicles, world  # noqa: F401  (register the calls)
from carla_recap.server.calls.actors import spawn
from carla_recap.server.calls.session import when_done
from carla_recap.server.host import Client
from carla_recap.server.protocol.releases import Release
from carla_recap.server.rpc.codec import DecodeError, decoder
from carla_recap.server.rpc.connection import error_text
from carla_recap.server.rpc.registry import CALLS, bare_call, unregistered_call
from carla_recap.server.rpc.structs import ActorDescription, VehicleLightState
from carla_recap.sim.geometry import Transform


@dataclass(frozen=True, slots=True)
class SpawnCommand:
    """The command that spawns an actor, relative to its parent if it has one; attachment and socket have no effect.

    Attributes:
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


_CONSOLE: Final = "console_command"
"""The command for the console of Unreal Engine, which has no effect."""
_SPAWN: Final = "spawn_actor"
_UNREGISTERED: Final = {each.__name__: unregistered_call(each) for each in (vehicles.set_walker_state, set_light_state)}
"""The commands that are no calls."""


@bare_call
def apply_batch(client: Client, commands: list[Any], do_tick: bool = False) -> list[Any] | Awaitable[list[Any]]:
    """Execute commands one after the other; an error of one does not keep the others from being executed.

    Commands are `[[number, fields]]` each; the answer to each is the id of its actor, or an error, as CARLA's `Response`. If
    a tick is asked for, it follows in synchronous mode. Calls of other clients are served in between if it takes long, but
    for what ticks or begins an episode.
    """
    answers = client.host.take(_execute_all(client, commands), at_once=not client.connection.is_open)
    if isinstance(answers, list):
        return _tick_after(client, answers, do_tick)

    async def complete() -> list[Any]:
        found = _tick_after(client, await answers, do_tick)
        return found if isinstance(found, list) else await found

    whole = asyncio.ensure_future(complete())
    client.connection.read_after(asyncio.wait([whole]))  # its next calls come after these commands
    return asyncio.shield(whole)  # if the client leaves, its commands and the tick are executed


def _execute_all(client: Client, commands: list[Any]) -> Generator[None, None, list[Any]]:
    """Execute commands, one in each step, and return CARLA's `Response` to each."""
    answers = []
    for command in commands:
        answer = yield from _answer(client, command)
        answers.append(answer)
    return answers


def _tick_after(client: Client, answers: list[Any], do_tick: bool) -> list[Any] | Awaitable[list[Any]]:
    """Return the answers to a batch, after a tick if that is to be in synchronous mode."""
    if not (do_tick and client.host.settings.synchronous_mode):
        return answers

    def tick() -> list[Any]:
        client.host.tick()
        return answers

    return when_done(client.host, client.host.sensors.pending(), tick)


def _answer(client: Client, command: Any, spawned: int | None = None) -> Generator[None, None, list[Any]]:
    """Execute a command, for an actor that was just spawned if there is one, and yield; return CARLA's `Response`."""
    answer: list[Any]
    try:
        answer = [1, (yield from _execute(client, command, spawned))]
    except Exception as error:
        answer = [0, [error_text("apply_batch", error)]]
    yield
    return [answer]


def _execute(client: Client, command: Any, spawned: int | None) -> Generator[None, None, int]:
    """Execute a command and return the id of its actor."""
    name, fields = _unpacked(command, client.release)
    if name == _CONSOLE:
        return 0
    if name == _SPAWN:
        return (yield from _spawn(client, decoder(SpawnCommand, client.release)(fields)))
    call = _UNREGISTERED.get(name) or CALLS[name]
    if spawned is not None:
        fields = [spawned, *fields[1:]]
    call(client, fields)
    id: int = fields[0]
    return id


def _spawn(client: Client, command: SpawnCommand) -> Generator[None, None, int]:
    """Spawn an actor and execute the commands for it; their errors are not reported, as in CARLA."""
    parent = None if command.parent is None else client.host.actor(command.parent)
    id = spawn(client, command.description, command.transform, parent).id
    for after in command.do_after:
        yield from _answer(client, after, id)
    return id


def _unpacked(command: Any, release: Release) -> tuple[str, list[Any]]:
    """Return the name of a command of a release and its fields."""
    try:
        ((number, fields),) = command
    except (TypeError, ValueError):
        number = fields = None
    if number.__class__ is int and fields.__class__ is list and fields:
        if 0 <= number < len(release.commands):
            return release.commands[number], fields
        raise DecodeError(f"apply_batch: there is no command {number}")
    raise DecodeError("apply_batch: a command of [[number, fields]] was expected")
