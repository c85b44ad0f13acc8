"""The renderer in a process of its own: only the caller that needs a picture waits for it.

`RenderProcess` is the client. It starts `python -m carla_recap.rendering.process`, and sends it commands over a pipe, as
pickles; the images come back through memory that both share. The process ends when its client has gone.
"""

from __future__ import annotations

import mmap
import os
import pickle
import subprocess
import sys
import tempfile
from concurrent.futures import Future
from contextlib import suppress
from functools import cache
from queue import SimpleQueue
from select import select
from threading import Lock, Thread, current_thread
from time import monotonic
from typing import TYPE_CHECKING, Any, BinaryIO, Final, NamedTuple, Self

import numpy as np

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.rendering.buffers import image_format
from carla_recap.rendering.camera import ImageKind
from carla_recap.rendering.renderer import LARGEST, Quality, Renderer
from carla_recap.scene.models import MODELS, own_models
from carla_recap.util.processes import close_pipes, module_command, module_environment, read_commands, wait_or_kill
from carla_recap.util.signals import ignore_termination

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from numpy.typing import NDArray

    from carla_recap.rendering.buffers import ModelShape, TiledMesh
    from carla_recap.rendering.camera import Camera
    from carla_recap.rendering.sky import Sky
    from carla_recap.scene.instances import Instances
    from carla_recap.scene.mesh import Mesh

    Images = dict[ImageKind, NDArray[Any]]

PATIENCE: Final = 300.0
"""The seconds after which a picture that does not come counts as failed."""
_READY: Final = b"carla-recap: ready to draw\n"
"""The first line of the process; lines before it are printed by other code that runs when an interpreter starts."""
_LOAD_MODELS: Final = "--models"
_END_PATIENCE: Final = 5.0  # s, for the end of the process
_PAGE: Final = 4096  # bytes between images
_PAUSES: Final = (1.0, 60.0)  # s without a restart after the first one that was in vain, and at most


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
        RecapError: There is no driver for OpenGL, or the process cannot be started.
    """

    def __init__(
        self,
        town: TiledMesh | Callable[[], TiledMesh | None] | None = None,
        *,
        models: Sequence[ModelShape] | None = None,
        quality: Quality | str = Quality.EPIC,
        supersampling: int | tuple[int, int] | None = None,
    ) -> None:
        quality = Quality(quality)

        @cache
        def setup() -> bytes:
            used = own_models() if models is None else models
            shapes = [_Shape(model.mesh, model.pivots, model.steered) for model in used]
            tiles = _Tiles(town() if callable(town) else town)
            return pickle.dumps((tiles, shapes, quality, supersampling), pickle.HIGHEST_PROTOCOL)

        self._setup = setup
        self._loads_models = models is None
        self._jobs: SimpleQueue[tuple[Future[Images], Any] | None] = SimpleQueue()
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
        self,
        camera: Camera,
        instances: Instances | None = None,
        kinds: Sequence[ImageKind] = (ImageKind.RGB,),
        sky: Sky | None = None,
        previous: tuple[Camera, Instances | None] | None = None,
        *,
        without: Collection[int] = (),
    ) -> Future[Images]:
        """Have images drawn; see `Renderer.draw`.

        Returns:
            The images to come. Its `result` raises RecapError where they could not be drawn; `add_done_callback` calls back
            in another thread; a picture that is cancelled before its turn is not drawn.
        """
        future: Future[Images] = Future()
        kinds = tuple(kind for kind in ImageKind if kind in kinds)
        command = camera, instances, kinds, sky, previous, frozenset(without)
        with self._lock:
            if self._is_closed:
                future.set_exception(RecapError("the renderer is closed"))
            else:
                self._jobs.put((future, command))
        return future

    def draw(
        self,
        camera: Camera,
        instances: Instances | None = None,
        kinds: Sequence[ImageKind] = (ImageKind.RGB,),
        sky: Sky | None = None,
        previous: tuple[Camera, Instances | None] | None = None,
        *,
        without: Collection[int] = (),
    ) -> Images:
        """Draw images, and wait for them; see `Renderer.draw`."""
        return self.submit(camera, instances, kinds, sky, previous, without=without).result()

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
        while (job := self._jobs.get()) is not None:
            future, command = job
            if self._is_closed:
                future.cancel()
            elif future.set_running_or_notify_cancel():
                self._carry_out(future, command)
        if self._child is not None:
            self._child.close()

    def _carry_out(self, future: Future[Images], command: Any) -> None:
        try:
            if self._child is None:
                self._child = self._restart()
            images = self._child.draw(command)
            self._pause = _PAUSES[0]
        except RenderProcessEnded as error:
            if self._child is not None:
                self._child.close()
            self._child = None
            future.set_exception(error)
        except Exception as error:
            future.set_exception(error)
        else:
            future.set_result(images)


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

    Args:
        setup: Returns a pickle of the arguments of the renderer; called while the process starts.
        loads_models: Whether the process loads the models of this package itself.

    Raises:
        RecapError: The process cannot be started.
    """

    def __init__(self, setup: Callable[[], bytes], *, loads_models: bool) -> None:
        if os.name != "posix":
            raise RecapError("cameras and videos need Linux or macOS")
        self._setup = setup
        self._memory = _SharedMemory(_create_memory())
        descriptor = self._memory.descriptor
        try:
            self.process = subprocess.Popen(
                module_command(__name__, str(descriptor), *([_LOAD_MODELS] if loads_models else [])),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,  # where drivers print remarks
                env=module_environment(),
                pass_fds=(descriptor,),
                start_new_session=True,
            )
        except OSError as error:
            self._memory.close()
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
            self._ask(setup)
        except BaseException:
            self.close()
            raise

    def draw(self, command: Any) -> Images:
        """Draw images.

        Raises:
            RenderProcessEnded: The process has ended.
            RecapError: They cannot be drawn.
        """
        camera, kinds = command[0], command[2]
        offsets, size = _layout(kinds, *_checked_size(camera))
        self._memory.grow(size)
        self._ask(pickle.dumps(command, pickle.HIGHEST_PROTOCOL))
        images = {}
        for kind, offset in offsets.items():
            shape, dtype = image_format(kind, camera.width, camera.height)
            images[kind] = np.ndarray(shape, dtype, self._memory.view, offset).copy()
        return images

    def close(self) -> None:
        """End the process."""
        close_pipes(self.process)
        wait_or_kill(self.process, _END_PATIENCE)
        self._memory.close()

    def _ask(self, command: bytes) -> None:
        """Send a command, and wait for its answer; raise the error that it is, if it is one."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            self.process.stdin.write(command)
            self.process.stdin.flush()
            if not select([self.process.stdout], [], [], PATIENCE)[0]:
                self.process.kill()
            answer = pickle.load(self.process.stdout)
        except Exception:
            with suppress(OSError):
                self.process.kill()  # it may have closed its pipes alone
            raise RenderProcessEnded(f"the process that draws has ended with exit code {self.process.wait()}") from None
        if answer is not None:
            raise answer


class _SharedMemory:
    """A file in memory that grows.

    Args:
        descriptor: The file.
    """

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


def _checked_size(camera: Camera) -> tuple[int, int]:
    """Return the width and height of the images of a camera.

    Raises:
        RecapError: They are too large.
    """
    if not (1 <= camera.width <= LARGEST and 1 <= camera.height <= LARGEST):
        size = f"{camera.width} x {camera.height}"
        raise RecapError(f"an image of {size} pixels: 1 to {LARGEST} along each side can be drawn")
    return camera.width, camera.height


def _layout(kinds: Sequence[ImageKind], width: int, height: int) -> tuple[dict[ImageKind, int], int]:
    """Return the offsets of images in the shared memory, and the size of it."""
    offsets, size = {}, 0
    for kind in kinds:
        shape, dtype = image_format(kind, width, height)
        offsets[kind] = size
        size += -(-int(np.prod(shape)) * np.dtype(dtype).itemsize // _PAGE) * _PAGE
    return offsets, max(size, _PAGE)


# --- in the process ----------------------------------------------------------------------------------------------------


def serve(commands: BinaryIO, answers: BinaryIO, descriptor: int, models: Sequence[ModelShape] = ()) -> None:
    """Draw until there are no more commands.

    Args:
        commands: Pickles: the arguments of the renderer, then those of each picture.
        answers: The destination of a pickle for each: None, or an error.
        descriptor: The shared memory.
        models: Models whose indices come before those of the models of the first command.
    """
    memory = _SharedMemory(descriptor)
    renderer: Renderer | None = None
    for command in read_commands(commands):
        try:
            if renderer is None:
                town, further, quality, supersampling = command
                renderer = Renderer(town, models=[*models, *further], quality=quality, supersampling=supersampling)
            else:
                _draw(renderer, memory, *command)
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


def _draw(
    renderer: Renderer,
    memory: _SharedMemory,
    camera: Camera,
    instances: Instances | None,
    kinds: Sequence[ImageKind],
    sky: Sky | None,
    previous: tuple[Camera, Instances | None] | None,
    without: Collection[int],
) -> None:
    offsets, size = _layout(kinds, camera.width, camera.height)
    memory.grow(size)
    into = {}
    for kind, offset in offsets.items():
        shape, dtype = image_format(kind, camera.width, camera.height)
        into[kind] = np.ndarray(shape, dtype, memory.view, offset)
    renderer.draw(camera, instances, kinds, sky, previous, without=without, into=into)


def main() -> None:
    """Run the process."""
    ignore_termination()  # it ends when its client does
    answers = sys.stdout.buffer
    sys.stdout = sys.stderr
    with suppress(OSError):  # the client may have gone by now
        answers.write(_READY)
        answers.flush()
        models: list[ModelShape] = []
        if _LOAD_MODELS in sys.argv:
            models = list(MODELS)  # read now, while the client makes the town
        serve(sys.stdin.buffer, answers, int(sys.argv[1]), models)


if __name__ == "__main__":
    main()
