"""Writes the frames of a running recording in a thread of its own, so that no tick waits for a disk."""

from __future__ import annotations

from contextlib import suppress
from queue import Queue
from threading import Thread
from typing import TYPE_CHECKING, Final

from carla_recap.errors import RecapError
from carla_recap.formats import create_writer
from carla_recap.recovery import recover
from carla_recap.sim.snapshots import develop

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from carla_recap.formats.base import Writer
    from carla_recap.frame import Header, Packet
    from carla_recap.sim.snapshots import Snapshot

BATCH: Final = 16
"""So many snapshots are handed to the thread together: two threads that take turns too often slow each other down."""
QUEUE: Final = 16
"""So many batches may wait; only a disk that is that far behind makes the simulation wait."""
SECONDS: Final = 5.0
"""The formats put so much of a recording on the disk at a time; a batch does not delay it."""


class BackgroundWriter:
    """Takes snapshots in without delay, and writes each as a frame when the next one has come, and told how long it was.

    A disk that is full or broken ends the recording, and nothing else: what is on the disk by then is made a whole
    recording if that can be done, and else left beside the destination, where `recover` takes it.

    Args:
        path: The destination; the suffix says the format.
        header: The header.
        introduction: Packets of the first frame, with which all that takes long is done at once.

    Attributes:
        path: The destination.
        error: What went wrong, and where the frames are that came before; None as long as nothing did.

    Raises:
        RecapError: The suffix is of no format, the place cannot be written to, or a packet cannot be written.
    """

    def __init__(self, path: Path, header: Header, introduction: Iterable[Packet]) -> None:
        self.path = path
        self.error: RecapError | None = None
        self._writer = _prepared(create_writer(path, header, live=True), introduction)
        self._batch: list[Snapshot] = []
        self._due = 0.0
        self._batches: Queue[list[Snapshot] | None] = Queue(QUEUE)
        self._thread = Thread(target=self._run, name="carla-recap-recorder", daemon=True)
        self._thread.start()

    def write(self, snapshot: Snapshot) -> None:
        """Add a snapshot; what goes wrong is told by `error`, sooner or later."""
        self._batch.append(snapshot)
        if len(self._batch) >= BATCH or snapshot.elapsed >= self._due:
            self._hand_over()
        if snapshot.elapsed >= self._due:
            self._due = snapshot.elapsed + SECONDS

    def close(self) -> None:
        """Wait until the file is complete, or has failed; twice is harmless."""
        if self._thread.is_alive():
            self._hand_over()
            self._batches.put(None)
            self._thread.join()

    def _hand_over(self) -> None:
        batch, self._batch = self._batch, []
        if batch and self.error is None:
            self._batches.put(batch)

    def _run(self) -> None:
        latest: list[Snapshot] = []
        batch: list[Snapshot] | None = []
        try:
            while (batch := self._batches.get()) is not None:
                *known, last = [*latest, *batch]
                self._write(known)
                latest = [last]
            self._write(latest)
            self._writer.close()
        except Exception as error:
            self.error = _ended_early(self._writer, self.path, error)
            while batch is not None:  # whoever waits for a place in the queue must not wait for ever
                batch = self._batches.get()

    def _write(self, snapshots: Sequence[Snapshot]) -> None:
        for frame in develop(snapshots):
            self._writer.write(frame)


def _prepared(writer: Writer, packets: Iterable[Packet]) -> Writer:
    try:
        for packet in packets:
            writer.prepare(packet)
    except BaseException:
        writer.abort()
        raise
    return writer


def _ended_early(writer: Writer, path: Path, error: Exception) -> RecapError:
    """Save what was written; returns what to tell."""
    partial = writer.abandon()
    try:
        saved = recover(partial, path)
    except Exception:  # whatever it is: the frames are safe where they are
        return RecapError(f"{error}; what was recorded until then lies in {partial}, for carla-recap recover")
    with suppress(OSError):
        partial.unlink()
    return RecapError(f"{error}; the recording ends at {saved.duration:g} s")
