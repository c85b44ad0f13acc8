"""Answers as tables: a list of dataclass rows that becomes a pandas DataFrame or an Arrow table."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, get_type_hints

import numpy as np

from carla_recap.errors import MissingExtra

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

T = TypeVar("T")


class Rows(list[T]):
    """A list of rows, all of one dataclass.

    Attributes:
        row_type: The dataclass, so that an empty list has columns too; None: that of the first row.
    """

    row_type: ClassVar[type[Any] | None] = None

    def to_pandas(self) -> pd.DataFrame:
        """The rows as a pandas DataFrame, one column per field.

        Raises:
            MissingExtra: pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise MissingExtra("to_pandas()", "pandas") from None
        columns = {
            name: pd.Series(values, dtype="str" if kind is str else None, name=name)
            for name, kind, values in self._columns()
        }
        return pd.DataFrame(columns)

    def to_arrow(self) -> pa.Table:
        """The rows as an Arrow table, one column per field.

        Raises:
            MissingExtra: pyarrow is not installed.
        """
        try:
            import pyarrow as pa
        except ImportError:
            raise MissingExtra("to_arrow()", "arrow") from None
        return pa.table(
            {name: pa.array(values, pa.string() if kind is str else None) for name, kind, values in self._columns()}
        )

    def _columns(self) -> list[tuple[str, Any, Any]]:
        """Name, type and values of each field."""
        row_type = self.row_type or (type(self[0]) if self else None)
        if row_type is None:
            return []
        kinds = get_type_hints(row_type)
        names = [field.name for field in fields(row_type)]
        return [(name, kinds[name], _column(kinds[name], [getattr(row, name) for row in self])) for name in names]


def _column(kind: Any, values: list[Any]) -> Any:
    if kind is int:
        return np.array(values, np.uint64 if any(value > _INT64_MAX for value in values) else np.int64)
    return np.array(values, kind) if kind in (float, bool) else values


_INT64_MAX = 2**63 - 1
