"""CARLA's packed layout: how the fields of a record follow each other, and payloads of packets ↔ records.

A `Layout` declares fields. Compiled, it is a sequence of steps: numbers that follow each other, a text, a counted array. All
codecs work through these steps, on what `locate` found in a payload; none of them reads the declarations.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeAlias, TypeVar

import numpy as np

from carla_recap.errors import RecordError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

Buffer = bytes | memoryview
Records: TypeAlias = "NDArray[np.void] | list[Any]"
"""The records of one type: a structured array, or a list of objects where the size varies."""

T = TypeVar("T")

# Field kinds. A kind is a numpy type code, or one of these:
REAL: Final = "real"  # a length, angle or speed: float32 in UE4 builds (0.9), float64 in UE5 builds (0.10)
FLAG: Final = "flag"  # a byte that should be 0 or 1
TEXT: Final = "text"  # u16 byte count, then UTF-8; invalid bytes become lone surrogates (PEP 383), so nothing is lost

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


class Framing(Enum):
    """How the records of a packet are counted."""

    MARKER = "marker"  # no payload
    SINGLE = "single"  # one record, no count
    LIST = "list"  # u16 count, then the records


class PayloadError(ValueError):
    """A payload contradicts its type's layout, at an offset in bytes."""

    def __init__(self, offset: int, expected: str) -> None:
        super().__init__(expected)
        self.offset = offset


# --- declarations ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Many:
    """A counted array inside a record.

    `layouts` are alternatives, the first with all fields: the one that consumes the packet to its last byte is taken.
    """

    count: str
    layouts: tuple[Layout, ...]


@dataclass(frozen=True, eq=False)
class Layout:
    """The fields of a record, in CARLA's order; packed, little-endian. Field k has protobuf field number k."""

    fields: dict[str, str | Many]  # name → kind, or `Many`
    make: type | None = None  # the class of a record whose size varies; None: the size is fixed, records are array rows

    def dtype(self, wide: bool) -> np.dtype[np.void]:
        """Return the numpy type of a fixed-size record. `wide`: REAL is float64."""
        real = "f8" if wide else "f4"
        codes = {REAL: real, FLAG: "u1"}
        return np.dtype([(name, "<" + codes.get(str(kind), str(kind))) for name, kind in self.fields.items()])

    @property
    def has_reals(self) -> bool:
        """Whether UE4 and UE5 builds write this record differently."""
        return any(
            kind == REAL or (isinstance(kind, Many) and any(layout.has_reals for layout in kind.layouts))
            for kind in self.fields.values()
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class PacketType:
    """How the packets of a type are packed."""

    name: str  # the name in Python: `frame["transforms"]`
    layout: Layout  # the fields of one record
    framing: Framing = Framing.LIST  # how the packet counts its records
    wide: bool = False  # whether this is UE5's double-precision layout
    opaque: bool = False  # whether packets are kept as raw bytes, never parsed
    dtype: np.dtype[np.void] = field(init=False)  # the numpy type of a record; without fields where the size varies

    def __post_init__(self) -> None:
        object.__setattr__(self, "dtype", compiled(self).dtype)

    @property
    def fixed(self) -> bool:
        """Whether every record has the same size, so that records are the rows of a structured array."""
        return self.layout.make is None and not self.opaque


# --- compiled ----------------------------------------------------------------------------------------------------------


class Numbers:
    """A step of a layout: numbers that follow each other."""

    def __init__(self, fields: Mapping[str, tuple[int, str]]) -> None:
        self.fields = fields  # field number and kind of each, by name
        self.codes = "".join(_STRUCT_CODES[kind] for _, kind in fields.values())  # the format characters, as in `struct`
        self.struct = struct.Struct("<" + self.codes)


class Text(NamedTuple):
    """A step of a layout: a text with its length."""

    number: int
    name: str


class Items(NamedTuple):
    """A step of a layout: a counted array, in one of some layouts; the first of these has all fields."""

    number: int
    name: str
    counter: struct.Struct
    layouts: tuple[CompiledLayout, ...]


Step = Numbers | Text | Items


class CompiledLayout:
    """A layout as steps."""

    def __init__(self, steps: Sequence[Step], make: type | None, dtype: np.dtype[np.void]) -> None:
        self.steps = steps
        self.make = make  # the class of a record; None where the size is fixed
        self.dtype = dtype  # the numpy type of a record whose size is fixed

    @property
    def choices(self) -> int:
        """The number of alternatives, of which each array has one or all."""
        return max((len(step.layouts) for step in self.steps if isinstance(step, Items)), default=1)


def compiled(type: PacketType) -> CompiledLayout:
    """Return the steps of the records of a type."""
    return _compile(type.layout, type.layout, type.wide)


@cache
def _compile(layout: Layout, full: Layout, wide: bool) -> CompiledLayout:
    """Compile a layout whose fields have the numbers that they have in another one."""
    steps: list[Step] = []
    run: dict[str, tuple[int, str]] = {}

    def end_run() -> None:
        if run:
            steps.append(Numbers(dict(run)))
            run.clear()

    numbers = {name: number for number, name in enumerate(full.fields, 1)}
    for name, kind in layout.fields.items():
        if isinstance(kind, Many):
            end_run()
            layouts = tuple(_compile(each, kind.layouts[0], wide) for each in kind.layouts)
            steps.append(Items(numbers[name], name, struct.Struct("<" + _STRUCT_CODES[kind.count]), layouts))
        elif kind == TEXT:
            end_run()
            steps.append(Text(numbers[name], name))
        else:
            run[name] = numbers[name], ("f8" if wide else "f4") if kind == REAL else kind
    end_run()
    dtype = np.dtype([]) if layout.make else layout.dtype(wide)
    return CompiledLayout(steps, layout.make, dtype)


# --- payloads to records -----------------------------------------------------------------------------------------------


class Span(NamedTuple):
    """Some records in a payload."""

    layout: CompiledLayout
    offset: int  # the offset of the first one, in bytes
    number: int  # the number of records
    # Of each record whose size varies, what each step of the layout is in the payload: the offset of numbers, the bytes of a
    # text, the span of an array.
    records: list[list[int | slice | Span]]


class _Cursor:
    """Goes through a payload, and takes the `choice`-th of alternative layouts."""

    def __init__(self, name: str, data: Buffer, choice: int) -> None:
        self._name = name
        self._data = data
        self._size = len(data)
        self._choice = choice
        self.offset = 0  # the offset of what comes next, in bytes

    def span(self, layout: CompiledLayout, count: int) -> Span:
        """Go over some records."""
        if layout.make is None:
            return Span(layout, self._skip(count * layout.dtype.itemsize, "{} records", count), count, [])
        return Span(layout, self.offset, count, [[self._part(step) for step in layout.steps] for _ in range(count)])

    def records(self, layout: CompiledLayout, count: int) -> Records:
        """Read some records."""
        make = layout.make
        if make is None:
            start = self._skip(count * layout.dtype.itemsize, "{} records", count)
            return np.frombuffer(self._data, layout.dtype, count, start)
        return [make(*self._values(layout)) for _ in range(count)]

    def _values(self, layout: CompiledLayout) -> list[Any]:
        values: list[Any] = []
        for step in layout.steps:
            if isinstance(step, Numbers):
                values += step.struct.unpack_from(self._data, self._skip(step.struct.size, "its numbers"))
            elif isinstance(step, Text):
                values.append(str(self._data[self._text(step)], "utf-8", "surrogateescape"))
            else:
                values.append(self.records(self._chosen(step), self.count(step.counter)))
        return values

    def count(self, counter: struct.Struct) -> int:
        """Go over a number of records."""
        count: int = counter.unpack_from(self._data, self._skip(counter.size, "a count of {} bytes", counter.size))[0]
        return count

    def _part(self, step: Step) -> int | slice | Span:
        if isinstance(step, Numbers):
            return self._skip(step.struct.size, "its numbers")
        if isinstance(step, Text):
            return self._text(step)
        return self.span(self._chosen(step), self.count(step.counter))

    def _text(self, step: Text) -> slice:
        size = self.count(U16)
        start = self._skip(size, step.name)
        return slice(start, start + size)

    def _chosen(self, step: Items) -> CompiledLayout:
        return step.layouts[min(self._choice, len(step.layouts) - 1)]

    def _skip(self, size: int, what: str, number: int = 0) -> int:
        start, end = self.offset, self.offset + size
        if end > self._size:
            raise PayloadError(start, f"{self._name}: {what.format(number)} need {end} bytes, the packet has {self._size}")
        self.offset = end
        return start


def locate(type: PacketType, payload: Buffer) -> tuple[Span, int]:
    """Find the records of a payload, and the number of bytes behind them, or raise `PayloadError`."""
    return _read(type, payload, _Cursor.span)


def _read(type: PacketType, payload: Buffer, read: Callable[[_Cursor, CompiledLayout, int], T]) -> tuple[T, int]:
    """Return what is read by the layout that uses all bytes, else the first possible one, and the number of bytes left."""
    if len(payload) > OBJECTS_LIMIT and not type.fixed:
        raise PayloadError(0, f"{type.name}: a packet of at most {OBJECTS_LIMIT} bytes, this has {len(payload)}")
    layout = compiled(type)
    found: tuple[T, int] | None = None
    failure: PayloadError | None = None
    for choice in range(layout.choices):
        cursor = _Cursor(type.name, payload, choice)
        try:
            records = read(cursor, layout, 1 if type.framing is Framing.SINGLE else cursor.count(U16))
        except PayloadError as error:
            failure = failure or error
            continue
        rest = len(payload) - cursor.offset
        if not rest:
            return records, 0
        found = found or (records, rest)
    if found is None:
        assert failure
        raise failure
    return found


def check(type: PacketType, payload: Buffer) -> int:
    """Return the number of bytes behind the records, found without parsing, or raise `PayloadError`."""
    if type.opaque:
        return 0
    return len(payload) if type.framing is Framing.MARKER else locate(type, payload)[1]


def unpack(type: PacketType, payload: Buffer) -> tuple[Records, int]:
    """Return the records of a payload, and the number of bytes left over behind them, or raise `PayloadError`."""
    if type.framing is Framing.MARKER or type.opaque:
        return np.empty(0, type.dtype), 0 if type.opaque else len(payload)
    if type.fixed and type.framing is Framing.LIST and len(payload) >= U16.size:  # as `locate`, in a tenth of the time
        (count,) = U16.unpack_from(payload)
        rest = len(payload) - U16.size - count * type.dtype.itemsize
        if rest >= 0:
            return np.frombuffer(payload, type.dtype, count, U16.size), rest
    return _read(type, payload if type.fixed else bytes(payload), _Cursor.records)


# --- records to payloads -----------------------------------------------------------------------------------------------


def pack(type: PacketType, records: Records) -> bytes:
    """Return the payload of some records, or raise `RecordError`."""
    if type.framing is Framing.MARKER:
        return b""
    if type.framing is Framing.SINGLE and isinstance(records, np.ndarray):
        if len(records) != 1:
            raise RecordError(f"{type.name}: expected one record, found {len(records)}")
        return records.tobytes()
    if len(records) > MAX_COUNT:
        raise RecordError(f"{type.name}: {len(records)} records, but a packet counts at most {MAX_COUNT}")
    if type.opaque and len(records):
        raise RecordError(f"{type.name}: records of UE5 builds are kept as bytes, and cannot be written")
    if isinstance(records, np.ndarray):
        return U16.pack(len(records)) + records.tobytes()
    layout = compiled(type)
    parts = [U16.pack(len(records))]
    for record in records:
        try:
            _pack(layout, record, parts)
        except (struct.error, TypeError, AttributeError, ValueError, OverflowError) as error:
            raise RecordError(f"{type.name}: {error} in {record!r:.60}") from None
    return b"".join(parts)


def _pack(layout: CompiledLayout, record: Any, parts: list[bytes]) -> None:
    for step in layout.steps:
        if isinstance(step, Numbers):
            parts.append(step.struct.pack(*(getattr(record, name) for name in step.fields)))
            continue
        value = getattr(record, step.name)
        if isinstance(step, Text):
            text = value.encode("utf-8", "surrogateescape")
            parts += (U16.pack(len(text)), text)
            continue
        parts.append(step.counter.pack(len(value)))
        if step.layouts[0].make is None:
            parts.append(_rows(value, [each.dtype for each in step.layouts]).tobytes())
        else:
            for item in value:
                _pack(step.layouts[0], item, parts)


def _rows(values: Any, dtypes: list[np.dtype[np.void]]) -> NDArray[np.void]:
    """Return a counted array in one of the types that it may have, made of rows if it is none."""
    if isinstance(values, np.ndarray) and values.dtype in dtypes:
        return values
    return np.array([tuple(row) for row in values], dtypes[0])
