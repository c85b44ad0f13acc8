"""One function for each of many recordings, in worker processes; answers come in the order of the recordings."""

from __future__ import annotations

import os
import signal
import warnings
from collections import deque
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import TYPE_CHECKING, Final, Generic, TypeVar

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from concurrent.futures import Future

    from carla_recap.fleet.sources import SourceFile

T = TypeVar("T")

_WINDOW: Final = 4
"""The recordings for each worker that are read, or wait for it, at a time."""


@dataclass(frozen=True, slots=True)
class Outcome(Generic[T]):
    """What came of one recording.

    Attributes:
        source: The recording.
        value: What the function returned; None after an error.
        error: The error, in one line; None if there was none.
        warnings: The warnings, a line each.
    """

    source: SourceFile
    value: T | None
    error: str | None = None
    warnings: tuple[str, ...] = ()


def map_sources(
    function: Callable[[SourceFile], T], sources: Iterable[SourceFile], *, jobs: int | None = None
) -> Iterator[Outcome[T]]:
    """Yield the outcome of a function for each of many recordings, in their order, as soon as it is known.

    Memory does not grow with the number of recordings.

    Args:
        function: Is called with each recording, in another process: a function of a module, or a partial of one. Its
            `RecapError` is the outcome's error.
        sources: The recordings.
        jobs: The number of processes; 1: this one alone; None: as many as there are processors.
    """
    jobs = jobs or os.cpu_count() or 1
    if jobs == 1:
        for source in sources:
            yield _outcome(function, source)
        return
    pool = ProcessPoolExecutor(jobs, get_context("spawn"), _ignore_interrupts)
    try:
        window: deque[Future[Outcome[T]]] = deque()
        for source in sources:
            window.append(pool.submit(_outcome, function, source))
            if len(window) >= _WINDOW * jobs:
                yield window.popleft().result()
        while window:
            yield window.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _ignore_interrupts() -> None:
    """Leave Ctrl-C, which all processes of a terminal get, to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _outcome(function: Callable[[SourceFile], T], source: SourceFile) -> Outcome[T]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            value, error = function(source), None
        except RecapError as failure:
            value, error = None, str(failure)
        except OSError as failure:
            value, error = None, f"{source.location}: {failure.strerror or failure}"
        except MemoryError:
            value, error = None, f"{source.location}: not enough memory"
    return Outcome(source, value, error, tuple(str(warning.message) for warning in caught))
