"""A pause of a client's traffic manager while the client changes to a new episode.

Between the end of `load_new_episode` and the first snapshot that it gets, the client has no episode. Its traffic manager
runs in a thread of the client's process and aborts that process if it looks at the episode then. It cannot look while it
waits for the answer to a call: so the server holds that answer back.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final

from carla_recap.server.traffic_manager.cycle import FIRST_CALL, LAST_CALL

if TYPE_CHECKING:
    from collections.abc import Callable

_CYCLE: Final = 0.25  # s: a manager that runs has made its next call by then
_SET_UP: Final = 0.1  # s: after subscribing, the client has set up what the manager needs by then
_MOST: Final = 5.0  # s, for the client to subscribe
_POLL: Final = 0.01  # s


class TrafficManagerPause:
    """A pause of the traffic manager of a client."""

    def __init__(self) -> None:
        self._held = {LAST_CALL}
        self._called = asyncio.Event()
        self._over = asyncio.Event()

    def hold(self, name: str, answer: Any) -> Any:
        """Return an awaitable that holds back the answer to a call of the manager, or the answer to any other call."""
        return self._hold(answer) if name in self._held else answer

    async def begin(self, new_frame: Callable[[], None]) -> None:
        """Wait for a call of the manager; there is none if it waits for a tick of its client.

        Args:
            new_frame: Sends the client a snapshot, which makes a manager that does not wait begin a cycle.
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
        self._called.set()
        await self._over.wait()
        return answer
