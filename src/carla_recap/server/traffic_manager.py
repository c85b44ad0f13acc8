"""The traffic managers of clients: which there are, the cycles in which they tick the world, and their pauses."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from inspect import isawaitable
from typing import TYPE_CHECKING, Any, Final

import msgpack

if TYPE_CHECKING:
    from collections.abc import Callable

FIRST_CALL: Final = "get_vehicle_light_states"
"""The first call of a cycle, even of a manager without vehicles."""
LAST_CALL: Final = "apply_batch"
"""The call that ends a cycle."""
_CALLS: Final = (FIRST_CALL, "get_weather_parameters", LAST_CALL, "get_episode_settings")  # with others in between
_TO_SETTINGS: Final = 0.1  # s: after its batch, a manager has asked for the settings by then
_LATE: Final = 2.0  # s: a manager that has not begun a cycle by then has missed the signal
_ANSWER: Final = 2.0  # s, for a manager to answer
_SYNCHRONOUS: Final = "set_synchronous_mode"  # a remote procedure of managers
_CYCLE: Final = 0.25  # s: a manager that runs has made its next call by then
_SET_UP: Final = 0.1  # s: after subscribing, the client has set up what the manager needs by then
_MOST: Final = 5.0  # s, for the client to subscribe
_POLL: Final = 0.01  # s


class TrafficManagerRegistry:
    """The traffic managers by their ports: each runs inside a client, which has a cycle, and leaves with it."""

    def __init__(self) -> None:
        self._running: dict[int, tuple[str, TrafficManagerCycle]] = {}

    def add(self, host: str, port: int, client: TrafficManagerCycle) -> bool:
        """Add a manager; return False if there is one at this port."""
        if port in self._running:
            return False
        self._running[port] = (host, client)
        return True

    def remove(self, port: int) -> None:
        """Remove the manager of a port."""
        self._running.pop(port, None)

    def remove_all(self, client: TrafficManagerCycle) -> None:
        """Remove the managers of a client."""
        self._running = {port: running for port, running in self._running.items() if running[1] is not client}

    def host(self, port: int) -> str | None:
        """Return the machine on which the manager of a port runs; None if there is no manager."""
        return self._running[port][0] if port in self._running else None

    def count(self, client: TrafficManagerCycle) -> int:
        """Return how many managers a client runs."""
        return sum(owner is client for _, owner in self._running.values())

    def unsettled(self) -> list[asyncio.Future[None]]:
        """Return futures that are done when no manager can miss a tick; see `TrafficManagerCycle`."""
        return [future for _, owner in self._running.values() for future in owner.unsettled()]

    def expect_cycles(self, client: TrafficManagerCycle) -> None:
        """Expect the managers of a client to begin their cycles: the client signals the tick to them itself."""
        if ports := sorted(port for port, (_, owner) in self._running.items() if owner is client):
            client.expect([(client.address, port) for port in ports])


class TrafficManagerCycle:
    """The position of a client's traffic manager in its cycle, in synchronous mode: one for each tick.

    A cycle ends with a batch of commands. Then the client goes on and ticks; the manager asks for the settings, and begins
    to wait for the client's signal that the tick has passed. The official client gives that signal without holding the
    manager's lock: a signal that comes at the very moment when the manager begins to wait is lost, and both wait for each
    other for ever.

    A tick that passes while the manager asks for the settings would bring client and manager to the moment when they can
    miss each other: such a tick waits. If they have missed each other all the same, on a busy machine, the manager is woken.

    Attributes:
        address: The address of the client's machine.
        wanted_port: The port about which the client asked last whether there is a manager.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.wanted_port = 0
        self._next = 0
        self._has_completed_one = False
        self._settled: asyncio.Future[None] | None = None
        self._limit: asyncio.TimerHandle | None = None
        self._expected: list[tuple[str, int]] = []
        self._alarm: asyncio.TimerHandle | None = None
        self._waking: asyncio.Task[None] | None = None

    def begin_call(self, name: str) -> None:
        """Take note of a call of the client, or of its manager: they share a connection."""
        if name == _CALLS[self._next]:
            self._next = (self._next + 1) % len(_CALLS)
            self._has_completed_one = self._has_completed_one or not self._next
            self._settle()
        elif name == FIRST_CALL:
            self._next = 1
        if name == FIRST_CALL and self._expected:
            self.expect(self._expected[1:])

    def unsettled(self) -> tuple[asyncio.Future[None], ...]:
        """Return a future of the manager's asking for the settings, if that comes next; it is done soon in any case."""
        if _CALLS[self._next] != _CALLS[-1]:
            return ()
        if self._settled is None:
            loop = asyncio.get_running_loop()
            self._settled = loop.create_future()
            self._limit = loop.call_later(_TO_SETTINGS, self._settle)
        return (self._settled,)

    def expect(self, managers: list[tuple[str, int]]) -> None:
        """Wake managers that do not begin a cycle in time, unless none has ever completed one.

        Their addresses are in the order in which the client signals to them: each after the one before is done.
        """
        self._expected = []
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None
        if managers and self._has_completed_one:
            self._expected = managers
            self._alarm = asyncio.get_running_loop().call_later(_LATE, self._wake)

    def _settle(self) -> None:
        if self._settled is not None and self._limit is not None:
            self._settled.set_result(None)
            self._limit.cancel()
            self._settled = self._limit = None

    def _wake(self) -> None:
        self._waking = asyncio.get_running_loop().create_task(_wake(*self._expected[0]))


async def _wake(host: str, port: int) -> None:
    """Wake a traffic manager by having it leave synchronous mode, and enter it again."""
    with suppress(OSError, OverflowError, TimeoutError, asyncio.IncompleteReadError):
        async with asyncio.timeout(_ANSWER):
            reader, writer = await asyncio.open_connection(host, port)
            try:
                for number, synchronous in enumerate((False, True)):
                    writer.write(msgpack.packb([0, number, _SYNCHRONOUS, [synchronous]]))
                    await reader.readexactly(len(msgpack.packb([1, number, None, None])))
            finally:
                writer.transport.abort()


class TrafficManagerPause:
    """A pause of the traffic managers of a client, while that changes to a new episode.

    Between the end of `load_new_episode` and the first snapshot that it gets, the client has no episode. A traffic manager
    runs in a thread of the client's process and aborts that process if it looks at the episode then. It cannot look while it
    waits for the answer to a call: so the server holds that answer back.
    """

    def __init__(self, managers: int) -> None:
        self._held = {LAST_CALL}
        self._missing = managers
        self._called = asyncio.Event()
        self._over = asyncio.Event()

    def hold(self, name: str, answer: Any) -> Any:
        """Return an awaitable that holds back the answer to a call of the manager, or the answer to any other call."""
        return self._hold(answer) if name in self._held else answer

    async def begin(self, new_frame: Callable[[], None]) -> None:
        """Wait for a call of each manager; there is none of one that waits for a tick of its client.

        A new frame makes a manager that does not wait begin a cycle.
        """
        for name in (LAST_CALL, FIRST_CALL):
            self._held.add(name)
            new_frame()
            with suppress(TimeoutError):
                await asyncio.wait_for(self._called.wait(), _CYCLE)
                return

    async def end(self, has_subscribed: Callable[[], bool]) -> None:
        """End the pause when the client has subscribed to the new episode."""
        loop = asyncio.get_running_loop()
        latest = loop.time() + _MOST
        while not has_subscribed() and loop.time() < latest:
            await asyncio.sleep(_POLL)
        await asyncio.sleep(_SET_UP)
        self._over.set()

    async def _hold(self, answer: Any) -> Any:
        self._missing -= 1
        if not self._missing:
            self._called.set()
        await self._over.wait()
        return await answer if isawaitable(answer) else answer
