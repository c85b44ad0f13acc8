"""Columns of numbers as one compressed text, for a page that loads from the disk."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

LEVEL: Final = 6  # of compression
_LARGEST: Final = 2.0**30  # units; larger columns get a larger unit


class Packer:
    """Collects columns; `pack` returns them with a value of JSON's types that refers to them.

    The text is base64 of a zlib stream: the length of the JSON as uint32, the JSON, the bytes of the columns. In the JSON, a
    column is an object with the key "column": the offset of its bytes, the number of its values, the number of bytes of
    each, its unit, and the number of times that differences were taken. The values are multiples of the unit, differences
    from the one before, zigzag-encoded, and stored as planes: the lowest bytes of all values, then the next ones.
    """

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._size = 0

    def column(self, values: ArrayLike, unit: float = 1.0, *, order: int = 1) -> dict[str, list[float]]:
        """Add a column of finite numbers, and return the reference to it.

        Args:
            values: The numbers.
            unit: The precision; numbers of more than a thousand million units get a larger one.
            order: The number of times to take differences: 0 for numbers that do not continue each other, 1 for those that
                do, 2 for those that change steadily.
        """
        numbers = np.asarray(values, np.float64)
        unit = max(unit, float(np.abs(numbers).max(initial=0.0)) / _LARGEST)
        whole = np.rint(numbers / unit).astype(np.int64)
        for _ in range(order):
            whole = np.diff(whole, prepend=np.int64(0))
        wrapped = whole.astype(np.int32)  # the reader's sums wrap as well
        zigzag = ((wrapped << 1) ^ (wrapped >> 31)).astype("<u4")
        planes = max(1, (int(zigzag.max(initial=0)).bit_length() + 7) // 8)
        self._add(zigzag.view(np.uint8).reshape(-1, 4).T[:planes].tobytes())
        return {"column": [self._size - planes * len(zigzag), len(zigzag), planes, unit, order]}

    def _add(self, part: bytes) -> None:
        self._parts.append(part)
        self._size += len(part)

    def pack(self, value: Any) -> str:
        """Return a value of JSON's types, with the columns, as text.

        Raises:
            ValueError: The value contains NaN or infinity.
        """
        head = json.dumps(value, separators=(",", ":"), allow_nan=False).encode()
        content = b"".join((struct.pack("<I", len(head)), head, *self._parts))
        return base64.b64encode(zlib.compress(content, LEVEL)).decode()
