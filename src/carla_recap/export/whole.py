"""A file that appears under its name when it is complete."""

from __future__ import annotations

from math import inf
from time import monotonic
from typing import TYPE_CHECKING, Final

from carla_recap.formats.atomic import AtomicFile

if TYPE_CHECKING:
    from pathlib import Path

SYNC_SECONDS: Final = 3.0
"""So often what was written of a live file is put on the disk."""


class WholeFile(AtomicFile):
    """Takes a place for a file; what is written appears there at the end.

    Args:
        path: The destination.
        live: Put what is written on the disk every `SYNC_SECONDS`, so that it is found beside the destination when the
            process dies.

    Raises:
        RecapError: The place cannot be written to.
    """

    def __init__(self, path: Path | str, *, live: bool = False) -> None:
        super().__init__(path)
        self._sync_at = monotonic() + SYNC_SECONDS if live else inf
        self._begin(lambda: None)

    def write(self, data: bytes) -> None:
        """Add to its content.

        Raises:
            RecapError: The disk is full, or broken.
        """
        self._put(data)
        if monotonic() >= self._sync_at:
            self._sync()
            self._sync_at = monotonic() + SYNC_SECONDS
