"""CARLA's packed layout: the payload of a packet ↔ its records.

The size of a packet's header and its id are the `.log` codec's business; here is only what lies between.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import RecordError
from carla_recap.model.records import FLAG, REAL, TEXT, Framing, Layout, Many, Records, RecordType

if TYPE_CHECKING:
    from numpy.typing import NDArray

Buffer = bytes | memoryview
U16: Final = struct.Struct("<H")

MAX_COUNT: Final = 0xFFFF
EMPTY_LIST: Final = b"\0\0"

OBJECTS_LIMIT: Final = 8 << 20
"""The largest packet of variable-size records that is parsed, in bytes: parsed records take up to 50 times that memory."""

_STRUCT_CODES: Final = {
    "u1": "B",
    "i1": "b",
    "u2": "H",
    "u4": "I",
    "i4": "i",
    "u8": "Q",
    "f4": "f",
    "f8": "d",
    FLAG: "B",
}


class PayloadError(ValueError):
    """A payload contradicts its type's layout.

    Args:
        at: Where in the payload, in bytes.
        expected: What should be there.
    """

    def __init__(self, at: int, expected: str) -> None:
        super().__init__(expected)
        self.at = at


def check(type: RecordType, payload: Buffer) -> int:
    """The number of bytes that the payload has too many, found without parsing where the record size is fixed.

    Raises:
        PayloadError: The payload is too short for what it announces.
    """
    if not type.fixed:
        return unpack(type, payload)[1]
    size = type.dtype.itemsize
    if type.framing is Framing.LIST and len(payload) > 1:
        extra = len(payload) - U16.size - (payload[0] | payload[1] << 8) * size
        if extra >= 0:
            return extra
    if type.framing is Framing.MARKER:
        return len(payload)
    count, start = _count(type, payload)
    return need(type, payload, start, count * size, f"{count} records")


def unpack(type: RecordType, payload: Buffer) -> tuple[Records, int]:
    """The records of a payload, and the number of bytes left over behind them.

    Raises:
        PayloadError: The payload is too short for what it announces, or too large to parse.
    """
    if type.framing is Framing.MARKER or type.opaque:
        return np.empty(0, type.dtype), 0 if type.opaque else len(payload)
    count, start = _count(type, payload)
    if not type.fixed:
        return _unpack_objects(type, payload, count)
    rest = need(type, payload, start, count * type.dtype.itemsize, f"{count} records")
    return np.frombuffer(payload, type.dtype, count, start), rest


def pack(type: RecordType, records: Records) -> bytes:
    """The payload of some records.

    Raises:
        RecordError: More records than a packet can count, or a value that does not fit its field.
    """
    if type.framing is Framing.MARKER:
        return b""
    if isinstance(records, np.ndarray):
        if type.framing is Framing.SINGLE:
            return records.tobytes()
        return _pack_count(type, len(records)) + records.tobytes()
    steps = _compile(type.layout, type.wide)
    parts = [_pack_count(type, len(records))]
    for record in records:
        try:
            _pack_object(steps, record, parts)
        except (struct.error, TypeError, AttributeError, ValueError, OverflowError) as error:
            raise RecordError(f"{type.name}: {error} in {record!r:.60}") from None
    return b"".join(parts)


def _count(type: RecordType, payload: Buffer) -> tuple[int, int]:
    if type.framing is Framing.SINGLE:
        return 1, 0
    need(type, payload, 0, 2, "a count of 2 bytes")
    return U16.unpack_from(payload)[0], 2


def need(type: RecordType, payload: Buffer, at: int, size: int, what: str) -> int:
    """The number of bytes behind a part of a payload.

    Raises:
        PayloadError: The part is not all there.
    """
    rest = len(payload) - at - size
    if rest < 0:
        raise PayloadError(at, f"{type.name}: {what} need {at + size} bytes, the packet has {len(payload)}")
    return rest


def _pack_count(type: RecordType, count: int) -> bytes:
    if count > MAX_COUNT:
        raise RecordError(f"{type.name}: {count} records, but a packet counts at most {MAX_COUNT}")
    return U16.pack(count)


Item = tuple[list[Any], Any]  # steps and class of an object, or no steps and a dtype
Step = struct.Struct | str | tuple[struct.Struct, Many, list[Item]]
_compiled: dict[tuple[int, bool], list[tuple[tuple[str, ...], Step]]] = {}


def _compile(layout: Layout, wide: bool) -> list[tuple[tuple[str, ...], Step]]:
    """A layout as steps: runs of scalars as one struct, texts, counted arrays."""
    key = (id(layout), wide)
    if key in _compiled:
        return _compiled[key]
    steps: list[tuple[tuple[str, ...], Step]] = []
    run: list[tuple[str, str]] = []

    def end_run() -> None:
        if run:
            steps.append((tuple(name for name, _ in run), struct.Struct("<" + "".join(code for _, code in run))))
            run.clear()

    for name, kind in layout.fields.items():
        if isinstance(kind, Many):
            end_run()
            items: list[Item] = [
                (_compile(item, wide), item.make) if item.make else ([], item.dtype(wide)) for item in kind.layouts
            ]
            steps.append(((name,), (struct.Struct("<" + _STRUCT_CODES[kind.count]), kind, items)))
        elif kind == TEXT:
            end_run()
            steps.append(((name,), TEXT))
        else:
            run.append((name, ("d" if wide else "f") if kind == REAL else _STRUCT_CODES[kind]))
    end_run()
    _compiled[key] = steps
    return steps


def _unpack_objects(type: RecordType, payload: Buffer, count: int) -> tuple[Records, int]:
    if len(payload) > OBJECTS_LIMIT:
        raise PayloadError(0, f"{type.name}: a packet of at most {OBJECTS_LIMIT} bytes, this has {len(payload)}")
    data = bytes(payload)
    choices = max(len(kind.layouts) if isinstance(kind, Many) else 1 for kind in type.layout.fields.values())
    results: list[tuple[Records, int]] = []
    failure: PayloadError | None = None
    for choice in range(choices):
        try:
            records, at = _read_objects(type, data, count, choice)
        except PayloadError as error:
            failure = failure or error
            continue
        results.append((records, len(data) - at))
        if at == len(data):
            return results[-1]
    if results:
        return results[0]
    assert failure
    raise failure


def _read_objects(type: RecordType, data: bytes, count: int, choice: int) -> tuple[list[Any], int]:
    steps = _compile(type.layout, type.wide)
    make = type.layout.make
    at = 2
    records = []
    for _ in range(count):
        values, at = _read_object(type, steps, data, at, choice)
        records.append(make(*values))  # type: ignore[misc]
    return records, at


def _read_object(
    type: RecordType, steps: list[tuple[tuple[str, ...], Step]], data: bytes, at: int, choice: int
) -> tuple[list[Any], int]:
    values: list[Any] = []
    try:
        for names, step in steps:
            if isinstance(step, struct.Struct):
                values.extend(step.unpack_from(data, at))
                at += step.size
            elif isinstance(step, str):
                end = at + 2 + U16.unpack_from(data, at)[0]
                need(type, data, at + 2, end - at - 2, names[0])
                values.append(data[at + 2 : end].decode("utf-8", "surrogateescape"))
                at = end
            else:
                counter, _, items = step
                (many,) = counter.unpack_from(data, at)
                at += counter.size
                inner, make = items[min(choice, len(items) - 1)]
                if isinstance(make, np.dtype):
                    need(type, data, at, many * make.itemsize, f"{many} {names[0]}")
                    values.append(np.frombuffer(data, make, many, at))
                    at += many * make.itemsize
                else:
                    rows = []
                    for _ in range(many):
                        row, at = _read_object(type, inner, data, at, choice)
                        rows.append(make(*row))
                    values.append(rows)
    except struct.error:
        raise PayloadError(at, f"{type.name}: the packet of {len(data)} bytes ends inside a record") from None
    return values, at


def _rows(values: Any, dtypes: list[np.dtype[np.void]]) -> NDArray[np.void]:
    """A counted array in one of the types that it may have, or rows to make it of."""
    if isinstance(values, np.ndarray) and values.dtype in dtypes:
        return values
    return np.array([tuple(row) for row in values], dtypes[0])


def _pack_object(steps: list[tuple[tuple[str, ...], Step]], record: Any, parts: list[bytes]) -> None:
    for names, step in steps:
        if isinstance(step, struct.Struct):
            parts.append(step.pack(*(getattr(record, name) for name in names)))
            continue
        value = getattr(record, names[0])
        if isinstance(step, str):
            text = value.encode("utf-8", "surrogateescape")
            parts += (U16.pack(len(text)), text)
        else:
            counter, _, items = step
            parts.append(counter.pack(len(value)))
            if isinstance(items[0][1], np.dtype):
                parts.append(_rows(value, [dtype for _, dtype in items]).tobytes())
            else:
                for item in value:
                    _pack_object(items[0][0], item, parts)
