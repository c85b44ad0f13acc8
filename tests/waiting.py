"""Waiting for a state, with one generous limit: a loaded machine is slow, and only what hangs fails."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final, TypeVar

Seen = TypeVar("Seen")

PATIENCE: Final = 600.0
"""The time in s after which something hangs. What is over sooner on a calm machine may take many times as long."""

PROCESSOR_TIME: Final = 40.0
"""The processor time in s that a process has for what takes it less than a tenth of that."""


def wait_until(state: Callable[[], Seen], pause: float = 0.02, patience: float = PATIENCE) -> Seen:
    """Wait until a state is true; return it.

    Args:
        state: Returns what is seen, which is true at the end of the wait. It may do something, such as tick a world.
        pause: The time between two looks, in s.
        patience: The time in s after which the test fails.
    """
    end = time.monotonic() + patience
    while not (seen := state()):
        assert time.monotonic() < end, f"after {patience:g} s it is still {seen!r}"
        time.sleep(pause)
    return seen


@contextmanager
def time_limit() -> Iterator[None]:
    """Fail instead of hanging, or computing for long."""

    def give_up(*_: object) -> None:
        raise TimeoutError(f"not done after {PATIENCE:g} s, or {PROCESSOR_TIME:g} s of processor time")

    limits = ((signal.SIGALRM, signal.ITIMER_REAL, PATIENCE), (signal.SIGPROF, signal.ITIMER_PROF, PROCESSOR_TIME))
    before = [signal.signal(number, give_up) for number, _, _ in limits]
    try:
        for _, timer, seconds in limits:
            signal.setitimer(timer, seconds)
        yield
    finally:
        for (number, timer, _), handler in zip(limits, before, strict=True):
            signal.setitimer(timer, 0)
            signal.signal(number, handler)


def is_running(pid: int) -> bool:
    """Return whether a process has not ended."""
    import psutil

    with suppress(psutil.NoSuchProcess):
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    return False
