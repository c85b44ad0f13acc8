"""What clients must not do to a server: garbage, calls without end, connections without end, leaving without a word."""

from __future__ import annotations

import os
import socket
import struct
import time
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgpack
import pytest

from carla_recap.server.rpc.connection import MessageBuffer
from tests.server.client import connect, serving
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from collections.abc import Iterator

    import carla

VERSION = [0, 1, "version", [[False]]]
QUICK = 1.0  # s


@pytest.fixture(scope="module")
def server(recordings: Path) -> Iterator[tuple[int, Path]]:
    """A server's port, and what the system tells of its process; it must say nothing on stderr, and end in peace.

    It can have 40 connections: of the files that it may open, 100 are for other things.
    """
    with serving("--recordings", recordings, through=("bash", "-c", 'ulimit -n 140; exec "$@"', "-")) as (process, port):
        yield port, Path("/proc", str(process.pid))
        process.terminate()
        _, said = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert "Traceback" not in said


@pytest.fixture(scope="module")
def port(server: tuple[int, Path]) -> int:
    return server[0]


@pytest.fixture
def memory(server: tuple[int, Path]) -> int:
    """The memory that the server has, in bytes."""
    return used(server[1])


def used(process: Path) -> int:
    with suppress(FileNotFoundError):
        return int((process / "statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    return pytest.skip("needs /proc")


def socket_to(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), timeout=PATIENCE)


def send(connection: socket.socket, data: bytes) -> None:
    """Send data to a server that may close the connection."""
    with suppress(OSError):
        connection.sendall(data)


def ask(connection: socket.socket, *call: Any) -> Any:
    connection.sendall(msgpack.packb(list(call)))
    unpacker = msgpack.Unpacker()
    while data := connection.recv(1 << 16):
        unpacker.feed(data)
        for reply in unpacker:
            return reply
    return None


def reset(connection: socket.socket) -> None:
    """Hang up as a process that ends does, which has not read all that it was sent."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


@pytest.mark.parametrize("pause", [0.0, 0.002, 0.01])
def test_the_last_calls_of_a_client_that_has_left_are_served(port: int, recordings: Path, pause: float) -> None:
    long, stop = [0, 2, "get_actor_definitions", [[False]]], [0, 3, "stop_recorder", [[False]]]
    for _ in range(2):
        path = recordings / f"last words {pause}.log"
        path.unlink(missing_ok=True)
        connection = socket_to(port)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        ask(connection, 0, 1, "start_recorder", [[False], str(path), False])
        connection.sendall(msgpack.packb(long) * 3)
        time.sleep(pause)
        connection.sendall(msgpack.packb(stop))
        reset(connection)
        wait_until(path.exists)


def ticks_quickly(world: carla.World) -> None:
    """Tick; if the machine is slow, until a tick is quick."""

    def is_quick() -> bool:
        start = time.monotonic()
        world.tick()
        return time.monotonic() - start < QUICK

    wait_until(is_quick)


@pytest.mark.parametrize(
    ("beyond", "data"),
    [
        (0, b"\xc1"),
        (0, b"GET / HTTP/1.1\r\n\r\n"),
        (0, b"\xdd\xff\xff\xff\xff"),
        (0, b"\xdc\x3f\xff" * 1100),
        (0, msgpack.packb([0, 1, "version", []])),
        (0, msgpack.packb([1, 1, None, None])),
        (0, bytes(range(256)) * 100),
        (1, b"much too long for a stream"),
    ],
)
def test_garbage_closes_the_connection(world: carla.World, port: int, beyond: int, data: bytes) -> None:
    with closing(socket_to(port + beyond)) as connection:
        send(connection, data)
        with suppress(ConnectionResetError):
            assert connection.recv(1) == b""
    ticks_quickly(world)


@pytest.mark.parametrize(
    ("parts", "clients", "most"),
    [
        ([msgpack.packb(VERSION)[:7], b"\xc6\xff\xff\xff\xff" + bytes(100_000)], 20, 32),  # incomplete messages
        ([msgpack.packb([0, 1, "version", [[False], bytes(31 << 20)]])[:-1]], 10, 400),  # long calls
        ([20 * 20_000 * msgpack.packb([0, 1, "get_map_data", [[False]]])], 10, 160),  # whose replies are not read
    ],
    ids=["incomplete", "long", "unread"],
)
def test_calls_of_many_clients_do_not_fill_the_memory(
    world: carla.World, server: tuple[int, Path], memory: int, parts: list[bytes], clients: int, most: int
) -> None:
    port, process = server
    with ExitStack() as stack:
        for number in range(clients):
            connection = stack.enter_context(closing(socket_to(port)))
            connection.settimeout(1.0)  # the server may read no further
            send(connection, parts[number % len(parts)])
        for _ in range(5):
            ticks_quickly(world)
        assert used(process) < memory + (most << 20)


def test_endless_calls_leave_time_for_other_clients(world: carla.World, port: int) -> None:
    with closing(socket_to(port)) as connection:
        calls = msgpack.packb(VERSION) * 5000
        connection.setblocking(False)
        for _ in range(50):
            with suppress(BlockingIOError):
                connection.send(calls)
            with suppress(BlockingIOError):
                connection.recv(1 << 20)
            ticks_quickly(world)


def test_wrong_types_are_errors_of_every_call(world: carla.World, port: int) -> None:
    from carla_recap.server.rpc.registry import CALLS

    changing = {"load_new_episode", "stop_recorder", "tick_cue"}
    with closing(socket_to(port)) as connection:
        for name in sorted(CALLS.keys() - changing):
            for arguments in (["text"] * 8, [[[]]] * 8, [None] * 8, [-1] * 8, [2**64 - 1] * 8, [1e300] * 8):
                reply = ask(connection, 0, 1, name, [[False], *arguments])
                assert reply is not None, (name, arguments)
                assert reply[:2] == [1, 1]
    ticks_quickly(world)


def test_silent_connections_are_closed_for_new_ones(world: carla.World, port: int) -> None:
    with ExitStack() as stack:
        for _ in range(50):
            stack.enter_context(closing(socket_to(port)))
        client = connect(port)
        assert client.get_server_version() == "0.9.16"
        ticks_quickly(world)


def test_a_connection_too_many_is_refused_with_an_error(world: carla.World, port: int) -> None:
    with ExitStack() as stack:
        replies = [ask(stack.enter_context(closing(socket_to(port))), *VERSION) for _ in range(45)]
        assert replies[0] == [1, 1, None, [[1, "0.9.16"]]]
        assert replies[-1] == [1, 1, None, [[0, ["the server has 40 connections, which is as many as it can have"]]]]
        ticks_quickly(world)


def test_a_message_buffer_returns_calls_in_whatever_pieces_they_arrive() -> None:
    calls = [VERSION, [0, 2, "apply_batch", [[False], [[1, [number]] for number in range(1000)]]], [0, 3, "x", [[True]]]]
    data = b"".join(map(msgpack.packb, calls))
    for size in (1, 7, 1000, len(data)):
        buffer, found = MessageBuffer(), []
        for start in range(0, len(data), size):
            buffer.feed(data[start : start + size])
            found += list(buffer)
        assert found == calls
        assert not buffer.part
