"""Calls without a network."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import msgpack

import carla_recap.server.calls  # noqa: F401  (registers the calls)
from carla_recap.server.host import Client, Host
from carla_recap.server.rpc.codec import EncodedText
from carla_recap.server.rpc.connection import ClientConnection
from carla_recap.server.rpc.registry import CALLS
from carla_recap.sim.town.loading import Town, load_town
from carla_recap.sim.world import World

if TYPE_CHECKING:
    from carla_recap.server.protocol import Release


class Inside:
    """A client of a release inside the server of a world, by default a new one with the built-in town."""

    def __init__(self, release: Release | None = None, world: World | None = None) -> None:
        self.world = world or World(_town())
        self.host = Host(self.world, release=release)
        self.client = client_inside(self.host)

    def call(self, name: str, *arguments: Any) -> Any:
        """Return the encoded answer to a call, without CARLA's `Response` around it; errors are raised."""
        entry = CALLS[name]
        answer = entry(self.client, list(arguments))
        if isinstance(answer, Coroutine):
            answer = asyncio.run(answer)
        if isinstance(answer, EncodedText):
            return answer.decode("utf-8", "surrogateescape")
        data = msgpack.packb(entry.encoded(self.client, answer), unicode_errors="surrogateescape")
        response = msgpack.unpackb(data, unicode_errors="surrogateescape")
        if entry.bare:
            return response
        return None if entry.result is None else response[0][1]

    def batch(self, *commands: Any) -> list[Any]:
        """Return the answers to a batch of commands, each [number, fields]."""
        answers: list[Any] = self.call("apply_batch", [[command] for command in commands], False)
        return answers


def client_inside(host: Host) -> Client:
    """Return a client of a host that has no connection."""
    client = Client(host, ClientConnection(CALLS, host.connections, lambda _: client))
    return client


def connected(host: Host) -> tuple[ClientConnection, Transport]:
    """Return a connection of a client to a host, and what is written to it."""
    connection, transport = ClientConnection(CALLS, host.connections, partial(Client, host)), Transport()
    connection.connection_made(transport)
    return connection, transport


@cache
def _town() -> Town:
    return load_town()


class Transport(asyncio.Transport):
    """Keeps what is written to it."""

    def __init__(self) -> None:
        super().__init__()
        self.written = b""

    def write(self, data: Any) -> None:
        self.written += data

    def is_closing(self) -> bool:
        return False

    def pause_reading(self) -> None:
        pass

    def resume_reading(self) -> None:
        pass

    def get_write_buffer_size(self) -> int:
        return 0

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return default

    @property
    def replies(self) -> list[list[Any]]:
        unpacker = msgpack.Unpacker(unicode_errors="surrogateescape")
        unpacker.feed(self.written)
        return list(unpacker)
