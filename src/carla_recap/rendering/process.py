"""The renderer in a process of its own: only the caller that needs a picture waits for it.

`RenderProcess` is the client. It starts `python -m carla_recap.rendering.process`, and sends it commands over a pipe, as
pickles; the images come back through memory that both share. The next command is sent while a picture is drawn, so that the
process need not wait for its client. It ends when its client has gone.
"""

from __future__ import annotations

import mmap
import os
import pickle
import subprocess
import sys
import tempfile
from collections import deque
from concurrent.futures import Future
from contextlib import suppress
from functools import cache
from queue import Empty, SimpleQueue
from threading import Lock, Thread, current_thread
from time import monotonic
from typing import TYPE_CHECKING, Any, BinaryIO, Final, NamedTuple, Self

import numpy as np

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.rendering.buffers import image_format
from carla_recap.rendering.camera import check_quality
from carla_recap.rendering.renderer import Renderer, check_size
from carla_recap.scene.models import MODELS, Models, own_models
from carla_recap.util.processes import (
    close_pipes,
    is_readable,
    module_command,
    module_environment,
    read_commands,
    wait_or_kill,
)
from carla_recap.util.signals import ignore_termination

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from carla_recap.rendering.buffers import ModelShape, TiledMesh
    from carla_recap.rendering.camera import Camera, DrawnView, ImageKind, Images, Quality
    from carla_recap.rendering.sky import Sky
    from carla_recap.scene.instances import Instances
    from carla_recap.scene.mesh import Mesh

PATIENCE: Final = 300.0
"""The seconds after which a picture that does not come counts as failed."""
_READY: Final = b"carla-recap: ready to draw\n"
"""The first line of the process; lines before it are printed by other code that runs when an interpreter starts."""
_LOAD_MODELS: Final = "--models"
_END_PATIENCE: Final = 5.0  # s, for the end of the process
_PAGE: Final = 4096  # bytes between images
_PAUSES: Final = (1.0, 60.0)  # s without a restart after the first one that was in vain, and at most
_SENT: Final = 2  # pictures that the process has at a time: it draws one, and finds the next one when that is done
_KEPT: Final = {"MALLOC_TRIM_THRESHOLD_": str(1 << 28), "MALLOC_MMAP_THRESHOLD_": str(1 << 25)}
"""Bytes of freed memory, and of the largest part of it, that glibc keeps for the next picture; else each maps it anew."""


class _Command(NamedTuple):
    """What is to be drawn of a moment."""

    views: Sequence[DrawnView]
    instances: Instances | None
    sky: Sky | None


class _Job(NamedTuple):
    """Pictures to come, by view, and what is to be drawn."""

    future: Future[list[Images]]
    command: _Command


class RenderProcessEnded(RecapError):
    """The process that draws has ended by itself; another is started for the next picture."""


class RenderProcessNotStarted(RenderProcessEnded):
    """There is no process that draws: it could not be started again, or is not started again yet."""


class RenderProcess:
    """Draws images in another process; see `Renderer` for the arguments.

    The town may also be a function that returns it: it is called while the process starts.

    Pictures are drawn in the order in which they are asked for; several may be asked for before the first has come. All
    methods may be called from any thread. If the process dies, the picture that it was drawing fails, and the next one
    starts another process. After each restart there is none for 1 s, and twice as long after each that was in vain, up to
    60 s; where a process is missing in this time, pictures fail.

    Raises:
        MissingExtra: moderngl is not installed.
        RecapError: There is no driver for OpenGL or no such quality, or the process cannot be started.
    """

    def __init__(
        self,
        town: TiledMesh | Callable[[], TiledMesh | None] | None = None,
        *,
        models: Sequence[ModelShape] | None = None,
        quality: Quality = "epic",
        supersampling: int | tuple[int, int] | None = None,
    ) -> None:
        check_quality(quality)

        @cache
        def setup() -> bytes:
            used = own_models() if models is None else models
            shapes = [_Shape(model.mesh, model.pivots, model.steered) for model in used]
            tiles = _Tiles(town() if callable(town) else town)
            return pickle.dumps((tiles, shapes, quality, supersampling), pickle.HIGHEST_PROTOCOL)

        self._setup = setup
        self._loads_models = models is None
        self._jobs: SimpleQueue[_Job | None] = SimpleQueue()
        self._lock = Lock()  # for what follows
        self._is_closed = False
        self._child: _Child | None = None
        self._child = self._start()
        self._pause = _PAUSES[0]
        self._next_start = 0.0
        self._thread = Thread(target=self._run, name="carla-recap-renderer", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def pid(self) -> int | None:
        """The id of the process; None while there is none."""
        child = self._child
        return child.process.pid if child else None

    def submit(
        self, views: Sequence[DrawnView], instances: Instances | None = None, sky: Sky | None = None
    ) -> Future[list[Images]]:
        """Have images of one or several cameras at a moment drawn; see `Renderer.draw`.

        Returns:
            The images to come, by view. Its `result` raises RecapError where they could not be drawn; `add_done_callback`
            calls back in another thread; a picture that is cancelled before its turn is not drawn.
        """
        future: Future[list[Images]] = Future()
        with self._lock:
            if self._is_closed:
                future.set_exception(RecapError("the renderer is closed"))
            else:
                self._jobs.put(_Job(future, _Command(views, instances, sky)))
        return future

    def draw(self, view: DrawnView, instances: Instances | None = None, sky: Sky | None = None) -> Images:
        """Draw images of a camera, and wait for them; see `Renderer.draw`."""
        return self.submit([view], instances, sky).result()[0]

    def close(self) -> None:
        """End the process; pictures that have not been drawn are cancelled. A second call does nothing."""
        with self._lock:
            was_closed, self._is_closed = self._is_closed, True
        if not was_closed:
            self._jobs.put(None)
        if current_thread() is not self._thread:
            self._thread.join()

    def _start(self) -> _Child:
        child = _Child(self._setup, loads_models=self._loads_models)
        child.wait_until_ready()
        return child

    def _restart(self) -> _Child:
        if monotonic() < self._next_start:
            raise RenderProcessNotStarted("the process that draws has ended, and is not started again yet")
        try:
            return self._start()
        except Exception as error:
            raise RenderProcessNotStarted(str(error)) from None
        finally:
            self._next_start = monotonic() + self._pause
            self._pause = min(2 * self._pause, _PAUSES[1])

    def _run(self) -> None:
        sent: deque[_Job] = deque()
        again: deque[_Job] = deque()  # were sent to a process that has ended
        is_ending = False
        while not is_ending or again or sent:
            job = None
            if again:
                job = again.popleft()
            elif not is_ending and len(sent) < _SENT:
                with suppress(Empty):
                    job = self._jobs.get(block=not sent)
                    is_ending = job is None
            if job is not None:
                if self._send(job.future, job.command):
                    sent.append(job)
            elif sent and not self._receive(sent.popleft()):
                again, sent = sent, again
        if self._child is not None:
            self._child.close()

    def _send(self, future: Future[list[Images]], command: _Command) -> bool:
        """Have a picture drawn; return false if it will not be."""
        if self._is_closed:
            if not future.cancel():
                future.set_exception(RecapError("the renderer is closed"))
        elif future.running() or future.set_running_or_notify_cancel():
            try:
                if self._child is None:
                    self._child = self._restart()
                self._child.send(command)
            except Exception as error:
                future.set_exception(error)
            else:
                return True
        return False

    def _receive(self, job: _Job) -> bool:
        """Wait for the picture that was sent first; return false if the process has ended."""
        assert self._child is not None
        try:
            images = self._child.receive(job.command)
            self._pause = _PAUSES[0]
        except RenderProcessEnded as error:
            self._child.close()
            self._child = None
            job.future.set_exception(error)
        except Exception as error:
            job.future.set_exception(error)
        else:
            job.future.set_result(images)
        return self._child is not None


class _Shape(NamedTuple):
    """A model, without what else it is: to read it, the process need not make all models."""

    mesh: Mesh
    pivots: NDArray[np.float32]
    steered: NDArray[np.bool_]


class _Tiles:
    """The tiles of a town, without what else it has."""

    def __init__(self, town: TiledMesh | None) -> None:
        self.tiles = list(town.tiles) if town is not None else []


class _Child:
    """The process, and the memory that it shares.

    `setup` returns a pickle of the arguments of the renderer; with `loads_models`, the process loads the models of this
    package.
    """

    def __init__(self, setup: Callable[[], bytes], *, loads_models: bool) -> None:
        if os.name != "posix":
            raise RecapError("cameras and videos need Linux or macOS")
        self._setup = setup
        self._memories = deque(_SharedMemory(_create_memory()) for _ in range(_SENT))  # that of the next picture first
        self._filled: deque[_SharedMemory] = deque()
        descriptors = [memory.descriptor for memory in self._memories]
        options = [_LOAD_MODELS] if loads_models else []
        try:
            self.process = subprocess.Popen(
                module_command(__name__, *options, *map(str, descriptors)),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,  # where drivers print remarks
                env=_KEPT | module_environment(),
                pass_fds=descriptors,
                start_new_session=True,
            )
        except OSError as error:
            self._close_memories()
            raise RecapError(f"the process that draws cannot be started: {error}") from None

    def wait_until_ready(self) -> None:
        """Send the setup, and wait until the process can draw.

        Raises:
            MissingExtra: moderngl is not installed.
            RecapError: There is no driver, or the process has ended.
        """
        assert self.process.stdout is not None
        try:
            setup = self._setup()
            while (line := self.process.stdout.readline()) != _READY:
                if not line:
                    raise RenderProcessEnded(f"the process that draws has not started: exit code {self.process.wait()}")
            self._write(setup)
            self._wait()
        except BaseException:
            self.close()
            raise

    def send(self, command: _Command) -> None:
        """Have images drawn; if the process has ended, that is found when they are received."""
        for view in command.views:
            check_size(view.camera)
        memory = self._memories[0]
        memory.grow(_size(command.views))
        self._write(pickle.dumps((memory.descriptor, command), pickle.HIGHEST_PROTOCOL))
        self._memories.rotate(-1)
        self._filled.append(memory)

    def receive(self, command: _Command) -> list[Images]:
        """Return the images of the command that was sent first, of those whose images have not been received.

        Raises:
            RenderProcessEnded: The process has ended.
            RecapError: They cannot be drawn.
        """
        memory = self._filled.popleft()
        self._wait()
        return [{kind: image.copy() for kind, image in images.items()} for images in _arrays(command.views, memory)]

    def close(self) -> None:
        """End the process."""
        close_pipes(self.process)
        wait_or_kill(self.process, _END_PATIENCE)
        self._close_memories()

    def _close_memories(self) -> None:
        for memory in self._memories:
            memory.close()

    def _write(self, command: bytes) -> None:
        assert self.process.stdin is not None
        with suppress(OSError):
            self.process.stdin.write(command)
            self.process.stdin.flush()

    def _wait(self) -> None:
        """Wait for the next answer; raise the error that it is, if it is one."""
        assert self.process.stdout is not None
        try:
            if not is_readable(self.process.stdout, PATIENCE):
                self.process.kill()
            answer = pickle.load(self.process.stdout)
        except Exception:
            with suppress(OSError):
                self.process.kill()  # it may have closed its pipes alone
            raise RenderProcessEnded(f"the process that draws has ended with exit code {self.process.wait()}") from None
        if answer is not None:
            raise answer


class _SharedMemory:
    """A file in memory that grows."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._map: mmap.mmap | None = None

    @property
    def view(self) -> Any:
        """The content, as a buffer."""
        return self._map

    def grow(self, size: int) -> None:
        """Make the file at least so large, and map all of it."""
        if os.fstat(self.descriptor).st_size < size:
            os.ftruncate(self.descriptor, size)
        if self._map is None or len(self._map) < size:
            self.release()
            self._map = mmap.mmap(self.descriptor, os.fstat(self.descriptor).st_size)

    def release(self) -> None:
        """Unmap the file."""
        if self._map is not None:
            with suppress(BufferError):  # an image is still in use, and keeps it
                self._map.close()
            self._map = None

    def close(self) -> None:
        """Unmap and close the file; a second call does nothing."""
        self.release()
        if self.descriptor >= 0:
            os.close(self.descriptor)
            self.descriptor = -1


def _create_memory() -> int:
    """Return the descriptor of a file in memory, which goes with its last descriptor."""
    if sys.platform == "linux":
        return os.memfd_create("carla-recap-images")
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def _bytes_of(kind: ImageKind, camera: Camera) -> int:
    shape, dtype = image_format(kind, camera.width, camera.height)
    return -(-int(np.prod(shape)) * np.dtype(dtype).itemsize // _PAGE) * _PAGE


def _size(views: Sequence[DrawnView]) -> int:
    """Return the bytes of memory that images take."""
    return max(sum(_bytes_of(kind, view.camera) for view in views for kind in view.kinds), _PAGE)


def _arrays(views: Sequence[DrawnView], memory: _SharedMemory) -> list[Images]:
    """Return the arrays of images in a memory."""
    found, offset = [], 0
    for camera, kinds, *_ in views:
        images = {}
        for kind in kinds:
            shape, dtype = image_format(kind, camera.width, camera.height)
            images[kind] = np.ndarray(shape, dtype, memory.view, offset)
            offset += _bytes_of(kind, camera)
        found.append(images)
    return found


# --- in the process ----------------------------------------------------------------------------------------------------


def serve(commands: BinaryIO, answers: BinaryIO, descriptors: Sequence[int], models: Models) -> None:
    """Draw until there are no more commands.

    Args:
        commands: Pickles: the arguments of the renderer, then of each picture the memory for it, and its arguments.
        answers: The destination of a pickle for each: None, or an error.
        descriptors: The shared memories.
        models: Models whose indices come before those of the models of the first command; see `Renderer`.
    """
    memories = {descriptor: _SharedMemory(descriptor) for descriptor in descriptors}
    renderer: Renderer | None = None
    for command in read_commands(commands):
        try:
            if renderer is None:
                town, further, quality, supersampling = command
                for model in further:
                    models.append(model)
                renderer = Renderer(town, models=models, quality=quality, supersampling=supersampling)
            else:
                descriptor, (views, instances, sky) = command
                memories[descriptor].grow(_size(views))
                for view, into in zip(views, _arrays(views, memories[descriptor]), strict=True):
                    camera, kinds, before, without = view
                    renderer.draw(camera, instances, kinds, sky, before, without=without, into=into)
            answer = None
        except (MissingExtra, RecapError) as error:
            answer = error
        except Exception as error:
            answer = RecapError(f"drawing has failed: {type(error).__name__}: {error}")
        try:
            pickle.dump(answer, answers)
            answers.flush()
        except OSError:  # the client has gone
            break
        if renderer is None:
            break
    if renderer is not None:
        renderer.close()


def main() -> None:
    """Run the process."""
    ignore_termination()  # it ends when its client does
    answers = sys.stdout.buffer
    sys.stdout = sys.stderr
    with suppress(OSError):  # the client may have gone by now
        answers.write(_READY)
        answers.flush()
        models = MODELS if _LOAD_MODELS in sys.argv else Models()
        descriptors = [int(argument) for argument in sys.argv[1:] if argument != _LOAD_MODELS]
        serve(sys.stdin.buffer, answers, descriptors, models)


if __name__ == "__main__":
    main()
