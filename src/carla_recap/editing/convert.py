"""Conversion from one format to the other without loss."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from carla_recap.errors import RecapError
from carla_recap.formats import create_writer, format_of, open_reader
from carla_recap.formats.sources import is_remote, path_of
from carla_recap.util.files import check_path

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Extent

    Progress = Callable[[Iterable[Batch], Reader], Iterable[Batch]]


def convert(
    source: Path | str,
    destination: Path | str,
    *,
    force: bool = False,
    progress: Progress | None = None,
) -> Extent:
    """Write a recording in another format; `.log` → `.mcap` → `.log` gives back the same bytes.

    Args:
        source: A recording of any format, or its URL.
        destination: The file to write; the suffix says the format. It appears when it is complete.
        force: Overwrite an existing file.
        progress: Gets the batches and their reader, and yields the batches.

    Returns:
        The extent of the recording.

    Raises:
        RecapError: The source is damaged, or the destination cannot be written.
    """
    check_destination(source, destination, force=force)
    reader = open_reader(source)
    try:
        with create_writer(destination, reader.header, force=force) as writer:
            batches: Iterable[Batch] = reader.batches()
            for batch in progress(batches, reader) if progress else batches:
                writer.write_batch(batch)
            for piece in reader.tail():
                writer.write_tail(piece)
        return reader.extent()
    finally:
        reader.close()


def check_destination(source: Path | str, destination: Path | str, *, force: bool) -> None:
    """Check that a destination is not the source, and that it does not exist or `force` is true.

    Raises:
        RecapError: It is the source, or it exists.
    """
    target = Path(destination)
    try:
        same = not is_remote(source) and target.exists() and path_of(source).exists() and target.samefile(path_of(source))
    except (OSError, ValueError) as error:
        raise RecapError(f"{str(destination)[:200]}: cannot be written: {_reason(error)}") from None
    if same:
        raise RecapError(f"{destination}: is the source itself")
    check_free(destination, force=force)


def check_free(destination: Path | str, *, force: bool) -> None:
    """Check that a destination does not exist, or that `force` is true.

    Raises:
        RecapError: It exists, or is a URL.
    """
    check_path(destination)
    try:
        exists = Path(destination).exists() or Path(destination).is_symlink()
    except (OSError, ValueError) as error:
        raise RecapError(f"{str(destination)[:200]}: cannot be written: {_reason(error)}") from None
    if exists and not force:
        raise RecapError(f"{destination}: exists already; --force (in Python, force=True) replaces it")


def check_new(destination: Path | str, *, force: bool) -> None:
    """Check that a recording can be written to a destination; see `check_free`.

    Raises:
        RecapError: The suffix is of no format, the folder is missing, or the destination exists.
    """
    format_of(destination)
    check_free(destination, force=force)
    path = Path(destination)
    if path.is_dir():
        raise RecapError(f"{destination}: cannot be written: is a directory")
    if not path.parent.is_dir():
        raise RecapError(f"{destination}: cannot be written: there is no folder {path.parent}")


def _reason(error: OSError | ValueError) -> str:
    return str(getattr(error, "strerror", None) or error)
