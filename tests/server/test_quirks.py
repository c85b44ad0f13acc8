"""The quirks of the official client, each with what happens without the server's answer to it."""

from __future__ import annotations

import asyncio
import inspect
import re
import socket
import struct
import time
from contextlib import suppress
from functools import cache
from pathlib import Path

import pytest

from carla_recap.server import quirks
from carla_recap.server.host import Host
from carla_recap.server.quirks import PendingSubscriptions, unread_bytes
from tests.server.inside import client_inside
from tests.server.listening import sensor
from tests.sim.flat import flat_world
from tests.waiting import PATIENCE


def rows() -> list[list[str]]:
    """The table of quirks: quirk, symptom, place, tests."""
    lines = [line for line in (inspect.getdoc(quirks) or "").splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


@cache
def names_of_tests() -> set[str]:
    texts = [path.read_text() for path in Path(__file__).parent.glob("test_*.py")]
    return {name for text in texts for name in re.findall(r"^(?:async )?def (test_\w+)", text, re.MULTILINE)}


@pytest.mark.parametrize("row", rows(), ids=lambda row: row[2])
def test_each_quirk_has_a_place_and_tests(row: list[str]) -> None:
    _, _, place, tests = row
    module, _, name = place.strip("`").rpartition(".")
    assert hasattr(__import__(f"carla_recap.server.{module}", fromlist=[name]), name)
    assert {test.strip(" `") for test in tests.split(",")} <= names_of_tests()


# --- unread calls ---------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="needs sockets as of Linux")
def test_what_arrived_before_a_write_failed_can_be_read() -> None:
    """Without it, asyncio closes the socket, and the last calls of a script are lost."""
    received: list[bytes] = []

    class Server(asyncio.Protocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            assert isinstance(transport, asyncio.Transport)
            self.transport = transport
            transport.pause_reading()

        def connection_lost(self, error: Exception | None) -> None:
            assert error is not None
            received.append(unread_bytes(self.transport))
            done.set()

    async def run() -> None:
        loop = asyncio.get_running_loop()
        one, other = socket.socketpair()
        transport, _ = await loop.create_connection(Server, sock=one)
        other.sendall(b"stop_recorder")
        other.close()
        with suppress(OSError):
            transport.write(b"a reply")
        await asyncio.wait_for(done.wait(), PATIENCE)

    done = asyncio.Event()
    asyncio.run(run())
    assert received == [b"stop_recorder"]


# --- subscriptions that are about to come ---------------------------------------------------------------------------------


async def test_a_tick_waits_for_the_subscriptions_of_its_client() -> None:
    """Without it, the client's `listen` is later than its tick, whose datum is lost."""
    pending, one, other = PendingSubscriptions(), object(), object()
    pending.expect(3, one)
    (subscription,) = pending.of(one)
    assert not pending.of(other)
    assert not subscription.done()
    pending.arrived(3)
    assert subscription.done()
    assert not pending.of(one)


async def test_a_tick_does_not_wait_long_for_a_subscription_that_never_comes() -> None:
    pending, client = PendingSubscriptions(), object()
    pending.expect(3, client)
    begin = time.monotonic()
    await asyncio.wait(pending.of(client))
    assert time.monotonic() - begin >= 0.2


async def test_the_end_of_an_earlier_wait_does_not_end_a_later_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quirks, "_SUBSCRIBED_BY", 0.1)
    pending, client = PendingSubscriptions(), object()
    pending.expect(3, client)
    monkeypatch.setattr(quirks, "_SUBSCRIBED_BY", PATIENCE)
    pending.expect(3, client)
    await asyncio.sleep(0.2)
    assert [subscription.done() for subscription in pending.of(client)] == [False]
    pending.arrived(3)


# --- threads that are busy with the episode before ------------------------------------------------------------------------


def test_nothing_of_an_episode_is_sent_after_its_end() -> None:
    """Without it, a client that has no episode reads an image of the old one, and aborts, now and then."""
    host = Host(flat_world())
    client = client_inside(host)
    gnss = sensor(host, "other.gnss")
    host.tick()
    host.begin_episode(host.world.town, client)
    assert gnss.closed
    assert len(gnss.take()) == 1


# --- a stream of snapshots for each connection ----------------------------------------------------------------------------


class Frames:
    """A subscriber that keeps what it gets."""

    def __init__(self, host: Host, stream: int) -> None:
        self.episodes: list[int] = []
        host.streams.add(stream, self)  # type: ignore[arg-type]

    def send(self, frame: bytes) -> None:
        self.episodes += struct.unpack_from("<Q", frame, 4 + 48)

    def close(self) -> None:
        pass


def test_a_client_that_begins_an_episode_gets_it_in_a_new_stream() -> None:
    """Without it, the client learns of the episode from its old stream while its own call goes on, and aborts."""
    host = Host(flat_world())
    client, other = client_inside(host), client_inside(host)
    old, theirs = Frames(host, client.stream), Frames(host, other.stream)
    before = client.stream
    host.tick()
    host.begin_episode(host.world.town, client)
    assert (old.episodes, theirs.episodes) == ([1], [1, 2])
    assert client.stream not in (before, other.stream)
    assert Frames(host, client.stream).episodes == [2]
    host.tick()
    assert (old.episodes, theirs.episodes) == ([1], [1, 2, 2])
