"""Calls without a network: what a client would be answered, straight from the table."""

from __future__ import annotations

from functools import cache
from typing import Any

import msgpack

import carla_recap.server.calls  # noqa: F401  (fills the table of calls)
from carla_recap.server.client import Client
from carla_recap.server.host import Host
from carla_recap.server.table import TABLE
from carla_recap.sim.town.town import Town, load_town
from carla_recap.sim.world import World


class Inside:
    """A client inside the server.

    Attributes:
        world: The world that is served.
        host: Who serves it.
    """

    def __init__(self) -> None:
        self.world = World(_town())
        self.host = Host(self.world)
        self._client = Client(self.host)

    def call(self, name: str, *arguments: Any) -> Any:
        """The answer to a call as it goes over the wire, without what CARLA wraps it in; errors are raised."""
        row = TABLE[name]
        answer = row(self._client, list(arguments))
        if row.result is None:
            return None
        data = msgpack.packb(row.result(answer), unicode_errors="surrogateescape")
        return msgpack.unpackb(data, unicode_errors="surrogateescape")

    def batch(self, *commands: Any) -> list[Any]:
        """The answers to a batch of commands, each [number, fields]."""
        answers: list[Any] = self.call("apply_batch", [[command] for command in commands], False)
        return answers


@cache
def _town() -> Town:
    return load_town()
