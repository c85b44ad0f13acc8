"""Files and folders that appear under their names only when they are complete: until then they are beside them."""

from __future__ import annotations

import errno
import os
from contextlib import contextmanager, suppress
from errno import EEXIST, EISDIR
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, BinaryIO, Final, Self

from carla_recap.errors import Closed, RecapError
from carla_recap.util.log import log_debug

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from types import TracebackType

    BytesLike = bytes | bytearray | memoryview

LFS_POINTER: Final = b"version https://git-lfs.github.com/spec/"
"""What the small file begins with that Git has in place of a large one."""
IS_LFS_POINTER: Final = "is a pointer of Git LFS, not the file itself, which `git lfs pull` fetches"
"""What errors say of such a file."""
_SYNC_SECONDS: Final = 1.0
"""The least time between two syncs, in s of the clock, so that a fast simulation does not keep the disk busy."""
_BUFFER_SIZE: Final = 1 << 20  # bytes
_TRIES: Final = 10  # times that the folder of a file is made
_NAME_SIZE: Final = 200  # characters of the destination's name in the name of a partial file

_SYNC = getattr(os, "fdatasync", os.fsync)  # some systems have only `fsync`


def _write_to_disk(descriptor: int) -> None:
    """Write a file to the disk, if its file system can."""
    try:
        _SYNC(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOSYS):
            raise


def _partial_path(path: Path) -> Path:
    """Return a new name beside a destination."""
    return path.with_name(f".{path.name[:_NAME_SIZE]}.{os.urandom(4).hex()}.partial")


def partials(path: Path | str) -> list[Path]:
    """Return the partial files beside a destination, which writers left that died."""
    from glob import escape

    path = Path(path)
    return sorted(path.parent.glob(f".{escape(path.name[:_NAME_SIZE])}.*.partial"))


class AtomicFile:
    """Base of the writers: a file that is written beside its destination, and moved there on `close`.

    If the process dies, the partial file remains, for `recover`: of a live file, everything that was handed over to the
    system; if the system goes down, too, everything that was on the disk, which is at most `_SYNC_SECONDS` behind.

    If it is `live`, the partial file is kept, too, if it cannot be finished. With `force`, it replaces a file that exists
    when it is complete; else that is an error. So is a destination that is a folder, a device or a pipe (`RecapError`).
    Folders that are missing are made.
    """

    def __init__(self, path: Path | str, *, live: bool = False, force: bool = True) -> None:
        self.path = Path(path)
        self._live = live
        self._force = force
        self._next_sync = 0.0
        self._partial = _partial_path(self.path)
        self._is_unused = False
        self._made: list[Path] = []  # the folders that were missing

    def _begin(self, write_start: Callable[[], None]) -> None:
        """Open the file and write its start; remove it again if that fails."""
        try:
            if self.path.is_dir():
                raise IsADirectoryError(EISDIR, "is a directory")
            if self.path.exists() and not self.path.is_file():
                raise FileExistsError(EEXIST, "is not a regular file")
            self._made = missing_folders(self.path.parent)
            self._file = self._open_partial()
            write_start()
            self._is_unused = True
        except OSError as error:
            self.abort()
            raise self._unwritable(error) from None
        except BaseException:
            self.abort()
            raise

    def _open_partial(self) -> BinaryIO:
        """Open the partial file; what gives up a file in a new folder may remove that before this one is there."""
        tries = 0
        while True:
            try:
                make_folder(self.path.parent)
                return self._partial.open("xb", buffering=_BUFFER_SIZE)
            except (FileNotFoundError, RecapError):
                tries += 1
                if tries == _TRIES:
                    raise

    def __del__(self) -> None:
        if getattr(self, "_is_unused", False):  # a signal came before the `with` block that would have closed it
            self.abort()

    def close(self) -> None:
        """Finish the file, and move it to its destination, or raise `RecapError`."""
        if self._file.closed:
            return
        try:
            self._finish()
            self._file.flush()
            _write_to_disk(self._file.fileno())  # else a crash of the machine may leave an empty file under the name
            self._file.close()
            self._move()
        except BaseException as error:
            if self._live:
                self.abandon()
            else:
                self.abort()
            if isinstance(error, OSError):
                raise self._unwritable(error) from None
            raise

    def abort(self) -> None:
        """Close the file, and remove what was written, and the folders that were made for it."""
        self.abandon()
        with suppress(OSError):
            self._partial.unlink()
        remove_empty(self._made)

    def abandon(self) -> Path:
        """Close the file unfinished, and return the partial file, which `recover` takes."""
        with suppress(OSError):  # the buffered rest may not fit on the disk
            if hasattr(self, "_file"):
                self._file.close()
        return self._partial

    def _finish(self) -> None:
        """Write the end of the file."""

    def _move(self) -> None:
        """Move the complete file to its destination."""
        log_debug(__name__, "%s is complete", self.path)
        if self._force:
            self._partial.replace(self.path)
            return
        try:
            os.link(self._partial, self.path)  # which fails where a rename would replace a file
        except FileExistsError:
            raise
        except OSError:  # a file system without links: an empty file takes the name first
            os.close(os.open(self.path, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
            self._partial.replace(self.path)
        else:
            self._partial.unlink()

    def _put(self, data: BytesLike) -> None:
        """Write bytes."""
        self._check_open()
        self._is_unused = False
        try:
            self._file.write(data)
        except OSError as error:
            raise self._unwritable(error) from None

    def _sync(self) -> None:
        """Hand over what was written to the system, and if `_SYNC_SECONDS` have passed, have it written to the disk."""
        try:
            self._file.flush()
            if monotonic() >= self._next_sync:
                _write_to_disk(self._file.fileno())
                self._next_sync = monotonic() + _SYNC_SECONDS
        except OSError as error:
            raise self._unwritable(error) from None

    def _check_open(self) -> None:
        if self._file.closed:
            raise Closed(self.path)

    def _unwritable(self, error: OSError) -> RecapError:
        return RecapError(f"{self.path}: cannot be written: {error.strerror}")

    def __enter__(self) -> Self:
        self._is_unused = False
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self.abort()


class WholeFile(AtomicFile):
    """A file of bytes; if it is `live`, what is written is synced, so that a partial file remains if the process dies."""

    def __init__(self, path: Path | str, *, live: bool = False, force: bool = True) -> None:
        super().__init__(path, live=live, force=force)
        self._begin(lambda: None)

    def write(self, data: bytes) -> None:
        """Write bytes, or raise `RecapError`."""
        self._put(data)
        if self._live:
            self._sync()


def check_path(destination: Path | str) -> None:
    """Raise `RecapError` for a destination that is a URL."""
    if isinstance(destination, str) and "://" in destination:
        raise RecapError(f"{destination}: is a URL; a path was expected, since only files of this machine are written")


def read_document(path: Path | str, largest: int, expected: str) -> str:
    """Return the text of a small file, in UTF-8, or raise `RecapError`, which says what is `expected`, such as "a rig"."""
    try:
        if Path(path).exists() and not Path(path).is_file() and not Path(path).is_dir():
            raise RecapError(f"{path}: is not a regular file; expected {expected}")
        with Path(path).open("rb") as file:
            content = file.read(largest + 1)
    except (OSError, ValueError) as error:
        raise RecapError(f"{path}: cannot be read: {reason_of(error)}") from None
    if content.startswith(LFS_POINTER):
        raise RecapError(f"{path}: {IS_LFS_POINTER}")
    if len(content) > largest:
        size = f"{largest >> 20} MB" if largest >> 20 else f"{largest >> 10} kB"
        raise RecapError(f"{path}: is larger than {size}; expected {expected}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecapError(f"{path}: byte {error.start}: expected UTF-8") from None


def reason_of(error: OSError | ValueError) -> str:
    """Return why a file or folder cannot be used, from the error about its path."""
    return str(getattr(error, "strerror", None) or error)


@contextmanager
def writing(path: Path | str) -> Iterator[None]:
    """Raise a `RecapError` that names a path if a `with` block cannot write to it."""
    try:
        yield
    except (OSError, ValueError) as error:
        raise RecapError(f"{str(path)[:200]}: cannot be written: {reason_of(error)}") from None


def make_folder(folder: Path | str) -> None:
    """Create a folder and those above it where they are missing, or raise `RecapError`."""
    with writing(folder):
        try:
            Path(folder).mkdir(parents=True, exist_ok=True)
        except FileExistsError:
            raise RecapError(f"{folder}: is a file; a folder was expected") from None


def missing_folders(folder: Path | str) -> list[Path]:
    """Return which of a folder and those above it do not exist."""
    return [each for each in (Path(folder), *Path(folder).parents) if not each.exists()]


def remove_empty(folders: Iterable[Path]) -> None:
    """Remove those of some folders that have nothing in them but each other."""
    for folder in sorted(folders, key=lambda folder: len(folder.parts), reverse=True):
        with suppress(OSError):
            folder.rmdir()


@contextmanager
def made_folder(folder: Path | str) -> Iterator[None]:
    """Make a folder as `make_folder` does; remove what is empty at the end of a `with` block of what was missing."""
    with writing(folder):
        missing = missing_folders(folder)
    try:
        make_folder(folder)
        yield
    finally:
        remove_empty(missing)


def prepare_file(path: Path | str) -> None:
    """Raise `RecapError` if a file cannot be written."""
    check_path(path)
    with writing(path):
        WholeFile(path).abort()


def check_folder(folder: Path | str, *, force: bool) -> None:
    """Raise `RecapError` for a destination that is no folder, or, without `force`, a folder that is not empty."""
    check_path(folder)
    folder = Path(folder)
    with writing(folder):
        if folder.exists() and not folder.is_dir():
            raise RecapError(f"{folder}: is a file; a folder was expected")
        if folder.exists() and not force and any(folder.iterdir()):
            over = "--force (in Python, force=True) writes over what it has of the same names"
            raise RecapError(f"{folder}: is not empty; {over}")


@contextmanager
def new_folder(folder: Path | str, *, force: bool = True) -> Iterator[Path]:
    """Yield a folder beside the destination, which is moved there at the end, or raise `RecapError`.

    If the destination exists, its files of the same names are replaced, and all others stay; without `force`, it has to be
    empty. What processes that were killed have left beside it is removed.
    """
    check_folder(folder, force=force)
    folder = Path(folder)
    partial = _partial_path(folder.absolute())
    try:
        with made_folder(folder.parent), scratch_folder(partial, partials(folder.absolute())):
            yield partial
            if folder.exists():
                _merge(partial, folder)
            else:
                partial.rename(folder)
    except RecapError as error:
        if str(partial) in str(error):
            raise RecapError(str(error).replace(str(partial), str(folder))) from None
        raise
    except OSError as error:
        raise RecapError(f"{folder}: cannot be written: {reason_of(error)}") from None


@contextmanager
def scratch_folder(folder: Path, others: Iterable[Path]) -> Iterator[None]:
    """Make a folder for a `with` block; remove it at its end, and the `others` now, whose processes are gone."""
    from shutil import rmtree

    for other in others:
        if other.is_dir() and (abandoned := _locked(other)) is not None:
            rmtree(other, ignore_errors=True)
            os.close(abandoned)
    lock = None
    unlocked = folder.with_name(f"{folder.name}.new")
    try:
        unlocked.mkdir()
        lock = _locked(unlocked)
        unlocked.rename(folder)
        yield
    finally:
        rmtree(folder, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def _locked(folder: Path) -> int | None:
    """Return the descriptor of a folder that is now locked until it is closed; None if a process has locked it."""
    try:
        from fcntl import LOCK_EX, LOCK_NB, flock
    except ImportError:  # on Windows
        return None
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        flock(descriptor, LOCK_EX | LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor


def _merge(source: Path, folder: Path) -> None:
    """Move the content of a folder into another one."""
    folder.mkdir(exist_ok=True)
    for item in source.iterdir():
        if item.is_dir():
            _merge(item, folder / item.name)
        else:
            item.replace(folder / item.name)


def size_of(path: Path | str) -> int | None:
    """Return the size of a file, or of all files in a folder, in bytes; None if it is neither."""
    path = Path(path)
    try:
        if path.is_dir():
            return sum(each.stat().st_size for each in path.rglob("*") if each.is_file())
        return path.stat().st_size if path.is_file() else None
    except (OSError, ValueError):  # such as a URL
        return None


def files_below(folder: Path) -> list[Path]:
    """Return the files in a folder and below it, in order."""
    return sorted(path for path in folder.rglob("*") if path.is_file())


def copy_files(source: Path, folder: Path) -> None:
    """Copy the files of a folder, without its subfolders."""
    from shutil import copyfile

    for file in source.iterdir():
        if file.is_file():
            copyfile(file, folder / file.name)
