"""The rounds of a traffic manager in synchronous mode, one for each tick, and what keeps it and its client from hanging.

A round ends with a batch of commands. Then the client goes on, and ticks; the manager asks for the settings, and sets out to
wait for the client's signal that the tick has passed. The official client gives that signal without holding the manager's
lock: at the very moment when the manager sets out it is lost, and then the two wait for each other for ever.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import Final

import msgpack

FIRST_CALL: Final = "get_vehicle_light_states"
"""What a round begins with, even that of a manager that has no vehicles."""
BATCH: Final = "apply_batch"
"""What a round ends with."""
_CALLS: Final = (FIRST_CALL, "get_weather_parameters", BATCH, "get_episode_settings")  # and some others in between
_TURN: Final = 0.1  # s: from its batch, a manager has come to asking for the settings
_LATE: Final = 2.0  # s: a manager that has not begun a round by then has missed the signal
_PATIENCE: Final = 2.0  # s, for a manager to answer
_SYNCHRONOUS: Final = "set_synchronous_mode"  # a procedure of managers


class Round:
    """Follows the traffic manager of a client from call to call.

    A tick that passed while the manager asks for the settings would bring its client and it together just where they can
    miss each other, so such a tick had better wait. Where they have missed each other all the same, because the machine is
    busy, the manager is woken.
    """

    def __init__(self) -> None:
        self._next = 0
        self._has_ended_one = False
        self._rest: asyncio.Future[None] | None = None
        self._limit: asyncio.TimerHandle | None = None
        self._expected: list[tuple[str, int]] = []
        self._alarm: asyncio.TimerHandle | None = None
        self._waking: asyncio.Task[None] | None = None

    def hear(self, name: str) -> None:
        """Take note of a call of the client, or of its manager: they share a connection."""
        if name == _CALLS[self._next]:
            self._next = (self._next + 1) % len(_CALLS)
            self._has_ended_one = self._has_ended_one or not self._next
            self._let_go()
        elif name == FIRST_CALL:
            self._next = 1
        if name == FIRST_CALL and self._expected:
            self.expect(self._expected[1:])

    def under_way(self) -> tuple[asyncio.Future[None], ...]:
        """What to wait for, if the manager is about to ask for the settings; it is not waited for long."""
        if _CALLS[self._next] != _CALLS[-1]:
            return ()
        if self._rest is None:
            loop = asyncio.get_running_loop()
            self._rest = loop.create_future()
            self._limit = loop.call_later(_TURN, self._let_go)
        return (self._rest,)

    def expect(self, managers: list[tuple[str, int]]) -> None:
        """Wake managers that do not begin a round before long; not if none has ever ended one.

        Args:
            managers: Their addresses, in the order in which the client signals to them: to each when the one before is done.
        """
        self.leave()
        if managers and self._has_ended_one:
            self._expected = managers
            self._alarm = asyncio.get_running_loop().call_later(_LATE, self._wake)

    def leave(self) -> None:
        """Expect nothing any more."""
        self._expected = []
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None

    def _let_go(self) -> None:
        if self._rest is not None and self._limit is not None:
            self._rest.set_result(None)
            self._limit.cancel()
            self._rest = self._limit = None

    def _wake(self) -> None:
        self._waking = asyncio.get_running_loop().create_task(_wake(*self._expected[0]))


async def _wake(host: str, port: int) -> None:
    """Have a traffic manager look up, as it does when told to leave synchronous mode; then it is told to enter it again."""
    with suppress(OSError, OverflowError, TimeoutError, asyncio.IncompleteReadError):
        async with asyncio.timeout(_PATIENCE):
            reader, writer = await asyncio.open_connection(host, port)
            try:
                for number, synchronous in enumerate((False, True)):
                    writer.write(msgpack.packb([0, number, _SYNCHRONOUS, [synchronous]]))
                    await reader.readexactly(len(msgpack.packb([1, number, None, None])))
            finally:
                writer.transport.abort()
