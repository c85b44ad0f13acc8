"""Images for streams: drawn in a thread beside the event loop, in the order of the ticks."""

from __future__ import annotations

import asyncio
import logging
import struct
from collections import Counter
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.rendering.camera import ImageKind
from carla_recap.server.streams import framed

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.rendering.camera import Camera
    from carla_recap.scene.instances import Instances
    from carla_recap.server.streams import Streams
    from carla_recap.sim.settings import Weather
    from carla_recap.sim.town.loading import Town

    Image = NDArray[Any]

_LOG: Final = logging.getLogger(__name__)
_AHEAD: Final = 2  # ticks whose images are waited for before the next tick
_TO_END: Final = 5.0  # s
_POLL: Final = 0.1  # s
_TRIES: Final = 2  # of drawing an image
_MOST_FAILURES: Final = 3  # of images of a size in succession
_LARGE: Final = 4_000_000  # pixels: what has drawn a larger image keeps much memory

# The bytes of each pixel: blue, green, red, alpha
GREY: Final = bytes((128, 128, 128, 255))
_BLANK: Final[Mapping[ImageKind, bytes]] = {
    ImageKind.RGB: GREY,
    ImageKind.DEPTH: bytes((255, 255, 255, 255)),  # depth is red + 256 green + 65536 blue; all set are 1,000 m
    ImageKind.SEMANTIC: bytes((0, 0, 0, 255)),
    ImageKind.INSTANCE: bytes((0, 0, 0, 255)),
    ImageKind.NORMALS: GREY,
    ImageKind.FLOW: struct.pack("<2f", 0.0, 0.0),
}


class ImagesUnavailable(RecapError):
    """No image can be drawn now, whatever its size; later ones may be."""


@dataclass(frozen=True, eq=False, slots=True)
class Shot:
    """An image that a camera takes for a stream; `encode` returns the parts of the frame after the header."""

    stream: int
    header: bytes
    kind: ImageKind
    encode: Callable[[Image], Iterable[bytes | memoryview]]


class CameraScene(NamedTuple):
    """A camera, and the actors in front of it at a moment."""

    camera: Camera
    instances: Instances


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """What cameras of the same pose, size and field of view see in a tick.

    Attributes:
        previous: The scene of the image before, for optical flow; None for other kinds, and for the first image.
        hidden: The ids of actors that are left out.
    """

    scene: CameraScene
    previous: CameraScene | None
    hidden: frozenset[int]
    weather: Weather
    shots: list[Shot]

    @property
    def kinds(self) -> tuple[ImageKind, ...]:
        """The kinds of images, none twice."""
        return tuple(dict.fromkeys(shot.kind for shot in self.shots))


class ImageSource(Protocol):
    """What draws the images of a town."""

    def draw(self, view: View) -> Mapping[ImageKind, Image]:
        """Return the images of a view, valid until the next call; raise `ImagesUnavailable` if none can be drawn now."""

    def close(self) -> None:
        """Release everything."""


def blank_images(view: View) -> Mapping[ImageKind, Image]:
    """Return images without content."""
    width, height = view.scene.camera.width, view.scene.camera.height
    images = {kind: np.frombuffer(_BLANK[kind] * (width * height), np.uint8) for kind in view.kinds}
    return {
        kind: image.view(np.float32 if kind is ImageKind.FLOW else np.uint8).reshape(height, width, -1)
        for kind, image in images.items()
    }


class ImageThread:
    """Draws images and sends them, while the world goes on.

    Images of a town whose source cannot be opened are blank.
    """

    def __init__(self, streams: Streams, open_source: Callable[[Town], ImageSource]) -> None:
        self._streams = streams
        self._open = open_source
        self._work: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._thread: Thread | None = None
        self._town: Town | None = None
        self._source: ImageSource | None = None
        self._failures: Counter[tuple[int, int]] = Counter()  # in succession, of images of a size
        self._is_failing = False
        self._is_closed = False
        self._pending = 0
        self._waiting: list[asyncio.Future[None]] = []
        self._opened: tuple[Town, Future[None]] | None = None
        self._largest = 0  # pixels of an image

    @property
    def is_busy(self) -> bool:
        """Whether there are images that have not been sent yet, or it is not ready."""
        return self._pending > 0 or (self._opened is not None and not self._opened[1].done())

    def prepare(self, town: Town) -> Future[None]:
        """Open the source of the images of a town, if it is not open yet; return when it is."""
        if self._opened is None or self._opened[0] is not town:
            self._opened = town, Future()
            self._put(partial(self._prepare, *self._opened))
        return self._opened[1]

    def release(self) -> None:
        """Close what has drawn large images, after those of earlier ticks; it is opened again for the next image."""
        if self._largest > _LARGE:
            self._largest, self._opened = 0, None
            self._put(self._close_source)

    def pending(self) -> list[asyncio.Future[None]]:
        """Return what the next tick waits for, so that images keep up with it."""
        if self._pending < _AHEAD:
            return []
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append(future)
        return [future]

    def submit(self, town: Town, views: Sequence[View], loop: asyncio.AbstractEventLoop, *, keeps_all: bool) -> None:
        """Draw the views of a tick and send their images, after those of earlier ticks.

        If all are kept, subscribers that are behind are waited for, so that they miss no image.
        """
        if self._put(partial(self._draw_tick, town, views, loop, keeps_all=keeps_all)):
            self._pending += 1
            self._largest = max(self._largest, *(view.scene.camera.width * view.scene.camera.height for view in views))

    def close(self) -> None:
        """End the thread, and release what draws."""
        self._is_closed = True
        self._work.put(None)
        if self._thread is not None:
            self._thread.join(_TO_END)

    def _put(self, work: Callable[[], None]) -> bool:
        """Have the thread call something, unless it is closed."""
        if self._is_closed:
            return False
        if self._thread is None:
            self._thread = Thread(target=self._run, name="carla-recap-images", daemon=True)
            self._thread.start()
        self._work.put(work)
        return True

    def _run(self) -> None:
        while (work := self._work.get()) is not None and not self._is_closed:
            work()
        self._close_source()

    def _prepare(self, town: Town, opened: Future[None]) -> None:
        self._source_of(town)
        opened.set_result(None)

    def _draw_tick(self, town: Town, views: Sequence[View], loop: asyncio.AbstractEventLoop, *, keeps_all: bool) -> None:
        for view in views:
            if self._streams.has_subscribers(shot.stream for shot in view.shots):
                self._deliver(self._send(self._frames(town, view), keeps_all=keeps_all), loop)
        with suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(self._done)

    def _frames(self, town: Town, view: View) -> list[tuple[int, bytes | memoryview]]:
        """Return the frames of a view and their streams."""
        images = self._draw(town, view)
        frames = []
        for shot in view.shots:
            try:
                parts = shot.encode(images[shot.kind])
                frames.append((shot.stream, framed(shot.header, *parts)))
            except Exception as error:
                _LOG.error("an image is lost: %r", error)
        return frames

    def _draw(self, town: Town, view: View) -> Mapping[ImageKind, Image]:
        size = view.scene.camera.width, view.scene.camera.height
        source = self._source_of(town)
        for _ in range(_TRIES):
            if source is None or self._failures[size] >= _MOST_FAILURES:
                break
            try:
                images = source.draw(view)
            except Exception as error:
                is_of_size = not isinstance(error, ImagesUnavailable)
                self._failures[size] += is_of_size
                self._log_failure(size, error)
                if not is_of_size:
                    break
            else:
                self._failures[size] = 0
                if self._is_failing:
                    self._is_failing = False
                    _LOG.warning("images are drawn again")
                return images
        return blank_images(view)

    def _log_failure(self, size: tuple[int, int], error: Exception) -> None:
        """Log that an image could not be drawn, unless the same is true of the one before."""
        if self._failures[size] >= _MOST_FAILURES:
            _LOG.error("images of %d x %d pixels are blank from now on: %s", *size, _text(error))
            self._is_failing = False
        elif not self._is_failing:
            _LOG.error("an image of %d x %d pixels cannot be drawn: %s", *size, _text(error))
            self._is_failing = True

    def _source_of(self, town: Town) -> ImageSource | None:
        """Return what draws a town, another one than for the town before; None if it cannot be opened."""
        if town is not self._town:
            self._close_source()
            self._town = town
            self._failures.clear()
            self._is_failing = False
            try:
                self._source = self._open(town)
            except Exception as error:
                _LOG.warning("cameras are blank: %s", _text(error))
        return self._source

    def _close_source(self) -> None:
        old, self._source, self._town = self._source, None, None
        if old is not None:
            with suppress(Exception):  # it may be broken
                old.close()

    def _deliver(self, sending: Coroutine[Any, Any, None], loop: asyncio.AbstractEventLoop) -> None:
        """Send frames in the event loop; wait until they are sent if none may be missed."""
        sent = asyncio.run_coroutine_threadsafe(sending, loop)
        while not self._is_closed and not sent.done():
            with suppress(TimeoutError):
                sent.result(_POLL)
        sent.cancel()

    async def _send(self, frames: list[tuple[int, bytes | memoryview]], *, keeps_all: bool) -> None:
        for stream, frame in frames:
            self._streams.send_framed(stream, frame)
        behind = self._streams.behind(stream for stream, _ in frames) if keeps_all else []
        if behind:
            await asyncio.wait(behind)

    def _done(self) -> None:
        self._pending -= 1
        if self._pending < _AHEAD:
            waiting, self._waiting = self._waiting, []
            for future in waiting:
                if not future.done():
                    future.set_result(None)


def _text(error: Exception) -> str:
    return str(error) if isinstance(error, RecapError) else repr(error)
