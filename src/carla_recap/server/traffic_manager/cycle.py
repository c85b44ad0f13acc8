"""The cycles of a client's traffic manager in synchronous mode, one for each tick.

A cycle ends with a batch of commands. Then the client goes on and ticks; the manager asks for the settings, and begins to
wait for the client's signal that the tick has passed. The official client gives that signal without holding the manager's
lock: a signal that comes at the very moment when the manager begins to wait is lost, and both wait for each other for ever.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Final

import msgpack

FIRST_CALL: Final = "get_vehicle_light_states"
"""The first call of a cycle, even of a manager without vehicles."""
LAST_CALL: Final = "apply_batch"
"""The call that ends a cycle."""
_CALLS: Final = (FIRST_CALL, "get_weather_parameters", LAST_CALL, "get_episode_settings")  # with others in between
_TO_SETTINGS: Final = 0.1  # s: after its batch, a manager has asked for the settings by then
_LATE: Final = 2.0  # s: a manager that has not begun a cycle by then has missed the signal
_ANSWER: Final = 2.0  # s, for a manager to answer
_SYNCHRONOUS: Final = "set_synchronous_mode"  # a remote procedure of managers


class TrafficManagerCycle:
    """The position of a client's traffic manager in its cycle.

    A tick that passes while the manager asks for the settings would bring client and manager to the moment when they can
    miss each other: such a tick waits. If they have missed each other all the same, on a busy machine, the manager is woken.
    """

    def __init__(self) -> None:
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

        Args:
            managers: Their addresses, in the order in which the client signals to them: each after the one before is done.
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
