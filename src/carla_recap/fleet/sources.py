"""Which recordings are meant: files, folders, globs and URLs of them, and lists of these."""

from __future__ import annotations

import os
import re
import sys
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import lru_cache
from glob import glob, has_magic
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from carla_recap.errors import RecapError
from carla_recap.formats import SUFFIXES
from carla_recap.formats.sources import WEB, is_remote, path_of, scheme_of, split_time
from carla_recap.util.files import reason_of
from carla_recap.util.log import log_info

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    Sources = str | Path | Iterable[str | Path]

_LONGEST_LINE: Final = 1 << 16  # bytes of a source in a list
_MAGIC: Final = re.compile(r"[*?\[]")


@dataclass(frozen=True, slots=True)
class SourceFile:
    """A recording that was found, or named.

    Attributes:
        location: Its path, or its URL.
        size: Its size in bytes; None if it cannot be read, or was not asked for.
        modified: The time of its last change, in s since 1970; None if unknown.
        etag: What identifies its content in an object store; None for a local file.
        error: Why it, or what should be recordings, cannot be found, in one line; None if it was found, or named.
        name: Its path below the folder, prefix or fixed part of the glob that was searched; of one that was named, its file
            name.
        absolute: Its absolute path, for workers in other folders; None if its location is enough.
    """

    location: str
    size: int | None = None
    modified: float | None = None
    etag: str | None = None
    error: str | None = None
    name: str = field(default="", compare=False)
    absolute: str | None = field(default=None, compare=False)

    @property
    def address(self) -> str:
        """What opens it, wherever the process is that does."""
        return self.absolute or self.location

    def as_given(self, message: str) -> str:
        """Return a message with the location as it was given."""
        return message if self.absolute is None else message.replace(self.absolute, self.location)


def find_sources(sources: Sources, *, errors: Literal["raise", "yield"] = "raise") -> Iterator[SourceFile]:
    """Yield the recordings that some sources mean, in the order of these; each of them once.

    A folder means all .log and .mcap files in it and below, except hidden ones, those of linked folders too, each folder
    once; a glob, all that it matches, `**` included.
    The same holds of prefixes and globs at object stores, in the order of their listing, which has sizes, times and ETags.
    A file that is named is yielded even if it does not exist: to open it says why.

    Args:
        sources: Paths, URLs, or `-` for a list of them on stdin, one in a line; or one of these.
        errors: "raise"; or "yield": a source that means none is yielded with its error.

    Raises:
        RecapError: A folder or a glob means no recording, or cannot be listed; or the list is empty.
        MissingExtra: It is remote, and the extra for that is not installed.
    """
    seen: set[str] = set()
    _real_folder.cache_clear()
    for source in _named(sources):
        try:
            if not source:
                raise RecapError("'': a path or a URL was expected")
            for found in _expanded(source):
                key = found.location if "://" in found.location else _place(found.location)
                if key not in seen:
                    seen.add(key)
                    yield found
        except (RecapError, OSError, ValueError) as error:  # the latter of names that are too long, or have a NUL
            if not isinstance(error, RecapError):
                error = RecapError(f"{source}: {reason_of(error)}")
            if errors == "raise":
                raise error from None
            yield SourceFile(source, error=str(error))


def means_one(source: str | Path) -> bool:
    """Return whether a source means one recording by its form: neither a folder nor a glob nor a list.

    Raises:
        RecapError: It is a URL of an unknown kind.
    """
    if source == "-":
        return False
    if is_remote(source):
        return not _is_glob(str(source)) and (scheme_of(source) in WEB or _has_suffix(split_time(str(source))[0]))
    path = path_of(source)
    return not path.is_dir() and (not has_magic(os.fspath(path)) or path.exists())


def _named(sources: Sources) -> Iterator[str]:
    """Yield sources; instead of `-`, the lines of stdin."""
    for source in [sources] if isinstance(sources, (str, os.PathLike)) else sources:
        if source != "-":
            yield os.fspath(source)
        else:
            names = (os.fsdecode(line.rstrip(b"\r\n")) for line in _lines() if line.strip())
            first = next(names, None)
            if first is None:
                raise RecapError("stdin: no recordings; a list of them was expected, one in a line")
            yield first
            yield from names


def _lines() -> Iterator[bytes]:
    """Yield the lines of stdin."""
    read = sys.stdin.buffer.readline if sys.stdin is not None else lambda _: b""
    for number, line in enumerate(iter(lambda: read(_LONGEST_LINE + 1), b""), 1):
        if len(line) > _LONGEST_LINE:
            raise RecapError(f"stdin: line {number}: a path or a URL of at most {_LONGEST_LINE:,} bytes was expected")
        yield line


def _expanded(source: str) -> Iterator[SourceFile]:
    if is_remote(source):
        yield from _remote(source)
        return
    path = os.fspath(path_of(source)) if scheme_of(source) else source
    errors: list[OSError] = []
    if Path(path).is_dir():
        found, folder = _in_folder(path, errors), path
        expected = "a folder with .log or .mcap files was expected"
    elif has_magic(path) and not Path(path).exists():
        globbed = glob(path, recursive=True)  # noqa: PTH207 - which takes no absolute pattern
        deepest_first = sorted(globbed, key=lambda path: path.count(os.sep), reverse=True)
        matched = sorted({_place(each): each for each in deepest_first}.values())
        found = [each for match in matched for each in (_in_folder(match, errors) if Path(match).is_dir() else [match])]
        folder = os.path.dirname(path[: _MAGIC.search(path).start()])  # type: ignore[union-attr]  # noqa: PTH120
        expected = "a glob that matches recordings was expected"
    else:
        yield _described(path, split_time(Path(path).name)[0])
        return
    for each in found:
        yield _described(each, os.path.relpath(each, folder or os.curdir))
    if errors:
        raise RecapError(f"{errors[0].filename}: {reason_of(errors[0])}")
    if not found:
        raise RecapError(f"{source}: no recordings; {expected}")


def _in_folder(folder: str, errors: list[OSError]) -> list[str]:
    """Return the recordings in a folder and below, of linked folders last; add errors of listing."""
    found = []
    skipped = 0
    tops, known = [folder], set[str]()
    for top in tops:  # which grows
        for parent, folders, files in os.walk(top, onerror=errors.append):
            if (place := os.path.realpath(parent)) in known:
                folders.clear()
                continue
            known.add(place)
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            tops += [path for name in folders if (path := os.path.join(parent, name)) and os.path.islink(path)]  # noqa: PTH114, PTH118
            names = [name for name in files if not name.startswith(".") and Path(name).suffix.lower() in SUFFIXES]
            found += [str(Path(parent, name)) for name in sorted(names)]
            skipped += len(files) - len(names)
    log_info(__name__, "%s has %s recordings; %s other files are skipped", folder, len(found), skipped)
    return found


@lru_cache
def _real_folder(folder: str) -> str:
    return os.path.realpath(folder)


def _place(path: str) -> str:
    """Return the path of a file in its folder itself, whatever links lead there; a link to a file stays one."""
    return os.path.join(_real_folder(os.path.dirname(path)), os.path.basename(path))  # noqa: PTH118, PTH119, PTH120


def _described(location: str, name: str) -> SourceFile:
    try:
        status = Path(split_time(location)[0]).stat()
    except (OSError, ValueError):
        return SourceFile(location, name=name)
    return SourceFile(location, status.st_size, status.st_mtime, name=name)


def _remote(source: str) -> Iterator[SourceFile]:
    """Yield the recordings that a URL means."""
    if scheme_of(source) in WEB:
        if _is_glob(source) or source.endswith("/") or not _key(source):
            raise RecapError(f"{source}: a web server does not list its files; name each file")
        yield SourceFile(source, name=path_of(split_time(source)[0]).name)
        return
    key = _key(source)
    root = source.removesuffix(key).rstrip("/") + "/"
    fixed = key.strip("/")
    if _is_glob(source):
        fixed = key[: min(index for index in map(key.find, "*?[") if index >= 0)].rpartition("/")[0]
    elif _has_suffix(split_time(key)[0]):
        yield SourceFile(source, name=split_time(key)[0].rpartition("/")[2])
        return
    from carla_recap.formats.remote import list_objects

    count, parts = 0, [part for part in key.split("/") if part]
    for location, size, modified, etag in list_objects(root + fixed, source):
        if _matches(parts, location[len(root) :].split("/")):
            count += 1
            yield SourceFile(location, size, modified, etag, name=location[len(root) + len(fixed) :].lstrip("/"))
    if not count:
        raise RecapError(f"{source}: no recordings; a prefix or a glob of .log or .mcap objects was expected")


def _key(url: str) -> str:
    return url.partition("://")[2].partition("/")[2]


def _is_glob(url: str) -> bool:
    key = _key(url)
    return has_magic(key.partition("?")[0] if scheme_of(url) in WEB else key)  # a web server's ? begins the query


def _has_suffix(key: str) -> bool:
    return key.lower().endswith(SUFFIXES)


def _is_listed(below: str) -> bool:
    """Return whether a key below a folder is that of a recording that is not hidden."""
    return _has_suffix(below) and not any(part.startswith(".") for part in below.split("/"))


def _matches(parts: Sequence[str], names: Sequence[str]) -> bool:
    """Return whether the names in a key match the parts of a glob, or begin with a match and are those of a recording."""
    if not parts:
        return not names or _is_listed("/".join(names))
    if parts[0] == "**":
        return _matches(parts[1:], names) or (bool(names) and names[0][:1] != "." and _matches(parts, names[1:]))
    if not names or (names[0].startswith(".") and not parts[0].startswith(".")):
        return False
    return fnmatchcase(names[0], parts[0]) and _matches(parts[1:], names[1:])
