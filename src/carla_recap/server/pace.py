"""The time of the world in asynchronous mode: it passes by itself, as fast as the clock on the wall does."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Final

from carla_recap.server.mishaps import tell

if TYPE_CHECKING:
    from carla_recap.server.host import Host

_TICK: Final = 0.05  # s: how often the world ticks where nobody says how long a tick is
_LONGEST: Final = 0.25  # s: a tick that would be longer, because something took its time, is this long
_BEHIND: Final = 1.0  # s: what is later than that is not made up for


class Pace:
    """Ticks a world while it is in asynchronous mode.

    Args:
        host: Whose world it is.
    """

    def __init__(self, host: Host) -> None:
        self._host = host
        self._changed = asyncio.Event()
        host.on_settings.append(self._changed.set)

    async def keep(self) -> None:
        """Tick, for ever."""
        while True:
            self._changed.clear()
            if self._host.settings.synchronous_mode:
                await self._changed.wait()
            else:
                await self._run()

    async def _run(self) -> None:
        """Tick until the settings change."""
        fixed = self._host.settings.fixed_delta_seconds
        due = last = time.monotonic()
        while not self._changed.is_set():
            due = max(due + (fixed or _TICK), time.monotonic() - _BEHIND)
            await asyncio.sleep(due - time.monotonic())
            if self._changed.is_set():
                return
            now = time.monotonic()
            try:
                self._host.tick(fixed or min(now - last, _LONGEST))
            except Exception as error:  # the next tick may go well
                tell("a tick has failed", error)
            last = now
