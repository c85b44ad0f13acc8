"""A struct of arrays that grows and shrinks by rows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


class _DeclaredColumn(NamedTuple):
    value: Any


def column(value: Any) -> Any:
    """Declare a column of a `StructOfArrays` by its value in a new row, such as 0.0 for floats."""
    return _DeclaredColumn(value)


class StructOfArrays:
    """A table with an array for each column, which allows to compute all rows at once.

    A subclass declares its columns by `column`, each with its value in a new row; the arrays are attributes of these names.
    They are replaced, not changed in place, when a row is added or removed.
    """

    COLUMNS: ClassVar[dict[str, Any]] = {}
    """The columns, with their values in a new row."""

    def __init_subclass__(cls) -> None:
        cls.COLUMNS = cls.COLUMNS | {
            name: each.value for name, each in vars(cls).items() if isinstance(each, _DeclaredColumn)
        }

    def __init__(self) -> None:
        self.count = 0
        for name, value in self.COLUMNS.items():
            setattr(self, name, np.empty((0, *np.shape(value)), np.asarray(value).dtype))

    def __len__(self) -> int:
        return self.count

    def append_row(self, **values: Any) -> int:
        """Add a row and return its index; columns without a value get their default."""
        for name, default in self.COLUMNS.items():
            rows: NDArray[Any] = getattr(self, name)
            grown = np.empty((self.count + 1, *rows.shape[1:]), rows.dtype)
            grown[:-1], grown[-1] = rows, values.get(name, default)
            setattr(self, name, grown)
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
