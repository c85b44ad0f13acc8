"""The signals that end a process: the first one is heeded; those that follow while things are finished are not.

Many come more than once: Ctrl-C is pressed twice, and `timeout` signals its child, and then its child's group.
"""

from __future__ import annotations

import signal
import threading
from contextlib import contextmanager
from time import monotonic
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

GRACE: Final = 3.0
"""For so many seconds after the first signal, others are ignored; one that comes later ends the process at once."""
ENDING: Final = tuple(signal.Signals[name] for name in ("SIGINT", "SIGTERM", "SIGHUP") if name in signal.Signals.__members__)
"""The signals that end a process, as far as the system knows them."""


class _First:
    """When the first signal came; None: none has come yet. Signals are the whole process's, as is this."""

    at: float | None = None


def is_ending() -> bool:
    """Whether a signal has come."""
    return _First.at is not None


def heeded(number: int) -> bool:
    """Whether a signal that has just come is to be heeded, as the first one; a late one ends the process here."""
    now = monotonic()
    if _First.at is None:
        _First.at = now
        return True
    if now - _First.at > GRACE:
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)
    return False


def handled(handler: Any) -> dict[signal.Signals, Any]:
    """Handle the signals that end a process, but for those that are ignored, as under nohup, or handled by nobody's Python.

    Returns:
        The handlers until now.
    """
    numbers = [number for number in ENDING if signal.getsignal(number) not in (signal.SIG_IGN, None)]
    return {number: signal.signal(number, handler) for number in numbers}


@contextmanager
def ended_by_signals(end: Callable[[str], object]) -> Iterator[None]:
    """Have signals end something else than the process, while a `with` block runs; outside the main thread, do nothing.

    Args:
        end: Is told the name of the first signal.
    """

    def handle(number: int, _: FrameType | None) -> None:
        if heeded(number):
            end(signal.Signals(number).name)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _First.at = None
    before = handled(handle)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
