"""Has the frames of a running recording written in a process of its own, so that no tick waits for a disk."""

from __future__ import annotations

from pathlib import Path
from queue import Queue
from threading import Thread
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import RecapError
from carla_recap.sim.recording.scribes import ScribeEnded, ScribeProcess

if TYPE_CHECKING:
    from carla_recap.frame import Header
    from carla_recap.sim.recording.snapshots import Strip

QUEUE: Final = 16
"""So many strips may wait; only a disk that is that far behind makes the simulation wait."""


class BackgroundWriter:
    """Takes strips of snapshots in without delay, and has the frames of each written when it is complete.

    What goes wrong with that ends the recording, and nothing else. Should this process be killed, the recording is completed
    all the same, but for what has not been handed over: the last strip, and those that wait for a slow disk.

    Args:
        path: The destination; the suffix says the format.
        header: The header.
        force: Take the place of what is at the destination by the end; else it stays, as does what was recorded, beside it.

    Attributes:
        path: The destination.
        error: What went wrong, and where the frames are that came before; None as long as nothing did.
        pid: The process that writes.

    Raises:
        RecapError: The suffix is of no format, or the place cannot be written to.
    """

    def __init__(self, path: Path, header: Header, *, force: bool = True) -> None:
        self.path = path
        self.error: RecapError | None = None
        self._strip: Strip | None = None
        self._strips: Queue[Strip | None] = Queue(QUEUE)
        self._thread = Thread(target=self._run, name="carla-recap-recorder", daemon=True)
        self._scribe = _begun(path, (_folder(path), path, header, force))
        self.pid = self._scribe.pid
        try:
            self._thread.start()
        except BaseException:
            self._scribe.end()
            raise

    def write(self, strip: Strip) -> None:
        """Add a strip, which is complete when another one comes; what goes wrong is told by `error`, sooner or later."""
        if strip is not self._strip:
            self._hand_over()
            self._strip = strip

    def close(self) -> None:
        """Wait until the file is complete, or has failed; twice is harmless."""
        if self._thread.is_alive():
            self._hand_over()
            self._strips.put(None)
            self._thread.join()

    def _hand_over(self) -> None:
        if self._strip is not None and self.error is None:
            self._strips.put(self._strip)

    def _run(self) -> None:
        strip: Strip | None = None
        try:
            while (strip := self._strips.get()) is not None:
                self._scribe.ask(self.path, "write", strip)
            self._scribe.ask(self.path, "close")
        except ScribeEnded as error:
            self.error = RecapError(f"{error}; what was recorded until then lies beside it, for carla-recap recover")
        except RecapError as error:
            self.error = error
        except Exception as error:
            self._scribe.end()  # which completes what it has got
            self.error = RecapError(f"{self.path}: has ended early: {type(error).__name__}: {error}")
        while strip is not None:  # whoever waits for a place in the queue must not wait for ever
            strip = self._strips.get()
        self._scribe.rest()


def _begun(path: Path, arguments: tuple[Any, ...]) -> ScribeProcess:
    """Who has begun a recording: one that rested, unless it has just died, or a new one."""
    scribe = ScribeProcess.found()
    try:
        try:
            scribe.ask(path, "begin", *arguments)
        except ScribeEnded:
            scribe = ScribeProcess()
            scribe.ask(path, "begin", *arguments)
    except RecapError:
        scribe.rest()
        raise
    except BaseException:  # as by Ctrl-C: an answer is still to come
        scribe.end()
        raise
    return scribe


def _folder(path: Path) -> Path:
    """What a path is relative to."""
    try:
        return Path(path.anchor) if path.is_absolute() else Path.cwd()
    except OSError as error:
        raise RecapError(f"{path}: the working directory cannot be told: {error.strerror}") from None
