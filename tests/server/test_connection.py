"""Connections and streams without a network: replies, errors, frames, and clients that leave early or are slow."""

from __future__ import annotations

import asyncio
import gc
import logging
import resource
import struct
from concurrent.futures import Future
from typing import TYPE_CHECKING, Any

import msgpack
import pytest

from carla_recap.errors import RecapError
from carla_recap.server.protocol import DEFAULT
from carla_recap.server.rpc import connection as connections
from carla_recap.server.rpc.codec import EncodedText
from carla_recap.server.rpc.connection import ClientConnection, ConnectionPool, connection_limit
from carla_recap.server.rpc.registry import unregistered_call
from carla_recap.server.rpc.structs import VehicleLightState
from carla_recap.server.streams import Streams, framed
from tests.server.inside import Transport

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.server.rpc.registry import Call


class Context:
    """A context of calls that holds back nothing."""

    release = DEFAULT

    def begin_call(self, name: str) -> None:
        pass

    def hold(self, name: str, answer: Any) -> Any:
        return answer

    def leave(self) -> None:
        pass


def double(client: Context, number: int, state: VehicleLightState | None = None) -> int:
    return 2 * number


def broken(client: Context) -> int:
    return 1 // 0


def unfit(client: Context) -> VehicleLightState:
    return None  # type: ignore[return-value]


async def slow(client: Context) -> int:
    await asyncio.sleep(0)
    return 7


async def fails_late(client: Context) -> int:
    await asyncio.sleep(0)
    raise KeyError("late")


async def long_text(client: Context) -> EncodedText:
    return EncodedText("Straße\udcff", "utf-8", "surrogateescape")


def refused(context: Context) -> None:
    raise RecapError("as it should be")


HANDLERS = (double, broken, unfit, slow, fails_late, long_text, refused)
CALLS = {handler.__name__: unregistered_call(handler) for handler in HANDLERS}


def connected(calls: Mapping[str, Call] = CALLS) -> tuple[ClientConnection, Transport]:
    connection, transport = ClientConnection(calls, ConnectionPool(), lambda _: Context()), Transport()
    connection.connection_made(transport)
    return connection, transport


def request(number: int, name: str, *arguments: Any) -> bytes:
    data: bytes = msgpack.packb([0, number, name, [[False], *arguments]])
    return data


def replies(*requests: bytes) -> list[list[Any]]:
    async def run() -> list[list[Any]]:
        connection, transport = connected()
        for data in requests:
            connection.data_received(data)
        while len(transport.replies) < len(requests):
            await asyncio.sleep(0)
        return transport.replies

    return asyncio.run(asyncio.wait_for(run(), 10))


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("broken", "ZeroDivisionError: integer division or modulo by zero"),
        ("unfit", "AttributeError: 'NoneType' object has no attribute 'bits'"),
        ("fails_late", "KeyError: 'late'"),
    ],
)
def test_an_exception_in_a_call_is_an_error_for_the_client_and_a_line_in_the_log(
    name: str, error: str, caplog: pytest.LogCaptureFixture
) -> None:
    failed, fine = sorted(replies(request(1, name), request(2, "double", 4)))
    assert failed == [1, 1, None, [[0, [f"{name}: {error}"]]]]
    assert fine == [1, 2, None, [[1, 8]]]
    (record,) = caplog.records
    assert record.levelno == logging.ERROR
    assert record.getMessage().startswith(f"{name} has failed: ")
    assert "\n" not in record.getMessage()


def test_a_text_that_is_encoded_already_arrives_as_a_text() -> None:
    (reply,) = replies(request(1, "long_text"))
    assert reply == [1, 1, None, [[1, "Straße\udcff"]]]


def test_arguments_of_newer_clients_are_ignored_and_those_of_older_ones_may_be_missing() -> None:
    """More arguments than expected, and more fields of a struct."""
    for more in ((), ([True, [1, "new", 2]], True, "override", [[0, 0, 0], [0, 0, 0]])):
        assert replies(request(1, "double", 4, *more)) == [[1, 1, None, [[1, 8]]]]
    (reply,) = replies(request(1, "double"))
    assert reply[3] == [[0, ["double: expected 1 arguments, found 0"]]]


def test_calls_that_follow_wait_for_what_the_client_waits_for() -> None:
    work: Future[None] = Future()
    waited = [1, 1, None, [[False]]]

    def wait(context: Context) -> None:
        connection.read_after(asyncio.shield(asyncio.wrap_future(work)))

    connection, transport = connected(CALLS | {"wait": unregistered_call(wait)})

    async def run() -> tuple[list[list[Any]], list[list[Any]]]:
        connection.data_received(request(1, "wait") + request(2, "double", 5))
        await asyncio.sleep(0)
        before = transport.replies
        work.set_result(None)
        while len(transport.replies) < 2:
            await asyncio.sleep(0)
        return before, transport.replies

    assert asyncio.run(asyncio.wait_for(run(), 10)) == ([waited], [waited, [1, 2, None, [[1, 10]]]])


def test_the_name_of_an_unknown_call_is_reported_and_cut_where_no_call_can_have_it() -> None:
    assert replies(request(3, "x" * 200)) == [[1, 3, "x" * 200 + ": there is no such call", None]]
    ((_, _, error, _),) = replies(request(3, "x" * 100_000))
    assert error.startswith("x" * 200 + "…")


def test_unknown_calls_are_logged_once_each_and_not_without_end(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "_unknown", set())
    replies(*(request(number, f"call_{number % 100}") for number in range(200)))
    assert caplog.messages[0] == "call_0: there is no such call; a newer client may make it"
    assert len(caplog.messages) == len(set(caplog.messages)) == 20


class Holding(Context):
    def hold(self, name: str, answer: Any) -> Any:
        return slow(self)


@pytest.mark.parametrize(("context", "name"), [(Context, "slow"), (Holding, "refused")])
async def test_a_client_that_leaves_early_leaves_no_coroutine_unawaited(
    context: type[Context], name: str, recwarn: pytest.WarningsRecorder
) -> None:
    connection = ClientConnection(CALLS, ConnectionPool(), lambda _: context())
    connection.connection_made(Transport())
    connection.data_received(request(1, name))
    connection.connection_lost(None)
    for _ in range(3):
        await asyncio.sleep(0)
    gc.collect()
    assert not [str(warning.message) for warning in recwarn]


@pytest.mark.parametrize(
    ("soft", "hard", "raised", "expected"),
    [
        (1024, 4096, 2100, 2000),
        (1024, resource.RLIM_INFINITY, 2100, 2000),
        (2100, 2100, None, 2000),
        (resource.RLIM_INFINITY, resource.RLIM_INFINITY, None, 2000),
        (256, 300, 300, 200),
        (64, 64, 64, 1),
    ],
)
def test_there_are_as_many_connections_as_files_can_be_opened(
    soft: int, hard: int, raised: int | None, expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits: list[tuple[int, int]] = []
    monkeypatch.setattr(resource, "getrlimit", lambda _: (soft, hard))
    monkeypatch.setattr(resource, "setrlimit", lambda _, pair: limits.append(pair))
    assert connection_limit() == expected
    assert limits == ([] if raised is None else [(raised, hard)])


def test_an_error_that_no_client_waits_for_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    replies(msgpack.packb([0, 1, "refused", [[True]]]), request(2, "refused"))
    assert caplog.messages == ["refused: as it should be"]


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


def test_frames_are_preceded_by_their_lengths_and_the_latest_one_counts() -> None:
    streams = new_streams()
    subscriber, wire = subscribe(streams, 3)
    streams.send(3, b"frame")
    assert wire.parts == [b"\x05\x00\x00\x00frame"]
    subscriber.pause_writing()
    for payload in (b"a", b"b", b"c"):
        streams.send(3, payload)
    assert len(wire.parts) == 1
    subscriber.resume_writing()
    assert wire.parts[1:] == [b"\x01\x00\x00\x00c"]
    streams.keep(3, b"old")
    streams.keep(3, b"new")
    _, late = subscribe(streams, 3)
    assert late.parts == [b"\x09\x00\x00\x00first new"]
    streams.silence(3)
    _, later = subscribe(streams, 3)
    assert not later.parts


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
