"""Worker processes of this machine that call a function for recordings.

The parent gives an idle worker a few recordings at a time, and gets their outcomes together. It knows which recordings a
worker has, so that the end of a worker loses none of them: they are given to others, one by one, until it is known which of
them ends the process.
"""

from __future__ import annotations

import pickle
import signal
import sys
import threading
import traceback
from collections import deque
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import chain, islice
from multiprocessing import get_context
from multiprocessing.connection import wait
from multiprocessing.resource_tracker import ensure_running
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from carla_recap.errors import RecapError
from carla_recap.fleet.outcomes import Outcome, outcome_of
from carla_recap.util.signals import TERMINATION, hold_termination

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
    """A worker process, and the tasks that it has.

    Args:
        function: The function that it calls.
    """

    def __init__(self, function: Callable[[SourceFile], T]) -> None:
        context = get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, function), daemon=True)
        ensure_running()  # which would release the signals below
        with hold_termination():
            self.process.start()
        theirs.close()
        self.tasks: deque[_Task] = deque()
        self.has_begun = False
        self.most = 1
        self._given = 0.0

    def give(self, tasks: Iterable[_Task]) -> None:
        """Give tasks to the worker, which has none. If it has ended, that is found when its outcomes are received."""
        self.tasks.extend(tasks)
        self._given = monotonic()
        with suppress(OSError), _broken_pipes_are_errors():
            self.connection.send([task.source for task in self.tasks])

    def receive(self) -> list[tuple[_Task, Outcome[T]]]:
        """Return the outcomes that the worker has sent.

        Raises:
            EOFError: The worker has ended.
            Exception: The function's error.
        """
        try:
            message: list[Outcome[T]] | _Raised | None = self.connection.recv()
        except OSError:
            raise EOFError from None
        self.has_begun = True
        if isinstance(message, _Raised):
            message.error.add_note(message.trace)
            raise message.error
        outcomes = [(self.tasks.popleft(), outcome) for outcome in message or ()]
        if outcomes and not self.tasks:
            is_short = monotonic() - self._given < _SHORT
            self.most = min(self.most * 2, _MOST) if is_short else max(self.most // 2, 1)
        return outcomes


def map_in_workers(
    function: Callable[[SourceFile], T], first: SourceFile, others: Iterator[SourceFile], jobs: int
) -> Iterator[Outcome[T]]:
    """Yield the outcomes of a function for a recording and others, in their order; see `engine.map_sources`."""
    unread = (_Task(index, source) for index, source in enumerate(chain([first], others)))
    again: deque[_Task] = deque()  # tasks of workers that ended
    known: dict[int, Outcome[T]] = {}  # the outcomes that wait for those of earlier recordings
    position = given = failures = 0
    workers: list[_Worker[T]] = []
    graceful = False
    try:
        while True:
            while (idle := next((each for each in workers if not each.tasks), None)) or len(workers) < jobs:
                room = position + _WINDOW * jobs - given
                if again:
                    tasks = [again.popleft()]
                else:
                    tasks = list(islice(unread, max(min(idle.most if idle else 1, room), 0)))
                    given += len(tasks)
                if not tasks:
                    break
                if idle is None:
                    idle = _Worker(function)
                    workers.append(idle)
                idle.give(tasks)
            busy = {worker.connection: worker for worker in workers if worker.tasks}
            if not busy:
                break
            for connection in wait(list(busy)):
                worker = busy[connection]  # type: ignore[index]
                try:
                    known.update((task.index, outcome) for task, outcome in worker.receive())
                    failures = 0
                except EOFError:
                    workers.remove(worker)
                    failures = 0 if worker.has_begun else failures + 1
                    if failures == _STARTS:
                        raise RecapError(_no_start(worker)) from None
                    for task, outcome in _lost(worker):
                        if outcome is None:
                            again.append(task)
                        else:
                            known[task.index] = outcome
            while position in known:
                yield known.pop(position)
                position += 1
        graceful = True
    finally:
        _end(workers, graceful=graceful)


def _lost(worker: _Worker[T]) -> Iterator[tuple[_Task, Outcome[T] | None]]:
    """Yield the tasks that a worker has not finished, with the outcome of one that it is to blame for."""
    alone = worker.has_begun and len(worker.tasks) == 1
    worker.process.join()
    for task in worker.tasks:
        task.ends += alone
        if task.ends < _TRIES:
            yield task, None
        else:
            message = f"{task.source.location}: the worker process that reads it ends ({_cause(worker)})"
            yield task, Outcome(task.source, None, message)


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


def _end(workers: Iterable[_Worker[Any]], *, graceful: bool) -> None:
    """End workers; those that are busy are terminated, and then killed."""
    for worker in workers:
        worker.connection.close()  # which ends one that waits
        if not graceful:
            worker.process.terminate()
    deadline = monotonic() + _GRACE
    for worker in workers:
        worker.process.join(max(deadline - monotonic(), 0.0))
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join()
        worker.process.close()


@contextmanager
def _broken_pipes_are_errors() -> Iterator[None]:
    """Make writing to a process that has ended an `OSError` in a `with` block, where it would end this process."""
    number = getattr(signal, "SIGPIPE", None)
    if (
        number is None
        or threading.current_thread() is not threading.main_thread()
        or signal.getsignal(number) is not signal.SIG_DFL
    ):
        yield
        return
    signal.signal(number, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(number, signal.SIG_DFL)


def _serve(connection: Connection, function: Callable[[SourceFile], T]) -> None:
    """Call a function for the recordings that come, until the connection is closed; the body of a worker."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # which all processes of a terminal get: the parent ends its workers
    signal.signal(signal.SIGTERM, _exit_silently)
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, TERMINATION)  # see `hold_termination`
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
