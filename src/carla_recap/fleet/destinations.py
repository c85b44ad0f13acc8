"""A file or a folder for each of many recordings, below one folder of this machine or of an object store."""

from __future__ import annotations

import os
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Final

from carla_recap.errors import RecapError
from carla_recap.fleet.engine import map_sources
from carla_recap.fleet.outcomes import one_line
from carla_recap.formats import SUFFIXES
from carla_recap.formats.sources import WEB, is_remote, path_of, scheme_of
from carla_recap.util.files import make_folder, missing_folders, remove_empty, size_of, writing
from carla_recap.util.log import log_info

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
    from typing import Unpack

    from carla_recap.fleet.engine import Processes
    from carla_recap.fleet.outcomes import Outcome, WrittenFile
    from carla_recap.fleet.sources import SourceFile

    Write = Callable[[str, str, bool], WrittenFile]
    """A function that writes: it gets the source, the destination, and whether to replace what is there."""

_LAST: Final = "actors.parquet"  # of the files of a folder, the one that is uploaded last: with it, the folder is complete


def write_file(write: Write, source: str, destination: str, *, force: bool) -> WrittenFile:
    """Write a file or a folder; if the destination is a URL, as a temporary file, which is uploaded when it is complete.

    What is there is replaced with `force`, else it is an error.
    """
    _check_scheme(destination)
    if not is_remote(destination):
        path = os.fspath(path_of(destination))
        written = write(source, path, force)
        return _at(written, path, path)
    from tempfile import TemporaryDirectory

    from carla_recap.formats.remote import modified_at, upload

    if not force and modified_at(destination) is not None:
        raise RecapError(f"{destination}: exists already; --force (in Python, force=True) replaces it")
    with TemporaryDirectory(prefix="carla-recap-") as folder:
        path = os.path.join(folder, destination.rstrip("/").rpartition("/")[2])  # noqa: PTH118
        try:
            written = write(source, path, True)
        except RecapError as error:
            if path in str(error):
                raise RecapError(str(error).replace(path, destination)) from None
            raise
        written = _at(written, path, destination)
        if not Path(path).is_dir():
            upload(Path(path), destination)
        else:
            for file in sorted(Path(path).rglob("*"), key=lambda file: (file.name == _LAST, file)):
                if file.is_file():
                    upload(file, f"{destination}/{file.relative_to(path).as_posix()}")
    return written


def _at(written: WrittenFile, path: str, destination: str) -> WrittenFile:
    size = size_of(path) if written.size is None else written.size
    return replace(written, path=f"{destination}/{written.path}" if written.path else destination, size=size)


@dataclass(slots=True)
class DestinationFolder:
    """The folder or prefix below which a file is written for each of many recordings, of the same name."""

    location: str  # its path, or its URL
    suffix: str  # the suffix of the files; empty for folders
    force: bool = False  # replace what is there; else that is an error
    newer: bool = False  # skip recordings whose file is there, and no older than they are; replace others
    skipped: list[str] = field(default_factory=list)  # the files that were skipped, so far
    again: list[SourceFile] = field(default_factory=list)  # whose file is that of another one, which may yet fail
    missing: set[Path] = field(default_factory=set)  # folders, and those above, that were not there at first

    def __post_init__(self) -> None:
        _check_scheme(self.location)
        with writing(self.location):
            if self.suffix and self.location.lower().endswith(self.suffix) and not Path(self.location).is_dir():
                raise RecapError(f"{self.location}: names a file; a folder was expected, for the files of many recordings")
            if not is_remote(self.location):
                self.location = os.fspath(path_of(self.location))
                there = next((each for each in (Path(self.location), *Path(self.location).parents) if each.exists()), Path())
                if not there.is_dir():
                    raise RecapError(f"{there}: is a file; a folder was expected, for the files of many recordings")
        self.location = self.location.rstrip("/") or "/"

    def file_of(self, source: SourceFile) -> str:
        """Return the path or URL of the file of a recording."""
        name = PurePath(source.name or PurePath(source.location).name)
        name = name.with_suffix("") if name.suffix.lower() in SUFFIXES else name
        return f"{self.location.rstrip('/')}/{name.as_posix()}{self.suffix}"

    def planned(self, sources: Iterable[SourceFile], given: dict[str, str]) -> Iterator[SourceFile]:
        """Yield the recordings that are to be read, or have an error.

        `given` has the files that are written already, or are to be, each with its recording; more are added.
        """
        uploaded = dict[str, float]()
        if self.newer and is_remote(self.location):
            from carla_recap.formats.remote import list_objects

            uploaded = {found.location: found.modified for found in list_objects(self.location, self.location)}
        written = frozenset(given)
        for source in sources:
            path, error = self.file_of(source), source.error
            if error is None and self._is_below(source):
                log_info(__name__, "%s is a file of an earlier run, and is skipped", source.location)
                continue
            if error is None and ".." in PurePath(source.name).parts:
                error = f"{source.location}: its name leads out of {self.location}"
            elif error is None and path in written:
                error = f"{source.location}: has the same name as {given[path]}; both would be written to {path}"
            elif error is None and path in given:
                self.again.append(source)
                continue
            elif error is None:
                given[path] = source.location
                if self.newer and is_current(path, source, uploaded):
                    self.skipped.append(path)
                    continue
                if not is_remote(path):
                    self.missing.update(missing_folders(Path(path).parent))
            yield replace(source, error=error)

    def _is_below(self, source: SourceFile) -> bool:
        """Return whether a recording was found in this folder, which is itself below the folder that was searched."""
        if is_remote(source.location) != is_remote(self.location):
            return False
        found, folder = source.location, self.location
        if not is_remote(folder):
            found, folder = os.path.abspath(found), os.path.abspath(folder)  # noqa: PTH100
        searched = found[: -len(source.name)].rstrip("/")
        return found.startswith(f"{folder}/") and folder.startswith(f"{searched}/")


def is_current(path: str, source: SourceFile, uploaded: Mapping[str, float] | None = None) -> bool:
    """Return whether a file or folder is there, and no older than its recording; the times of objects may be known."""
    if source.modified is None:
        return False
    if not is_remote(path):
        return Path(path).exists() and Path(path).stat().st_mtime >= source.modified
    if uploaded is None:
        from carla_recap.formats.remote import modified_at

        written = modified_at(path)
    else:
        written = uploaded.get(path, uploaded.get(f"{path}/{_LAST}"))
    return written is not None and written >= source.modified


def write_files(
    write: Write, sources: Iterable[SourceFile], folder: DestinationFolder, **processes: Unpack[Processes]
) -> Generator[Outcome[WrittenFile]]:
    """Yield what is written for each of many recordings, or the error, in their order.

    Of recordings of one name, the first that can be written is; the others come behind all recordings, with an error.
    """
    if processes.get("client") is not None and not is_remote(folder.location):
        folder.location = os.path.abspath(folder.location)  # noqa: PTH100
    plain = DestinationFolder(folder.location, folder.suffix, folder.force, folder.newer)
    function, given = partial(_write_one, write, plain), dict[str, str]()
    try:
        while sources:
            planned = folder.planned(sources, given)
            with closing(map_sources(function, planned, **processes)) as outcomes:
                for outcome in outcomes:
                    path = folder.file_of(outcome.source)
                    if outcome.value is None and given.get(path) == outcome.source.location:
                        del given[path]
                    yield outcome
            sources, folder.again = folder.again, []
    finally:
        remove_empty(folder.missing)


def _write_one(write: Write, folder: DestinationFolder, source: SourceFile) -> WrittenFile:
    destination = folder.file_of(source)
    try:
        if not is_remote(destination):
            make_folder(Path(destination).parent)
        return write_file(write, source.address, destination, force=folder.force or folder.newer)
    except (RecapError, OSError, MemoryError):
        raise
    except Exception as error:  # whatever a recording causes, the others are written
        raise RecapError(one_line(error, source)) from error


def _check_scheme(destination: str) -> None:
    if scheme_of(destination) in WEB:
        raise RecapError(f"{destination}: a web server takes no files; a path or s3://BUCKET/KEY was expected")
