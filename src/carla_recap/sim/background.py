"""Writes the frames of a running recording in a thread of its own, so that no tick waits for a disk."""

from __future__ import annotations

from queue import Queue
from threading import Thread
from typing import TYPE_CHECKING, Final

from carla_recap.formats import create_writer
from carla_recap.recovery import rescue

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from carla_recap.errors import RecapError
    from carla_recap.formats.base import Writer
    from carla_recap.frame import Header, Packet
    from carla_recap.sim.snapshots import Strip

QUEUE: Final = 16
"""So many strips may wait; only a disk that is that far behind makes the simulation wait."""


class BackgroundWriter:
    """Takes strips of snapshots in without delay, and writes the frames of each when it is complete.

    A disk that is full or broken ends the recording, and nothing else: what is on the disk by then is made a whole
    recording if that can be done, and else left beside the destination, where `recover` takes it.

    Args:
        path: The destination; the suffix says the format.
        header: The header.
        introduction: Packets of the first frame, with which all that takes long is done at once.
        force: Take the place of what is at the destination by the end; else it stays, as does what was recorded, beside it.

    Attributes:
        path: The destination.
        error: What went wrong, and where the frames are that came before; None as long as nothing did.

    Raises:
        RecapError: The suffix is of no format, the place cannot be written to, or a packet cannot be written.
    """

    def __init__(self, path: Path, header: Header, introduction: Iterable[Packet], *, force: bool = True) -> None:
        self.path = path
        self.error: RecapError | None = None
        self._writer = _prepared(create_writer(path, header, live=True, force=force), introduction)
        self._strip: Strip | None = None
        self._strips: Queue[Strip | None] = Queue(QUEUE)
        self._thread = Thread(target=self._run, name="carla-recap-recorder", daemon=True)
        self._thread.start()

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
                for run in strip.runs():
                    self._writer.write_run(run)
            self._writer.close()
        except Exception as error:
            self.error = rescue(self._writer, self.path, error)
            while strip is not None:  # whoever waits for a place in the queue must not wait for ever
                strip = self._strips.get()


def _prepared(writer: Writer, packets: Iterable[Packet]) -> Writer:
    try:
        for packet in packets:
            writer.prepare(packet)
    except BaseException:
        writer.abort()
        raise
    return writer
