"""The content of OpenDRIVE files, and the errors about it."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

from carla_recap.errors import FormatError, RecapError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_LARGEST: Final = 128 << 20  # bytes of a file


def read_content(path: Path) -> bytes:
    """Return the content of an OpenDRIVE file.

    Raises:
        RecapError: The file cannot be read.
    """
    if path.exists() and not path.is_file():
        raise RecapError(f"{path}: is not a regular file")
    try:
        with path.open("rb") as file:
            content = file.read(_LARGEST + 1)
    except (OSError, ValueError) as error:
        raise RecapError(f"{path}: {getattr(error, 'strerror', error)}") from None
    if len(content) > _LARGEST:
        raise RecapError(f"{path}: is larger than {_LARGEST >> 20} MB, which no map is")
    return content


def decode(content: bytes) -> str:
    """Return the text of an OpenDRIVE file."""
    return content.decode("utf-8-sig", "replace")


@contextmanager
def expecting_map(path: Path) -> Iterator[None]:
    """Name the file in the errors about the content of an OpenDRIVE file.

    Raises:
        FormatError: The file is no OpenDRIVE map.
    """
    try:
        yield
    except (ValueError, ArithmeticError) as error:
        raise FormatError(path, None, f"an OpenDRIVE map was expected: {error}") from None
