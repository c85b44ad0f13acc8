"""Dask's clusters: the same function for each of many recordings, on the workers of a cluster."""

from __future__ import annotations

import pickle
import threading
from collections import deque
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

from carla_recap.errors import MissingExtra, NotSetUp, RecapError
from carla_recap.fleet.outcomes import Outcome, outcome_of
from carla_recap.fleet.workers import KeptWorker
from carla_recap.util.text import single_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from distributed import Client, Future

    from carla_recap.fleet.sources import SourceFile

T = TypeVar("T")

_EACH: Final = 16  # recordings of a task: its administration costs about a millisecond
_WINDOW: Final = 3  # tasks for each thread of the cluster that run, or wait, at a time
_LEAST: Final = 8  # tasks, so that a cluster that adapts its size grows
_PATIENCE: Final = 10.0  # s for the scheduler to answer
_HAS_PACKAGE: Final = "__import__('importlib.util').util.find_spec('carla_recap') is not None"

_one_at_a_time = threading.Lock()
"""Held while recordings are read: threads of one process gain nothing, and their warnings would be mixed."""
_children: dict[tuple[bytes, float], KeptWorker[Any]] = {}
"""The child process of a worker for functions with a limit."""


def connect(address: str) -> Client:
    """Return a client of the cluster whose scheduler has an address, such as tcp://10.0.0.1:8786.

    Raises:
        MissingExtra: distributed is not installed.
        RecapError: There is no scheduler.
    """
    try:
        from distributed import Client
        from distributed.comm.addressing import parse_address
        from distributed.comm.registry import get_backend
    except ImportError:
        raise MissingExtra("a Dask cluster", "dask") from None
    try:
        get_backend(parse_address(address)[0])  # of an invalid address, since a client of one ends late and in disorder
        return Client(address, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise RecapError(f"{address}: no Dask scheduler answers ({single_line(error) or 'no reason given'})") from None


def map_on_cluster(
    function: Callable[[SourceFile], T], sources: Iterable[SourceFile], client: Client, limit: float | None = None
) -> Iterator[Outcome[T]]:
    """Yield the outcomes of a function for recordings, in their order; see `engine.map_sources`.

    The cluster's workers open local files by their absolute paths, and have to see these files. Dask runs the tasks of
    workers that are lost on others. What a worker lacks, such as an extra or credentials, ends the iteration.
    """
    from distributed.client import ClosedClientError
    from distributed.protocol.pickle import dumps
    from distributed.scheduler import KilledWorker

    left, pickled = iter(sources), dumps(function)
    window: deque[tuple[list[SourceFile], Future[list[Outcome[T]]]]] = deque()

    def submit(group: list[SourceFile]) -> tuple[list[SourceFile], Future[list[Outcome[T]]]]:
        return group, client.submit(_outcomes, pickled, group, limit, pure=False)

    done = room = 0
    each = _EACH if limit is None else 1
    try:
        for worker, has_package in client.run(eval, _HAS_PACKAGE).items():
            if not has_package:
                raise _WorkerLacks(f"the Dask worker {worker}: carla-recap is not installed there")
        while True:
            if done % _EACH == 0:
                room = max(_WINDOW * workers_of(client), _LEAST)
            while len(window) < room and (group := [_absolute(source) for source in islice(left, each)]):
                window.append(submit(group))
            if not window:
                return
            group, future = window[0]
            try:
                outcomes = future.result()
            except KilledWorker:
                window.popleft()
                if len(group) > 1:  # one of them is to blame, or none: all that waits on a worker that ends is given up
                    window.extendleft(reversed([submit([source]) for source in group]))
                    continue
                for _, other in window:
                    other.exception()  # which waits for its end
                outcomes = _alone(submit(group)[1], group[0])
            else:
                window.popleft()
            done += 1
            yield from outcomes
    except _WorkerLacks as error:
        raise RecapError(str(error)) from None
    except (ClosedClientError, CancelledError, OSError, TimeoutError) as error:
        raise RecapError(f"the Dask cluster is gone ({_line(error)})") from None
    finally:
        with suppress(Exception):  # of a client that is closed
            client.cancel([future for _, future in window])


def workers_of(client: Client) -> int:
    """Return how many recordings the workers of a cluster read at the same time."""
    return sum(client.nthreads().values())


def _alone(future: Future[list[Outcome[T]]], source: SourceFile) -> list[Outcome[T]]:
    """Return the outcomes of a task that is the only one, and thus to blame if its workers end."""
    from distributed.scheduler import KilledWorker

    try:
        return future.result()
    except KilledWorker:
        return [Outcome(source, None, f"{source.location}: its worker processes end")]


def _line(error: BaseException) -> str:
    return single_line(error) or type(error).__name__


def _absolute(source: SourceFile) -> SourceFile:
    return source if "://" in source.location else replace(source, absolute=str(Path(source.location).absolute()))


def _outcomes(pickled: bytes, sources: Iterable[SourceFile], limit: float | None) -> list[Outcome[T]]:
    """Return the outcomes of a function for some recordings, on a worker.

    The function comes as bytes, since Dask waits forever for a worker that lacks the module of a function. With a limit, a
    child process of the worker calls it.
    """
    from distributed import get_worker
    from distributed.protocol.pickle import loads

    with _one_at_a_time:
        if limit is not None:
            return _in_child(pickled, sources, limit)
        try:
            function = loads(pickled)
        except ImportError as error:
            raise _WorkerLacks(f"the Dask worker {get_worker().address}: {_line(error)}") from None
        return [outcome_of(partial(_on_worker, function), source) for source in sources]


def _in_child(pickled: bytes, sources: Iterable[SourceFile], limit: float) -> list[Outcome[T]]:
    """Return the outcomes of a function in a child process, which is kept until there is one for another function."""
    child = _children.pop((pickled, limit), None) or KeptWorker(_Pickled(pickled), limit)
    while _children:
        _children.popitem()[1].close()
    found = [child.call(source) for source in sources]
    _children[pickled, limit] = child
    return found


class _Pickled:
    """A function that Dask has pickled, which a child process gets as it is."""

    def __init__(self, pickled: bytes) -> None:
        self._pickled = pickled

    def __call__(self, source: SourceFile) -> Any:
        return self.__reduce__()[0](self._pickled)(source)

    def __reduce__(self) -> tuple[Callable[[bytes], Any], tuple[bytes]]:
        return pickle.loads, (self._pickled,)


class _WorkerLacks(Exception):
    """A worker lacks something, whatever the recording; no `RecapError`, which would be an outcome."""


def _on_worker(function: Callable[[SourceFile], T], source: SourceFile) -> T:
    from distributed import get_worker

    try:
        return function(source)
    except (NotSetUp, ImportError) as error:
        raise _WorkerLacks(f"the Dask worker {get_worker().address}: {source.as_given(_line(error))}") from None
