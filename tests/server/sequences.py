"""Random calls of three clients, while a fourth one ticks: no client can stop the world of the others.

`python -m tests.server.sequences --seconds 900 --random` searches; `tests/server/test_sequences.py` makes a few calls.
"""

from __future__ import annotations

import argparse
import random
import socket
import struct
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import ExitStack, closing
from dataclasses import fields, is_dataclass
from pathlib import Path
from select import select
from types import UnionType
from typing import Any, Final, Union, get_args, get_origin, get_type_hints

import msgpack

from carla_recap.server.actor_records import sensor_of
from carla_recap.server.calls.batches import SpawnCommand
from carla_recap.server.protocol import DEFAULT
from carla_recap.server.rpc.codec import encoder
from carla_recap.server.rpc.registry import CALLS
from carla_recap.server.rpc.structs import ActorDescription
from carla_recap.sim.blueprints import standard_library
from carla_recap.sim.geometry import Transform
from carla_recap.sim.physics.physics_control import PhysicsControl
from carla_recap.sim.town.loading import load_town
from tests.server.client import serving

CLIENTS: Final = 3
LIMIT: Final = 30.0  # s, for a call of a client, and for a tick
PAUSE: Final = 0.01  # s, between two ticks while a call is made
WAITING: Final = 0.2  # s of the server's processor time for which one client may keep another waiting
FAULTS: Final = ("has failed", "a tick goes on without", "Traceback", "its control ends here")
USUAL: Final[dict[type, Any]] = {
    bool: (False, True),
    float: (0.0, 0.05, 0.5, 1.0, -1.0, 3.0, 20.0, -90.0, 300.0),
    int: (0, 1, 2, 3, 8, 50),
    str: ("", "hero", "front", "a", "calls.log", "calls.mcap", "Brickfield", "Town77", "0", "3.5f", "Nav"),
    bytes: (b"",),
}
ODD: Final[dict[type, Any]] = USUAL | {
    float: (float("nan"), float("inf"), -float("inf"), 1e-30, 1e5, -2e9, 1e30, 3e38, -0.0),
    int: (-1, 255, 20_000, 2**24, 2**31 - 1, 2**32 - 1, -(2**31), 2**63),
    str: ("\0", "../out.log", "x" * 5000, "ä\ud800", "%s%n", "<OpenDRIVE/>", "/", "1e999"),
}
SPAWNED: Final = ("vehicle.*", "vehicle.*", "walker.*", "static.*", "static.trigger.friction", "sensor.*", "controller.*")


class Caller:
    """Makes up calls of the protocol with values of the right types, some of which make sense.

    Attributes:
        ids: The ids of actors that were spawned, also of those that are dead, and of earlier episodes.
    """

    def __init__(self, seed: int) -> None:
        self.ids: list[int] = []
        self._random = random.Random(seed)
        self._odd = 0.0
        self._library, self._town = standard_library(), load_town()

    def call(self) -> tuple[str, list[Any]]:
        """Return the name of a call and its arguments."""
        self._odd = self._random.choice((0.0, 0.0, 0.1, 0.5))
        name = self._random.choice((*["spawn_actor"] * 30, *["apply_batch"] * 10, *CALLS))
        if name == "apply_batch":
            return name, [[self._command() for _ in range(self._random.randrange(6))], self._maybe(0.5)]
        return name, [self._value(type) for type in CALLS[name].arguments]

    def _command(self) -> list[Any]:
        number = self._random.randrange(len(DEFAULT.commands))
        name = DEFAULT.commands[number]
        if name == "spawn_actor":
            return [[number, self._value(SpawnCommand)]]
        types = CALLS[name].arguments if name in CALLS else (int, Transform, float)
        return [[number, [self._value(type) for type in types]]]

    def _maybe(self, probability: float) -> bool:
        return self._random.random() < probability

    def _value(self, type: Any) -> Any:
        """Return a value of a type as it goes over the wire."""
        type = getattr(type, "__supertype__", type)
        origin, inner = get_origin(type), get_args(type)
        if type is Any:
            return self._value(self._random.choice((bool, str, int, Transform)))
        if type is int and self.ids and self._maybe(0.7):
            return self._random.choice(self.ids[-20:])
        if type in USUAL:
            return self._random.choice((ODD if self._maybe(self._odd) else USUAL)[type])
        if type is ActorDescription:
            return self._description()
        if type is Transform and self._maybe(0.7 - self._odd):
            return encoder(Transform, DEFAULT)(self._random.choice(self._town.spawn_points))
        if type is PhysicsControl:
            return self._changed(encoder(type, DEFAULT)(self._library.get("vehicle.tesla.model3").physics))
        if is_dataclass(type):
            hints = get_type_hints(type)
            return [self._value(hints[each.name]) for each in fields(type)]
        if origin in (Union, UnionType):
            return [True, self._value(inner[0])] if self._maybe(0.5) else [False]
        if origin is list or inner[1:] == (...,):
            return [self._value(inner[0]) for _ in range(self._random.choice((0, 1, 1, 2, 5)))]
        return [self._value(part) for part in inner]

    def _description(self) -> list[Any]:
        blueprint = self._random.choice(list(self._library.filter(self._random.choice(SPAWNED))))
        attributes = [
            [key, 4, self._value(str) if self._maybe(0.3) else self._random.choice(choices)]
            for key, choices in blueprint.choices.items()
            if choices and self._maybe(0.05)
        ]
        small = [[key, 1, "32"] for key in ("image_size_x", "image_size_y")]  # large images take all the time
        return [0, blueprint.id, attributes + small * blueprint.id.startswith("sensor.camera")]

    def _changed(self, value: Any) -> Any:
        """Return a struct with some other numbers, and some lists that are longer or shorter."""
        if isinstance(value, list | tuple):
            changed = [self._changed(item) for item in value]
            return changed * self._random.choice((0, 2, 5)) if self._maybe(0.02) else changed
        return self._value(type(value)) if self._maybe(0.2) else value


class Connection:
    """A client, as plain as can be."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=LIMIT)
        self._unpacker = msgpack.Unpacker(unicode_errors="surrogateescape")

    def send(self, name: str, *arguments: Any) -> None:
        self._socket.sendall(msgpack.packb([0, 0, name, [[False], *arguments]], unicode_errors="surrogatepass"))

    def reply(self, patience: float = LIMIT) -> list[Any] | None:
        """Return the reply to the call that was sent; None if it does not come in s."""
        while True:
            for reply in self._unpacker:
                return list(reply)
            if not select([self._socket], [], [], patience)[0]:
                return None
            data = self._socket.recv(1 << 20)
            assert data, "the server has hung up"
            self._unpacker.feed(data)

    def close(self) -> None:
        self._socket.close()


class Clock(Connection):
    """The client that ticks, and measures for how long the thread of the server that serves calls keeps it waiting, in s."""

    def __init__(self, port: int, server: int) -> None:
        super().__init__(port)
        self._busy = Path(f"/proc/{server}/task/{server}/schedstat")

    def busy(self) -> float:
        return int(self._busy.read_text().split()[0]) / 1e9 if self._busy.exists() else 0.0

    def tick(self) -> float:
        """Tick; what has no answer to give must be answered soon."""
        before, found = self.busy(), []
        for name in ("version", "tick_cue"):
            self.send(name)
            found.append((self.reply(), self.busy() - before))
        assert all(reply is not None and reply[2] is None for reply, _ in found), found
        return found[0][1]


def run(seconds: float, seed: int, most: int = sys.maxsize) -> tuple[Counter[str], tuple[float, str, list[Any]], list[str]]:
    """Make at most some random calls for some seconds.

    Returns how often which call was made; the longest time that the server has kept the fourth client waiting, in s, with
    the call; and the lines of the server's log that report a fault of its own.
    """
    made: Counter[str] = Counter()
    slowest: tuple[float, str, list[Any]] = 0.0, "", []
    caller, end = Caller(seed), time.monotonic() + seconds
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        process, port = stack.enter_context(serving("--recordings", folder, "--confine", "--quality=low"))
        lines: list[str] = []
        assert process.stderr is not None
        reader = threading.Thread(target=lambda log: lines.extend(log), args=(process.stderr,))
        reader.start()
        clock = stack.enter_context(closing(Clock(port, process.pid)))
        clients = [stack.enter_context(closing(Connection(port))) for _ in range(CLIENTS)]
        while time.monotonic() < end and made.total() < most:
            client, (name, arguments) = clients[made.total() % CLIENTS], caller.call()
            client.send(name, *arguments)
            asked, longest, reply = time.monotonic(), 0.0, None
            while reply is None:
                longest = max(longest, clock.tick())
                reply = client.reply(PAUSE)
                assert time.monotonic() < asked + LIMIT, (name, arguments)
            made[name] += 1
            slowest = max(slowest, (longest, name, arguments), key=lambda each: each[0])
            if name == "spawn_actor" and reply[3][0][0]:
                id = reply[3][0][1][0]
                caller.ids.append(id)
                if arguments[0][1].startswith("sensor."):
                    listener = stack.enter_context(closing(socket.create_connection(("127.0.0.1", port + 1))))
                    listener.sendall(struct.pack("<I", id - sensor_of(0)))
        clock.tick()
        assert process.poll() is None
        process.terminate()
        reader.join()
        assert process.wait() == 0
    return made, slowest, [line for line in lines if any(fault in line for fault in FAULTS)]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.server.sequences", description=__doc__)
    parser.add_argument("--seconds", type=float, default=900.0, help="how long (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="the seed (default: %(default)s)")
    parser.add_argument("--random", action="store_true", help="other calls in every run")
    options = parser.parse_args()
    seed = random.randrange(1 << 32) if options.random else options.seed
    made, slowest, faults = run(options.seconds, seed)
    print(*faults, sep="")
    print(f"seed {seed}: {made.total()} calls, {len(faults)} faults in the log, slowest: {slowest!s:.500}")
    sys.exit(bool(faults) or slowest[0] > WAITING)


if __name__ == "__main__":
    main()
