"""What a recording is read from: a file of this machine, or an object at a URL; parts of it are read, each checked.

A location is a path or a URL, as the caller gives it: `runs/crash.mcap`, `s3://bucket/runs/crash.mcap`.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, BinaryIO, Final, NamedTuple
from urllib.parse import unquote, urlsplit

from carla_recap.errors import Closed, FormatError, RecapError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    ByteRange = tuple[int, int]
    """The offset of some bytes, and their number."""

SCHEMES: Final = ("s3", "s3a", "gs", "az", "adl", "azure", "abfs", "abfss", "http", "https")
"""The kinds of URLs that are read over the network."""
_TIMES: Final = re.compile(r"(.+)#t=(?:npt:)?([0-9]+(?:\.[0-9]*)?)(?:,([0-9]+(?:\.[0-9]*)?))?", re.DOTALL)
_URL: Final = re.compile("([A-Za-z][A-Za-z0-9+.-]+)://")
WEB: Final = ("http", "https")
"""The kinds of URLs of web servers, which list no files."""


class ByteSource:
    """What a reader reads from; threads may read at the same time."""

    size = 0  # bytes
    etag: str | None = None  # what identifies its content in an object store; None: a local file, or the server does not say
    bytes_read = 0  # so far
    is_remote = False  # whether it is read over the network

    def __init__(self, location: Path | str) -> None:
        self.location = os.fspath(location)  # its path or URL, as given; for messages
        self.path = path_of(location)  # its path; of a URL, one with the same name, which says nothing about this machine
        self._lock = Lock()

    def read(self, offset: int, size: int, what: str) -> bytes:
        """Return some bytes, or raise `FormatError` or `RecapError`, which say `what` they should be."""
        raise NotImplementedError

    def read_ranges(self, spans: Iterable[ByteRange], what: str, *, whole: bool = False) -> Iterator[bytes]:
        """Yield the bytes of each of some spans, in their order; those of an object are fetched many at a time.

        With `whole`, all are wanted for certain; else, few are fetched at first.
        """
        return (self.read(offset, size, what) for offset, size in spans)

    def check_open(self) -> None:
        """Raise `Closed` if it is closed."""
        raise NotImplementedError

    def close(self) -> None:
        """Close it; do nothing if it is closed."""
        raise NotImplementedError

    def _check(self, offset: int, size: int, what: str) -> None:
        """Check that bytes can be read."""
        if offset < 0 or size < 0 or offset + size > self.size:
            message = f"{what} of {size} bytes does not fit in the file of {self.size}"
            raise FormatError(self.location, offset, message)
        self.check_open()


class LocalSource(ByteSource):
    """A file of this machine, or in place of it an unbuffered `file`, such as a copy of an object; see `ByteSource`."""

    def __init__(self, location: Path | str, file: BinaryIO | None = None) -> None:
        super().__init__(location)
        try:
            self._file: BinaryIO = file or self.path.open("rb", buffering=0)
            self.size = self._file.seek(0, 2)
        except OSError as error:
            raise RecapError(f"{location}: {error.strerror}") from None

    def read(self, offset: int, size: int, what: str) -> bytes:
        """Return some bytes; see `ByteSource.read`."""
        self._check(offset, size, what)
        try:
            with self._lock:  # the next chunk may be read by another thread
                self._file.seek(offset)
                data = self._file.read(size)
                while len(data) < size and (more := self._file.read(size - len(data))):  # network mounts read short
                    data += more
                self.bytes_read += len(data)
        except OSError as error:
            raise RecapError(f"{self.location}: {error.strerror}") from None
        if len(data) < size:
            raise FormatError(self.location, offset + len(data), "the file has become shorter while it was read")
        return data

    def check_open(self) -> None:
        """Check that the file is not closed; see `ByteSource.check_open`."""
        if self._file.closed:
            raise Closed(self.location)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def scheme_of(location: Path | str) -> str:
    """Return the scheme of a URL, in small letters; nothing for a path. A `Path` is never a URL."""
    found = _URL.match(location) if isinstance(location, str) else None
    return found[1].lower() if found else ""


def is_remote(location: Path | str) -> bool:
    """Return whether a location is read over the network, or raise `RecapError` for an unknown kind of URL."""
    scheme = scheme_of(location)
    if scheme in ("", "file"):
        return False
    if scheme not in SCHEMES:
        raise RecapError(f"{location}: unknown kind of URL; s3, gs, az, abfs, http, https or file was expected")
    return True


def path_of(location: Path | str) -> Path:
    """Return the path of a file; of the URL of an object, one with the same name, which says nothing about this machine."""
    scheme = scheme_of(location)
    try:
        url = urlsplit(str(location) if scheme else "")
    except ValueError as error:
        raise RecapError(f"{location}: {error}") from None
    if scheme == "file":
        if url.netloc not in ("", "localhost"):
            raise RecapError(f"{location}: is on another machine; file:///PATH was expected")
        from urllib.request import url2pathname  # which imports much

        return Path(url2pathname(url.path))
    if scheme in WEB:
        return Path(f"{url.scheme}://{url.netloc}{unquote(url.path)}")
    return Path(location)


def unsigned(location: str) -> str:
    """Return a location without the query of a web server's URL, which may be a signature, for files that are passed on."""
    return location.partition("?")[0] if scheme_of(location) in WEB else location


class TimeFragment(NamedTuple):
    """The times that the end of a location names, in elapsed seconds: a moment, or a span if it has a stop."""

    start: float
    stop: float | None


def split_time(location: str) -> tuple[str, TimeFragment | None]:
    """Return a location without the times at its end, and these: `runs/crash.mcap#t=12.1`, or `#t=12.1,20`.

    Media fragments of the W3C have this form. A local file of such a name is a file.
    """
    found = _TIMES.fullmatch(location)
    if found is None:
        return location, None
    try:
        if scheme_of(location) in ("", "file") and path_of(location).exists():
            return location, None
    except (OSError, ValueError):  # such as a name that is too long
        return location, None
    start, stop = float(found[2]), None if found[3] is None else float(found[3])
    return found[1], TimeFragment(start, stop)
