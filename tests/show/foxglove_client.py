"""A client, as Foxglove is one, of a server of Foxglove's protocol."""

from __future__ import annotations

import asyncio
import json
import struct
from base64 import b64decode
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, Final

from mcap_protobuf.decoder import DecoderFactory
from tornado.websocket import websocket_connect

from carla_recap.show.foxglove.topics import TOPICS
from tests.waiting import PATIENCE

State = tuple[int, int, float, str]


_PAUSE: Final = 0.05  # s


class Viewer:
    """A client, as Foxglove is one: it has subscribed to all topics.

    Args:
        address: What it connects to.
        further: The number of topics beside those of scenes.

    Attributes:
        info: What the server says of itself.
        channels: What it offers, by topic.
        messages: Topic, time in ns and data of the messages so far.
        states: Status, time in ns, speed and request of the states of playback so far.
        time: The time in ns by which it shows messages.
    """

    def __init__(self, address: str, further: int = 0) -> None:
        self._loop = asyncio.new_event_loop()
        self.messages: list[tuple[str, int, bytes]] = []
        self.states: list[State] = []
        self.channels: dict[str, dict[str, Any]] = {}
        self.time = 0
        options = {"subprotocols": ["foxglove.sdk.v1"], "max_message_size": 1 << 28}
        self._socket = self._run(lambda: websocket_connect(address, **options))
        self.info = json.loads(self._run(self._socket.read_message))
        while len(self.channels) < len(TOPICS) + further:
            for channel in json.loads(self._run(self._socket.read_message)).get("channels", []):
                self.channels[channel["topic"]] = channel
        self._topics = dict(enumerate(self.channels))
        wanted = [{"id": id, "channelId": self.channels[topic]["id"]} for id, topic in self._topics.items()]
        self._send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def _run(self, call: Callable[[], Any]) -> Any:
        async def answer() -> Any:
            return await asyncio.wait_for(call(), PATIENCE)

        return self._loop.run_until_complete(answer())

    def _send(self, data: bytes | str) -> None:
        self._run(lambda: self._socket.write_message(data, binary=isinstance(data, bytes)))

    def control(self, command: int, speed: float = 1.0, seek: int | None = None, id: str = "me") -> State:
        """Request a change of playback; return the state that the server answers."""
        self.states.clear()
        self.request(command, speed, seek, id)
        self.receive(lambda: any(state[3] == id for state in self.states))
        return next(state for state in self.states if state[3] == id)

    def request(self, command: int, speed: float = 1.0, seek: int | None = None, id: str = "me") -> None:
        """Request a change of playback, and wait for no answer."""
        self._send(struct.pack("<BBfBQI", 3, command, speed, seek is not None, seek or 0, len(id)) + id.encode())

    def receive(self, is_enough: Callable[[], object], meanwhile: Callable[[], object] = lambda: None) -> None:
        """Receive until a condition is met; meanwhile, call a function again and again."""
        while not is_enough():
            found = self._run(lambda: self._next(meanwhile))
            assert isinstance(found, bytes), found
            if found[0] == 1:
                id, time = struct.unpack_from("<IQ", found, 1)
                self.messages.append((self._topics[id], time, found[13:]))
            elif found[0] == 2:
                (self.time,) = struct.unpack_from("<Q", found, 1)
            elif found[0] == 5:
                status, time, speed, _ = struct.unpack_from("<BQfB", found, 1)
                self.states.append((status, time, speed, found[19:].decode()))

    async def _next(self, meanwhile: Callable[[], object]) -> Any:
        waiting = asyncio.ensure_future(self._socket.read_message())
        while not waiting.done():
            meanwhile()
            await asyncio.wait([waiting], timeout=_PAUSE)
        return waiting.result()

    def latest(self, *topics: str) -> dict[str, bytes]:
        """Receive until there is a message of each of some topics; return the latest of each."""
        self.receive(lambda: set(topics) <= {topic for topic, _, _ in self.messages})
        return {topic: data for topic, _, data in self.messages}

    def close(self) -> None:
        async def end() -> None:
            self._socket.close()
            while await self._socket.read_message() is not None:
                pass

        self._run(end)
        self._loop.close()


@contextmanager
def connected(address: str, further: int = 0) -> Iterator[Viewer]:
    viewer = Viewer(address, further)
    try:
        yield viewer
    finally:
        viewer.close()


def decoded(viewer: Viewer, topic: str, data: bytes) -> Any:
    """Return a message, decoded by the schema that the server has sent."""
    channel = viewer.channels[topic]
    schema = SimpleNamespace(
        id=channel["id"], name=channel["schemaName"], encoding="protobuf", data=b64decode(channel["schema"])
    )
    return DecoderFactory().decoder_for("protobuf", schema)(data)
