"""A server that computes nothing: it replays the replies of a real one, so that only the client's share of a tick is left.

    python -m benchmarks.replies PORT FILE         # a proxy of the server on PORT, which records its replies in FILE
    python -m benchmarks.replies FILE              # replays them, for a client that makes the same calls

Both print the port for the client, and end with the standard input.
"""

from __future__ import annotations

import asyncio
import pickle
import selectors
import socket
import struct
import sys
from collections import defaultdict, deque
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgpack

LENGTH: Final = struct.Struct("<I")
HEAD: Final = struct.Struct("<QQ")  # of a message of a stream: kind of sensor, number of the frame
STREAM_ADDRESS: Final = struct.Struct("<HBB")  # in the token of a stream: port, TCP, no address
TEXTS: Final = {"unicode_errors": "surrogateescape"}
READ_SIZE: Final = 1 << 20
INTERVAL: Final = 0.05  # s between two snapshots until the client ticks

Key = tuple[str, bytes]


@dataclass
class Replies:
    """What a server has sent.

    Attributes:
        port: The port for calls.
        replies: The replies to each call, by its name and arguments, and to all calls of a name.
        snapshots: The snapshots by the numbers of their frames.
    """

    port: int = 0
    replies: defaultdict[Key, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    snapshots: dict[int, bytes] = field(default_factory=dict)


def key(name: str, arguments: Any) -> Key:
    return name, msgpack.packb(arguments, **TEXTS)


async def record(server: int, file: Path) -> None:
    """Forward calls to a server and record its replies until the standard input ends."""
    recorded = Replies()
    calls = await asyncio.start_server(lambda *ends: _forward_calls(recorded, server, *ends), "127.0.0.1", 0)
    recorded.port = calls.sockets[0].getsockname()[1]
    streams = await asyncio.start_server(
        lambda *ends: _forward_stream(recorded, server + 1, *ends), "127.0.0.1", recorded.port + 1
    )
    print(recorded.port, flush=True)
    await asyncio.to_thread(sys.stdin.read)
    calls.close()
    streams.close()
    file.write_bytes(pickle.dumps(recorded))


async def _forward_calls(recorded: Replies, server: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    server_reader, server_writer = await asyncio.open_connection("127.0.0.1", server)
    calls: dict[int, Key] = {}

    async def forward_requests() -> None:
        unpacker = msgpack.Unpacker(**TEXTS)
        while data := await reader.read(READ_SIZE):
            unpacker.feed(data)
            for _, number, name, arguments in unpacker:
                calls[number] = key(name, arguments)
            server_writer.write(data)

    async def forward_replies() -> None:
        unpacker = msgpack.Unpacker(**TEXTS, max_buffer_size=0)
        theirs, ours = STREAM_ADDRESS.pack(server + 1, 1, 0), STREAM_ADDRESS.pack(recorded.port + 1, 1, 0)
        while data := await server_reader.read(READ_SIZE):
            unpacker.feed(data)
            for _, number, error, result in unpacker:
                reply = msgpack.packb(error, **TEXTS) + msgpack.packb(result, **TEXTS).replace(theirs, ours)
                name, arguments = calls.pop(number)
                recorded.replies[name, arguments].append(reply)
                recorded.replies[name, b""].append(reply)
                writer.write(_message(number, reply))

    with suppress(ConnectionError):
        await asyncio.wait(
            [asyncio.create_task(forward_requests()), asyncio.create_task(forward_replies())],
            return_when=asyncio.FIRST_COMPLETED,
        )
    server_writer.close()
    writer.close()


async def _forward_stream(
    recorded: Replies, server: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
) -> None:
    server_reader, server_writer = await asyncio.open_connection("127.0.0.1", server)
    server_writer.write(await reader.readexactly(LENGTH.size))
    with suppress(ConnectionError, asyncio.IncompleteReadError):
        while True:
            size = await server_reader.readexactly(LENGTH.size)
            content = await server_reader.readexactly(*LENGTH.unpack(size))
            _, number = HEAD.unpack_from(content)
            recorded.snapshots[number] = size + content
            writer.write(size + content)
    server_writer.close()
    writer.close()


def _message(number: int, reply: bytes) -> bytes:
    return b"\x94\x01" + msgpack.packb(number) + reply


class ReplayingServer:
    """Replays recorded replies until the standard input ends."""

    def __init__(self, recorded: Replies) -> None:
        self._replies = {call: deque(replies) for call, replies in recorded.replies.items()}
        self._snapshots = recorded.snapshots
        self._latest = min(recorded.snapshots)
        self._is_ticked = False
        self._subscribers: list[socket.socket] = []
        self._selector = selectors.DefaultSelector()
        for port, handle in ((recorded.port, self._handle_calls), (recorded.port + 1, self._handle_subscription)):
            listener = socket.create_server(("127.0.0.1", port))
            self._selector.register(listener, selectors.EVENT_READ, (self._accept, (listener, handle)))
        print(recorded.port, flush=True)

    def serve(self) -> None:
        self._selector.register(sys.stdin, selectors.EVENT_READ, None)
        while True:
            events = self._selector.select(None if self._is_ticked else INTERVAL)
            if not events:
                self._publish(self._latest + 1)
            for event, _ in events:
                if event.data is None:
                    return
                handle, arguments = event.data
                handle(*arguments)

    def _accept(self, listener: socket.socket, handle: Any) -> None:
        connection, _ = listener.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        unpacker = msgpack.Unpacker(**TEXTS)
        self._selector.register(connection, selectors.EVENT_READ, (handle, (connection, unpacker)))

    def _handle_calls(self, connection: socket.socket, unpacker: msgpack.Unpacker) -> None:
        unpacker.feed(self._read(connection))
        for _, number, name, arguments in unpacker:
            reply = self._next_reply(name, arguments)
            if name == "tick_cue":
                self._is_ticked = True
                self._publish(msgpack.unpackb(reply[1:])[0][1])
            connection.sendall(_message(number, reply))

    def _next_reply(self, name: str, arguments: Any) -> bytes:
        """Return the next reply to a call; after the last one, the last one again."""
        replies = self._replies.get(key(name, arguments)) or self._replies[name, b""]
        return replies.popleft() if len(replies) > 1 else replies[0]

    def _publish(self, number: int) -> None:
        if number in self._snapshots:
            self._latest = number
        for subscriber in self._subscribers:
            subscriber.sendall(self._snapshots[self._latest])

    def _handle_subscription(self, connection: socket.socket, _: msgpack.Unpacker) -> None:
        if self._read(connection):
            self._subscribers.append(connection)
            connection.sendall(self._snapshots[self._latest])
        else:
            self._subscribers.remove(connection)

    def _read(self, connection: socket.socket) -> bytes:
        try:
            data = connection.recv(READ_SIZE)
        except ConnectionError:
            data = b""
        if not data:
            self._selector.unregister(connection)
        return data


if __name__ == "__main__":
    if len(sys.argv) > 2:
        asyncio.run(record(int(sys.argv[1]), Path(sys.argv[2])))
    else:
        ReplayingServer(pickle.loads(Path(sys.argv[1]).read_bytes())).serve()  # a file of `record`
