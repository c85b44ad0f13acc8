"""One function for each of many recordings, in worker processes; answers come in the order of the recordings."""

from __future__ import annotations

import os
from time import monotonic
from typing import TYPE_CHECKING, Final, TypeVar

from carla_recap.fleet.outcomes import Outcome, outcome_of
from carla_recap.util.log import log_info

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from distributed import Client

    from carla_recap.fleet.sources import SourceFile

__all__ = ["Outcome", "map_sources", "processors"]

T = TypeVar("T")

_PATIENCE: Final = 0.3  # s of reading in this process after which worker processes, which start in that time, are worthwhile
_MOST: Final = 32  # worker processes, or four for each processor if these are more
_LARGE: Final = 16 << 20  # bytes of a recording that is worth them


def map_sources(
    function: Callable[[SourceFile], T],
    sources: Iterable[SourceFile],
    *,
    jobs: int | None = None,
    client: Client | None = None,
) -> Iterator[Outcome[T]]:
    """Yield the outcome of a function for each of many recordings, in their order, as soon as it is known.

    Memory does not grow with the number of recordings. If a worker process ends, as for want of memory, its recordings are
    read again by another one; a recording with which it ends again has an error. Worker processes are gone when the iterator
    ends, or is closed.

    Args:
        function: Is called with each recording, maybe in another process: a function of a module, or a partial of one. Its
            `RecapError`, `OSError` or `MemoryError` is the outcome's error; others are raised.
        sources: The recordings.
        jobs: The number of worker processes, 32 or four for each processor at most; 1: this process alone; None: as many as
            there are processors, but this process alone while the recordings are few and small.
        client: Dask's client, whose cluster is used instead of processes of this machine.

    Raises:
        RecapError: The worker processes do not start, or the cluster is gone.
    """
    if client is not None:
        from carla_recap.fleet.cluster import map_on_cluster

        yield from map_on_cluster(function, sources, client)
        return
    left = iter(sources)
    count = min(jobs or processors(), max(_MOST, 4 * processors()))
    deadline = monotonic() + _PATIENCE if jobs is None else 0.0
    for source in left:
        if count > 1 and (monotonic() > deadline or (source.size or 0) >= _LARGE):
            from carla_recap.fleet.workers import map_in_workers

            log_info(__name__, "reads %s and further recordings in %s processes", source.location, count)
            yield from map_in_workers(function, source, left, count)
            return
        yield outcome_of(function, source)


def processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
