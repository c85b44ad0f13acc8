"""Worker processes of this machine that call a function for recordings, one at a time.

The parent knows which recording a worker has, so that the end of a worker loses none: it is read again by another one.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import threading
import traceback
from collections import deque
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import current_process, get_context, parent_process
from multiprocessing.connection import wait
from multiprocessing.resource_tracker import ensure_running
from time import monotonic
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

from carla_recap.errors import RecapError
from carla_recap.fleet.outcomes import Outcome, outcome_of
from carla_recap.util.signals import TERMINATION, broken_pipes_are_errors, hold_termination

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator
    from multiprocessing.connection import Connection

    from carla_recap.fleet.sources import SourceFile

T = TypeVar("T")

_WINDOW: Final = 64  # recordings for each worker that are read, or whose outcomes wait for those of earlier ones, at a time
_TRIES: Final = 2  # times that a recording is read by workers that end
_STARTS: Final = 3  # workers that end in a row before they have begun
_GRACE: Final = 0.5  # s that workers have to clean up
_CHECK: Final = 0.1  # s between looks at workers that have a limit
_HINT: Final = (
    "a script calls this below `if __name__ == '__main__':`, a notebook with a function of a module, or with jobs=1"
)


@dataclass(slots=True)
class _Task:
    """A recording, its position among all, and the number of workers that ended while they read it."""

    index: int
    source: SourceFile
    ends: int = 0


class _Worker(Generic[T]):
    """A worker process; without a limit, no function ends or blocks it."""

    def __init__(self, function: Callable[[SourceFile], T], limit: float | None) -> None:
        context = get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, function, limit is not None), daemon=True)
        ensure_running()  # which would release the signals below
        with hold_termination(), _may_have_children():
            self.process.start()
        theirs.close()
        self.has_begun = False
        self._limit = limit
        self._given = 0.0

    def give(self, source: SourceFile) -> None:
        """Give it a recording. If the process has ended, that is found when the outcome is asked for."""
        self._given = monotonic()
        with suppress(OSError), broken_pipes_are_errors():
            self.connection.send(source)

    def outcome(self) -> Outcome[T] | None:
        """Return the outcome if there is one; raise the function's error.

        Raise `EOFError` if the process has ended without an outcome; it says so if that was for the limit.
        """
        has_ended = not self.process.is_alive()  # which the connection does not say while another process holds it
        try:
            has_answered = self.connection.poll()
            message: Outcome[T] | Exception | None = self.connection.recv() if has_answered else None
        except OSError:
            raise EOFError from None
        if has_answered:
            if isinstance(message, Exception):
                raise message
            if message is None:
                self.has_begun = True
                self._given = monotonic()
            return message
        if has_ended:
            raise EOFError
        if self._limit is not None and self.has_begun and monotonic() - self._given > self._limit:
            self.process.kill()
            raise EOFError(f"takes more than {self._limit:g} s")
        return None

    def close(self) -> str:
        """Wait for the end of the process, and end those that it has left behind; return how it ended."""
        self.connection.close()
        if self._limit is not None and hasattr(os, "killpg"):
            with suppress(OSError):
                os.killpg(self.process.pid or 0, signal.SIGKILL)
        self.process.join()
        code = self.process.exitcode or 0
        self.process.close()
        try:
            return signal.Signals(-code).name
        except ValueError:
            return f"exit code {code}"


def map_in_workers(
    function: Callable[[SourceFile], T], sources: Iterable[SourceFile], jobs: int, limit: float | None = None
) -> Generator[Outcome[T]]:
    """Yield the outcomes of a function for recordings, in their order; see `engine.map_sources`."""
    unread = (_Task(index, source) for index, source in enumerate(sources))
    again: deque[_Task] = deque()  # tasks of workers that ended
    known: dict[int, Outcome[T]] = {}  # the outcomes that wait for those of earlier recordings
    position = given = failures = 0
    idle: list[_Worker[T]] = []
    busy: dict[_Worker[T], _Task] = {}
    try:
        while True:
            while len(busy) < jobs:
                task = again.popleft() if again else next(unread, None) if given - position < _WINDOW * jobs else None
                if task is None:
                    break
                given = max(given, task.index + 1)
                worker = idle.pop() if idle else _Worker(function, limit)
                busy[worker] = task
                worker.give(task.source)
            if not busy:
                return
            wait([worker.connection for worker in busy], None if limit is None else _CHECK)
            for worker, task in list(busy.items()):
                outcome = None
                try:
                    outcome = worker.outcome()
                    if outcome is None:
                        continue
                    del busy[worker]
                    idle.append(worker)
                    failures = 0
                except EOFError as end:
                    del busy[worker]
                    cause = worker.close()
                    failures = 0 if worker.has_begun else failures + 1
                    if failures == _STARTS:
                        raise RecapError(f"the worker processes do not start ({cause}); {_HINT}") from None
                    task.ends += worker.has_begun
                    if task.ends < _TRIES and not end.args:
                        again.append(task)
                    else:
                        reason = str(end) or f"its worker process ends ({cause})"
                        outcome = Outcome(task.source, None, f"{task.source.location}: {reason}")
                if outcome is not None:
                    known[task.index] = outcome
            while position in known:
                yield known.pop(position)
                position += 1
    finally:
        _end(idle, busy)


class KeptWorker(Generic[T]):
    """A worker process that calls a function for one recording after another, and is started anew when it ends.

    An error of the function that is no outcome ends it.
    """

    def __init__(self, function: Callable[[SourceFile], T], limit: float) -> None:
        self._given: deque[SourceFile] = deque()
        self._outcomes = map_in_workers(function, iter(self._given.popleft, None), 1, limit)

    def call(self, source: SourceFile) -> Outcome[T]:
        """Return the outcome of the function for a recording."""
        self._given.append(source)
        return next(self._outcomes)

    def close(self) -> None:
        """End the process."""
        self._outcomes.close()


def _end(idle: Iterable[_Worker[Any]], busy: Iterable[_Worker[Any]]) -> None:
    """End workers; those that are busy are terminated, and after a while killed."""
    for worker in busy:
        worker.process.terminate()
    for worker in idle:
        worker.connection.close()  # which ends one that waits
    deadline = monotonic() + _GRACE
    for worker in (*busy, *idle):
        worker.process.join(max(deadline - monotonic(), 0.0))
        worker.process.kill()
        worker.close()


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
            source = connection.recv()
            try:
                message: Outcome[T] | Exception = outcome_of(function, source)
            except Exception as error:
                message = _raised(error)
            connection.send_bytes(_pickled(message))


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


def _raised(error: Exception) -> Exception:
    """Return an error that can be sent, with its traceback as a note."""
    trace = "In a worker process:\n" + traceback.format_exc()
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        error = RuntimeError(f"{type(error).__name__}: {error}")
    error.add_note(trace)
    return error
