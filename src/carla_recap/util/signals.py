"""The signals that ask a process to end: the first one is handled, further ones are ignored while it cleans up.

Many arrive more than once: Ctrl-C is pressed twice, and `timeout` signals its child, and then its child's group.
"""

from __future__ import annotations

import signal
import sys
import threading
from contextlib import contextmanager
from time import monotonic
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

GRACE: Final = 3.0
"""Seconds after the first signal in which others are ignored; one that comes later ends the process at once."""
TERMINATION: Final = tuple(
    signal.Signals[name] for name in ("SIGINT", "SIGTERM", "SIGHUP") if name in signal.Signals.__members__
)
"""The signals that ask a process to end, as far as the system has them."""


_first: float | None = None  # the time of the first signal to this process, in s


def is_terminating() -> bool:
    """Return whether a signal has arrived."""
    return _first is not None


def is_first(number: int) -> bool:
    """Return whether the signal that has just arrived is the first one; one after `GRACE` ends the process here."""
    global _first
    if _first is None:
        _first = monotonic()
        return True
    if monotonic() - _first > GRACE:
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)
    return False


def set_handlers(handler: Any) -> dict[signal.Signals, Any]:
    """Set the handler of `TERMINATION`, except for signals that are ignored, as under nohup, or have no handler in Python.

    Return the handlers until now.
    """
    numbers = [number for number in TERMINATION if signal.getsignal(number) not in (signal.SIG_IGN, None)]
    return {number: signal.signal(number, handler) for number in numbers}


def ignore_termination() -> None:
    """Ignore `TERMINATION` from now on."""
    for number in TERMINATION:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def hold_termination() -> Iterator[None]:
    """Hold `TERMINATION` in a `with` block: the first one is handled at its end.

    Processes that start in the block hold these signals until they release them. Another thread may receive a signal that
    this one has blocked, and Python then calls its handler here all the same: so there is another handler meanwhile.
    """
    held: list[int] = []
    is_main = threading.current_thread() is threading.main_thread()
    handlers = set_handlers(lambda number, _: held.append(number)) if is_main else {}
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINATION) if hasattr(signal, "pthread_sigmask") else None
    try:
        yield
    finally:
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number, handler in handlers.items():
            signal.signal(number, handler)
        if held:
            signal.raise_signal(held[0])


@contextmanager
def call_on_termination(callback: Callable[[str], object]) -> Iterator[None]:
    """Call a function with the name of the first signal, instead of ending the process, while a `with` block runs.

    Outside the main thread, do nothing.
    """
    global _first

    def handle(number: int, _: FrameType | None) -> None:
        if is_first(number):
            callback(signal.Signals(number).name)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _first = None
    before = set_handlers(handle)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def unwind_on_termination() -> Iterator[None]:
    """Raise SystemExit on SIGTERM and SIGHUP while a `with` block runs, unless they have handlers already.

    Writing to a closed pipe is a `BrokenPipeError` in the block. Outside the main thread, do nothing.
    """
    changed = []
    if threading.current_thread() is threading.main_thread():
        for name, handler in (("SIGTERM", _exit), ("SIGHUP", _exit), ("SIGPIPE", signal.SIG_IGN)):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is signal.SIG_DFL:
                signal.signal(number, handler)
                changed.append(number)
    try:
        yield
    finally:
        for number in changed:
            signal.signal(number, signal.SIG_DFL)


@contextmanager
def broken_pipes_are_errors() -> Iterator[None]:
    """Make writing to a process that has ended an `OSError` in a `with` block, in any thread, where it may end this one."""
    if not hasattr(signal, "SIGPIPE"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
    try:
        yield
    finally:
        if signal.SIGPIPE not in before:
            if signal.SIGPIPE in signal.sigpending():
                signal.sigwait({signal.SIGPIPE})
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _exit(number: int, _: FrameType | None) -> None:
    sys.exit(128 + number)
