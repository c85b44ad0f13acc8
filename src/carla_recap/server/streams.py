"""Streams: what the server sends by itself to its subscribers, frame after frame.

A subscription is a connection of its own: the client sends the number of the stream, and then only reads. A subscriber that
reads too slowly misses frames, and holds up nothing.
"""

from __future__ import annotations

import asyncio
import struct
from collections import defaultdict
from itertools import count
from typing import TYPE_CHECKING, Final, cast

import numpy as np

from carla_recap.server.quirks import PendingSubscriptions
from carla_recap.server.rpc.connection import PooledConnection

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from carla_recap.server.protocol.releases import Release
    from carla_recap.server.rpc.connection import ConnectionPool

_ID: Final = struct.Struct("<I")
_LENGTH: Final = struct.Struct("<I")
# stream id, port, protocol (1: TCP), kind of address (0: none, so that the client takes the host that it knows), address
_TOKEN: Final = struct.Struct("<IHBB16x")
_TCP: Final = 1
_NO_ADDRESS: Final = 0
_STALLED: Final = 3.0  # s: a subscriber that is behind for longer is not waited for
_BACKLOG: Final = 256 << 10  # bytes, besides the system's buffer: a subscriber that is farther behind misses frames
_PIECE: Final = 1 << 20  # bytes of a frame that are written at once: asyncio copies what the system does not take


def framed(*parts: bytes | memoryview) -> bytes | memoryview:
    """Return a frame of some parts, with its length before them."""
    size = sum(map(len, parts))
    parts = _LENGTH.pack(size), *parts
    if size < _PIECE:
        return b"".join(parts)
    frame, at = np.empty(_LENGTH.size + size, np.uint8), 0
    for part in parts:  # numpy lets other threads run meanwhile, as joining does not
        frame[at : at + len(part)] = np.frombuffer(part, np.uint8)
        at += len(part)
    return frame.data


class Streams:
    """All streams and their subscribers; `mark_first` turns the latest frame into the first frame of a subscriber.

    Attributes:
        pending: The subscriptions that clients are about to make.
        port: The port to which subscribers connect.
    """

    def __init__(self, connections: ConnectionPool, mark_first: Callable[[bytes], bytes]) -> None:
        self.connections = connections
        self.pending = PendingSubscriptions()
        self.port = 0
        self._mark_first = mark_first
        self._subscribers: defaultdict[int, set[Subscriber]] = defaultdict(set)
        self._latest: dict[int, bytes] = {}

    def token(self, stream: int) -> bytes:
        """Return the address of a stream for a client, 24 bytes."""
        return _TOKEN.pack(stream, self.port, _TCP, _NO_ADDRESS)

    @property
    def subscribed(self) -> tuple[int, ...]:
        """The streams that have subscribers."""
        return tuple(self._subscribers)

    def has_subscribers(self, streams: Iterable[int]) -> bool:
        """Return whether any of some streams has subscribers; it may be called from any thread."""
        return any(stream in self._subscribers for stream in streams)

    def send(self, stream: int, payload: bytes) -> None:
        """Send a frame to the subscribers of a stream."""
        if stream in self._subscribers:
            self.send_framed(stream, framed(payload))

    def send_framed(self, stream: int, frame: bytes | memoryview) -> None:
        """Send what `framed` has returned to the subscribers of a stream."""
        for subscriber in tuple(self._subscribers.get(stream, ())):
            subscriber.send(frame)

    def behind(self, streams: Iterable[int]) -> list[asyncio.Future[None]]:
        """Return what to wait for until the subscribers of some streams have read all frames, or have stalled."""
        subscribers = (subscriber for stream in streams for subscriber in self._subscribers.get(stream, ()))
        return [caught_up for subscriber in subscribers if (caught_up := subscriber.caught_up()) is not None]

    def keep(self, stream: int, payload: bytes) -> None:
        """Send a frame now, and to later subscribers until there is a newer one."""
        self._latest[stream] = payload
        self.send(stream, payload)

    def silence(self, stream: int) -> None:
        """Send nothing more to the subscribers of a stream."""
        self._latest.pop(stream, None)

    def close(self, stream: int) -> None:
        """End a stream."""
        self.silence(stream)
        for subscriber in tuple(self._subscribers.get(stream, ())):
            subscriber.close()

    def connection(self) -> Subscriber:
        """Return the protocol of a new connection."""
        return Subscriber(self)

    def add(self, stream: int, subscriber: Subscriber) -> None:
        """Add a subscriber to a stream."""
        self._subscribers[stream].add(subscriber)
        self.pending.arrived(stream)
        if stream in self._latest:
            subscriber.send(framed(self._mark_first(self._latest[stream])))

    def remove(self, stream: int, subscriber: Subscriber) -> None:
        """Remove a subscriber from a stream."""
        subscribers = self._subscribers[stream]
        subscribers.discard(subscriber)
        if not subscribers:
            del self._subscribers[stream]


class SnapshotStreams:
    """The streams of snapshots: one for each connection; see `quirks`."""

    def __init__(self, streams: Streams, for_release: Callable[[bytes, Release], bytes]) -> None:
        self._streams = streams
        self._for_release = for_release
        self._numbers = count(1)
        self._open: dict[int, Release] = {}

    def open(self, release: Release) -> int:
        """Return the number of the stream of a new client of a release."""
        stream = next(self._numbers)
        self._open[stream] = release
        return stream

    def renew(self, stream: int) -> int:
        """Return the number of the stream of a client that begins an episode: a new one, if its release subscribes to one.

        It asks for the new one when its call is answered. The old one stays open and silent: through it, the client would
        learn of the episode while it has none.
        """
        if not self._open[stream].renews_stream:
            return stream
        self._streams.silence(stream)
        return self.open(self._open.pop(stream))

    def close(self, stream: int) -> None:
        """End the stream of a client that has left."""
        self._open.pop(stream, None)
        self._streams.close(stream)

    def keep(self, stream: int, payload: bytes) -> None:
        """Send a snapshot to a client, now or when it subscribes."""
        self._streams.keep(stream, self._for_release(payload, self._open[stream]))

    def publish(self, payload: bytes) -> None:
        """Send a snapshot to all clients."""
        payloads = {release: self._for_release(payload, release) for release in set(self._open.values())}
        for stream, release in self._open.items():
            self._streams.keep(stream, payloads[release])


class Subscriber(PooledConnection):
    """A connection that gets the frames of a stream."""

    def __init__(self, streams: Streams) -> None:
        super().__init__(streams.connections)
        self._streams = streams
        self._received = b""
        self._stream: int | None = None
        self._is_behind = False
        self._rest = memoryview(b"")  # of the frame that is being written
        self._next: bytes | memoryview | None = None
        self._caught_up: asyncio.Future[None] | None = None
        self._has_stalled = False

    @property
    def held(self) -> int:
        """The bytes that are kept for it."""
        return super().held + (0 if self._transport is None else len(self._rest))

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See `asyncio.Protocol`."""
        super().connection_made(transport)
        cast("asyncio.Transport", transport).set_write_buffer_limits(high=_BACKLOG, low=0)

    def data_received(self, data: bytes) -> None:
        """Read the number of the stream; close the connection if there is anything else."""
        if self._stream is not None:
            return self.close()
        self._received += data
        if len(self._received) > _ID.size:
            return self.close()
        if len(self._received) == _ID.size:
            (self._stream,) = _ID.unpack(self._received)
            self.has_spoken = True
            self._streams.add(self._stream, self)
        return None

    def connection_lost(self, _: Exception | None) -> None:
        """See `asyncio.Protocol`."""
        self._transport = None
        self._release()
        self._pool.remove(self)
        if self._stream is not None:
            self._streams.remove(self._stream, self)

    def send(self, frame: bytes | memoryview) -> None:
        """Send a frame; while the subscriber is behind, only the latest one is kept."""
        if self._is_behind:
            self._next = frame
        else:
            self._rest = memoryview(frame)
            self._write()

    def _write(self) -> None:
        """Write the rest of a frame, until the subscriber is behind."""
        while self._rest and not self._is_behind and self._transport is not None and not self._transport.is_closing():
            piece, self._rest = self._rest[:_PIECE], self._rest[_PIECE:]
            self._transport.write(piece)

    def caught_up(self) -> asyncio.Future[None] | None:
        """Return what to wait for until it has read all frames, or has stalled; None if either is the case."""
        if not self._is_behind or self._has_stalled or self._transport is None:
            return None
        if self._caught_up is None:
            loop = asyncio.get_running_loop()
            self._caught_up = loop.create_future()
            loop.call_later(_STALLED, self._stall, self._caught_up)
        return self._caught_up

    def _stall(self, caught_up: asyncio.Future[None]) -> None:
        if caught_up is self._caught_up:
            self._has_stalled = True
            self._release()

    def _release(self) -> None:
        if self._caught_up is not None and not self._caught_up.done():
            self._caught_up.set_result(None)
        self._caught_up = None

    def pause_writing(self) -> None:
        """See `asyncio.Protocol`."""
        self._is_behind = True
        self._pool.check_memory()

    def resume_writing(self) -> None:
        """See `asyncio.Protocol`."""
        self._is_behind = False
        self._has_stalled &= bool(self._rest)
        self._write()
        if self._next is not None and not self._is_behind:
            frame, self._next = self._next, None
            self.send(frame)
        if not self._is_behind:
            self._release()
