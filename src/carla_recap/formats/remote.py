"""Objects in object stores and files on web servers, read in ranges with obstore: the one module that imports it.

The last `TAIL` bytes come with the first request, together with size and ETag; an MCAP file has its summary there. Further
parts are fetched many at a time, and only from an object that has not changed since.
"""

from __future__ import annotations

import os
import re
import tempfile
from bisect import bisect_right
from collections import deque
from concurrent.futures import Future
from datetime import timedelta
from functools import lru_cache, partial
from shutil import disk_usage
from threading import Thread
from typing import TYPE_CHECKING, BinaryIO, Final, NamedTuple, TypeVar

from carla_recap.errors import Closed, MissingExtra, NoCredentials, NotARecording, RecapError
from carla_recap.formats.sources import WEB, ByteSource, scheme_of, unsigned
from carla_recap.util.log import log_debug, log_info
from carla_recap.util.text import single_line

try:
    import obstore
    from obstore.exceptions import (
        BaseError,
        NotSupportedError,
        PermissionDeniedError,
        PreconditionError,
        UnauthenticatedError,
    )
    from obstore.store import HTTPStore, from_url
except ModuleNotFoundError:
    raise MissingExtra("a recording at a URL", "remote") from None

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from pathlib import Path

    from obstore import GetOptions, ObjectMeta
    from obstore.store import ClientConfig, ObjectStore, RetryConfig

    from carla_recap.formats.sources import ByteRange

T = TypeVar("T")

TAIL: Final = 512 << 10
"""The bytes at the end of an object that are fetched when it is opened."""
_BLOCK: Final = 64 << 10  # bytes that are fetched at least; a gap of fewer is fetched, too, instead of another request
_FIRST_WINDOW: Final = 256 << 10  # bytes that are fetched first of a long read, which may end early
_WINDOW: Final = 8 << 20  # bytes that are fetched at once later, and as many again ahead of them
_PART: Final = 4 << 20  # bytes of a file that is copied, for each request
_AT_ONCE: Final = 32  # requests
_METADATA: Final = ("/latest/api/token", "/latest/meta-data", "metadata.google.internal", "/metadata/identity")
"""Where keys are looked for last."""
_MESSAGE: Final = re.compile('(?:message|error): "([^"]+)"')
_STATUS: Final = re.compile(r"status code: ([0-9]+ [A-Za-z -]+)")
_REFUSED: Final = re.compile("the server answers (400|501) |: is empty; ")
_OTHER_RANGE: Final = re.compile(r"Requested ([0-9]+)\.\.([0-9]+), got ([0-9]+)\.\.([0-9]+)")
_KIND: Final = re.compile("^Generic [A-Za-z0-9]+ error: ")
_CLIENT: Final[ClientConfig] = {
    "allow_http": True,
    "connect_timeout": timedelta(seconds=5),
    "read_timeout": timedelta(seconds=20),
    "timeout": timedelta(seconds=120),
}
_RETRIES: Final[RetryConfig] = {
    "max_retries": 3,
    "retry_timeout": timedelta(seconds=30),
    "backoff": {"init_backoff": timedelta(milliseconds=100), "max_backoff": timedelta(seconds=2), "base": 2},
}
_VARIABLES: Final = ("AWS_", "AZURE_", "GOOGLE_")
_PLAIN: Final = re.compile("[A-Za-z0-9_.,=~-]+(/[A-Za-z0-9_.,=~-]+)*")  # a path without encoded characters
_LONGEST_REASON: Final = 300  # characters
_NO_KEYS: Final = (
    "no credentials were found in the environment, such as AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY; "
    "a public bucket needs none with AWS_SKIP_SIGNATURE=true"
)
_REASONS: Final[tuple[tuple[tuple[type[Exception], ...], tuple[str, ...], str], ...]] = (
    ((FileNotFoundError,), (), "not found (404)"),
    ((PermissionDeniedError,), (), "the server denies access (403)"),
    ((UnauthenticatedError,), (), "the server expects credentials (401)"),
    ((NotSupportedError,), (), "the server sends no ranges of a file, only all of it; download it"),
    ((), ("non-partial response",), "the server sends no ranges of it, or it is empty"),
    ((), _METADATA, _NO_KEYS),
    ((), ("IncompleteMessage", "response body error"), "the server has hung up"),
    ((), ("TimedOut",), "the server does not answer in time"),
)
"""Errors by their class or by parts of their text, and what each means."""


class ObjectAddress(NamedTuple):
    """An object: its store, and its key there."""

    store: ObjectStore
    key: str


def address_of(url: str) -> ObjectAddress:
    """Return the object at a URL. Keys, endpoint and region come from the environment, as obstore reads it."""
    scheme = scheme_of(url)
    root, _, key = url.partition("://")[2].partition("/")
    if not root:
        raise RecapError(f"{url}: expected {scheme}://{'HOST/PATH' if scheme in WEB else 'BUCKET/KEY'}")
    try:
        if scheme in WEB and not _PLAIN.fullmatch(key):  # a key would be encoded in another spelling
            return ObjectAddress(_store(url, _settings()), "")
        return ObjectAddress(_store(f"{scheme}://{root}", _settings()), key)
    except (BaseError, ValueError) as error:
        raise RecapError(f"{url}: {_reason(error)}") from None


class ListedObject(NamedTuple):
    """An object of a listing: its URL, its size in bytes, the time of its last change in s since 1970, and its ETag."""

    location: str
    size: int
    modified: float
    etag: str | None


def list_objects(url: str, source: str = "") -> Iterator[ListedObject]:
    """Yield the objects below a URL, in the order of the server, as they are listed; messages name the `source` instead."""
    store, key = address_of(url)
    root = url[: len(url) - len(key)]
    root = root if root.endswith("/") else f"{root}/"
    try:
        log_info(__name__, "lists %s", unsigned(url))
        listing = obstore.list(store, key or None, chunk_size=1000)
        while listed := _started(partial(next, listing, ())).result():
            for meta in listed:
                modified = meta["last_modified"].timestamp()
                yield ListedObject(root + meta["path"], meta["size"], modified, meta["e_tag"])
    except (BaseError, OSError, ValueError) as error:
        if " 404 " in str(error):
            raise RecapError(f"{source or url}: no such bucket or prefix") from None
        raise _failed(f"{source or url}: cannot be listed", error) from None


def modified_at(url: str) -> float | None:
    """Return the time of the last change of an object, in s since 1970; None if there is no such object."""
    store, key = address_of(url)
    try:
        return _started(partial(obstore.head, store, key)).result()["last_modified"].timestamp()
    except FileNotFoundError:
        return None
    except (BaseError, OSError, ValueError) as error:
        raise _failed(f"{url}: cannot be read", error) from None


def upload(path: Path, url: str) -> None:
    """Copy a file to an object, which appears when all of it is there, or raise `RecapError`."""
    store, key = address_of(url)
    try:
        log_info(__name__, "uploads %s", unsigned(url))
        _started(partial(obstore.put, store, key, path)).result()
    except (BaseError, OSError, ValueError) as error:
        if isinstance(error, FileNotFoundError):
            raise RecapError(f"{url}: cannot be written: no such bucket") from None
        raise _failed(f"{url}: cannot be written", error) from None


def _settings() -> frozenset[tuple[str, str]]:
    """Return the part of the environment that obstore reads."""
    return frozenset((name, value) for name, value in os.environ.items() if name.upper().startswith(_VARIABLES))


@lru_cache(64)
def _store(root: str, settings: frozenset[tuple[str, str]]) -> ObjectStore:
    """Return a store, whose connections serve all its objects; a new one if the environment has changed."""
    if scheme_of(root) in WEB:
        return HTTPStore.from_url(root, client_options=_CLIENT, retry_config=_RETRIES)
    return from_url(root, client_options=_CLIENT, retry_config=_RETRIES)


class RemoteSource(ByteSource):
    """An object in an object store, or a file on a web server; see `ByteSource`."""

    is_remote = True

    def __init__(self, url: str) -> None:
        super().__init__(url)
        self._address = address_of(url)
        self._closed = False
        self._block = 0, b""  # the offset of the bytes that were read last, and these
        tail, meta = _started(self._get_tail).result()
        self.size, self.etag = meta["size"], meta["e_tag"]
        self._tail = self.size - len(tail), tail

    def read(self, offset: int, size: int, what: str) -> bytes:
        """Return some bytes; see `ByteSource.read`."""
        self._check(offset, size, what)
        for begin, data in (self._tail, self._block):
            if begin <= offset and offset + size <= begin + len(data):
                return data[offset - begin : offset - begin + size]
        fetched = max(size, min(_BLOCK, self._tail[0] - offset))
        data = _started(partial(self._fetch, offset, fetched)).result()
        self._block = offset, data
        return data[:size]

    def read_ranges(self, spans: Iterable[ByteRange], what: str, *, whole: bool = False) -> Iterator[bytes]:
        """Yield the bytes of each of some spans; see `ByteSource.read_ranges`."""
        # The second window is asked for when all of the first one was used: many a read ends there.
        coming: Future[deque[bytes]] | None = None
        for number, window in enumerate(_windows(spans, self._tail[0], _WINDOW if whole else _FIRST_WINDOW)):
            fetched = coming.result() if coming is not None else deque[bytes]()
            coming = _started(partial(self._fetch_all, window, what))
            yield from _each(fetched if number else coming.result())
            coming = coming if number else None
        if coming is not None:
            yield from _each(coming.result())

    def start(self) -> bytes:
        """Return the first bytes, which say the format."""
        return self.read(0, min(64, self.size), "the start")

    def ends_with(self, end: bytes) -> bool:
        """Return whether these are the last bytes."""
        return self._tail[1].endswith(end)

    def check_open(self) -> None:
        """Check that it is not closed; see `ByteSource.check_open`."""
        if self._closed:
            raise Closed(self.location)

    def close(self) -> None:
        """Forget the bytes; do nothing if that was done."""
        self._closed = True
        self._tail = self._block = 0, b""

    def _fetch_all(self, spans: Sequence[ByteRange], what: str) -> deque[bytes]:
        """Return the bytes of some spans, fetched at once."""
        for offset, size in spans:
            self._check(offset, size, what)
        begin, tail = self._tail
        joined = _joined(spans, begin)
        if len(joined) == 1 and begin - sum(joined[0]) < _BLOCK and self.size - joined[0][0] <= _WINDOW:
            # The events of a long recording begin before the tail; they are asked for again.
            offset = joined.pop()[0]
            tail = _started(partial(self._fetch, offset, begin - offset)).result() + tail
            begin = offset
            self._tail = begin, tail
        parts = _at_once(lambda span: self._fetch(*span), joined)
        starts, parts = [*(offset for offset, _ in joined), begin], [*parts, tail]
        found = deque[bytes]()
        for offset, size in spans:
            index = bisect_right(starts, offset) - 1
            at = offset - starts[index]
            found.append(parts[index][at : at + size])
        return found

    def _fetch(self, offset: int, size: int) -> bytes:
        if size == 0:
            return b""
        return self._get({"range": (offset, offset + size)})[0]

    def _get_tail(self) -> tuple[bytes, ObjectMeta]:
        """Return the last bytes, and the description of the object; see `_get`.

        Some small web servers refuse to count ranges from the end; they are asked for the size first.
        """
        try:
            return self._get({"range": {"suffix": TAIL}})
        except RecapError as error:
            if scheme_of(self.location) not in WEB or not _REFUSED.search(str(error)):
                raise
            try:
                size = obstore.head(*self._address)["size"]
            except (BaseError, OSError, ValueError):
                size = 0
            if not size:
                raise
        return self._get({"range": (max(size - TAIL, 0), size)})

    def _get(self, options: GetOptions) -> tuple[bytes, ObjectMeta]:
        """Return what the server sends, and the description of the object."""
        self.check_open()
        if self.etag and not self.etag.startswith("W/"):  # which never matches
            options["if_match"] = self.etag
        try:
            found = obstore.get(*self._address, options=options)
            meta, data = found.meta, bytes(found.bytes())
            log_debug(__name__, "got %s bytes of %s", len(data), unsigned(self.location))
        except PreconditionError:
            raise self._changed() from None
        except (BaseError, OSError, ValueError) as error:
            if " 416 " in str(error):  # there are no bytes of an empty file
                if self.size:
                    raise self._changed() from None
                raise NotARecording(self.location, "is empty; a CARLA log or an MCAP recording was expected") from None
            raise _failed(f"{self.location}: cannot be read", error) from None
        expected = found.range[1] - found.range[0]
        if len(data) != expected:
            raise RecapError(f"{self.location}: cannot be read: the server sent {len(data)} of {expected} bytes")
        with self._lock:
            self.bytes_read += len(data)
        if self.size and (meta["size"], meta["e_tag"]) != (self.size, self.etag):
            raise self._changed()
        return data, meta

    def _changed(self) -> RecapError:
        return RecapError(f"{self.location}: has changed while it was read; try it again")


def _started(function: Callable[[], T]) -> Future[T]:
    """Call a function in a thread of its own, so that Ctrl-C does not wait for a server."""
    future: Future[T] = Future()

    def work() -> None:
        try:
            future.set_result(function())
        except BaseException as error:
            future.set_exception(error)

    Thread(target=work, name="carla-recap-remote", daemon=True).start()
    return future


def _at_once(fetch: Callable[[ByteRange], bytes], spans: Sequence[ByteRange]) -> list[bytes]:
    """Return what is fetched for each of some spans, with several requests at the same time."""
    parts = dict.fromkeys(range(len(spans)), b"")
    waiting = deque(enumerate(spans))

    def work() -> None:
        while waiting:
            try:
                index, span = waiting.popleft()
            except IndexError:  # another thread has taken the last one
                return
            parts[index] = fetch(span)

    try:
        for future in [_started(work) for _ in range(min(len(spans), _AT_ONCE))]:
            future.result()
    finally:
        waiting.clear()
    return list(parts.values())


def copy_of(url: str) -> BinaryIO:
    """Return a copy of an object; see `copied`."""
    source = RemoteSource(url)
    try:
        return copied(source)
    finally:
        source.close()


def copied(source: RemoteSource) -> BinaryIO:
    """Return a copy of an object, an unbuffered file without a name that is removed when it is closed."""
    folder = tempfile.gettempdir()
    try:
        free = disk_usage(folder).free
        if free < source.size:
            raise RecapError(f"{source.location}: {source.size} bytes do not fit on the disk of {folder}, {free} are free")
        file = tempfile.TemporaryFile(prefix="carla-recap-", buffering=0)  # noqa: SIM115
        try:
            spans = ((offset, min(_PART, source.size - offset)) for offset in range(0, source.size, _PART))
            for data in source.read_ranges(spans, "the file", whole=True):
                view = memoryview(data)
                while view:
                    view = view[file.write(view) :]
            file.seek(0)
        except BaseException:
            file.close()
            raise
    except OSError as error:
        raise RecapError(f"{source.location}: cannot be copied to {folder}: {error.strerror}") from None
    return file


def _windows(spans: Iterable[ByteRange], stop: int, limit: int) -> Iterator[list[ByteRange]]:
    """Yield spans in parts, the first of limited size, each twice as large; bytes from an offset on are there already."""
    window: list[ByteRange] = []
    total = 0
    for span in spans:
        size = span[1] if span[0] < stop else 0
        if window and total + size > limit:
            yield window
            window, total, limit = [], 0, min(2 * limit, _WINDOW)
        window.append(span)
        total += size
    if window:
        yield window


def _joined(spans: Iterable[ByteRange], stop: int) -> list[ByteRange]:
    """Return spans that contain those that begin before an offset, with gaps between them that are worth a request.

    `obstore.get_ranges` joins ranges, too, but takes no ETag: old and new content of an object could be mixed.
    """
    joined: list[ByteRange] = []
    for offset, size in sorted(spans):
        if offset >= stop:
            break
        if joined and offset - sum(joined[-1]) < _BLOCK:
            begin, length = joined[-1]
            joined[-1] = begin, max(length, offset + size - begin)
        else:
            joined.append((offset, size))
    return joined


def _each(parts: deque[bytes]) -> Iterator[bytes]:
    """Yield parts, each of which is forgotten then."""
    while parts:
        yield parts.popleft()


def _failed(what: str, error: Exception) -> RecapError:
    """Return the error about what has failed."""
    kind = NoCredentials if any(host in str(error) for host in _METADATA) else RecapError
    return kind(f"{what}: {_reason(error)}")


def _reason(error: Exception) -> str:
    """Return in one line why an object cannot be read."""
    text = str(error)
    for kinds, parts, reason in _REASONS:
        if isinstance(error, kinds) or any(part in text for part in parts):
            return reason
    if (other := _OTHER_RANGE.search(text)) is not None:
        start, stop, begin, end = map(int, other.groups())
        return f"the server sent {end - begin} of {stop - start} bytes"
    if (status := _STATUS.search(text)) is not None:
        return f"the server answers {status[1]}"
    first = text.partition("\n")[0].rpartition(" - ")[2]
    said = _MESSAGE.findall(text)
    return single_line(said[-1] if said else _KIND.sub("", first))[:_LONGEST_REASON]
