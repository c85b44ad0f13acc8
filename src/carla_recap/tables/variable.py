"""Records of variable size as columns: arrays of numbers and texts, and lists of nested records."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.stride_tricks import as_strided

from carla_recap.model.batch import equal_rows
from carla_recap.model.layout import FLAG, U16, Items, Numbers, Span, compiled, locate
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.model.batch import Column
    from carla_recap.model.layout import Buffer, CompiledLayout, PacketType

Fields = dict[str, Any]
"""The fields of records by name: arrays of numbers, arrays of texts, or `Lists`; without those that the build omits."""


@dataclass(frozen=True, eq=False)
class Lists:
    """A list of nested records for each record."""

    lengths: NDArray[np.int64]  # the number of nested records of each record, (n,)
    fields: Fields  # the fields of all nested records, one after the other

    def __len__(self) -> int:
        return len(self.lengths)

    def to_list(self) -> list[list[dict[str, Any]]]:
        """Return the nested records as plain Python."""
        columns = [values.to_list() if isinstance(values, Lists) else values.tolist() for values in self.fields.values()]
        rows = [dict(zip(self.fields, row, strict=True)) for row in zip(*columns, strict=True)]
        if any(isinstance(values, np.ma.MaskedArray) for values in self.fields.values()):
            rows = [{name: value for name, value in row.items() if value is not None} for row in rows]
        ends = np.cumsum(self.lengths).tolist()
        return [rows[start:stop] for start, stop in zip([0, *ends], ends, strict=False)]


def record_fields(column: Column, frames: int) -> Iterator[tuple[int, int, Fields]]:
    """Yield the fields of the records in a column of packets, for runs of packets with the same counts and texts.

    Each has the numbers of frames and of records in each of them; the first packet of a run alone is parsed.
    """
    assert column.type is not None
    payloads, row = column.payloads(frames), 0
    while row < frames:
        packet = column.packet(row)
        packet.records  # noqa: B018  (raises the error that names the offset, or warns of surplus bytes)
        span, _ = locate(column.type, packet.payload)
        constant = np.concatenate([np.arange(start, stop) for start, stop in [(0, U16.size), *_constant(span)]])
        count = equal_rows(payloads[row:], constant)
        yield count, span.number, _fields(span.layout, [span], payloads[row : row + count], packet.payload)
        row += count


def _constant(span: Span) -> Iterator[tuple[int, int]]:
    """Yield the offsets of counts and texts: the start, and the byte after the end."""
    for record in span.records:
        for step, part in zip(span.layout.steps, record, strict=True):
            if isinstance(part, slice):
                yield part.start - U16.size, part.stop
            elif isinstance(part, Span) and isinstance(step, Items):
                yield part.offset - step.counter.size, part.offset
                yield from _constant(part)


def _fields(layout: CompiledLayout, spans: Sequence[Any], payloads: NDArray[np.uint8], first: Buffer) -> Fields:
    """Return the fields of the records in the same spans of each payload, (n, size); the first one is given, too."""
    if layout.make is None:
        size = layout.dtype.itemsize
        offsets = [span.offset + index * size for span in spans for index in range(span.number)]
        return _gathered(payloads, layout.dtype, offsets)
    fields: Fields = {}
    records = [record for span in spans for record in span.records]
    for index, step in enumerate(layout.steps):
        parts: list[Any] = [record[index] for record in records]
        if isinstance(step, Numbers):
            kinds = {name: "u1" if kind == FLAG else kind for name, (_, kind) in step.fields.items()}
            fields |= _gathered(payloads, np.dtype([(name, f"<{kind}") for name, kind in kinds.items()]), parts)
        elif isinstance(step, Items):
            nested = _fields(parts[0].layout if parts else step.layouts[0], parts, payloads, first)
            fields[step.name] = Lists(np.tile(np.array([part.number for part in parts], np.int64), len(payloads)), nested)
        else:
            texts = [readable(str(first[part], "utf-8", "surrogateescape")) for part in parts]
            fields[step.name] = np.tile(np.array(texts, object), len(payloads))
    return fields


def _gathered(payloads: NDArray[np.uint8], dtype: np.dtype[np.void], offsets: list[int]) -> Fields:
    """Return the fields of structures at some offsets of each payload, one payload after the other."""
    values = np.empty(0, dtype)
    if offsets:
        one = payloads[:, : dtype.itemsize].view(f"V{dtype.itemsize}")
        shape = len(payloads), payloads.shape[1] - dtype.itemsize + 1
        at_every_byte = as_strided(one, shape, (payloads.strides[0], 1), writeable=False)
        values = at_every_byte[:, offsets].reshape(-1).view(dtype)
    return {name: values[name] for name in dtype.names or ()}


def joined(type: PacketType, pieces: Sequence[Fields]) -> Fields:
    """Return the fields of pieces, one after the other; fields that a piece lacks are masked there."""
    return _joined([_fields(compiled(type), [], np.empty((0, 0), np.uint8), b""), *pieces])


def _joined(pieces: Sequence[Fields]) -> Fields:
    """Return the fields of pieces, the first of which is empty and has all fields."""
    fields: Fields = {}
    sizes = [len(next(iter(piece.values()), ())) for piece in pieces]
    parts = [(piece, size) for piece, size in zip(pieces, sizes, strict=True) if size]
    for name, empty in pieces[0].items():
        if isinstance(empty, Lists):
            lists = [empty, *(piece[name] for piece, _ in parts)]
            fields[name] = Lists(np.concatenate([each.lengths for each in lists]), _joined([each.fields for each in lists]))
            continue
        masked = any(name not in piece for piece, _ in parts)
        values = [
            piece[name] if name in piece else np.ma.MaskedArray(np.zeros(size, empty.dtype), True) for piece, size in parts
        ]
        fields[name] = (np.ma.concatenate if masked else np.concatenate)([empty, *values])
    return fields
