"""Lines on their way from one process to another: as the bytes of an .npz."""

from __future__ import annotations

from io import BytesIO
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Lines = dict[str, list[NDArray[Any]]]


_SIZES: Final = ".sizes"


def pack(lines: Lines) -> bytes:
    """Lists of lines by name, as bytes; those of a list are (n, 3), or else all of one width and type."""
    arrays: dict[str, Any] = {}
    for name, group in lines.items():
        arrays[name] = np.concatenate(group) if group else np.empty((0, 3))
        arrays[name + _SIZES] = np.array([len(line) for line in group], np.int64)
    file = BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def unpack(data: bytes) -> Lines:
    """The lists of lines again."""
    with np.load(BytesIO(data)) as arrays:
        names = [name for name in arrays.files if not name.endswith(_SIZES)]
        return {name: np.split(arrays[name], np.cumsum(arrays[name + _SIZES]))[:-1] for name in names}
