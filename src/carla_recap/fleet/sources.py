"""Which recordings are meant: files, folders, globs, and lists of these."""

from __future__ import annotations

import os
from dataclasses import dataclass
from glob import glob, has_magic
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from carla_recap.errors import RecapError
from carla_recap.formats import SUFFIXES

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator


@dataclass(frozen=True, slots=True)
class SourceFile:
    """A recording that was found, or named.

    Attributes:
        location: Its path, or its URL.
        size: Its size in bytes; None if it cannot be read, or was not asked for.
        modified: The time of its last change, in s since 1970; None if unknown.
        etag: What identifies its content in an object store; None for a local file.
        error: Why it, or what should be recordings, cannot be found, in one line; None if it was found, or named.
    """

    location: str
    size: int | None = None
    modified: float | None = None
    etag: str | None = None
    error: str | None = None


def find_sources(sources: Iterable[str | Path], *, errors: Literal["raise", "yield"] = "raise") -> Iterator[SourceFile]:
    """Yield the recordings that some sources mean, in the order of these; each of them once.

    A folder means all .log and .mcap files in it and below, except hidden ones; a glob, all that it matches, `**` included.
    A file that is named is yielded even if it does not exist: to open it says why.

    Args:
        sources: What means recordings.
        errors: "raise"; or "yield": a source that means none is yielded with its error.

    Raises:
        RecapError: A folder or a glob means no recording.
    """
    seen: set[str] = set()
    for source in sources:
        try:
            locations = _expanded(os.fspath(source))
        except RecapError as error:
            if errors == "raise":
                raise
            yield SourceFile(os.fspath(source), error=str(error))
            continue
        for location in locations:
            if location not in seen:
                seen.add(location)
                yield _described(location)


def _expanded(source: str) -> list[str]:
    if Path(source).is_dir():
        found = _in_folder(source)
        expected = "a folder with .log or .mcap files was expected"
    elif has_magic(source) and not Path(source).exists():
        matched = sorted(glob(source, recursive=True))  # noqa: PTH207 - which takes no absolute pattern
        found = [each for match in matched for each in (_in_folder(match) if Path(match).is_dir() else [match])]
        expected = "a glob that matches recordings was expected"
    else:
        return [source]
    if not found:
        raise RecapError(f"{source}: no recordings; {expected}")
    return found


def _in_folder(folder: str) -> list[str]:
    found = []
    for parent, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        found += [
            str(Path(parent, name))
            for name in sorted(files)
            if not name.startswith(".") and Path(name).suffix.lower() in SUFFIXES
        ]
    return found


def _described(location: str) -> SourceFile:
    try:
        status = Path(location).stat()
    except (OSError, ValueError):
        return SourceFile(location)
    return SourceFile(location, status.st_size, status.st_mtime)


def means_one(source: str | Path) -> bool:
    """Return whether a source means one recording by its form: neither a folder nor a glob."""
    return not Path(source).is_dir() and (not has_magic(os.fspath(source)) or Path(source).exists())
