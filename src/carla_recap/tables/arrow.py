"""The bridge to pyarrow: Arrow tables with units, and Parquet files.

The types of arrays are numpy's, those of lists come from type hints.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from dataclasses import fields, is_dataclass
from importlib.abc import MetaPathFinder
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Final, Literal, Self, Union, get_args, get_origin, get_type_hints

import numpy as np

from carla_recap.errors import MissingExtra
from carla_recap.tables.variable import Lists
from carla_recap.util.files import WholeFile, writing

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from types import TracebackType

    import pyarrow as pa


_HINTS: Final = {int: "int64", float: "float64", bool: "bool_", str: "string"}
"""The Arrow types of Python's."""


def require(feature: str) -> None:
    """Raise `MissingExtra` if pyarrow, which a feature needs, is not installed."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise MissingExtra(feature, "arrow") from None


def spare_pandas() -> None:
    """Keep pyarrow from importing pandas, which takes half a second, to see whether a list is one of its columns.

    It does so once. This is for a process of a command alone: after it, pyarrow takes a column of pandas for any sequence.
    """
    if "pandas" in sys.modules:
        return
    with suppress(ImportError):
        import pyarrow as pa

        sys.meta_path.insert(0, _WithoutPandas())
        try:
            pa.array([])
        finally:
            sys.meta_path.pop(0)


class _WithoutPandas(MetaPathFinder):
    """Refuses to import pandas, as if it were not installed."""

    def find_spec(self, name: str, *_: object) -> None:
        """Raise ImportError for pandas."""
        if name == "pandas":
            raise ModuleNotFoundError(name)


def type_of(kind: Any) -> pa.DataType | None:
    """Return the Arrow type of a type hint; None if it must be inferred from the values."""
    import pyarrow as pa

    if kind in _HINTS:
        return getattr(pa, _HINTS[kind])()
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Union, UnionType):
        return type_of(next(each for each in arguments if each is not NoneType))
    if origin is Literal:
        return type_of(type(arguments[0]))
    if origin is dict:
        return pa.map_(*map(type_of, arguments))
    if origin in (list, tuple):
        return pa.list_(type_of(arguments[0]))
    if is_dataclass(kind):
        hints = get_type_hints(kind)
        return pa.struct([pa.field(field.name, type_of(hints[field.name])) for field in fields(kind)])
    return None


def table(columns: Mapping[str, Any], types: Mapping[str, Any], units: Mapping[str, str]) -> pa.Table:
    """Return columns (arrays, lists and `Lists`) as an Arrow table; types are those of lists, units go to the metadata."""
    import pyarrow as pa

    arrays = {name: _array(values, types.get(name)) for name, values in columns.items()}
    schema = [
        pa.field(name, array.type, metadata={"unit": units[name]} if name in units else None)
        for name, array in arrays.items()
    ]
    return pa.table(list(arrays.values()), schema=pa.schema(schema))


def _array(values: Any, type: pa.DataType | None) -> pa.Array:
    import pyarrow as pa

    if isinstance(values, Lists):
        offsets = np.concatenate(([0], np.cumsum(values.lengths))).astype(np.int32)
        items = [_array(each, None) for each in values.fields.values()]
        return pa.ListArray.from_arrays(offsets, pa.StructArray.from_arrays(items, list(values.fields)))
    if isinstance(values, np.ndarray) and values.dtype == object:
        return pa.array(values, pa.string())
    if type is not None and pa.types.is_map(type):
        values = [list(value.items()) for value in values]
    return pa.array(values, type)


class ParquetFile:
    """Writes a Parquet file table by table, each as a row group; a context manager.

    Integers, texts and times are dictionary-encoded; other real numbers are not, which would take three times as long.
    """

    def __init__(self, path: Path | pa.BufferOutputStream, schema: pa.Schema) -> None:
        import pyarrow as pa
        from pyarrow import parquet

        repeating = [
            field.name for field in schema if not pa.types.is_floating(field.type) and not pa.types.is_nested(field.type)
        ]
        with writing(path):
            self._writer = parquet.ParquetWriter(
                path,
                schema,
                compression="zstd",
                compression_level=1,
                use_dictionary=[*repeating, "time"] if "time" in schema.names else repeating,
            )
        self._path = path
        self.rows = 0  # the number of rows written

    def write(self, table: pa.Table) -> None:
        """Add a row group, or raise `RecapError`."""
        with writing(self._path):
            self._writer.write_table(table)
        self.rows += len(table)

    def close(self) -> None:
        """Finish the file, or raise `RecapError`."""
        with writing(self._path):
            self._writer.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()


def write_parquet(path: Path | str, table: pa.Table) -> None:
    """Write a table as a Parquet file, which replaces another when it is complete, or raise `RecapError`."""
    import pyarrow as pa

    buffer = pa.BufferOutputStream()
    with ParquetFile(buffer, table.schema) as file:
        file.write(table)
    with WholeFile(path) as whole:
        whole.write(buffer.getvalue().to_pybytes())
