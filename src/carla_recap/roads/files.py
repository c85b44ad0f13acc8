"""The content of OpenDRIVE and route files, and the errors about it."""

from __future__ import annotations

from codecs import getincrementaldecoder
from contextlib import contextmanager
from hashlib import sha256
from typing import TYPE_CHECKING, Final

from carla_recap.errors import FormatError, RecapError
from carla_recap.util.files import IS_LFS_POINTER, LFS_POINTER, reason_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

_LARGEST: Final = 128 << 20  # bytes of a file
_PART: Final = 1 << 20  # bytes


def read_text(path: Path) -> str:
    """Return the text of an OpenDRIVE file; a `RecapError` if it cannot be read."""
    return "".join(read_parts(path))


def read_parts(path: Path, what: str = "map") -> Iterator[str]:
    """Yield the text of a file, part by part; a `RecapError`, which names the kind of file, if it cannot be read."""
    decoder = getincrementaldecoder("utf-8-sig")("replace")
    for part in _parts(path, what):
        yield decoder.decode(part)
    yield decoder.decode(b"", final=True)


def content_digest(path: Path) -> bytes:
    """Return a digest of the content of an OpenDRIVE file; a `RecapError` if it cannot be read."""
    digest = sha256()
    for part in _parts(path):
        digest.update(part)
    return digest.digest()


def _parts(path: Path, what: str = "map") -> Iterator[bytes]:
    if path.exists() and not path.is_file():
        raise RecapError(f"{path}: is not a regular file")
    try:
        with path.open("rb") as file:
            while part := file.read(_PART):
                if file.tell() > _LARGEST:
                    raise RecapError(f"{path}: is larger than {_LARGEST >> 20} MB, which no {what} is")
                if part.startswith(LFS_POINTER):
                    raise RecapError(f"{path}: {IS_LFS_POINTER}")
                yield part
    except (OSError, ValueError) as error:
        raise RecapError(f"{path}: {reason_of(error)}") from None


@contextmanager
def expecting(path: Path, what: str = "an OpenDRIVE map") -> Iterator[None]:
    """Turn errors about the content of a file into a `FormatError` that names the file and what it should be."""
    try:
        yield
    except (ValueError, ArithmeticError) as error:
        raise FormatError(path, None, f"{what} was expected: {error}") from None
