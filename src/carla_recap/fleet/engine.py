"""Many recordings: opened one after another, or a function for each, in worker processes; in the order of the sources."""

from __future__ import annotations

import os
import warnings
from functools import partial
from itertools import chain
from time import monotonic
from typing import TYPE_CHECKING, Final, Literal, TypedDict, TypeVar, Unpack

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.fleet.outcomes import Outcome, outcome_of
from carla_recap.fleet.sources import find_sources
from carla_recap.util.log import log_info

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator

    from distributed import Client

    from carla_recap.fleet.sources import SourceFile, Sources
    from carla_recap.recording import Recording

T = TypeVar("T")


class Processes(TypedDict, total=False):
    """Which processes read many recordings; see `map_sources`."""

    jobs: int | None
    client: Client | None


_PATIENCE: Final = 0.3  # s of reading in this process after which worker processes, which start in that time, are worthwhile
_MOST: Final = 32  # worker processes, or four for each processor if these are more
_LARGE: Final = 16 << 20  # bytes of a recording that is worth them


def map_sources(
    function: Callable[[SourceFile], T],
    sources: Iterable[SourceFile],
    *,
    jobs: int | None = None,
    client: Client | None = None,
    limit: float | None = None,
) -> Generator[Outcome[T], None, None]:
    """Yield the outcome of a function for each of many recordings, in their order, as soon as it is known.

    Memory does not grow with the number of recordings. If a worker process ends, as for want of memory, its recordings are
    read again by another one; a recording with which it ends again has an error. Worker processes are gone when the iterator
    ends, or is closed. That they do not start, or that the cluster is gone, is a `RecapError`.

    Args:
        function: A function of a module, or a partial of one. Its `RecapError`, `OSError` or `MemoryError` is the outcome's
            error; others are raised.
        sources: The recordings.
        jobs: The number of worker processes, 32 or four for each processor at most; 1: this process alone; None: as many as
            there are processors, but this process alone while the recordings are few and small.
        client: Dask's client, whose cluster is used instead of processes of this machine.
        limit: The most seconds for a recording, which has an error then; inf for any number. A function with a limit may do
            whatever it wants to its process, which is always a worker process, on a cluster one of Dask's worker. If it has
            a method `prepare`, each worker process calls that first, which does not count.
    """
    if client is not None:
        from carla_recap.fleet.cluster import map_on_cluster

        yield from map_on_cluster(function, sources, client, limit)
        return
    if limit is not None:
        from carla_recap.fleet.workers import map_in_workers

        yield from map_in_workers(function, sources, jobs or processors(), limit)
        return
    left = iter(sources)
    count = min(jobs or processors(), max(_MOST, 4 * processors()))
    deadline = monotonic() + _PATIENCE if jobs is None else 0.0
    for source in left:
        if count > 1 and (monotonic() > deadline or (source.size or 0) >= _LARGE):
            from carla_recap.fleet.workers import map_in_workers

            log_info(__name__, "reads %s and further recordings in %s processes", source.location, count)
            yield from map_in_workers(function, chain([source], left), count)
            return
        yield outcome_of(function, source)


def processors() -> int:
    """Return the number of processors that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def open_recordings(sources: Sources, *, errors: Literal["raise", "warn"] = "raise") -> Iterator[Recording]:
    """Yield the recordings that some sources mean, open; each is closed when the next one is asked for.

    Args:
        sources: Files, folders, globs and URLs of recordings, or one of them.
        errors: What to do about a recording that cannot be opened, and about a source that means none: "raise" its error, or
            "warn" of it, and go on with the next.

    Warns:
        RecapWarning: A recording cannot be opened.

    Raises:
        NotARecording: A file is not a recording.
        FormatError: A file is damaged.
        RecapError: A file cannot be read, or a folder or a glob means no recording.
    """
    from carla_recap.recording import open_recording

    for source in find_sources(sources, errors="yield"):
        try:
            if source.error is not None:
                raise RecapError(source.error)
            recording = open_recording(source.location)
        except RecapError as error:
            if errors == "raise":
                raise
            warnings.warn(str(error), RecapWarning, stacklevel=2)
            continue
        with recording:
            yield recording


def map_recordings(
    function: Callable[[Recording], T], sources: Sources, **processes: Unpack[Processes]
) -> Iterator[Outcome[T]]:
    """Yield what a function returns for each of many recordings, or its error, in their order, as soon as it is known.

    Recordings that are few and small are read in this process, others in worker processes: a script calls this function
    below `if __name__ == "__main__":`. Memory does not grow with the number of recordings.

    Args:
        function: Is called with each recording, which is open: a method such as `Recording.collisions`, another function of
            a module, or a `functools.partial` of one. What it returns must be picklable. Its `RecapError` is the outcome's
            error, as are those of recordings that cannot be opened; others are raised.
        sources: Files, folders, globs and URLs of recordings, or one of them.
        processes: `jobs`, the number of processes; 1: this process alone; None: as many as there are processors, if it is
            worthwhile. Or `client`, Dask's client, whose cluster is used instead. Its workers have to see the recordings.

    Raises:
        RecapError: The worker processes do not start, or the cluster is gone.
    """
    return map_sources(partial(_call, function), find_sources(sources, errors="yield"), **processes)


def _call(function: Callable[[Recording], T], source: SourceFile) -> T:
    from carla_recap.recording import open_recording

    with open_recording(source.address) as recording:
        return function(recording)
