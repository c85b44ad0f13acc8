"""A client: its connection, the calls that come over it, and the replies."""

from __future__ import annotations

import asyncio
import sys
import traceback
from inspect import isawaitable
from typing import TYPE_CHECKING, Any, Final

import msgpack

from carla_recap.errors import RecapError
from carla_recap.server.calls.table import TABLE

if TYPE_CHECKING:
    from collections.abc import Awaitable

    from carla_recap.server.calls.table import Call
    from carla_recap.server.host import Host

_REQUEST, _REPLY = 0, 1
_LARGEST: Final = 32 << 20  # bytes of a call: the text of a large map
_MOST_ITEMS: Final = 1 << 20  # of an array


class Client(asyncio.Protocol):
    """A connected client.

    Args:
        host: Who serves it.
        number: Its number, and that of the stream of its snapshots.

    Attributes:
        host: Who serves it.
        stream: The number of the stream of its snapshots.
        has_called: Whether it has made a call.
    """

    def __init__(self, host: Host, number: int) -> None:
        self.host = host
        self.stream = number
        self.has_called = False
        self._transport: asyncio.Transport | None = None
        self._packer = msgpack.Packer(unicode_errors="surrogateescape")
        self._unpacker = msgpack.Unpacker(
            max_buffer_size=_LARGEST,
            max_array_len=_MOST_ITEMS,
            max_map_len=0,
            max_ext_len=0,
            unicode_errors="surrogateescape",
        )
        self._tasks: set[asyncio.Task[None]] = set()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See `asyncio.Protocol`."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self.host.clients[self.stream] = self

    def connection_lost(self, _: Exception | None) -> None:
        """See `asyncio.Protocol`."""
        self._transport = None
        for task in self._tasks:
            task.cancel()
        self.host.clients.pop(self.stream, None)
        self.host.managers.leave(self)
        self.host.streams.forget(self.stream)

    def pause_writing(self) -> None:
        """Whoever does not read its replies is not served."""
        if self._transport is not None:
            self._transport.pause_reading()

    def resume_writing(self) -> None:
        """See `asyncio.Protocol`."""
        if self._transport is not None:
            self._transport.resume_reading()

    def data_received(self, data: bytes) -> None:
        """Serve the calls that have arrived; whoever sends something else is cut off."""
        try:
            self._unpacker.feed(data)
            for request in self._unpacker:
                self._take(request)
        except (msgpack.UnpackException, ValueError):
            self.close()

    def close(self) -> None:
        """Cut the connection."""
        if self._transport is not None:
            self._transport.abort()

    def _take(self, request: Any) -> None:
        match request:
            case [0, int(number), str(name), [[*_], *arguments]]:
                self.has_called = True
                self._serve(number, name, arguments)
            case _:
                raise ValueError

    def _serve(self, number: int, name: str, arguments: list[Any]) -> None:
        call = TABLE.get(name)
        if call is None:
            return self._send([_REPLY, number, f"{name}: there is no such call", None])
        try:
            answer = call(self, arguments)
        except Exception as error:
            return self._reply_error(number, call, error)
        if isawaitable(answer):
            task = asyncio.ensure_future(self._serve_later(number, call, answer))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)
            return None
        return self._reply(number, call, answer)

    async def _serve_later(self, number: int, call: Call, answer: Awaitable[Any]) -> None:
        try:
            result = await answer
        except Exception as error:
            return self._reply_error(number, call, error)
        return self._reply(number, call, result)

    def _reply(self, number: int, call: Call, answer: Any) -> None:
        if call.result is None:
            self._send([_REPLY, number, None, [[False]]])
        else:
            value = call.result(answer)
            self._send([_REPLY, number, None, value if call.bare else [[1, value]]])

    def _reply_error(self, number: int, call: Call, error: Exception) -> None:
        text = describe(call.name, error)
        self._send([_REPLY, number, None, [[call.result is None or 0, [text]]]])

    def _send(self, reply: list[Any]) -> None:
        if self._transport is not None:
            self._transport.write(self._packer.pack(reply))


def describe(name: str, error: Exception) -> str:
    """What a client is told of an error; what should not have happened is told on stderr, too."""
    if isinstance(error, RecapError):
        return str(error)
    print(f"carla-recap: {name} has failed", *traceback.format_exception(error), sep="\n", file=sys.stderr)
    return f"{name}: {type(error).__name__}: {error}"
