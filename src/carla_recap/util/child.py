"""A process that answers requests, one after the other; what it answers comes back through memory that both share.

The parent has a `Child`: it runs a module, which calls `answer_requests`. The child ends when its parent has gone.
"""

from __future__ import annotations

import mmap
import os
import pickle
import subprocess
import sys
import tempfile
from collections import deque
from contextlib import contextmanager, suppress
from itertools import cycle, pairwise
from multiprocessing.connection import Connection, Pipe
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.util.processes import module_command, module_environment, wait_or_kill
from carla_recap.util.signals import broken_pipes_are_errors, ignore_termination

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

PATIENCE: Final = 300.0
"""The seconds after which an answer that does not come counts as failed."""
_END_PATIENCE: Final = 5.0  # s, for the end of the process
_PARENT_CHECK: Final = 1.0  # s between checks whether the parent has ended
_KEPT: Final = {"MALLOC_TRIM_THRESHOLD_": str(1 << 28), "MALLOC_MMAP_THRESHOLD_": str(1 << 25)}
"""Bytes of freed memory, and of the largest part of it, that glibc keeps for the next answer; else each maps it anew."""


class ChildEnded(RecapError):
    """A child has ended by itself."""


class Child:
    """A process that answers requests.

    Args:
        module: The module that it runs.
        does: What it does, in errors: "draws".
        most: How many requests are sent before the answer to the first one is received, at most: each has a memory.

    Raises:
        RecapError: The process cannot be started.
    """

    def __init__(self, module: str, does: str, most: int) -> None:
        if os.name != "posix":
            raise RecapError(f"the process that {does} needs Linux or macOS")
        self._does = does
        self._memories = [_SharedMemory(_create_memory()) for _ in range(most)]
        self._received = 0
        self._connection, theirs = Pipe()
        descriptors = [theirs.fileno(), *(memory.descriptor for memory in self._memories)]
        try:
            self.process = subprocess.Popen(
                module_command(module, *map(str, descriptors)),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,  # where drivers print remarks
                env=_KEPT | module_environment(),
                pass_fds=descriptors,
                start_new_session=True,
            )
        except OSError as error:
            self._release()
            raise RecapError(f"the process that {does} cannot be started: {error}") from None
        finally:
            theirs.close()

    def send(self, request: Any) -> None:
        """Send a request; if the process has ended, that is found when the answer is received."""
        with suppress(OSError), broken_pipes_are_errors():
            self._connection.send(request)

    def receive(self) -> Any:
        """Return the answer to the request that was sent first, of those whose answers have not been received.

        Its arrays are in the shared memory: `most` requests later, others are there.

        Raises:
            ChildEnded: The process has ended.
            RecapError: The process has raised it.
        """
        memory = self._memories[self._received % len(self._memories)]
        self._received += 1
        try:
            if not self._connection.poll(PATIENCE):
                self.process.kill()
            answer, sizes = self._connection.recv()
        except (OSError, EOFError, pickle.UnpicklingError):
            self.process.kill()  # it may have closed its connection alone
            raise ChildEnded(f"the process that {self._does} has ended with exit code {self.process.wait()}") from None
        found = pickle.loads(answer, buffers=memory.parts(sizes))
        if isinstance(found, Exception):
            raise found
        return found

    def close(self) -> None:
        """End the process; a second call does nothing."""
        self._connection.close()
        wait_or_kill(self.process, _END_PATIENCE)
        self._release()

    def kill(self) -> None:
        """End the process without waiting until it has started or answered."""
        self.process.kill()
        self.close()

    def _release(self) -> None:
        self._connection.close()
        for memory in self._memories:
            memory.close()


_ahead: dict[tuple[str, str, int], Child] = {}
if os.name == "posix":
    os.register_at_fork(after_in_child=_ahead.clear)  # they answer to one process


@contextmanager
def started_ahead(*kinds: tuple[str, str, int]) -> Iterator[None]:
    """Have children started, given the arguments of each, for what needs them later in the `with` block."""
    for kind in kinds:
        if kind not in _ahead:
            with suppress(RecapError):  # it is tried again
                child = Child(*kind)
                if _ahead.setdefault(kind, child) is not child:  # another thread has been faster
                    child.kill()
    try:
        yield
    finally:
        for kind in kinds:
            if left := _ahead.pop(kind, None):
                left.kill()


def new_child(*kind: *tuple[str, str, int]) -> Child:
    """Return a child, given its arguments: that started ahead, or a new one."""
    return _ahead.pop(kind, None) or Child(*kind)


class _SharedMemory:
    """A file in memory that grows; it goes with its last descriptor."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._map: mmap.mmap | None = None

    def parts(self, sizes: list[int]) -> list[NDArray[np.uint8]]:
        """Return parts of the memory of some sizes, one after the other; it grows where they need more room."""
        ends = np.cumsum([0, *sizes]).tolist()
        if not ends[-1]:
            return [np.empty(0, np.uint8) for _ in sizes]
        if os.fstat(self.descriptor).st_size < ends[-1]:
            os.ftruncate(self.descriptor, ends[-1])
        if self._map is None or len(self._map) < ends[-1]:
            self._map = mmap.mmap(self.descriptor, ends[-1])  # arrays keep the one before, if they are in use
        content = np.frombuffer(self._map, np.uint8)
        return [content[start:end] for start, end in pairwise(ends)]

    def close(self) -> None:
        """Unmap and close the file; a second call does nothing."""
        self._map = None
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1


def _create_memory() -> int:
    """Return the descriptor of a file in memory."""
    if sys.platform == "linux":
        return os.memfd_create("carla-recap")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


# --- in the process ----------------------------------------------------------------------------------------------------


def answer_requests(prepare: Callable[[Any], Callable[[Any], Callable[[], Any]]]) -> None:
    """Answer requests until the parent has gone; errors are answers, too.

    Args:
        prepare: Is called with the first request, whose answer is None, and returns what begins to answer another one: it
            returns what waits for the answer, or makes it. All requests that have come are begun before that.
    """
    ignore_termination()  # the process ends when its parent does
    parent = os.getppid()
    descriptors = [int(argument) for argument in sys.argv[1:]]
    connection, memories = Connection(descriptors[0]), [_SharedMemory(each) for each in descriptors[1:]]
    with suppress(EOFError, OSError):  # the parent has gone
        begun: deque[Any] = deque()
        begin: Any = None
        for memory in cycle(memories):
            while len(begun) < len(memories) and _has_request(connection, parent, waits=not begun):
                if begin is None:
                    begin = _attempted(prepare, connection.recv())
                    begun.append(begin if isinstance(begin, Exception) else _nothing)
                else:
                    begun.append(_attempted(begin, connection.recv()))
            if not begun:
                break
            waiting = begun.popleft()
            _send(connection, memory, waiting if isinstance(waiting, Exception) else _attempted(waiting))
    os._exit(0)  # without taking down what the process has, such as a driver


def _nothing() -> None: ...


def _attempted(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return what a function returns, or the error that it raises."""
    try:
        return function(*arguments)
    except RecapError as error:
        return error
    except Exception as error:
        return RecapError(f"the request has failed: {type(error).__name__}: {error}")


def _send(connection: Connection, memory: _SharedMemory, answer: Any) -> None:
    """Send an answer, with its arrays in the memory."""
    buffers: list[pickle.PickleBuffer] = []
    data = pickle.dumps(answer, pickle.HIGHEST_PROTOCOL, buffer_callback=buffers.append)
    sizes = [buffer.raw().nbytes for buffer in buffers]
    for part, buffer in zip(memory.parts(sizes), buffers, strict=True):
        part[:] = np.frombuffer(buffer.raw(), np.uint8)
    connection.send((data, sizes))


def _has_request(connection: Connection, parent: int, *, waits: bool) -> bool:
    """Return whether there is a request, or the end of the connection; wait for it while the parent is there."""
    while not connection.poll(_PARENT_CHECK if waits else 0.0):
        if not waits or os.getppid() != parent:  # other processes that it has forked may hold the connection open
            return False
    return True
