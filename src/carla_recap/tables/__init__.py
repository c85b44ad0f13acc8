"""Answers as tables: rows or columns that become a pandas DataFrame or an Arrow table."""

from __future__ import annotations

from dataclasses import asdict, fields, is_dataclass
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, get_type_hints

import numpy as np

from carla_recap.errors import MissingExtra

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

T = TypeVar("T")

_INT64_MAX = 2**63 - 1


class Tabular:
    """Whatever has columns."""

    def _columns(self) -> list[tuple[str, bool, Any]]:
        """Name of each column, whether it is text, and its values."""
        raise NotImplementedError

    def to_pandas(self) -> pd.DataFrame:
        """A pandas DataFrame, one column per field.

        Raises:
            MissingExtra: pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise MissingExtra("to_pandas()", "pandas") from None
        return pd.DataFrame(
            {name: pd.Series(values, dtype="str" if text else None, name=name) for name, text, values in self._columns()}
        )

    def to_arrow(self) -> pa.Table:
        """An Arrow table, one column per field.

        Raises:
            MissingExtra: pyarrow is not installed.
        """
        try:
            import pyarrow as pa
        except ImportError:
            raise MissingExtra("to_arrow()", "arrow") from None
        return pa.table({name: pa.array(values, pa.string() if text else None) for name, text, values in self._columns()})


class Columns(Tabular):
    """Base of a dataclass whose fields are arrays of one length."""

    def _columns(self) -> list[tuple[str, bool, Any]]:
        names = [field.name for field in fields(self)]  # type: ignore[arg-type]
        return [(name, False, getattr(self, name)) for name in names]


class Rows(list[T], Tabular):
    """A list of rows, all of one dataclass.

    Attributes:
        row_type: The dataclass, so that an empty list has columns too; None: that of the first row.
    """

    row_type: ClassVar[type[Any] | None] = None

    def _columns(self) -> list[tuple[str, bool, Any]]:
        row_type: Any = self.row_type or (type(self[0]) if self else None)
        if row_type is None:
            return []
        kinds = get_type_hints(row_type)
        names = [field.name for field in fields(row_type)]
        return [(name, kinds[name] is str, _column(kinds[name], [getattr(row, name) for row in self])) for name in names]


def _column(kind: Any, values: list[Any]) -> Any:
    if kind is int:
        return np.array(values, np.uint64 if any(value > _INT64_MAX for value in values) else np.int64)
    if kind in (float, bool):
        return np.array(values, kind)
    return [asdict(value) if is_dataclass(value) and not isinstance(value, type) else value for value in values]
