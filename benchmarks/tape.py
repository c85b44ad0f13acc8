"""A server that reckons nothing: it says again what the real one has said, which leaves the client's own share.

    python -m benchmarks.tape PORT FILE         # stands before the server at PORT, and keeps what that says in FILE
    python -m benchmarks.tape FILE              # plays it, to a client that does the same again

Both print the port for the client.
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
HEAD: Final = struct.Struct("<QQ")  # of a frame of a stream: kind of sensor, number of the frame
STREAMS: Final = struct.Struct("<HBB")  # in what tells where a stream is: port, TCP, no address
TEXTS: Final = {"unicode_errors": "surrogateescape"}
AT_ONCE: Final = 1 << 20
PACE: Final = 0.05  # s: so often there is a snapshot until the client ticks

Key = tuple[str, bytes]


@dataclass
class Tape:
    """What a server has said.

    Attributes:
        port: Where it was listening.
        replies: The answers to each call, by its name and arguments; and to all calls of a name.
        frames: The snapshots by their numbers.
    """

    port: int = 0
    replies: defaultdict[Key, list[bytes]] = field(default_factory=lambda: defaultdict(list))
    frames: dict[int, bytes] = field(default_factory=dict)


def key(name: str, arguments: Any) -> Key:
    return name, msgpack.packb(arguments, **TEXTS)


async def keep(server: int, file: Path) -> None:
    """Stand before a server until the standard input ends."""
    tape = Tape()
    calls = await asyncio.start_server(lambda *ends: _calls(tape, server, *ends), "127.0.0.1", 0)
    tape.port = calls.sockets[0].getsockname()[1]
    streams = await asyncio.start_server(lambda *ends: _stream(tape, server + 1, *ends), "127.0.0.1", tape.port + 1)
    print(tape.port, flush=True)
    await asyncio.to_thread(sys.stdin.read)
    calls.close()
    streams.close()
    file.write_bytes(pickle.dumps(tape))


async def _calls(tape: Tape, server: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    back, forth = await asyncio.open_connection("127.0.0.1", server)
    asked: dict[int, Key] = {}

    async def listen() -> None:
        unpacker = msgpack.Unpacker(**TEXTS)
        while data := await reader.read(AT_ONCE):
            unpacker.feed(data)
            for _, number, name, arguments in unpacker:
                asked[number] = key(name, arguments)
            forth.write(data)

    async def answer() -> None:
        unpacker = msgpack.Unpacker(**TEXTS, max_buffer_size=0)
        there, here = STREAMS.pack(server + 1, 1, 0), STREAMS.pack(tape.port + 1, 1, 0)
        while data := await back.read(AT_ONCE):
            unpacker.feed(data)
            for _, number, error, result in unpacker:
                said = msgpack.packb(error, **TEXTS) + msgpack.packb(result, **TEXTS).replace(there, here)
                name, arguments = asked.pop(number)
                tape.replies[name, arguments].append(said)
                tape.replies[name, b""].append(said)
                writer.write(_reply(number, said))

    with suppress(ConnectionError):
        await asyncio.wait(
            [asyncio.create_task(listen()), asyncio.create_task(answer())], return_when=asyncio.FIRST_COMPLETED
        )
    forth.close()
    writer.close()


async def _stream(tape: Tape, server: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    back, forth = await asyncio.open_connection("127.0.0.1", server)
    forth.write(await reader.readexactly(LENGTH.size))
    with suppress(ConnectionError, asyncio.IncompleteReadError):
        while True:
            size = await back.readexactly(LENGTH.size)
            frame = await back.readexactly(*LENGTH.unpack(size))
            _, number = HEAD.unpack_from(frame)
            tape.frames[number] = size + frame
            writer.write(size + frame)
    forth.close()
    writer.close()


def _reply(number: int, said: bytes) -> bytes:
    return b"\x94\x01" + msgpack.packb(number) + said


class Player:
    """Plays a tape until the standard input ends."""

    def __init__(self, tape: Tape) -> None:
        self._replies = {call: deque(said) for call, said in tape.replies.items()}
        self._frames = tape.frames
        self._latest = min(tape.frames)
        self._is_ticked = False
        self._subscribers: list[socket.socket] = []
        self._selector = selectors.DefaultSelector()
        for port, accept in ((tape.port, self._called), (tape.port + 1, self._subscribed)):
            listener = socket.create_server(("127.0.0.1", port))
            self._selector.register(listener, selectors.EVENT_READ, (self._accept, (listener, accept)))
        print(tape.port, flush=True)

    def play(self) -> None:
        self._selector.register(sys.stdin, selectors.EVENT_READ, None)
        while True:
            events = self._selector.select(None if self._is_ticked else PACE)
            if not events:
                self._show(self._latest + 1)
            for event, _ in events:
                if event.data is None:
                    return
                act, arguments = event.data
                act(*arguments)

    def _accept(self, listener: socket.socket, act: Any) -> None:
        connection, _ = listener.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        unpacker = msgpack.Unpacker(**TEXTS)
        self._selector.register(connection, selectors.EVENT_READ, (act, (connection, unpacker)))

    def _called(self, connection: socket.socket, unpacker: msgpack.Unpacker) -> None:
        data = self._data(connection)
        unpacker.feed(data)
        for _, number, name, arguments in unpacker:
            said = self._said(name, arguments)
            if name == "tick_cue":
                self._is_ticked = True
                self._show(msgpack.unpackb(said[1:])[0][1])
            connection.sendall(_reply(number, said))

    def _said(self, name: str, arguments: Any) -> bytes:
        """The next answer to a call; at the end of the tape, the last one again."""
        said = self._replies.get(key(name, arguments)) or self._replies[name, b""]
        return said.popleft() if len(said) > 1 else said[0]

    def _show(self, number: int) -> None:
        if number in self._frames:
            self._latest = number
        for subscriber in self._subscribers:
            subscriber.sendall(self._frames[self._latest])

    def _subscribed(self, connection: socket.socket, _: msgpack.Unpacker) -> None:
        if self._data(connection):
            self._subscribers.append(connection)
            connection.sendall(self._frames[self._latest])
        else:
            self._subscribers.remove(connection)

    def _data(self, connection: socket.socket) -> bytes:
        try:
            data = connection.recv(AT_ONCE)
        except ConnectionError:
            data = b""
        if not data:
            self._selector.unregister(connection)
        return data


if __name__ == "__main__":
    if len(sys.argv) > 2:
        asyncio.run(keep(int(sys.argv[1]), Path(sys.argv[2])))
    else:
        Player(pickle.loads(Path(sys.argv[1]).read_bytes())).play()  # our own
