"""A table of numbers that grows and shrinks by rows: one array for each column, so that all rows are worked on at once."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np


class Columns:
    """A struct of arrays: a subclass names its columns, each with the value of a new row, and finds them as attributes.

    The arrays are replaced, not changed in place, when a row comes or goes: what holds one of them keeps the old rows.
    """

    COLUMNS: ClassVar[dict[str, Any]] = {}

    def __init__(self) -> None:
        self.count = 0
        for name, value in self.COLUMNS.items():
            setattr(self, name, np.empty((0, *np.shape(value)), np.asarray(value).dtype))

    def __len__(self) -> int:
        return self.count

    def append_row(self, **values: Any) -> int:
        """Add a row; columns that are not named get their default.

        Returns:
            Its index.
        """
        for name, default in self.COLUMNS.items():
            array = getattr(self, name)
            new = np.asarray(values.get(name, default), array.dtype)
            setattr(self, name, np.concatenate((array, np.broadcast_to(new, array.shape[1:])[None])))
        self.count += 1
        return self.count - 1

    def remove_row(self, row: int) -> None:
        """Take a row out; the ones behind it move up."""
        for name in self.COLUMNS:
            setattr(self, name, np.delete(getattr(self, name), row, axis=0))
        self.count -= 1
