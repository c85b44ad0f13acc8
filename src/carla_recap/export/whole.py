"""A file that is made in memory, and appears under its name when it is complete."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.formats.atomic import AtomicFile

if TYPE_CHECKING:
    from pathlib import Path


class WholeFile(AtomicFile):
    """Takes a place for a file; what is written appears there at the end.

    Args:
        path: The destination.

    Raises:
        RecapError: The place cannot be written to.
    """

    def __init__(self, path: Path | str) -> None:
        super().__init__(path)
        self._begin(lambda: None)

    def write(self, data: bytes) -> None:
        """Add to its content.

        Raises:
            RecapError: The disk is full, or broken.
        """
        self._put(data)
