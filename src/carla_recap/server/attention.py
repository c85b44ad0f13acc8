"""The event loop of the server, which stays awake for a moment after each call, because the next one comes soon.

A client in synchronous mode calls hundreds of times a second, and its traffic manager makes ten calls for each tick. A
processor that goes to sleep in between takes tens of microseconds to wake up, in a virtual machine most of all.
"""

from __future__ import annotations

import asyncio
import os
import selectors
import sys
import time
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable

Ready = list[tuple[selectors.SelectorKey, int]]

_MOMENT: Final = 0.002  # s: a traffic manager of 50 vehicles makes its next call within that time, mostly
_let_others_run: Final[Callable[[], Any]] = getattr(os, "sched_yield", lambda: None)


class _Attentive(selectors.DefaultSelector):
    """Where something has just happened, looks again and again for a moment before it waits; others may run meanwhile."""

    _is_busy = False

    def select(self, timeout: float | None = None) -> Ready:
        """See `selectors.BaseSelector.select`."""
        ready = super().select(0)
        if ready:
            self._is_busy = True
        elif timeout is None or timeout > 0:
            if self._is_busy:
                begin = time.monotonic()
                ready = self._watch(_MOMENT if timeout is None else min(_MOMENT, timeout))
                timeout = None if timeout is None else max(0.0, timeout - (time.monotonic() - begin))
            ready = ready or super().select(timeout)
            self._is_busy = bool(ready)
        return ready

    def _watch(self, seconds: float) -> Ready:
        end = time.monotonic() + seconds
        ready: Ready = []
        while not ready and time.monotonic() < end:
            _let_others_run()
            ready = super().select(0)
        return ready


def attentive_loop() -> asyncio.AbstractEventLoop:
    """An event loop that stays awake for a moment; Windows has its own, which takes more connections."""
    if sys.platform == "win32":
        return asyncio.new_event_loop()
    return asyncio.SelectorEventLoop(_Attentive())
