"""Records of variable size as columns: arrays of numbers and texts, and lists of nested records."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.stride_tricks import as_strided

from carla_recap.model.batch import equal_rows
from carla_recap.model.layout import TEXT, U16, Layout, Many
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.model.batch import Column

    Bytes = NDArray[np.uint8]
    Integers = NDArray[np.int64]

Fields = dict[str, Any]
"""The fields of records by name: arrays of numbers, arrays of texts, or `Lists`; without those that the build omits."""


@dataclass(frozen=True, eq=False)
class Lists:
    """A list of nested records for each record.

    Attributes:
        lengths: The number of nested records of each record, (n,).
        fields: The fields of all nested records, one after the other.
    """

    lengths: Integers
    fields: Fields

    def to_list(self) -> list[list[dict[str, Any]]]:
        """Return the nested records as plain Python."""
        columns = [values.to_list() if isinstance(values, Lists) else values.tolist() for values in self.fields.values()]
        rows = [dict(zip(self.fields, row, strict=True)) for row in zip(*columns, strict=True)]
        if any(isinstance(values, np.ma.MaskedArray) for values in self.fields.values()):
            rows = [{name: value for name, value in row.items() if value is not None} for row in rows]
        ends = np.cumsum(self.lengths).tolist()
        return [rows[start:stop] for start, stop in zip([0, *ends], ends, strict=False)]


def record_fields(column: Column, frames: int) -> Iterator[tuple[int, int, Fields]]:
    """Yield the fields of the records in a column of packets, for runs of frames whose records have the same form.

    Only the first packet of a run is parsed.

    Args:
        column: The packets.
        frames: The number of frames.

    Yields:
        The number of frames, the number of records in each of them, and the fields of all of these records.

    Raises:
        FormatError: A packet contradicts its layout.
    """
    type = column.type
    assert type is not None
    payloads, row = column.payloads(frames), 0
    while row < frames:
        records = column.packet(row).records
        form = _Form(type.layout, type.wide)
        offset, constant = U16.size, [np.arange(U16.size)]
        for record in records:
            offset = form.add(record, offset, constant)
        count = equal_rows(payloads[row:], np.concatenate(constant))
        yield count, len(records), form.fields(payloads[row : row + count])
        row += count


class _Form:
    """The offsets of the fields of records in a payload, and the texts of these records."""

    def __init__(self, layout: Layout, wide: bool) -> None:
        self._layout = layout
        self._steps: list[tuple[str | None, Any, list[Any]]] = []  # field, type, and offsets, texts or lengths
        for is_number, group in groupby(
            layout.fields.items(), lambda item: item[1] != TEXT and not isinstance(item[1], Many)
        ):
            if is_number:
                self._steps.append((None, Layout(dict(group)).dtype(wide), []))
            else:
                for name, kind in group:
                    nested = _Form(kind.layouts[0], wide) if isinstance(kind, Many) else None
                    self._steps.append((name, nested, []))
        self._counters = {name: np.dtype(kind.count) for name, kind in layout.fields.items() if isinstance(kind, Many)}

    def add(self, record: Any, offset: int, constant: list[Integers]) -> int:
        """Add a record.

        Args:
            record: The record.
            offset: The offset of its first byte in the payload.
            constant: Gets the offsets of the bytes that are the same in all payloads of this form.

        Returns:
            The offset of the byte after the record.
        """
        for name, kind, found in self._steps:
            if name is None:
                found.append(offset)
                offset += kind.itemsize
                continue
            value, start = getattr(record, name), offset
            if kind is None:
                offset += U16.size + len(value.encode("utf-8", "surrogateescape"))
                found.append(readable(value))
                constant.append(np.arange(start, offset))
                continue
            offset += self._counters[name].itemsize
            found.append(len(value))
            constant.append(np.arange(start, offset))
            if isinstance(value, np.ndarray):
                offset = kind.add_rows(value, offset)
            else:
                for item in value:
                    offset = kind.add(item, offset, constant)
        return offset

    def add_rows(self, rows: NDArray[np.void], offset: int) -> int:
        """Add the rows of an array, and return the offset of the byte after them."""
        if len(rows):
            self._steps[0] = (None, rows.dtype, self._steps[0][2])
            self._steps[0][2].extend(range(offset, offset + rows.nbytes, rows.itemsize))
        return offset + rows.nbytes

    def fields(self, payloads: Bytes) -> Fields:
        """Return the fields of the records in payloads of this form."""
        fields: Fields = {}
        for name, kind, found in self._steps:
            if name is None:
                numbers = _gathered(payloads, kind, found)
                fields |= {field: numbers[field] for field in kind.names}
            elif kind is None:
                fields[name] = np.tile(np.array(found, object), len(payloads))
            else:
                fields[name] = Lists(np.tile(np.array(found, np.int64), len(payloads)), kind.fields(payloads))
        return fields


def _gathered(payloads: Bytes, dtype: np.dtype[np.void], offsets: list[int]) -> NDArray[np.void]:
    """Return the values of a type at some offsets of each payload, one payload after the other."""
    if not offsets:
        return np.empty(0, dtype)
    first = payloads[:, : dtype.itemsize].view(f"V{dtype.itemsize}")
    shape = len(payloads), payloads.shape[1] - dtype.itemsize + 1
    at_every_byte = as_strided(first, shape, (payloads.strides[0], 1), writeable=False)
    return at_every_byte[:, offsets].reshape(-1).view(dtype)


def joined(layout: Layout, wide: bool, pieces: Sequence[Fields], counts: Sequence[int]) -> Fields:
    """Return the fields of pieces, one after the other; those that some pieces lack are masked there.

    Args:
        layout: The layout of the records.
        wide: Whether REAL fields are in double precision.
        pieces: The fields of each piece.
        counts: The number of records of each piece.
    """
    fields: Fields = {}
    parts = [(piece, count) for piece, count in zip(pieces, counts, strict=True) if count]
    for name, kind in layout.fields.items():
        if isinstance(kind, Many):
            lists = [piece[name] for piece, _ in parts]
            lengths = np.concatenate([np.empty(0, np.int64), *(each.lengths for each in lists)])
            nested = joined(
                kind.layouts[0], wide, [each.fields for each in lists], [int(each.lengths.sum()) for each in lists]
            )
            fields[name] = Lists(lengths, nested)
            continue
        dtype = np.dtype(object) if kind == TEXT else Layout({name: kind}).dtype(wide)[name]
        present = all(name in piece for piece, _ in parts)
        values = [
            piece[name] if name in piece else np.ma.MaskedArray(np.zeros(count, dtype), True) for piece, count in parts
        ]
        fields[name] = (np.concatenate if present else np.ma.concatenate)([np.empty(0, dtype), *values])
    return fields
