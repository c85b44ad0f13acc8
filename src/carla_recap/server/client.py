"""A client: its connection, the calls that come over it, and the replies."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from inspect import isawaitable, iscoroutine
from typing import TYPE_CHECKING, Any, Final, cast

import msgpack

from carla_recap.errors import RecapError
from carla_recap.server.inbox import Inbox
from carla_recap.server.mishaps import tell
from carla_recap.server.rounds import Round
from carla_recap.server.table import TABLE

if TYPE_CHECKING:
    from collections.abc import Awaitable

    from carla_recap.server.host import Host
    from carla_recap.server.managers import Truce
    from carla_recap.server.table import Call

_REPLY: Final = 1
_PACKER: Final = msgpack.Packer(unicode_errors="surrogateescape")  # for all: it keeps a large buffer
_AT_ONCE: Final = 64  # calls, after which it is the others' turn
_MOST_PENDING: Final = 32  # answers of a client that are being worked at
_LAST: Final = 1 << 16  # bytes that are heard of who is gone
_MUCH: Final = 1 << 16  # bytes of a call that has not arrived as a whole


class Client(asyncio.Protocol):
    """A connected client.

    Who does not read its replies, or has many calls pending, is not listened to until that changes. Of one who is gone, the
    calls that have arrived are served: the last one of a script is often to stop the recorder, and no script waits for it.

    Args:
        host: Who serves it.

    Attributes:
        host: Who serves it.
        stream: The number of the stream of its snapshots; in an episode that it has begun itself, it has a new one.
        has_spoken: Whether it has made a call.
        round: What its traffic manager is at.
        truce: What keeps its traffic manager still, if something does.
    """

    def __init__(self, host: Host) -> None:
        self.host = host
        self.stream = host.new_stream()
        self.has_spoken = False
        self.round = Round()
        self.truce: Truce | None = None
        self._transport: asyncio.Transport | None = None
        self._inbox = Inbox()
        self._pending: set[asyncio.Task[None]] = set()
        self._is_refused = False
        self._is_cut = False
        self._is_behind = False
        self._is_waiting = False

    @property
    def address(self) -> str:
        """The address of the machine that it is on."""
        peer = None if self._transport is None else self._transport.get_extra_info("peername")
        return peer[0] if peer else ""

    @property
    def held(self) -> int:
        """How many bytes are kept for it: calls that have not arrived as a whole, and replies that it has not read."""
        unsent = 0 if self._transport is None else self._transport.get_write_buffer_size()
        return len(self._inbox.part) + unsent

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See `asyncio.Protocol`."""
        self._transport = cast("asyncio.Transport", transport)
        self.host.clients[self.stream] = self
        self.host.connections.enter(self)

    def connection_lost(self, error: Exception | None) -> None:
        """See `asyncio.Protocol`."""
        transport, self._transport = self._transport, None
        if error is not None and transport is not None:
            self._hear_out(transport)
        for task in self._pending:
            task.cancel()
        self.round.leave()
        self.host.connections.leave(self)
        self.host.clients.pop(self.stream, None)
        self.host.managers.leave(self)
        self.host.streams.forget(self.stream)

    def pause_writing(self) -> None:
        """See `asyncio.Protocol`."""
        self._is_behind = True
        self.host.connections.check_memory()

    def resume_writing(self) -> None:
        """See `asyncio.Protocol`."""
        self._is_behind = False
        self._go_on()

    def data_received(self, data: bytes) -> None:
        """Serve the calls that have arrived; whoever sends something else is cut off."""
        try:
            self._inbox.feed(data)
        except ValueError:
            return self.close()
        self._listen()
        if len(self._inbox.part) > _MUCH:
            self.host.connections.check_memory()
        return None

    def refuse(self) -> None:
        """Serve none of its calls: answer the first one with an error, and cut the connection."""
        self._is_refused = True

    def close(self) -> None:
        """Cut the connection."""
        self._is_cut = True
        if self._transport is not None:
            self._transport.abort()

    def in_background(self, work: Awaitable[None]) -> None:
        """Let something be done after the call that is being served, and no longer than the client is there."""
        task = asyncio.ensure_future(work)
        self._pending.add(task)
        task.add_done_callback(self._done)

    def _listen(self) -> None:
        """Serve calls until there are no more, or something else has to be done before."""
        try:
            for count, request in enumerate(self._inbox, 1):
                self._take(request)
                if self._is_cut:
                    return None
                if self._is_behind or len(self._pending) >= _MOST_PENDING:
                    return self._wait()
                if count == _AT_ONCE:
                    asyncio.get_running_loop().call_soon(self._go_on)
                    return self._wait()
        except ValueError:
            self.close()
        return None

    def _hear_out(self, transport: asyncio.Transport) -> None:
        """Serve the calls that arrived over a connection before it broke; a reply that nobody takes breaks it earlier."""
        self._is_behind = self._is_waiting = False
        self._listen()
        with suppress(OSError), transport.get_extra_info("socket").dup() as rest:
            data = rest.recv(_LAST)
            if not self._is_waiting:
                self.data_received(data)

    def _wait(self) -> None:
        self._is_waiting = True
        if self._transport is not None:
            self._transport.pause_reading()

    def _go_on(self) -> None:
        if self._transport is None or not self._is_waiting or self._is_behind or len(self._pending) >= _MOST_PENDING:
            return
        self._is_waiting = False
        self._transport.resume_reading()
        self._listen()

    def _done(self, task: asyncio.Task[None]) -> None:
        self._pending.discard(task)
        self._go_on()

    def _take(self, request: Any) -> None:
        match request:
            case [0, int(number), str(name), [[*_], *arguments]]:
                if self._is_refused:
                    self._send([_REPLY, number, None, [[0, [self.host.connections.refusal]]]])
                    self._is_cut = True
                    if self._transport is not None:
                        self._transport.close()
                    return
                self.has_spoken = True
                self._serve(number, name, arguments)
            case _:
                raise ValueError

    def _serve(self, number: int, name: str, arguments: list[Any]) -> None:
        call = TABLE.get(name)
        if call is None:
            return self._send([_REPLY, number, f"{name}: there is no such call", None])
        self.round.hear(name)
        try:
            answer = call(self, arguments)
            if self._transport is None and iscoroutine(answer):
                return answer.close()  # who is gone waits for nothing
            if self.truce is not None:
                answer = self.truce.hold(name, answer)
            if isawaitable(answer):
                return self.in_background(self._serve_later(number, call, answer))
            return self._reply(number, call, answer)
        except Exception as error:
            return self._reply_error(number, call, error)

    async def _serve_later(self, number: int, call: Call, answer: Awaitable[Any]) -> None:
        try:
            self._reply(number, call, await answer)
        except Exception as error:
            self._reply_error(number, call, error)

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
        data = _PACKER.pack(reply)
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(data)


def describe(name: str, error: Exception) -> str:
    """What a client is told of an error; what should not have happened is told on stderr, too."""
    if isinstance(error, RecapError):
        return str(error)
    tell(f"{name} has failed", error)
    return f"{name}: {type(error).__name__}: {error}"
