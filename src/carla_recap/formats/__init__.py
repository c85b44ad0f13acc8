"""The file formats of recordings: recognised by content when read, by suffix when written."""

from __future__ import annotations

import warnings
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING

from carla_recap.errors import NotARecording, RecapError, RecapWarning
from carla_recap.formats.sources import is_remote, path_of, unsigned
from carla_recap.util.files import IS_LFS_POINTER, LFS_POINTER
from carla_recap.util.log import log_info

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader, Writer
    from carla_recap.model.frame import Header

SUFFIXES = (".log", ".mcap")
_PATIENCE = 5.0  # s without a change
_PAUSE = 0.01  # s
_MCAP = b"\x89MCAP"
_MCAP_END = b"\x89MCAP0\r\n"


def open_reader(location: Path | str) -> Reader:
    """Open a recording of either format, at a path or a URL; see `formats.sources`.

    Of a remote MCAP file, only the parts that are asked for are read; a remote log is copied to a temporary file.

    While a server records, the file of that name has no frames. This function waits until it has, since clients do not
    wait for the end of `stop_recorder`.

    A `RecapWarning` says that the recording is incomplete, and has not changed for `_PATIENCE` seconds. A `NotARecording` is
    in neither format, a `FormatError` says that it is damaged, and `MissingExtra` that a remote one needs an extra.
    """
    if is_remote(location):
        return _open_remote(str(location))
    path = path_of(location)
    since, before = monotonic(), None
    while True:
        opened = _inode(path)
        reader = _open(location)
        if not reader.is_empty:
            return reader
        from carla_recap.util.files import partials

        left = partials(path)
        if not left and _inode(path) == opened:
            return reader
        if (written := _sizes(left)) != before:
            since, before = monotonic(), written
        if monotonic() > since + _PATIENCE:
            message = f"{location}: is being recorded, or was interrupted; its frames are in {' and '.join(map(str, left))}"
            warnings.warn(message, RecapWarning, stacklevel=3)
            return reader
        reader.close()
        sleep(_PAUSE)


def _inode(path: Path) -> int | None:
    """Return the inode of a file; None for one that cannot be read."""
    try:
        return path.stat().st_ino
    except (OSError, ValueError):
        return None


def unfinished(location: Path | str, partials: list[Path]) -> RecapError:
    """Return the error about a recording that was never finished, with the paths of its partial files."""
    paths = " and ".join(map(str, partials))
    return RecapError(f"{location}: was never finished; what was written of it until then is in {paths}")


def _sizes(paths: list[Path]) -> list[int]:
    """Return the sizes of those of some files that exist."""
    sizes = []
    for path in paths:
        with suppress(OSError):
            sizes.append(path.stat().st_size)
    return sizes


def _open(location: Path | str) -> Reader:
    # The module of a format is imported when a file needs it: a command on a small file should not wait.
    start = read_start(location)
    if start.startswith(_MCAP):
        from carla_recap.formats.mcap.reader import McapReader

        log_info(__name__, "opens %s (MCAP)", location)
        return McapReader(location)
    from carla_recap.formats.carla_log import LogReader, is_log

    if is_log(start):
        log_info(__name__, "opens %s (CARLA's log)", location)
        return LogReader(location)
    raise _not_a_recording(location, start)


def _not_a_recording(location: Path | str, start: bytes) -> NotARecording:
    if start.startswith(LFS_POINTER):
        return NotARecording(location, IS_LFS_POINTER)
    if not start:
        return NotARecording(location, "is empty; a CARLA log or an MCAP recording was expected")
    return NotARecording(location, "is not a recording (neither CARLA's log nor MCAP)")


def _open_remote(url: str) -> Reader:
    from carla_recap.formats.remote import RemoteSource, copied

    source = RemoteSource(url)
    log_info(__name__, "opens %s (%s bytes)", unsigned(url), source.size)
    try:
        start = b"" if source.ends_with(_MCAP_END) else source.start()
        if not start or start.startswith(_MCAP):
            from carla_recap.formats.mcap.reader import McapReader

            return McapReader(source)
        from carla_recap.formats.carla_log import LogReader, is_log

        if not is_log(start):
            raise _not_a_recording(url, start)
        reader = LogReader(url, file=copied(source))
    except BaseException:
        source.close()
        raise
    source.close()
    return reader


def read_start(location: Path | str) -> bytes:
    """Return the first bytes of a local file, which say its format; a `NotARecording` is not a regular file."""
    try:
        path = path_of(location)
        if not path.is_dir() and path.exists() and not path.is_file():
            raise NotARecording(location, "is not a regular file")
        with path.open("rb") as file:
            return file.read(64)
    except IsADirectoryError:
        raise RecapError(f"{location}: is a folder; a recording was expected, a .log or .mcap file") from None
    except OSError as error:
        from carla_recap.util.files import partials

        left = partials(path) if isinstance(error, FileNotFoundError) else []
        raise unfinished(location, left) if left else RecapError(f"{location}: {error.strerror}") from None
    except ValueError as error:
        raise RecapError(f"{location!r}: {error}") from None


def format_of(path: Path | str) -> str:
    """Return the suffix of a destination, which says its format; a `RecapError` if it belongs to none."""
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        found = f"unknown format {suffix!r}" if suffix else "no suffix, which says the format"
        raise RecapError(f"{path}: {found}; {' or '.join(SUFFIXES)} was expected")
    return suffix


def create_writer(
    path: Path | str, header: Header, *, live: bool = False, force: bool = True, format: str | None = None
) -> Writer:
    """Return a writer of a new recording, in the format of a path's suffix, or of another suffix that is given.

    If it is `live`, the data are written as they come, so that a crash loses at most 5 s of the recording; an unfinished
    file is left beside the destination, which `recover` can read. With `force`, a file of that name is replaced; else it is
    an error. A `RecapError` says that the suffix belongs to no format, or that the destination cannot be written.
    """
    if (format or format_of(path)) == ".log":
        from carla_recap.formats.carla_log import LogWriter

        return LogWriter(path, header, live=live, force=force)
    from carla_recap.formats.mcap.writer import McapWriter

    return McapWriter(path, header, live=live, force=force)
