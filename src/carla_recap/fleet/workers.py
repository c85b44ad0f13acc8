"""Worker processes of this machine that call a function for recordings.

The parent gives an idle worker a few recordings at a time, and gets their outcomes together. It knows which recordings a
worker has, so that the end of a worker loses none of them: they are given to others, one by one, until it is known which of
them ends the process.
"""

from __future__ import annotations

import math
import os
import pickle
import signal
import sys
import threading
import traceback
from collections import deque
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import islice
from multiprocessing import current_process, get_context, parent_process
from multiprocessing.connection import wait
from multiprocessing.resource_tracker import ensure_running
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from carla_recap.errors import RecapError
from carla_recap.fleet.outcomes import Outcome, outcome_of
from carla_recap.util.signals import TERMINATION, broken_pipes_are_errors, hold_termination

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from multiprocessing.connection import Connection

    from carla_recap.fleet.sources import SourceFile

T = TypeVar("T")

_WINDOW: Final = 64  # recordings for each worker that are read, or whose outcomes wait for those of earlier ones, at a time
_MOST: Final = 16  # recordings that a worker has at a time
_SHORT: Final = 0.05  # s; if a worker takes less for those that it has, it is given more
_TRIES: Final = 2  # times that a recording is read alone by workers that end
_STARTS: Final = 3  # workers that end in a row before they have begun
_GRACE: Final = 0.5  # s that workers have to clean up
_CHECK: Final = 1.0  # s between looks at workers that have a limit


@dataclass(slots=True)
class _Task:
    """A recording, its position among all, and the number of workers that ended while they read it alone."""

    index: int
    source: SourceFile
    ends: int = 0


@dataclass(frozen=True, slots=True)
class _Raised:
    """An error of a function that is no outcome, with its traceback as text."""

    error: Exception
    trace: str


class _Worker(Generic[T]):
    """A worker process, and the tasks that it has; without a limit, no function ends or blocks it."""

    def __init__(self, function: Callable[[SourceFile], T], limit: float | None) -> None:
        context = get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, function, limit is not None), daemon=True)
        ensure_running()  # which would release the signals below
        with hold_termination(), _may_have_children():
            self.process.start()
        self._limit = limit
        theirs.close()
        self.tasks: deque[_Task] = deque()
        self.has_begun = False
        self.most = 1
        self._given = math.inf

    @property
    def due(self) -> float:
        """When its recording has taken too long, on the monotonic clock."""
        return self._given + (math.inf if self._limit is None else self._limit) if self.has_begun else math.inf

    def give(self, tasks: Iterable[_Task]) -> None:
        """Give tasks to the worker, which has none. If it has ended, that is found when its outcomes are received."""
        self.tasks.extend(tasks)
        self._given = monotonic()
        with suppress(OSError), broken_pipes_are_errors():
            self.connection.send([task.source for task in self.tasks])

    def receive(self) -> list[tuple[_Task, Outcome[T]]]:
        """Return the outcomes that the worker has sent; raise `EOFError` if it has ended, or the function's error."""
        try:
            message: list[Outcome[T]] | _Raised | None = self.connection.recv()
        except OSError:
            raise EOFError from None
        if not self.has_begun:
            self.has_begun = True
            self._given = monotonic()
        if isinstance(message, _Raised):
            message.error.add_note(message.trace)
            raise message.error
        outcomes = [(self.tasks.popleft(), outcome) for outcome in message or ()]
        if outcomes and not self.tasks and self._limit is None:
            is_short = monotonic() - self._given < _SHORT
            self.most = min(self.most * 2, _MOST) if is_short else max(self.most // 2, 1)
        return outcomes

    def end_group(self) -> None:
        """End the processes that the function has left behind."""
        if self._limit is not None and hasattr(os, "killpg"):
            with suppress(OSError):
                os.killpg(self.process.pid or 0, signal.SIGKILL)


class _Pool(Generic[T]):
    """Worker processes that call a function."""

    def __init__(self, function: Callable[[SourceFile], T], limit: float | None) -> None:
        self._function = function
        self._limit = limit
        self._workers: list[_Worker[T]] = []
        self._failures = 0  # workers in a row that ended before they had begun

    def __len__(self) -> int:
        return len(self._workers)

    def idle(self) -> _Worker[T] | None:
        """Return a worker without tasks, if there is one."""
        return next((each for each in self._workers if not each.tasks), None)

    def start(self) -> _Worker[T]:
        """Start another worker."""
        worker = _Worker(self._function, self._limit)
        self._workers.append(worker)
        return worker

    def wait(self) -> list[tuple[_Task, Outcome[T] | None]]:
        """Wait for workers that have tasks; return finished tasks with their outcomes, None for those to be given anew."""
        busy = {worker.connection: worker for worker in self._workers if worker.tasks}
        patience = None if self._limit is None else min(_CHECK, *(each.due - monotonic() for each in busy.values()))
        found: list[tuple[_Task, Outcome[T] | None]] = []
        for connection in wait(list(busy), patience if patience is None else max(patience, 0.0)):
            worker = busy.pop(connection)  # type: ignore[call-overload]
            try:
                found += worker.receive()
                self._failures = 0
            except EOFError:
                found += self._lost(worker)
        for worker in busy.values() if self._limit is not None else ():
            if worker.connection.poll():
                continue
            if monotonic() > worker.due:
                task = worker.tasks[0]
                self._workers.remove(worker)
                _end([worker], graceful=False, grace=0.0)
                found.append(
                    (task, Outcome(task.source, None, f"{task.source.location}: takes more than {self._limit:g} s"))
                )
            elif not worker.process.is_alive():  # and a process that it has forked holds the connection
                found += self._lost(worker)
        return found

    def end(self, *, graceful: bool) -> None:
        """End all workers."""
        _end(self._workers, graceful=graceful)
        self._workers = []

    def _lost(self, worker: _Worker[T]) -> Iterator[tuple[_Task, Outcome[T] | None]]:
        """Yield the tasks that an ended worker has not finished, with the outcome of one that it is to blame for."""
        self._workers.remove(worker)
        worker.end_group()
        worker.process.join()
        self._failures = 0 if worker.has_begun else self._failures + 1
        if self._failures == _STARTS:
            raise RecapError(_no_start(worker)) from None
        alone = worker.has_begun and len(worker.tasks) == 1
        for task in worker.tasks:
            task.ends += alone
            if task.ends < _TRIES:
                yield task, None
            else:
                message = f"{task.source.location}: its worker process ends ({_cause(worker)})"
                yield task, Outcome(task.source, None, message)


def map_in_workers(
    function: Callable[[SourceFile], T], sources: Iterable[SourceFile], jobs: int, limit: float | None = None
) -> Iterator[Outcome[T]]:
    """Yield the outcomes of a function for recordings, in their order; see `engine.map_sources`."""
    unread = (_Task(index, source) for index, source in enumerate(sources))
    again: deque[_Task] = deque()  # tasks of workers that ended
    known: dict[int, Outcome[T]] = {}  # the outcomes that wait for those of earlier recordings
    position = given = 0
    pool = _Pool(function, limit)
    graceful = False
    try:
        while True:
            while (idle := pool.idle()) or len(pool) < jobs:
                room = position + _WINDOW * jobs - given
                if again:
                    tasks = [again.popleft()]
                else:
                    tasks = list(islice(unread, max(min(idle.most if idle else 1, room), 0)))
                    given += len(tasks)
                if not tasks:
                    break
                (idle or pool.start()).give(tasks)
            if position == given:
                break
            for task, outcome in pool.wait():
                if outcome is None:
                    again.append(task)
                else:
                    known[task.index] = outcome
            while position in known:
                yield known.pop(position)
                position += 1
        graceful = True
    finally:
        pool.end(graceful=graceful)


class KeptWorker(Generic[T]):
    """A worker process that calls a function for one recording after another, and is started anew when it ends."""

    def __init__(self, function: Callable[[SourceFile], T], limit: float) -> None:
        self._pool = _Pool(function, limit)

    def call(self, source: SourceFile) -> Outcome[T]:
        """Return the outcome of the function for a recording."""
        task = _Task(0, source)
        while True:
            (self._pool.idle() or self._pool.start()).give([task])
            found: list[tuple[_Task, Outcome[T] | None]] = []
            while not found:
                found = self._pool.wait()
            outcome = found[0][1]
            if outcome is not None:
                return outcome

    def close(self) -> None:
        """End the process."""
        self._pool.end(graceful=True)


def _no_start(worker: _Worker[Any]) -> str:
    worker.process.join()
    hint = "a script calls this below `if __name__ == '__main__':`, a notebook with a function of a module, or with jobs=1"
    return f"the worker processes do not start ({_cause(worker)}); {hint}"


def _cause(worker: _Worker[Any]) -> str:
    code = worker.process.exitcode or 0
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"exit code {code}"


def _end(workers: Iterable[_Worker[Any]], *, graceful: bool, grace: float = _GRACE) -> None:
    """End workers; those that are busy are terminated, and after some seconds killed."""
    for worker in workers:
        worker.connection.close()  # which ends one that waits
        if not graceful:
            worker.process.terminate()
    deadline = monotonic() + grace
    for worker in workers:
        worker.process.join(max(deadline - monotonic(), 0.0))
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()
        worker.end_group()
        worker.process.close()


@contextmanager
def _may_have_children() -> Iterator[None]:
    """Let this process start others in a `with` block, which a daemon, such as a worker of Dask, may not."""
    process = current_process()
    is_daemon = process.daemon
    process.daemon = False
    try:
        yield
    finally:
        process.daemon = is_daemon


def _serve(connection: Connection, function: Callable[[SourceFile], T], is_limited: bool) -> None:
    """Call a function for the recordings that come, until the connection is closed; the body of a worker.

    If it is limited, the function may do whatever it wants to the process, which has a group of its own and ends with the
    parent at the latest.
    """
    if is_limited and hasattr(os, "setpgid"):
        os.setpgid(0, 0)
        threading.Thread(target=_end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # which all processes of a terminal get: the parent ends its workers
    signal.signal(signal.SIGTERM, _exit_silently)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, TERMINATION)  # see `hold_termination`
    prepare = getattr(function, "prepare", None)
    if prepare is not None:
        prepare()
    with suppress(EOFError, OSError):
        connection.send(None)
        while True:
            outcomes: list[Outcome[T]] = []
            due = monotonic() + _SHORT
            for source in connection.recv():
                if outcomes and monotonic() > due:
                    connection.send_bytes(_pickled(outcomes))
                    outcomes, due = [], monotonic() + _SHORT
                try:
                    outcomes.append(outcome_of(function, source))
                except Exception as error:
                    connection.send_bytes(_pickled(_raised(error)))
                    return
            connection.send_bytes(_pickled(outcomes))


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os.killpg(0, signal.SIGKILL)


def _exit_silently(*_: object) -> None:
    sys.unraisablehook = lambda _: None  # SystemExit cannot be raised from a generator or an object that is being deleted
    sys.exit(128 + signal.SIGTERM)


def _pickled(message: object) -> bytes:
    try:
        return pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # whatever the objects' own methods raise
        return pickle.dumps(_raised(error))


def _raised(error: Exception) -> _Raised:
    trace = "In a worker process:\n" + traceback.format_exc()
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        error = RuntimeError(f"{type(error).__name__}: {error}")
    return _Raised(error, trace)
