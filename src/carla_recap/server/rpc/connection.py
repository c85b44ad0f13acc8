"""Connections of clients: the calls that arrive over one, the replies, and the limits of all connections together."""

from __future__ import annotations

import asyncio
import logging
import struct
from contextlib import suppress
from inspect import isawaitable, iscoroutine
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

import msgpack

from carla_recap.errors import RecapError
from carla_recap.server.quirks import unread_bytes
from carla_recap.server.rpc.codec import EncodedText

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterator, Mapping

    from carla_recap.server.protocol.clients import Address
    from carla_recap.server.protocol.releases import Release
    from carla_recap.server.rpc.registry import Call

_LOG: Final = logging.getLogger(__name__)
_REPLY: Final = 1
_TEXT: Final = struct.Struct(">BI")
_LONG_TEXT: Final = 0xDB  # of MessagePack: a text whose length has 32 bits
_PACKER: Final = msgpack.Packer(unicode_errors="surrogateescape")  # shared: it keeps a large buffer
_CALLS_AT_ONCE: Final = 64  # before other connections are served
_MOST_PENDING: Final = 32  # replies of a client that are being prepared
_LARGE_PART: Final = 1 << 16  # bytes of an incomplete message
_MOST_CONNECTIONS: Final = 2000  # each sensor that a client listens to is one
_RESERVED_FILES: Final = 100  # files that the process needs besides
_MOST_HELD: Final = 128 << 20  # bytes
_SHOWN: Final = 200  # characters of an unknown name in an error
_MOST_UNKNOWN: Final = 20  # unknown calls in the log
_MOST_LOGGED: Final = 100  # errors of a connection that no client waits for
_unknown: Final[set[str]] = set()
"""The unknown calls that have been logged."""
_LARGEST: Final = 32 << 20  # bytes of a message: the text of a large map
_LONG: Final = 1 << 20  # bytes: in longer messages, the items are counted
_MOST_ITEMS: Final = 2 << 20  # of all counted arrays together: ten thousand actors to spawn
_LONGEST_ARRAY: Final = 1 << 14  # items: memory is allocated for them before they have arrived
_BUFFER: Final = 1 << 10  # bytes, at first


class PooledConnection(asyncio.Protocol):
    """A connection as the pool sees it; `has_spoken` is whether it has sent a call, or the number of a stream."""

    def __init__(self, pool: ConnectionPool) -> None:
        self.has_spoken = False
        self._pool = pool
        self._transport: asyncio.Transport | None = None

    @property
    def held(self) -> int:
        """The bytes that are kept for it."""
        return 0 if self._transport is None else self._transport.get_write_buffer_size()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See `asyncio.Protocol`."""
        self._transport = cast("asyncio.Transport", transport)
        self._pool.add(self)

    def refuse(self) -> None:
        """Close the connection, since there are too many, and say so where possible."""
        self.close()

    def close(self) -> None:
        """Close the connection at once."""
        if self._transport is not None:
            self._transport.abort()


class ConnectionPool:
    """The connections of a server.

    When the pool is full, a connection that has never sent anything is closed in favour of a new one; if there is none, the
    new one is refused.
    """

    def __init__(self) -> None:
        self._limit = connection_limit()
        self._members: dict[PooledConnection, None] = {}

    @property
    def refusal(self) -> str:
        """The error text for a refused connection."""
        return f"the server has {self._limit} connections, which is as many as it can have"

    def add(self, connection: PooledConnection) -> None:
        """Add a new connection, or refuse it."""
        if len(self._members) >= self._limit:
            silent = next((member for member in self._members if not member.has_spoken), None)
            if silent is None:
                connection.refuse()
            else:
                del self._members[silent]
                silent.close()
        self._members[connection] = None

    def remove(self, connection: PooledConnection) -> None:
        """Remove a connection."""
        self._members.pop(connection, None)

    def check_memory(self) -> None:
        """Close the connection that holds most memory if all together hold too much."""
        if sum(member.held for member in self._members) > _MOST_HELD:
            max(self._members, key=lambda member: member.held).close()


def connection_limit() -> int:
    """Return the number of possible connections, after raising the process' limit of open files as far as needed."""
    with suppress(ImportError, OSError, ValueError):  # not on Windows
        import resource

        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = _MOST_CONNECTIONS + _RESERVED_FILES
        if soft != resource.RLIM_INFINITY and soft < wanted:
            soft = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
            return min(_MOST_CONNECTIONS, max(1, soft - _RESERVED_FILES))
    return _MOST_CONNECTIONS


class CallContext(Protocol):
    """The state of a client, which calls get as their first argument."""

    @property
    def release(self) -> Release:
        """The release of the client."""

    def begin_call(self, name: str) -> None:
        """Take note of a call before it is served, or refuse it by a `RecapError`."""

    def hold(self, name: str, answer: Any) -> Any:
        """Return the answer to a call, or an awaitable of it."""

    def leave(self) -> None:
        """Release everything when the connection is closed."""


class ClientConnection(PooledConnection):
    """A connection over which a client makes calls.

    Reading pauses while the client does not read its replies or has many calls pending. The calls that arrived before a
    client left are served: the last call of a script is often to stop the recorder, and no script waits for its reply.
    """

    def __init__(
        self,
        calls: Mapping[str, Call],
        pool: ConnectionPool,
        open_context: Callable[[ClientConnection], CallContext],
    ) -> None:
        super().__init__(pool)
        self._logged = 0
        self._calls = calls
        self._open_context = open_context
        self._context: CallContext | None = None
        self._buffer = MessageBuffer()
        self._pending: set[asyncio.Future[Any]] = set()
        self._awaited: asyncio.Future[Any] | None = None
        self._is_refused = False
        self._is_closed = False
        self._is_behind = False
        self._is_paused = False

    @property
    def ends(self) -> tuple[Address, Address] | None:
        """The addresses of the client and of the server; None without a network."""
        names = [self._transport.get_extra_info(end) for end in ("peername", "sockname")] if self._transport else []
        return (names[0][:2], names[1][:2]) if all(names) and names else None

    @property
    def is_open(self) -> bool:
        """Whether it has not been lost."""
        return self._transport is not None

    @property
    def address(self) -> str:
        """The address of the client's machine."""
        return self.ends[0][0] if self.ends else ""

    @property
    def held(self) -> int:
        """The bytes that are kept for it: of incomplete calls, and of replies that it has not read."""
        return len(self._buffer.part) + super().held

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See `asyncio.Protocol`."""
        super().connection_made(transport)
        self._context = self._open_context(self)

    def connection_lost(self, error: Exception | None) -> None:
        """See `asyncio.Protocol`."""
        transport, self._transport = self._transport, None
        if error is not None and transport is not None:
            self._serve_rest(transport)
        for pending in self._pending:
            pending.cancel()
        self._pool.remove(self)
        if self._context is not None:
            self._context.leave()
            self._context = None  # else the two would keep each other, and the buffer, until a garbage collection

    def pause_writing(self) -> None:
        """See `asyncio.Protocol`."""
        self._is_behind = True

    def resume_writing(self) -> None:
        """See `asyncio.Protocol`."""
        self._is_behind = False
        self._resume()

    def data_received(self, data: bytes) -> None:
        """Serve the calls that have arrived; close the connection if the data is anything else."""
        try:
            self._buffer.feed(data)
        except ValueError:
            return self.close()
        self._serve_buffered()
        if len(self._buffer.part) > _LARGE_PART:
            self._pool.check_memory()
        return None

    def refuse(self) -> None:
        """Answer the first call with an error, and close."""
        self._is_refused = True

    def close(self) -> None:
        """Close the connection at once."""
        self._is_closed = True
        super().close()

    def in_background(self, work: Awaitable[None]) -> None:
        """Run something after the current call; it is cancelled when the client leaves."""
        self._watch(asyncio.ensure_future(work))

    def read_after(self, work: Awaitable[object]) -> None:
        """Read nothing, and serve no more calls, before some work is done; it is cancelled when the client leaves."""
        if self._transport is not None:
            self._pause()
            self._awaited = asyncio.ensure_future(work)
            self._watch(self._awaited)
        elif iscoroutine(work):
            work.close()

    @property
    def _is_busy(self) -> bool:
        """Whether no more calls can be served for now."""
        return self._is_behind or len(self._pending) >= _MOST_PENDING or self._awaited in self._pending

    def _watch(self, task: asyncio.Future[Any]) -> None:
        self._pending.add(task)
        task.add_done_callback(self._forget)

    def _serve_buffered(self) -> None:
        """Serve calls until there are no more, or reading has to pause."""
        try:
            for count, request in enumerate(self._buffer, 1):
                self._take(request)
                if self._is_closed:
                    return None
                if self._is_busy:
                    return self._pause()
                if count == _CALLS_AT_ONCE:
                    asyncio.get_running_loop().call_soon(self._resume)
                    return self._pause()
        except ValueError:
            self.close()
        return None

    def _serve_rest(self, transport: asyncio.Transport) -> None:
        """Serve the calls that arrived before the connection broke; see `unread_bytes`."""
        self._is_behind = self._is_paused = False
        self._awaited = None
        self._serve_buffered()
        data = unread_bytes(transport)
        if data and not self._is_paused:
            self.data_received(data)

    def _pause(self) -> None:
        self._is_paused = True
        if self._transport is not None:
            self._transport.pause_reading()

    def _resume(self) -> None:
        if self._transport is None or not self._is_paused or self._is_busy:
            return
        self._is_paused = False
        self._transport.resume_reading()
        self._serve_buffered()

    def _forget(self, task: asyncio.Future[Any]) -> None:
        self._pending.discard(task)
        self._resume()

    def _take(self, request: Any) -> None:
        match request:
            case [0, int(number), str(name), [[*metadata], *arguments]]:
                if self._is_refused:
                    self._send([_REPLY, number, None, [[0, [self._pool.refusal]]]])
                    self._is_closed = True
                    if self._transport is not None:
                        self._transport.close()
                    return
                self.has_spoken = True
                self._serve(number, name, arguments, waits=metadata[:1] != [True])
            case _:
                raise ValueError

    def _serve(self, number: int, name: str, arguments: list[Any], *, waits: bool) -> None:
        call = self._calls.get(name)
        context = self._context
        assert context is not None
        if call is None:
            return self._send([_REPLY, number, _unknown_call(name), None])
        try:
            context.begin_call(name)
            answer = call(context, arguments)
            if self._transport is None and iscoroutine(answer):
                return answer.close()  # the client has left
            answer = context.hold(name, answer)
            if isawaitable(answer):
                return self._reply_later(number, call, answer, waits=waits)
            return self._send([_REPLY, number, None, call.encoded(context, answer)])
        except Exception as error:
            return self._reply_error(number, call, error, waits=waits)

    def _reply_later(self, number: int, call: Call, answer: Awaitable[Any], *, waits: bool) -> None:
        """Reply when an answer is ready; it is a task itself, so that it is not left unawaited when the client leaves."""
        context = self._context

        def reply(task: asyncio.Future[Any]) -> None:
            if task.cancelled():
                return
            try:
                answer = task.result()
                if isinstance(answer, EncodedText):
                    self._send([_REPLY, number, None, [[1, None]]], answer)
                else:
                    self._send([_REPLY, number, None, call.encoded(context, answer)])
            except Exception as error:
                self._reply_error(number, call, error, waits=waits)

        task = asyncio.ensure_future(answer)
        task.add_done_callback(reply)
        self._watch(task)

    def _reply_error(self, number: int, call: Call, error: Exception, *, waits: bool) -> None:
        """Reply with an error, and log it if the client does not wait for the reply, as then no script sees it."""
        text = error_text(call.name, error)
        if not waits and self._logged < _MOST_LOGGED:
            self._logged += 1
            _LOG.warning("%s: %s", call.name, text)
        self._send([_REPLY, number, None, [[call.result is None or 0, [text]]]])

    def _send(self, reply: list[Any], text: EncodedText | None = None) -> None:
        """Send a reply, at whose end is None instead of a text if that is given."""
        data = _PACKER.pack(reply)
        if text is not None:
            data = data[:-1] + _TEXT.pack(_LONG_TEXT, len(text))
        if self._transport is not None and not self._transport.is_closing():
            self._transport.write(data)
            if text is not None:
                self._transport.write(memoryview(text))
            if self._transport.get_write_buffer_size() > _LARGE_PART:
                self._pool.check_memory()


def error_text(name: str, error: Exception) -> str:
    """Return the text of an error for a client; an unexpected one is logged, too."""
    if isinstance(error, RecapError):
        return str(error)
    _LOG.error("%s has failed: %r", name, error)
    return f"{name}: {type(error).__name__}: {error}"


def _unknown_call(name: str) -> str:
    """Return the error text for an unknown call; only a name that is no call of any client is shortened."""
    shown = name if len(name) <= _SHOWN else f"{name[:_SHOWN]}… ({len(name)} characters)"
    text = f"{shown}: there is no such call"
    if shown not in _unknown and len(_unknown) < _MOST_UNKNOWN:
        _unknown.add(shown)
        _LOG.warning("%s; a newer client may make it", text)
    return text


class MessageBuffer:
    """Splits what a client sends into messages, at a bounded cost of memory: `part` has the bytes of an incomplete one.

    A MessagePack value does not begin with its length: one has to scan it. The bytes of an incomplete message are kept as
    they are, and objects are made only when it is complete: an object takes up to eighty times the memory of its bytes.
    """

    def __init__(self) -> None:
        self.part = bytearray()
        self._scanner: msgpack.Unpacker | None = None
        self._chunk = b""
        self._unpacker = _unpacker()
        self._consumed = 0
        self._items = 0

    def feed(self, data: bytes) -> None:
        """Add data, once all complete messages are taken out; raise ValueError if it is no MessagePack, or too large."""
        if self._scanner is None:
            self._open(data)
        else:
            self._collect(data)

    def __iter__(self) -> Iterator[Any]:
        """Take out the complete messages, as `feed` raises; one can stop in between and go on with a new iterator."""
        for value in self._unpacker:
            self._consumed = self._unpacker.tell()
            yield value
        if self._consumed < len(self._chunk):
            part = self._chunk[self._consumed :]
            self._open(b"")
            self._scanner = _unpacker()
            self._collect(part)

    def _open(self, chunk: bytes) -> None:
        """Start with a chunk that begins with a message."""
        self._chunk = chunk
        self._consumed = self._items = 0
        self._unpacker = _unpacker(self._count if len(chunk) > _LONG else None)
        self._unpacker.feed(chunk)

    def _collect(self, data: bytes) -> None:
        """Add to an incomplete message, and open it if it is complete now."""
        assert self._scanner is not None
        self.part += data
        self._scanner.feed(data)
        try:
            self._scanner.skip()
        except msgpack.OutOfData:
            if len(self.part) > _LARGEST:
                raise ValueError from None
            return
        chunk = bytes(self.part)
        self._scanner = None
        self.part = bytearray()
        self._open(chunk)

    def _count(self, items: list[Any]) -> list[Any]:
        self._items += len(items)
        if self._items > _MOST_ITEMS:
            raise ValueError
        return items


def _unpacker(list_hook: Callable[[list[Any]], list[Any]] | None = None) -> msgpack.Unpacker:
    return msgpack.Unpacker(
        read_size=_BUFFER,
        max_buffer_size=2 * _LARGEST,
        max_array_len=_LONGEST_ARRAY,
        max_map_len=0,
        max_ext_len=0,
        list_hook=list_hook,
        unicode_errors="surrogateescape",
    )
