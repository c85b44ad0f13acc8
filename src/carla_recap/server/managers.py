"""The traffic managers of clients: who runs one and where, and how they are kept still while episodes change."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.server.client import Client

_LAST_CALL: Final = "apply_batch"  # of a manager's cycle
_ANY_CALL: Final = "get_vehicle_light_states"  # of a cycle, even of a manager that has no vehicles
_CYCLE: Final = 0.25  # s: a manager has called by then, or will not call
_SETTLING: Final = 0.1  # s: after that, its client has set up what the manager needs
_ROUND: Final = (_ANY_CALL, "get_weather_parameters", _LAST_CALL, "get_episode_settings")  # and whatever else in between
_TURN: Final = 0.01  # s: from one call of a round, a manager has come to the next
_PATIENCE: Final = 5.0  # s, for a client to subscribe
_LOOK: Final = 0.01  # s


class Managers:
    """The traffic managers by their ports; each is gone with its client, which alone could answer for it."""

    def __init__(self) -> None:
        self._running: dict[int, tuple[str, Client]] = {}

    def add(self, host: str, port: int, client: Client) -> bool:
        """Enter a manager; False if there is one at this port."""
        if port in self._running:
            return False
        self._running[port] = (host, client)
        return True

    def remove(self, port: int) -> None:
        """Forget a manager."""
        self._running.pop(port, None)

    def host(self, port: int) -> str | None:
        """Where the manager of a port runs; None if there is none."""
        return self._running[port][0] if port in self._running else None

    def under_way(self) -> list[asyncio.Future[None]]:
        """What to wait for until all managers wait for a tick, as far as they do; see `Round`."""
        return [rest for _, owner in self._running.values() for rest in owner.round.under_way()]

    def owns_one(self, client: Client) -> bool:
        """Whether a client runs a manager."""
        return any(owner is client for _, owner in self._running.values())

    def leave(self, client: Client) -> None:
        """Forget the managers of a client."""
        self._running = {port: running for port, running in self._running.items() if running[1] is not client}


class Round:
    """Follows the traffic manager of a client from call to call.

    In synchronous mode a round ends with a batch. Then the client goes on, and ticks; the manager asks for the settings,
    and sets out to wait for the client's signal that the tick has passed. The official client gives it without holding the
    manager's lock: at the very moment when the manager sets out it is lost, and both wait for each other for ever. A tick
    that passed before the manager has been answered would bring the two together there, so it had better wait.
    """

    def __init__(self) -> None:
        self._next = 0
        self._rest: asyncio.Future[None] | None = None
        self._limit: asyncio.TimerHandle | None = None

    def hear(self, name: str) -> None:
        """Take note of a call of the client, or of its manager: they share a connection."""
        if name == _ROUND[self._next]:
            self._next = (self._next + 1) % len(_ROUND)
            self._let_go()
        elif name == _ROUND[0]:
            self._next = 1

    def under_way(self) -> tuple[asyncio.Future[None], ...]:
        """What to wait for, if the manager is about to ask for the settings; it is not waited for long."""
        if _ROUND[self._next] != _ROUND[-1]:
            return ()
        if self._rest is None:
            loop = asyncio.get_running_loop()
            self._rest = loop.create_future()
            self._limit = loop.call_later(_TURN, self._let_go)
        return (self._rest,)

    def _let_go(self) -> None:
        if self._rest is not None and self._limit is not None:
            self._rest.set_result(None)
            self._limit.cancel()
            self._rest = self._limit = None


class Truce:
    """Keeps the traffic manager of a client still while the client goes over to a new episode.

    Between the end of `load_new_episode` and the first snapshot that it gets, the client has no episode, and its manager,
    which runs in a thread of the client's process, would take that process down if it looked. It cannot look while it
    waits for the answer to a call: so that answer is held back.
    """

    def __init__(self) -> None:
        self._waited_for = {_LAST_CALL}
        self._called = asyncio.Event()
        self._over = asyncio.Event()

    def hold(self, name: str, answer: Any) -> Any:
        """Hold back the answer to a call of the manager; that to another call is handed on."""
        return self._hold(answer) if name in self._waited_for else answer

    async def begin(self, new_frame: Callable[[], None]) -> None:
        """Wait for a call of the manager; there is none where it waits for a tick of its client.

        Args:
            new_frame: Sends the client a snapshot, which lets a manager that does not wait begin a cycle.
        """
        for name in (_LAST_CALL, _ANY_CALL):
            self._waited_for.add(name)
            new_frame()
            with suppress(TimeoutError):
                await asyncio.wait_for(self._called.wait(), _CYCLE)
                return

    async def end(self, has_subscribed: Callable[[], bool]) -> None:
        """Let the manager go on once its client has subscribed to the new episode."""
        loop = asyncio.get_running_loop()
        latest = loop.time() + _PATIENCE
        while not has_subscribed() and loop.time() < latest:
            await asyncio.sleep(_LOOK)
        await asyncio.sleep(_SETTLING)
        self._over.set()

    async def _hold(self, answer: Any) -> Any:
        self._called.set()
        await self._over.wait()
        return answer
