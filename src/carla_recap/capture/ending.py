"""Lets Ctrl-C, and what ends a process, end something in good order."""

from __future__ import annotations

import signal
import threading
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

_SIGNALS: Final = ("SIGINT", "SIGTERM", "SIGHUP")


@contextmanager
def ended_by_signals(end: Callable[[str], None]) -> Iterator[None]:
    """Have signals end something else than the process, while a `with` block runs; the second one ends the process.

    Args:
        end: Is told the name of the signal.
    """

    def handle(number: int, _: FrameType | None) -> None:
        end(signal.Signals(number).name)
        for each in before:
            signal.signal(each, signal.SIG_DFL)

    before: dict[signal.Signals, Any] = {}
    if threading.current_thread() is threading.main_thread():
        for name in _SIGNALS:
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) != signal.SIG_IGN:  # as under nohup
                before[number] = signal.signal(number, handle)
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
