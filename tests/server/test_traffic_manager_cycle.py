from __future__ import annotations

import asyncio
import socket
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import msgpack
import pytest

from carla_recap.server.traffic_manager import TrafficManagerPause
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Iterator

    import carla

CYCLE: Final = (("get_vehicle_light_states",), ("get_weather_parameters",), ("apply_batch", [], False))
TICK: Final = ("tick_cue",)
SETTINGS: Final = ("get_episode_settings",)


@pytest.fixture
def wire(client: carla.Client, port: int) -> Iterator[socket.socket]:
    """A bare connection; the world is in synchronous mode."""
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as wire:
        yield wire


@pytest.fixture
def manager(wire: socket.socket) -> Iterator[socket.socket]:
    """A traffic manager that is registered over that connection."""
    with registered(wire) as manager:
        yield manager


@contextmanager
def registered(wire: socket.socket) -> Iterator[socket.socket]:
    """The server of a traffic manager that is registered over a connection."""
    with socket.create_server(("127.0.0.1", 0)) as manager:
        manager.settimeout(PATIENCE)
        answered(wire, ("add_traffic_manager_running", list(manager.getsockname())))
        yield manager


def answered(wire: socket.socket, *calls: tuple[Any, ...]) -> list[str]:
    """Send calls at once; returns their names in the order of the answers."""
    wire.sendall(b"".join(msgpack.packb([0, number, name, [[False], *rest]]) for number, (name, *rest) in enumerate(calls)))
    unpacker, names = msgpack.Unpacker(), list[str]()
    while len(names) < len(calls):
        unpacker.feed(wire.recv(1 << 16))
        names += [calls[number][0] for _, number, _, _ in unpacker]
    return names


def test_a_tick_passes_once_the_manager_waits_for_it(wire: socket.socket, manager: socket.socket) -> None:
    for _ in range(3):
        assert answered(wire, *CYCLE, TICK, SETTINGS)[-2:] == [SETTINGS[0], TICK[0]]
        assert answered(wire, *CYCLE, SETTINGS, TICK)[-2:] == [SETTINGS[0], TICK[0]]


def test_settings_are_taken_once_the_manager_waits_for_the_next_tick(wire: socket.socket, manager: socket.socket) -> None:
    wire.sendall(msgpack.packb([0, 0, *SETTINGS, [[False]]]))
    _, _, _, ((_, settings),) = msgpack.unpackb(wire.recv(1 << 16))
    names = answered(wire, *CYCLE, ("set_episode_settings", settings), SETTINGS)
    assert names[-2:] == [SETTINGS[0], "set_episode_settings"]


def test_a_tick_passes_even_if_the_manager_goes_no_further(wire: socket.socket, manager: socket.socket) -> None:
    for _ in range(3):
        assert answered(wire, *CYCLE, TICK)[-1] == TICK[0]


def test_without_a_manager_the_answers_are_in_order(wire: socket.socket) -> None:
    assert answered(wire, *CYCLE, TICK, SETTINGS)[-2:] == [TICK[0], SETTINGS[0]]


def test_a_manager_that_has_missed_a_tick_is_woken(wire: socket.socket, manager: socket.socket, port: int) -> None:
    """Another one that has begun a cycle is not."""
    with socket.create_connection(("127.0.0.1", port), timeout=PATIENCE) as other, registered(other) as late:
        answered(wire, *CYCLE, SETTINGS, TICK, CYCLE[0])
        answered(other, *CYCLE, SETTINGS, TICK)
        caller, _ = late.accept()
        with caller:
            caller.settimeout(PATIENCE)
            assert [answered_request(caller), answered_request(caller)] == [
                ["set_synchronous_mode", [False]],
                ["set_synchronous_mode", [True]],
            ]
    manager.settimeout(0.1)  # its tick was the earlier one
    with pytest.raises(TimeoutError):
        manager.accept()


def test_the_manager_whose_turn_it_is_is_woken(wire: socket.socket) -> None:
    with registered(wire) as one, registered(wire) as other:
        first, second = sorted((one, other), key=lambda manager: manager.getsockname()[1])
        answered(wire, *CYCLE, SETTINGS, TICK, CYCLE[0])
        caller, _ = second.accept()
        caller.close()
        first.settimeout(0.1)
        with pytest.raises(TimeoutError):
            first.accept()


def test_a_manager_without_an_address_has_the_port_that_its_client_asked_about(wire: socket.socket) -> None:
    answered(wire, ("is_traffic_manager_running", 8123), ("add_traffic_manager_running", ["", 0]))
    wire.sendall(msgpack.packb([0, 0, "get_traffic_manager_running", [[False], 8123]]))
    assert msgpack.unpackb(wire.recv(1 << 10))[3] == [[1, ["127.0.0.1", 8123]]]


async def test_a_pause_waits_for_each_manager() -> None:
    """Without it, the thread of a second manager looks at the episode while the client has none."""
    pause = TrafficManagerPause(2)
    beginning = asyncio.create_task(pause.begin(lambda: None))
    held = [asyncio.create_task(pause.hold("apply_batch", "done"))]
    await asyncio.sleep(0.05)
    assert not beginning.done()
    held.append(asyncio.create_task(pause.hold("apply_batch", asyncio.sleep(0, "done"))))  # as of a long batch
    await beginning
    await pause.end(lambda: True)
    assert await asyncio.gather(*held) == ["done", "done"]


def answered_request(caller: socket.socket) -> list[Any]:
    """Return the request of a caller, and answer it."""
    _, number, *wanted = msgpack.unpackb(caller.recv(1 << 10))
    caller.sendall(msgpack.packb([1, number, None, None]))
    return wanted
