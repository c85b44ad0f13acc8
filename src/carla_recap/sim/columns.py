"""A struct of arrays that grows and shrinks by rows."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np


class StructOfArrays:
    """A table with an array for each column, which allows to compute all rows at once.

    A subclass lists its columns in `COLUMNS`, each with its value in a new row; the arrays are attributes of these names.
    They are replaced, not changed in place, when a row is added or removed.
    """

    COLUMNS: ClassVar[dict[str, Any]] = {}

    def __init__(self) -> None:
        self.count = 0
        for name, value in self.COLUMNS.items():
            setattr(self, name, np.empty((0, *np.shape(value)), np.asarray(value).dtype))

    def __len__(self) -> int:
        return self.count

    def append_row(self, **values: Any) -> int:
        """Add a row and return its index; columns without a value get their default."""
        for name, default in self.COLUMNS.items():
            array = getattr(self, name)
            new = np.asarray(values.get(name, default), array.dtype)
            setattr(self, name, np.concatenate((array, np.broadcast_to(new, array.shape[1:])[None])))
        self.count += 1
        return self.count - 1

    def remove_row(self, row: int) -> None:
        """Remove a row; the rows behind it move up."""
        for name in self.COLUMNS:
            setattr(self, name, np.delete(getattr(self, name), row, axis=0))
        self.count -= 1
