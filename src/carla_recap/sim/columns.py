"""A struct of arrays that grows and shrinks by rows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_LEAST: Final = 8  # rows for which there is room at least


class _DeclaredColumn(NamedTuple):
    value: Any


def column(value: Any) -> Any:
    """Declare a column of a `StructOfArrays` by its value in a new row, such as 0.0 for floats."""
    return _DeclaredColumn(value)


class StructOfArrays:
    """A table with an array for each column, which allows to compute all rows at once.

    A subclass declares its columns by `column`, each with its value in a new row; the arrays are attributes of these names.
    They are replaced, not changed in place, when a row is added or removed. Room is kept for further rows, so that adding
    many copies each row a few times only.
    """

    COLUMNS: ClassVar[dict[str, Any]] = {}
    """The columns, with their values in a new row."""

    def __init_subclass__(cls) -> None:
        cls.COLUMNS = cls.COLUMNS | {
            name: each.value for name, each in vars(cls).items() if isinstance(each, _DeclaredColumn)
        }

    def __init__(self) -> None:
        self.count = 0
        self._buffers: dict[str, NDArray[Any]] = {}
        for name, value in self.COLUMNS.items():
            setattr(self, name, np.empty((0, *np.shape(value)), np.asarray(value).dtype))

    def __len__(self) -> int:
        return self.count

    def append_row(self, **values: Any) -> int:
        """Add a row and return its index; columns without a value get their default."""
        for name, default in self.COLUMNS.items():
            buffer = self._buffer_for(name)
            buffer[self.count] = values.get(name, default)
            setattr(self, name, buffer[: self.count + 1])
        self.count += 1
        return self.count - 1

    def remove_row(self, row: int) -> None:
        """Remove a row; the rows behind it move up."""
        for name in self.COLUMNS:
            values: NDArray[Any] = getattr(self, name)
            kept = values[:-1].copy()
            kept[row:] = values[row + 1 :]
            setattr(self, name, kept)
        self.count -= 1

    def _buffer_for(self, name: str) -> NDArray[Any]:
        """Return an array that begins with the rows of a column and has room for one more."""
        array: NDArray[Any] = getattr(self, name)
        buffer = self._buffers.get(name)
        if buffer is None or array.base is not buffer or self.count == len(buffer):
            buffer = np.empty((max(_LEAST, 2 * self.count), *array.shape[1:]), array.dtype)
            buffer[: self.count] = array
            self._buffers[name] = buffer
        return buffer
