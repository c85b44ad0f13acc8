from __future__ import annotations

import asyncio
import struct
from typing import TYPE_CHECKING

from carla_recap.server.rpc.connection import ConnectionPool
from carla_recap.server.streams import Streams, framed
from tests.server.inside import Transport

if TYPE_CHECKING:
    import pytest


class Wire(Transport):
    """Keeps the parts in which it is written to."""

    def __init__(self) -> None:
        super().__init__()
        self.parts: list[bytes] = []
        self.when_written = lambda: None

    def write(self, data: bytes) -> None:
        self.parts.append(data)
        self.when_written()

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        pass

    def get_write_buffer_size(self) -> int:
        return sum(map(len, self.parts))


def subscribe(streams: Streams, stream: int) -> tuple[asyncio.Protocol, Wire]:
    wire, subscriber = Wire(), streams.connection()
    subscriber.connection_made(wire)
    subscriber.data_received(struct.pack("<I", stream))
    return subscriber, wire


def new_streams() -> Streams:
    return Streams(ConnectionPool(), lambda payload: b"first " + payload)


def test_each_frame_is_preceded_by_its_length() -> None:
    streams = new_streams()
    _, wire = subscribe(streams, 3)
    streams.send(3, b"frame")
    assert wire.parts == [b"\x05\x00\x00\x00frame"]


def test_a_late_subscriber_gets_the_latest_frame() -> None:
    streams = new_streams()
    streams.keep(3, b"old")
    streams.keep(3, b"new")
    _, wire = subscribe(streams, 3)
    assert wire.parts == [b"\x09\x00\x00\x00first new"]


def test_a_slow_subscriber_misses_all_frames_but_the_latest() -> None:
    streams = new_streams()
    subscriber, wire = subscribe(streams, 3)
    subscriber.pause_writing()
    for payload in (b"a", b"b", b"c"):
        streams.send(3, payload)
    assert not wire.parts
    subscriber.resume_writing()
    assert wire.parts == [b"\x01\x00\x00\x00c"]


def test_a_silenced_stream_sends_nothing_to_new_subscribers() -> None:
    streams = new_streams()
    streams.keep(3, b"frame")
    streams.silence(3)
    _, wire = subscribe(streams, 3)
    assert not wire.parts


def test_a_large_frame_is_written_in_pieces_as_the_subscriber_reads() -> None:
    streams, frame = new_streams(), framed(bytes(range(256)) * (3 << 12))
    subscriber, wire = subscribe(streams, 3)
    wire.when_written = subscriber.pause_writing
    streams.send_framed(3, frame)
    streams.send(3, b"next")
    assert len(wire.parts[0]) == 1 << 20
    for count in range(1, 6):
        assert len(wire.parts) == count
        subscriber.resume_writing()
    assert b"".join(wire.parts) == bytes(frame) + framed(b"next")


def test_a_stalled_subscriber_is_not_waited_for_until_it_has_read_its_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("carla_recap.server.streams._STALLED", 0.0)
    streams = new_streams()
    subscriber, wire = subscribe(streams, 3)
    wire.when_written = subscriber.pause_writing

    async def stall() -> None:
        streams.send_framed(3, framed(bytes(1 << 21)))
        await asyncio.wait(streams.behind([3]))
        subscriber.resume_writing()
        assert not streams.behind([3])

    asyncio.run(stall())
