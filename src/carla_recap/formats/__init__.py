"""The file formats of recordings, each a reader and a writer of frames; found by content to read, by suffix to write."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from carla_recap.errors import NotARecording, RecapError

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader, Writer
    from carla_recap.frame import Header

SUFFIXES = (".log", ".mcap")


def open_reader(path: Path | str) -> Reader:
    """Open a recording of either format.

    Raises:
        NotARecording: The content is of neither.
        FormatError: The content is damaged.
        RecapError: The file cannot be read.
    """
    # Each format is imported when it is needed, for a command on a small file should not wait.
    from carla_recap.formats.carla_log import LogReader, is_log

    start = read_start(path)
    if is_log(start):
        return LogReader(path)
    if start.startswith(b"\x89MCAP"):
        from carla_recap.formats.mcap.reader import McapReader

        return McapReader(path)
    if not start:
        raise NotARecording(path, "is empty; a CARLA log or an MCAP recording was expected")
    raise NotARecording(path, "is not a recording (neither CARLA's log nor MCAP)")


def read_start(path: Path | str) -> bytes:
    """The first bytes of a file, by which its format is known.

    Raises:
        NotARecording: It is no regular file.
        RecapError: It cannot be read.
    """
    try:
        if not Path(path).is_dir() and Path(path).exists() and not Path(path).is_file():
            raise NotARecording(path, "is not a regular file")
        with Path(path).open("rb") as file:
            return file.read(64)
    except OSError as error:
        raise RecapError(f"{path}: {error.strerror}") from None
    except ValueError as error:
        raise RecapError(f"{path!r}: {error}") from None


def format_of(path: Path | str) -> str:
    """The suffix of a destination, which says its format.

    Raises:
        RecapError: It is of no format.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        found = f"unknown format {suffix!r}" if suffix else "no suffix, which says the format"
        raise RecapError(f"{path}: {found}; {' or '.join(SUFFIXES)} was expected")
    return suffix


def create_writer(path: Path | str, header: Header, *, live: bool = False, force: bool = True) -> Writer:
    """Begin a recording in the format of a path's suffix.

    Args:
        path: The destination, ending in .log or .mcap.
        header: The header.
        live: Write the data as it comes, so that a crash costs 5 s of recording at the most. What cannot be
            finished is left beside the destination, where `recover` takes it.
        force: Take the place of what is at the destination by the end; else that is an error.

    Raises:
        RecapError: The suffix is of no format, or the place cannot be written to.
    """
    if format_of(path) == ".log":
        from carla_recap.formats.carla_log import LogWriter

        return LogWriter(path, header, live=live, force=force)
    from carla_recap.formats.mcap.writer import McapWriter

    return McapWriter(path, header, live=live, force=force)
