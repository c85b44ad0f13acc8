"""A folder that appears under its name only when it is complete."""

from __future__ import annotations

import os
import shutil
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from collections.abc import Iterator


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
