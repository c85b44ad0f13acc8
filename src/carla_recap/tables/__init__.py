"""Tables: rows or columns, as pandas DataFrames, Arrow tables and Parquet files."""

from __future__ import annotations

from dataclasses import asdict, fields, is_dataclass
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, get_type_hints

import numpy as np

from carla_recap.errors import MissingExtra
from carla_recap.tables.display import Preview, as_html, as_text, first_and_last

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import pandas as pd
    import pyarrow as pa

T = TypeVar("T")

_INT64_MAX = 2**63 - 1


class Tabular:
    """Base of classes with columns of one length; at a prompt and in a notebook, they are tables of a few rows."""

    def __repr__(self) -> str:
        return as_text(self._preview())

    def _repr_html_(self) -> str:
        return as_html(self._preview())

    def columns(self) -> dict[str, Any]:
        """Return the columns by name: arrays of numbers, or lists."""
        raise NotImplementedError

    def units(self) -> Mapping[str, str]:
        """Return the units of columns by name."""
        return {}

    def to_pandas(self) -> pd.DataFrame:
        """Return a pandas DataFrame.

        Raises:
            MissingExtra: pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise MissingExtra("to_pandas()", "pandas") from None
        types = self._types()
        return pd.DataFrame(
            {
                name: pd.Series(values, dtype="str" if types.get(name) is str else None, name=name)
                for name, values in self.columns().items()
            }
        )

    def to_arrow(self) -> pa.Table:
        """Return an Arrow table, with the units of columns in their metadata.

        Raises:
            MissingExtra: pyarrow is not installed.
        """
        from carla_recap.tables import arrow

        arrow.require("to_arrow()")
        types = {name: arrow.type_of(kind) for name, kind in self._types().items()}
        return arrow.table(self._arrow_columns(), types, self.units())

    def to_parquet(self, path: Path | str) -> None:
        """Write a Parquet file, with the units of columns in their metadata.

        Raises:
            MissingExtra: pyarrow is not installed.
            RecapError: The file cannot be written.
        """
        from carla_recap.tables import arrow

        arrow.require("to_parquet()")
        arrow.write_parquet(path, self.to_arrow())

    def _types(self) -> Mapping[str, Any]:
        """Return the types of columns that are lists, by name, as type hints."""
        return {}

    def _arrow_columns(self) -> dict[str, Any]:
        """Return the columns for an Arrow table: as in `columns`, or `Lists`."""
        return self.columns()

    def _preview(self) -> Preview:
        """Return what is shown: the first and the last rows."""
        columns = self.columns()
        count = len(next(iter(columns.values()), ()))
        shown = {name: first_and_last(values) for name, values in columns.items()}
        return Preview(type(self).__name__, shown, self.units(), count)


class Columns(Tabular):
    """Base of a dataclass whose fields are arrays of one length.

    Attributes:
        column_units: The units of the fields that have one.
    """

    column_units: ClassVar[Mapping[str, str]] = {}

    def columns(self) -> dict[str, Any]:
        """See `Tabular.columns`."""
        return {field.name: getattr(self, field.name) for field in fields(self)}  # type: ignore[arg-type]

    def units(self) -> Mapping[str, str]:
        """See `Tabular.units`."""
        return self.column_units


class Rows(list[T], Tabular):
    """A list of rows, all of one dataclass.

    Attributes:
        row_type: The dataclass, which gives an empty list its columns; None: that of the first row.
        row_units: The units of its fields.
    """

    row_type: ClassVar[type[Any] | None] = None
    row_units: ClassVar[Mapping[str, str]] = {}

    __repr__ = Tabular.__repr__

    def columns(self) -> dict[str, Any]:
        """See `Tabular.columns`."""
        return {name: _column(kind, [getattr(row, name) for row in self]) for name, kind in self._kinds().items()}

    def units(self) -> Mapping[str, str]:
        """See `Tabular.units`."""
        return self.row_units

    def _types(self) -> Mapping[str, Any]:
        return {name: kind for name, kind in self._kinds().items() if kind not in _NUMBERS}

    def _preview(self) -> Preview:
        rows = first_and_last(self)
        columns = {name: [getattr(row, name) for row in rows] for name in self._kinds()}
        return Preview(type(self).__name__, columns, self.row_units, len(self))

    def _kinds(self) -> dict[str, Any]:
        """Return the type hints of the rows' fields."""
        row_type: Any = self.row_type or (type(self[0]) if self else None)
        return {} if row_type is None else column_types(row_type)


def column_names(row_type: type[Any]) -> list[str]:
    """Return the names of a dataclass's columns: of all fields that its `repr` shows."""
    return [field.name for field in fields(row_type) if field.repr]


def column_types(row_type: type[Any]) -> dict[str, Any]:
    """Return the type hints of a dataclass's columns."""
    hints = get_type_hints(row_type)
    return {name: hints[name] for name in column_names(row_type)}


_NUMBERS = (int, float, bool)


def _column(kind: Any, values: list[Any]) -> Any:
    if kind is int:
        return np.array(values, np.uint64 if any(value > _INT64_MAX for value in values) else np.int64)
    if kind in _NUMBERS:
        return np.array(values, kind)
    return [asdict(value) if is_dataclass(value) and not isinstance(value, type) else value for value in values]
