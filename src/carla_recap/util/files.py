"""Files and folders that appear under their names only when they are complete."""

from __future__ import annotations

import os
import shutil
from contextlib import contextmanager, suppress
from errno import EEXIST
from glob import escape
from math import inf
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Final, Self

from carla_recap.errors import Closed, RecapError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import TracebackType

    Buffer = bytes | bytearray | memoryview

_SYNC_SECONDS = 1.0  # on the clock: a simulation that is fast must not have the disk written to all the time
WHOLE_FILE_SYNC_SECONDS: Final = 3.0
"""The time between two syncs of a live `WholeFile`, in s of the clock."""

_put_on_disk = getattr(os, "fdatasync", os.fsync)  # not every system knows both
_NAME = 200  # characters of the destination's name that are in the name of what is beside it


class AtomicFile:
    """Base of the writers: writes beside the destination, and moves there on `close`.

    A crash leaves the file beside the destination, where `recover` finds what it holds: of a live file, all that was handed
    over to the system, or, should that go down, what was on the disk, which is not more than `_SYNC_SECONDS` behind.

    Args:
        path: The destination.
        live: Leave what was written beside the destination, too, when the file cannot be finished.
        force: Take the place of what is at the destination by the end; else that is an error.

    Raises:
        RecapError: The place cannot be written to.
    """

    def __init__(self, path: Path | str, *, live: bool = False, force: bool = True) -> None:
        self.path = Path(path)
        self._live = live
        self._next_sync = 0.0
        self._force = force
        self._partial = self.path.with_name(f".{self.path.name[:_NAME]}.{os.urandom(4).hex()}.partial")

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
            self._appear()
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

    def _appear(self) -> None:
        """Put the file under its name."""
        if self._force:
            self._partial.replace(self.path)
            return
        try:
            os.link(self._partial, self.path)  # no rename leaves alone what is there
        except FileExistsError:
            raise
        except OSError:  # a file system without links
            if os.path.lexists(self.path):
                raise FileExistsError(EEXIST, os.strerror(EEXIST)) from None
            self._partial.replace(self.path)
        else:
            self._partial.unlink()

    def _give_up(self) -> None:
        if self._live:
            self.abandon()
        else:
            self.abort()

    def _put(self, data: Buffer) -> None:
        """Add bytes.

        Raises:
            RecapError: The disk is full, or broken, or the file is closed.
        """
        self._check_open()
        try:
            self._file.write(data)
        except OSError as error:
            raise self._unwritable(error) from None

    def _check_open(self) -> None:
        if self._file.closed:
            raise Closed(self.path)

    def _unwritable(self, error: OSError) -> RecapError:
        return RecapError(f"{self.path}: cannot be written: {error.strerror}")

    def _finish(self) -> None:
        """Write what comes last."""

    def _sync(self) -> None:
        """Hand what was written over to the system, which outlives this process; now and then, have it put on the disk.

        Raises:
            RecapError: The disk is full, or broken.
        """
        try:
            self._file.flush()
            if monotonic() >= self._next_sync:
                _put_on_disk(self._file.fileno())
                self._next_sync = monotonic() + _SYNC_SECONDS
        except OSError as error:
            raise self._unwritable(error) from None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()


def partials(path: Path | str) -> list[Path]:
    """What lies beside a destination and was left by writers that died."""
    path = Path(path)
    return sorted(path.parent.glob(f".{escape(path.name[:_NAME])}.*.partial"))


class WholeFile(AtomicFile):
    """Takes a place for a file; what is written appears there at the end.

    Args:
        path: The destination.
        live: Put what is written on the disk every `WHOLE_FILE_SYNC_SECONDS`, so that it is found beside the destination
            when the process dies.

    Raises:
        RecapError: The place cannot be written to.
    """

    def __init__(self, path: Path | str, *, live: bool = False) -> None:
        super().__init__(path)
        self._sync_at = monotonic() + WHOLE_FILE_SYNC_SECONDS if live else inf
        self._begin(lambda: None)

    def write(self, data: bytes) -> None:
        """Add to its content.

        Raises:
            RecapError: The disk is full, or broken.
        """
        self._put(data)
        if monotonic() >= self._sync_at:
            self._sync()
            self._sync_at = monotonic() + WHOLE_FILE_SYNC_SECONDS


def check_folder(folder: Path | str, *, force: bool) -> None:
    """Refuse a place where there is something else, and without `force`, a folder that has anything in it.

    Raises:
        RecapError: That is so.
    """
    folder = Path(folder)
    try:
        if not folder.exists():
            return
        if not folder.is_dir():
            raise RecapError(f"{folder}: is a file; a folder was expected")
        if not force and any(folder.iterdir()):
            raise RecapError(
                f"{folder}: is not empty; --force (in Python, force=True) writes over what it has of the same names"
            )
    except (OSError, ValueError) as error:
        raise RecapError(f"{str(folder)[:200]}: cannot be written: {error}") from None


@contextmanager
def new_folder(folder: Path | str) -> Iterator[Path]:
    """A folder to write to, beside the destination, which it becomes at the end.

    If there is a folder already, the files are put into it, one by one; nothing that is there goes away, but for files of
    the same names.

    Raises:
        RecapError: The place cannot be written to. What is raised within names the destination, not the folder beside it.
    """
    folder = Path(folder)
    partial = folder.absolute().with_name(f".{folder.absolute().name[:200]}.{os.urandom(4).hex()}.partial")
    try:
        partial.mkdir(parents=True)
        yield partial
        if folder.exists():
            _move_into(partial, folder)
        else:
            partial.rename(folder)
    except RecapError as error:
        if str(partial) in str(error):
            raise RecapError(str(error).replace(str(partial), str(folder))) from None
        raise
    except OSError as error:
        raise RecapError(f"{folder}: cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def copy_files(source: Path, folder: Path) -> None:
    """Copy the files of a folder, but not what is in folders of it."""
    for file in source.iterdir():
        if file.is_file():
            shutil.copyfile(file, folder / file.name)


def _move_into(source: Path, folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    for item in source.iterdir():
        if item.is_dir():
            _move_into(item, folder / item.name)
        else:
            item.replace(folder / item.name)
