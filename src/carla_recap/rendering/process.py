"""The renderer in a process of its own: only the caller that needs a picture waits for it.

The next picture is asked for while one is drawn, so that the process need not wait for its client.
"""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future
from contextlib import suppress
from functools import cache
from queue import Empty, SimpleQueue
from threading import Lock, Thread, current_thread
from time import monotonic
from typing import TYPE_CHECKING, Final, NamedTuple, Self

from carla_recap.errors import RecapError
from carla_recap.rendering.camera import check_quality
from carla_recap.scene.models import own_models
from carla_recap.util.child import Child, ChildEnded, new_child

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from carla_recap.rendering.camera import DrawnView, Images, Quality
    from carla_recap.rendering.sky import Sky
    from carla_recap.scene.instances import Instances
    from carla_recap.scene.mesh import Mesh
    from carla_recap.scene.models import Model
    from carla_recap.town.mesh import TownMesh

DRAWING: Final = ("carla_recap.rendering.drawing", "draws", 2)
"""The arguments of the `Child` that draws. It draws a picture, and finds the next one when that is done."""
_PAUSES: Final = (1.0, 60.0)  # s without a restart after the first one that was in vain, and at most
_SENT: Final = DRAWING[2]  # pictures that the process has at a time


class DrawingSetup(NamedTuple):
    """The first request to the process: the arguments of the renderer."""

    tiles: Sequence[Mesh]
    loads_models: bool  # whether it has the models of this package, before others
    models: Sequence[Model]
    quality: Quality
    supersampling: int | tuple[int, int] | None


class DrawnMoment(NamedTuple):
    """What is to be drawn of a moment."""

    views: Sequence[DrawnView]
    instances: Instances | None
    sky: Sky | None


class _Job(NamedTuple):
    """Pictures to come, by view, and what is to be drawn."""

    future: Future[list[Images]]
    moment: DrawnMoment


class RenderProcessNotStarted(ChildEnded):
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
        town: TownMesh | Callable[[], TownMesh | None] | None = None,
        *,
        models: Sequence[Model] | None = None,
        quality: Quality = "epic",
        supersampling: int | tuple[int, int] | None = None,
    ) -> None:
        check_quality(quality)

        @cache
        def setup() -> DrawingSetup:
            drawn = own_models() if models is None else models
            found = town() if callable(town) else town
            return DrawingSetup(found.tiles if found else (), models is None, drawn, quality, supersampling)

        self._setup = setup
        self._jobs: SimpleQueue[_Job | None] = SimpleQueue()
        self._lock = Lock()  # for what follows
        self._is_closed = False
        self._child: Child | None = None
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
                self._jobs.put(_Job(future, DrawnMoment(views, instances, sky)))
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

    def _start(self) -> Child:
        child = new_child(*DRAWING)
        try:
            child.send(self._setup())
            child.receive()
        except BaseException:
            child.close()
            raise
        return child

    def _restart(self) -> Child:
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
                if self._send(job.future, job.moment):
                    sent.append(job)
            elif sent and not self._receive(sent.popleft().future):
                again, sent = sent, again
        if self._child is not None:
            self._child.close()

    def _send(self, future: Future[list[Images]], moment: DrawnMoment) -> bool:
        """Have a picture drawn; return false if it will not be."""
        if self._is_closed:
            if not future.cancel():
                future.set_exception(RecapError("the renderer is closed"))
        elif future.running() or future.set_running_or_notify_cancel():
            try:
                if self._child is None:
                    self._child = self._restart()
                self._child.send(moment)
            except Exception as error:
                future.set_exception(error)
            else:
                return True
        return False

    def _receive(self, future: Future[list[Images]]) -> bool:
        """Wait for the picture that was sent first; return false if the process has ended."""
        assert self._child is not None
        try:
            drawn = self._child.receive()
            images = [{kind: image.copy() for kind, image in each.items()} for each in drawn]
            self._pause = _PAUSES[0]
        except ChildEnded as error:
            self._child.close()
            self._child = None
            future.set_exception(error)
        except Exception as error:
            future.set_exception(error)
        else:
            future.set_result(images)
        return self._child is not None
