"""Calls without a network."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from functools import cache
from typing import Any

import msgpack

import carla_recap.server.calls  # noqa: F401  (registers the calls)
from carla_recap.server.host import Client, Host
from carla_recap.server.rpc.connection import ClientConnection
from carla_recap.server.rpc.registry import CALLS
from carla_recap.sim.town.loading import Town, load_town
from carla_recap.sim.world import World


class Inside:
    """A client inside the server.

    Attributes:
        world: The served world.
        host: The host of that world.
    """

    def __init__(self) -> None:
        self.world = World(_town())
        self.host = Host(self.world)
        self._client = client_inside(self.host)

    def call(self, name: str, *arguments: Any) -> Any:
        """Return the encoded answer to a call, without CARLA's `Response` around it; errors are raised."""
        entry = CALLS[name]
        answer = entry(self._client, list(arguments))
        if isinstance(answer, Coroutine):
            answer = asyncio.run(answer)
        data = msgpack.packb(entry.encoded(self._client, answer), unicode_errors="surrogateescape")
        response = msgpack.unpackb(data, unicode_errors="surrogateescape")
        return response if entry.bare else response[0][-1] or None

    def batch(self, *commands: Any) -> list[Any]:
        """Return the answers to a batch of commands, each [number, fields]."""
        answers: list[Any] = self.call("apply_batch", [[command] for command in commands], False)
        return answers


def client_inside(host: Host) -> Client:
    """Return a client of a host that has no connection."""
    client = Client(host, ClientConnection(CALLS, host.connections, lambda _: client))
    return client


@cache
def _town() -> Town:
    return load_town()
