"""The traffic managers of clients: who runs one and where, and how they are kept still while episodes change."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, Protocol

from carla_recap.server.rounds import BATCH, FIRST_CALL

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.server.rounds import Round

_CYCLE: Final = 0.25  # s: a manager has called by then, or will not call
_SETTLING: Final = 0.1  # s: after that, its client has set up what the manager needs
_PATIENCE: Final = 5.0  # s, for a client to subscribe
_LOOK: Final = 0.01  # s


class Owner(Protocol):
    """A client that runs a traffic manager."""

    @property
    def address(self) -> str:
        """The address of the machine that it is on."""

    @property
    def round(self) -> Round:
        """What its traffic manager is at."""


class Managers:
    """The traffic managers by their ports; each is gone with its client, which alone could answer for it."""

    def __init__(self) -> None:
        self._running: dict[int, tuple[str, Owner]] = {}

    def add(self, host: str, port: int, client: Owner) -> bool:
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

    def tick(self, client: Owner) -> None:
        """Expect the managers of a client to begin their rounds, now that it is told of a tick: it signals them itself."""
        ports = sorted(port for port, (_, owner) in self._running.items() if owner is client)
        if ports:
            client.round.expect([(client.address, port) for port in ports])

    def owns_one(self, client: Owner) -> bool:
        """Whether a client runs a manager."""
        return any(owner is client for _, owner in self._running.values())

    def leave(self, client: Owner) -> None:
        """Forget the managers of a client."""
        self._running = {port: running for port, running in self._running.items() if running[1] is not client}


class Truce:
    """Keeps the traffic manager of a client still while the client goes over to a new episode.

    Between the end of `load_new_episode` and the first snapshot that it gets, the client has no episode, and its manager,
    which runs in a thread of the client's process, would take that process down if it looked. It cannot look while it
    waits for the answer to a call: so that answer is held back.
    """

    def __init__(self) -> None:
        self._waited_for = {BATCH}
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
        for name in (BATCH, FIRST_CALL):
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
