"""Streams: what the server sends by itself, a frame after the other, to whoever has subscribed.

A subscription is a connection of its own: the client sends the number of the stream, and then only reads. A subscriber who
reads too slowly misses frames, and holds up nobody.
"""

from __future__ import annotations

import asyncio
import struct
from collections import defaultdict
from typing import TYPE_CHECKING, Final, cast

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.server.connections import Connections

_ID: Final = struct.Struct("<I")
_LENGTH: Final = struct.Struct("<I")
# stream id, port, protocol (1: TCP), kind of address (0: none, so that the client takes the host that it knows), address
_TOKEN: Final = struct.Struct("<IHBB16x")
_TCP: Final = 1
_NO_ADDRESS: Final = 0
_BACKLOG: Final = 256 << 10  # bytes, besides what the system keeps: a subscriber who is so far behind misses frames
_SOON: Final = 0.25  # s: who has asked where a stream is has subscribed by then, or is not waited for any longer


class Streams:
    """All streams and their subscribers.

    Args:
        connections: All connections of the server.
        welcome: Makes the first frame that a subscriber gets out of the latest one.

    Attributes:
        connections: All connections of the server.
        port: Where subscribers connect to.
    """

    def __init__(self, connections: Connections, welcome: Callable[[bytes], bytes]) -> None:
        self.connections = connections
        self.port = 0
        self._welcome = welcome
        self._subscribers: defaultdict[int, set[Subscriber]] = defaultdict(set)
        self._latest: dict[int, bytes] = {}
        self._expected: dict[int, tuple[object, asyncio.Future[None]]] = {}

    def token(self, stream: int) -> bytes:
        """What tells a client where a stream is, 24 bytes."""
        return _TOKEN.pack(stream, self.port, _TCP, _NO_ADDRESS)

    def expect(self, stream: int, client: object) -> None:
        """Take note that a client has asked where a stream is, and is about to subscribe, over another connection."""
        self._has_come(stream)
        loop = asyncio.get_running_loop()
        self._expected[stream] = client, loop.create_future()
        loop.call_later(_SOON, self._has_come, stream)

    def expected(self, client: object) -> list[asyncio.Future[None]]:
        """What to wait for until a client has all subscriptions that it is about to have."""
        return [subscription for who, subscription in self._expected.values() if who is client]

    @property
    def subscribed(self) -> tuple[int, ...]:
        """The streams that have subscribers."""
        return tuple(self._subscribers)

    def send(self, stream: int, payload: bytes) -> None:
        """Send a frame to the subscribers of a stream."""
        if stream in self._subscribers:
            frame = _LENGTH.pack(len(payload)) + payload
            for subscriber in tuple(self._subscribers[stream]):
                subscriber.send(frame)

    def keep(self, stream: int, payload: bytes) -> None:
        """Send a frame, and send it to whoever subscribes later, too, until there is a newer one."""
        self._latest[stream] = payload
        self.send(stream, payload)

    def silence(self, stream: int) -> None:
        """Send nothing more to the subscribers of a stream, until they leave."""
        self._latest.pop(stream, None)

    def forget(self, stream: int) -> None:
        """End a stream."""
        self.silence(stream)
        for subscriber in tuple(self._subscribers.get(stream, ())):
            subscriber.close()

    def connection(self) -> Subscriber:
        """For a new connection."""
        return Subscriber(self)

    def enter(self, stream: int, subscriber: Subscriber) -> None:
        """Take in a subscriber."""
        self._subscribers[stream].add(subscriber)
        self._has_come(stream)
        if stream in self._latest:
            payload = self._welcome(self._latest[stream])
            subscriber.send(_LENGTH.pack(len(payload)) + payload)

    def leave(self, stream: int, subscriber: Subscriber) -> None:
        """Let a subscriber go."""
        subscribers = self._subscribers[stream]
        subscribers.discard(subscriber)
        if not subscribers:
            del self._subscribers[stream]

    def _has_come(self, stream: int) -> None:
        """Let those go on who wait for a subscription, if anybody does."""
        if stream in self._expected:
            _, subscription = self._expected.pop(stream)
            subscription.set_result(None)


class Subscriber(asyncio.Protocol):
    """A connection that gets the frames of a stream.

    Args:
        streams: All streams.
    """

    def __init__(self, streams: Streams) -> None:
        self._streams = streams
        self._transport: asyncio.Transport | None = None
        self._hello = b""
        self._stream: int | None = None
        self._is_behind = False
        self._next: bytes | None = None

    @property
    def has_spoken(self) -> bool:
        """Whether it has told which stream it wants."""
        return self._stream is not None

    @property
    def held(self) -> int:
        """How many bytes are kept for it."""
        return 0 if self._transport is None else self._transport.get_write_buffer_size()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See `asyncio.Protocol`."""
        self._transport = cast("asyncio.Transport", transport)
        self._transport.set_write_buffer_limits(high=_BACKLOG, low=0)
        self._streams.connections.enter(self)

    def data_received(self, data: bytes) -> None:
        """Take in the number of the stream; there is nothing else to be told."""
        if self._stream is not None:
            return self.close()
        self._hello += data
        if len(self._hello) > _ID.size:
            return self.close()
        if len(self._hello) == _ID.size:
            (self._stream,) = _ID.unpack(self._hello)
            self._streams.enter(self._stream, self)
        return None

    def connection_lost(self, _: Exception | None) -> None:
        """See `asyncio.Protocol`."""
        self._transport = None
        self._streams.connections.leave(self)
        if self._stream is not None:
            self._streams.leave(self._stream, self)

    def send(self, frame: bytes) -> None:
        """Send a frame; while the subscriber is behind, only the latest one waits."""
        if self._is_behind:
            self._next = frame
        elif self._transport is not None and not self._transport.is_closing():
            self._transport.write(frame)

    def pause_writing(self) -> None:
        """See `asyncio.Protocol`."""
        self._is_behind = True
        self._streams.connections.check_memory()

    def resume_writing(self) -> None:
        """See `asyncio.Protocol`."""
        self._is_behind = False
        if self._next is not None:
            frame, self._next = self._next, None
            self.send(frame)

    def refuse(self) -> None:
        """End it before it has begun."""
        self.close()

    def close(self) -> None:
        """End the subscription."""
        if self._transport is not None:
            self._transport.abort()
