"""A file that appears under its name only when it is complete."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Self

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import TracebackType

    from carla_recap.payload import Buffer


class AtomicFile:
    """Base of the writers: writes beside the destination, and moves there on `close`.

    A crash leaves the file beside the destination, where `recover` finds what it holds.

    Args:
        path: The destination.
        live: Leave what was written beside the destination, too, when the file cannot be finished.

    Raises:
        RecapError: The place cannot be written to.
    """

    def __init__(self, path: Path | str, *, live: bool = False) -> None:
        self.path = Path(path)
        self._live = live
        self._partial = self.path.with_name(f".{self.path.name[:200]}.{os.urandom(4).hex()}.partial")

    def _begin(self, write: Callable[[], None]) -> None:
        """Open the file, and let what comes first be written; whatever interrupts that leaves nothing behind."""
        try:
            if self.path.is_dir():
                raise IsADirectoryError(21, "is a directory")
            self._file = self._partial.open("xb", buffering=1 << 20)
            write()
        except OSError as error:
            self.abort()
            raise self._unwritable(error) from None
        except BaseException:
            self.abort()
            raise

    def close(self) -> None:
        """Finish the file, and put it under its name."""
        if self._file.closed:
            return
        try:
            self._finish()
            self._file.close()
            self._partial.replace(self.path)
        except OSError as error:
            self._give_up()
            raise self._unwritable(error) from None
        except BaseException:
            self._give_up()
            raise

    def abort(self) -> None:
        """Give the file up, and remove what was written."""
        self.abandon()
        with suppress(OSError):
            self._partial.unlink()

    def abandon(self) -> Path:
        """Give the file up, but leave what was written where it is, which is returned; `recover` takes it."""
        with suppress(OSError):  # what waits in memory may not fit on the disk either
            if hasattr(self, "_file"):
                self._file.close()
        return self._partial

    def _give_up(self) -> None:
        if self._live:
            self.abandon()
        else:
            self.abort()

    def _put(self, data: Buffer) -> None:
        """Add bytes.

        Raises:
            RecapError: The disk is full, or broken.
        """
        try:
            self._file.write(data)
        except OSError as error:
            raise self._unwritable(error) from None

    def _unwritable(self, error: OSError) -> RecapError:
        return RecapError(f"{self.path}: cannot be written: {error.strerror}")

    def _finish(self) -> None:
        """Write what comes last."""

    def _sync(self) -> None:
        """Put what was written on the disk.

        Raises:
            RecapError: The disk is full, or broken.
        """
        try:
            self._file.flush()
            os.fdatasync(self._file.fileno())
        except OSError as error:
            raise self._unwritable(error) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()
