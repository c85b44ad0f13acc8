"""Batches: runs of consecutive frames that have the same packets of the same sizes, as arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, overload

import numpy as np

from carla_recap.errors import RecordError
from carla_recap.model.frame import Frame, Packet, read_only
from carla_recap.model.layout import U16, Buffer, Framing
from carla_recap.model.records import UE4

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.model.records import RecordType
    from carla_recap.util.arrays import Floats


_FIRST_STEP: Final = 128  # rows that are compared at once, at first
_GROWTH: Final = 8


class ConstantColumn:
    """The same packet in each frame, such as one without records; see `Column`."""

    __slots__ = ("_count", "_packet", "id", "type")

    def __init__(self, packet: Packet, count: int = 1) -> None:
        self.id = packet.id
        self.type = packet.type
        self._packet = packet
        self._count = count

    @property
    def size(self) -> int:
        """Bytes of each payload."""
        return len(self._packet.payload)

    @property
    def records(self) -> NDArray[np.void]:
        """The records of all frames, (frames, records of each); for types whose records have one size."""
        records = self._packet.records
        assert isinstance(records, np.ndarray)
        return read_only(records[None]) if self._count == 1 else np.broadcast_to(records, (self._count, len(records)))

    def packet(self, row: int) -> Packet:
        """Return the packet of one of the frames."""
        return self._packet

    def payloads(self, count: int) -> NDArray[np.uint8]:
        """Return the payloads of the first frames as bytes, (count, size)."""
        return np.broadcast_to(np.frombuffer(self._packet.payload, np.uint8), (count, self.size))

    def sliced(self, start: int, stop: int) -> ConstantColumn:
        """Return the column of some of the frames."""
        return ConstantColumn(self._packet, stop - start)


class PackedColumn:
    """Payloads of some size in CARLA's layout, at equal distances (`stride` bytes) in a buffer, from an offset on.

    `origin` is the location of the file that the buffer was read from, and the offset of the buffer's first byte in it.
    """

    __slots__ = ("_buffer", "_count", "_offset", "_origin", "_stride", "id", "size", "type")

    def __init__(
        self,
        id: int,
        type: RecordType | None,
        size: int,
        buffer: Buffer,
        offset: int,
        stride: int,
        count: int,
        origin: tuple[str, int] | None = None,
    ) -> None:
        self.id = id
        self.type = type
        self.size = size
        self._buffer = buffer
        self._offset = offset
        self._stride = stride
        self._count = count
        self._origin = origin

    @property
    def records(self) -> NDArray[np.void]:
        """The records of all frames, (frames, records of each): a strided view of the buffer."""
        type = self.type
        assert type is not None
        itemsize = type.dtype.itemsize
        start = U16.size if type.framing is Framing.LIST else 0
        number = 1 if type.framing is Framing.SINGLE else 0
        if type.framing is Framing.LIST and self.size >= start:
            (number,) = U16.unpack_from(self._buffer, self._offset)
        if start + number * itemsize != self.size:
            self.packet(0).records  # noqa: B018  (raises the error that names the offset, or warns of surplus bytes)
        shape, strides = (self._count, number), (self._stride, itemsize)
        if not number:
            return np.empty(shape, type.dtype)
        return np.ndarray(shape, type.dtype, self._buffer, self._offset + start, strides)

    def packet(self, row: int) -> Packet:
        """Return the packet of one of the frames."""
        start = self._offset + row * self._stride
        origin = (self._origin[0], self._origin[1] + start) if self._origin else None
        return Packet(self.id, self.type, self._buffer[start : start + self.size], None, origin)

    def payloads(self, count: int) -> NDArray[np.uint8]:
        """Return the payloads of the first frames as bytes, (count, size): a strided view of the buffer."""
        if not self.size:
            return np.empty((count, 0), np.uint8)
        return np.ndarray((count, self.size), np.uint8, self._buffer, self._offset, (self._stride, 1))

    def sliced(self, start: int, stop: int) -> PackedColumn:
        """Return the column of some of the frames."""
        offset = self._offset + start * self._stride
        return PackedColumn(self.id, self.type, self.size, self._buffer, offset, self._stride, stop - start, self._origin)


Column = ConstantColumn | PackedColumn
"""The packets at one position in the frames of a batch: all of one id, type (None for an unknown id), size and count."""


def packed(type: RecordType, records: NDArray[np.void]) -> PackedColumn:
    """Return the column of packets made from records of one size, (frames, records of each), with the fields of a type."""
    start = 0 if type.framing is Framing.SINGLE else U16.size
    size = start + records.shape[1] * type.dtype.itemsize
    data = np.empty((len(records), size), np.uint8)
    if start:
        data[:, :start] = np.frombuffer(U16.pack(records.shape[1]), np.uint8)
    if records.size:
        rows = np.ndarray(records.shape, type.dtype, data, start, (size, type.dtype.itemsize))
        for name in type.dtype.names or ():
            rows[name] = records[name]
    return PackedColumn(type.id, type, size, read_only(data.reshape(-1)).data, 0, size, len(records))


class Batch:
    """A run of consecutive frames of one shape: the same packets, in the same order, of the same sizes and counts.

    Attributes:
        index: The position of the first frame in the recording, from 0.
        columns: The packets of the frames, in file order; those that start the frames are not among them.
        id: CARLA's frame numbers, (n,).
        elapsed: Seconds since the recording began, (n,).
        duration: Seconds until the next frame, (n,); -1 for the last one of a recording.
        preamble: Whether these are packets before the first frame starts.
    """

    __slots__ = ("columns", "duration", "elapsed", "id", "index", "preamble")

    def __init__(
        self,
        index: int,
        id: NDArray[np.uint64],
        elapsed: Floats,
        duration: Floats,
        columns: Sequence[Column],
        *,
        preamble: bool = False,
    ) -> None:
        self.index = index
        self.id = id
        self.elapsed = elapsed
        self.duration = duration
        self.columns = columns
        self.preamble = preamble

    @staticmethod
    def of(frame: Frame) -> Batch:
        """Return the batch of a single frame."""
        id = read_only(np.array([frame.id], np.uint64))
        elapsed, duration = read_only(np.array(((frame.elapsed,), (frame.duration,)), np.float64))
        columns = [ConstantColumn(packet) for packet in frame.packets]
        return Batch(frame.index, id, elapsed, duration, columns, preamble=frame.preamble)

    def __len__(self) -> int:
        return len(self.id)

    def __iter__(self) -> Iterator[Frame]:
        return map(self.frame, range(len(self)))

    def __repr__(self) -> str:
        names = ", ".join(column.type.name if column.type else str(column.id) for column in self.columns)
        return f"Batch({len(self)} frames from {self.index}; {names})"

    def frame(self, row: int) -> Frame:
        """Return one of the frames; -1 stands for the last one."""
        row = range(len(self))[row]
        packets = [column.packet(row) for column in self.columns]
        id, elapsed, duration = self.id.item(row), self.elapsed.item(row), self.duration.item(row)
        return Frame(self.index + row, id, elapsed, duration, packets, preamble=self.preamble)

    @overload
    def __getitem__(self, key: str) -> NDArray[np.void]: ...
    @overload
    def __getitem__(self, key: slice) -> Batch: ...
    def __getitem__(self, key: str | slice) -> NDArray[np.void] | Batch:
        """Return the records of a type by its name, see `records`; or the batch of some consecutive frames by a slice.

        Raises:
            RecordError: See `records`.
            FormatError: See `records`.
            TypeError: The key is neither, or the slice leaves frames out.
        """
        if isinstance(key, str):
            return self.records(key)
        if not isinstance(key, slice) or key.step not in (None, 1):
            raise TypeError(f"expected the name of a record type, or a slice of frames in a row, found {key!r}")
        start, stop, _ = key.indices(len(self))
        stop = max(start, stop)
        return Batch(
            self.index + start,
            self.id[start:stop],
            self.elapsed[start:stop],
            self.duration[start:stop],
            [column.sliced(start, stop) for column in self.columns],
            preamble=self.preamble,
        )

    def records(self, name: str) -> NDArray[np.void]:
        """Return the records of a type, (frames, records of each); of several packets, one after the other. Read-only.

        Args:
            name: A record type whose records have one size.

        Raises:
            RecordError: There is no such type, or its records vary in size.
            FormatError: A packet contradicts its layout.
        """
        type = UE4.named(name)
        if not type.fixed:
            raise RecordError(f"{name}: the records vary in size; take them from the frames")
        found = [column.records for column in self.columns if column.type is not None and column.type.name == name]
        if not found:
            found.append(np.empty((len(self), 0), type.dtype))
        records = found[0] if len(found) == 1 else np.concatenate(found, axis=1)
        return read_only(records.view()) if records.flags.writeable else records


def equal_rows(rows: NDArray[Any], columns: NDArray[np.intp], masks: NDArray[Any] | None = None) -> int:
    """Return the number of rows, from the first one on, that equal it in some columns, or in some bits of these."""
    expected = rows[0, columns]
    if masks is not None:
        expected &= masks
    equal, step = 1, _FIRST_STEP
    while equal < len(rows):
        found = rows[equal : equal + step, columns]
        if masks is not None:
            found &= masks
        different = found != expected
        first = int(different.argmax())
        if different.item(first):
            return equal + first // len(columns)
        equal = min(equal + step, len(rows))
        step *= _GROWTH
    return equal


class FramePart:
    """The frames from one elapsed time on (-inf: all), until the first one at or after another (inf: all), in s.

    Frames between these two are in it, even if their clock goes back to before the first. Batches are given in file order.
    """

    def __init__(self, start: float, stop: float) -> None:
        self._start, self._stop = start, stop
        self._begun = start == -np.inf
        self.ended = False

    def of(self, batch: Batch) -> Batch:
        """Return the frames of a batch that are in it."""
        first, stop = 0, 0 if self.ended else len(batch)
        if stop and self._stop < np.inf and len(late := np.flatnonzero(batch.elapsed >= self._stop)):
            stop, self.ended = int(late[0]), True
        if stop and not self._begun:
            reached = np.flatnonzero(batch.elapsed[:stop] >= self._start)
            self._begun, first = bool(len(reached)), int(reached[0]) if len(reached) else stop
        return batch if stop - first == len(batch) else batch[first:stop]


def within(batches: Iterable[Batch], start: float, stop: float) -> Iterator[Batch]:
    """Yield the frames of a `FramePart`, in batches."""
    part = FramePart(start, stop)
    for batch in batches:
        if len(found := part.of(batch)):
            yield found
        if part.ended:
            return
