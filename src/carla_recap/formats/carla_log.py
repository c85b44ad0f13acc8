"""CARLA's own binary `.log`: a header, then packets, each with an id and a size.

The format is little-endian and packed. Sources: CARLA's public documentation of the recorder's binary file format, and real
recordings of 0.9.10 and 0.9.13.
"""

from __future__ import annotations

import math
import struct
import warnings
from array import array
from typing import TYPE_CHECKING, BinaryIO, Final

import numpy as np

from carla_recap.errors import FormatError, NotARecording, RecapWarning, RecordError
from carla_recap.formats.base import PIECE, Reader, Writer
from carla_recap.formats.log_scan import PACKET, START, START_HEAD, Scanner, Window, is_sound
from carla_recap.formats.sources import LocalSource
from carla_recap.model.batch import Batch, ConstantColumn, PackedColumn
from carla_recap.model.frame import SAME_TIME, Extent, Frame, Header, Packet
from carla_recap.model.layout import EMPTY_LIST, MAX_COUNT, OBJECTS_LIMIT, U16, Buffer, Framing
from carla_recap.model.records import FRAME_START, UE4, UE5, RecordType

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Sequence
    from pathlib import Path

    from carla_recap.formats.log_scan import PacketSpan, Run
    from carla_recap.model.batch import Column

MAGIC: Final = b"CARLA_RECORDER"
DATE: Final = struct.Struct("<q")
_STARTS: Final = np.dtype([("id", "<u8"), ("duration", "<f8"), ("elapsed", "<f8")])
_BARE: Final = {Framing.LIST: EMPTY_LIST, Framing.MARKER: b""}  # payloads without records

SHIFT: Final = {21: 23, 22: 21, 23: 22}
"""Packet ids of the development builds that put the doors first, and the ids of all other builds."""
UNSHIFT: Final = {plain: shifted for shifted, plain in SHIFT.items()}

_SNIFFED_FRAMES: Final = 3  # builds that have the shifted packets write them in every frame
_SNIFFED_PACKETS: Final = 20_000
SYNC_SECONDS: Final = 5.0
"""The time in seconds that a live recording loses at most if its process dies."""

_FEW: Final = 1 << 15  # bytes that are read for one frame, unless it is larger
_LONGEST_HEADER: Final = 1 << 18  # bytes: two texts of at most 64 KiB, and some numbers
_SNIFFED: Final = frozenset((2, 6, 12, 13, 17, *SHIFT))  # ids of packets by which builds differ


def is_log(start: bytes) -> bool:
    """Return whether a file that starts with some bytes is a CARLA log; CARLA ignores the case of the magic."""
    return len(start) >= 4 and start[4 : 4 + U16.unpack_from(start, 2)[0]].upper() == MAGIC


class LogReader(Reader):
    """Reads a CARLA log from a path, a `file:` URL, or in place of it from an unbuffered `file`: a copy of an object.

    If it is `lenient`, it leaves out what contradicts the format, and goes on with the next frame that looks complete.
    It raises `NotARecording` for a file that is no CARLA log, and `FormatError` for a header that contradicts the format.
    """

    def __init__(self, location: Path | str, *, lenient: bool = False, file: BinaryIO | None = None) -> None:
        self.lost_bytes = 0  # the number of bytes that were left out so far
        self._lenient = lenient
        self._warned = False
        self._extent: Extent | None = None
        self._elapsed: array[float] | None = None  # of each frame, in s
        self._offsets: array[int] | None = None  # of each frame, once all have been read
        self._end: int | None = None  # of the last complete packet, once known
        self._source = LocalSource(location, file)
        self.path, self.location, self._size = self._source.path, self._source.location, self._source.size
        try:
            if not self._size:
                raise NotARecording(location, "expected a CARLA log, found an empty file")
            self.header, self._start = self._read_header()
        except BaseException:
            self._source.close()
            raise
        self._types: list[RecordType | None] = [None] * 256
        for type in self.header.table:
            self._types[UNSHIFT.get(type.id, type.id) if self.header.shifted else type.id] = type
        self._ids = [SHIFT.get(id, id) if self.header.shifted else id for id in range(256)]
        # Packets without records, which are in every frame; by id in the file and payload.
        self._empty = {
            (id, bare): Packet(self._ids[id], type, bare)
            for id, type in enumerate(self._types)
            if type is not None and (bare := _BARE.get(type.framing)) is not None
        }
        start = self._window().read(self._start, 1)
        self._preamble = bool(start) and start[0] != FRAME_START

    @property
    def is_empty(self) -> bool:
        """Whether the file ends with the header."""
        return self._start == self._size

    def _batches(self, types: Collection[str] | None, start: float, stop: float, *, sparse: bool) -> Iterator[Batch]:
        names = None if types is None else frozenset(self.header.table.named(name).name for name in types)
        first = (0, self._start) if start == -math.inf else self._first_at(start)
        if start > -math.inf and sparse:  # if the clock goes back, the first frame of the part may hold no wanted packet
            sparse = bool((np.diff(np.frombuffer(self._indexed()[0])) >= 0).all())
        if first is not None:
            yield from map(self._batch, self._runs(*first, names, sparse=sparse and stop == math.inf))

    def frame_at(self, elapsed: float) -> Frame | None:
        """Return the frame at a time; see `Reader.frame_at`."""
        self.check_open()
        times, offsets = self._indexed()
        later = np.flatnonzero(np.frombuffer(times) > elapsed + SAME_TIME)
        position = (int(later[0]) if len(later) else len(times)) - 1
        return None if position < 0 or math.isnan(elapsed) else self._frame_from(position, offsets[position], None)

    def frames_by_index(self, indexes: Iterable[int], types: Collection[str]) -> Iterator[Frame] | None:
        """Return the frames at some indexes, if all frames have been read before; see `Reader.frames_by_index`."""
        if (offsets := self._offsets) is None:
            return None
        names = frozenset(types)
        return (self._frame_from(index, offsets[index], names, piece=_FEW) for index in indexes)

    def extent(self) -> Extent:
        """Return the number of frames, the last id and the duration."""
        if self._extent is None:
            for _ in self._runs(0, self._start, frozenset(), sparse=True):
                pass
        assert self._extent
        return self._extent

    def tail(self) -> Iterator[bytes]:
        """Yield the bytes after the last complete packet, in pieces."""
        self.check_open()
        self.extent()
        assert self._end is not None
        for offset in range(self._end, self._size, PIECE):
            yield self._window().read(offset, PIECE)

    # --- the header ----------------------------------------------------------------------------------------------------

    def _read_header(self) -> tuple[Header, int]:
        start = self._window().read(0, _LONGEST_HEADER)
        if not is_log(start):
            raise NotARecording(self.location, "is not a CARLA log (the magic CARLA_RECORDER is missing)")
        try:
            (version,) = U16.unpack_from(start)
            _, offset = _read_text(start, 2)
            (date,) = DATE.unpack_from(start, offset)
            name, end = _read_text(start, offset + DATE.size)
        except (struct.error, IndexError):
            raise FormatError(self.location, len(start), "the file ends inside the header") from None
        plain = Header(name.decode("utf-8", "surrogateescape"), date, version)
        raw = start[:end]
        wide, shifted = self._sniff(end)
        return Header(plain.map_name, date, version, wide, shifted, None if raw == pack_header(plain) else raw), end

    def _sniff(self, offset: int) -> tuple[bool, bool]:
        """Return by what builds the file was written: whether lengths are doubles, and whether the ids are shifted."""
        wide: bool | None = None
        shifted: bool | None = None
        spawns: bytes | None = None
        after = False
        window, size = self._window(), self._size
        scanner = Scanner(self.location, window, [None] * 256)
        frames = 0
        for _ in range(_SNIFFED_PACKETS):
            sized = wide is not None or spawns is not None
            if offset + PACKET.size > size or (sized and (shifted is not None or frames > _SNIFFED_FRAMES)):
                break
            window.begin(offset)
            id, length = PACKET.unpack(window.read(offset, PACKET.size))
            if offset + PACKET.size + length > size or (id == FRAME_START and length != START.size):
                complete = scanner.next_frame(offset + 1) if self._lenient else None
                if complete is None:
                    break
                offset = complete
                continue
            payload = window.read(offset + PACKET.size, length) if id in _SNIFFED and length <= OBJECTS_LIMIT else b""
            offset += PACKET.size + length
            if id == FRAME_START:
                after = False
                frames += 1
            elif 6 <= id <= 11:
                after = True
            if wide is None and id in (6, 12, 13, 17):
                wide = next((table.wide for table in (UE4, UE5) if length > 2 and is_sound(table[id], payload)), None)
            elif id == 2 and spawns is None and length > 2:
                spawns = payload
            elif shifted is None and id in SHIFT:
                shifted = _is_shifted(id, payload, after)
        if wide is None and spawns is not None:
            wide = not is_sound(UE4[2], spawns) and is_sound(UE5[2], spawns)
        return bool(wide), bool(shifted)

    # --- the frames ----------------------------------------------------------------------------------------------------

    def _window(self, piece: int | None = None) -> Window:
        self.check_open()
        return Window(self._source, piece)

    def _frame_from(self, index: int, offset: int, names: frozenset[str] | None, *, piece: int | None = None) -> Frame:
        """Return a frame that was found before; for the arguments see `_runs`."""
        run = next(self._runs(index, offset, names, piece=piece), None)
        if run is None:
            raise FormatError(self.location, offset, "the file has changed while it was read")
        return self._batch(run).frame(0)

    def _runs(
        self, index: int, offset: int, names: frozenset[str] | None, *, sparse: bool = False, piece: int | None = None
    ) -> Iterator[Run]:
        """Scan the frames from one on to the end; by default for all packets, else for those of some types with records.

        With `sparse`, frames without such packets are left out. `piece` bytes are read at once, if not as many as usual.
        """
        window = self._window(piece)
        wanted = None if names is None else [type is not None and type.name in names for type in self._types]
        scanner = Scanner(self.location, window, self._types, wanted=wanted, sparse=sparse, lenient=self._lenient)
        for run in scanner.runs(index, offset, preamble=self._preamble and offset == self._start):
            yield run
            self.check_open()
        self.lost_bytes += scanner.lost_bytes
        assert scanner.end is not None
        self._end = scanner.end
        if offset == self._start:
            self._offsets = scanner.offsets
        self._extent = Extent()
        if scanner.last is not None:
            id, _, elapsed = START.unpack(window.read(scanner.last + PACKET.size, START.size))
            self._extent = Extent(scanner.count - self._preamble, id, elapsed)
        if self._end < self._size and not self._warned:
            self._warned, dropped = True, self._size - self._end
            message = f"the recording was cut short; the last {dropped} bytes are no complete packet"
            warnings.warn(f"{self.location}: byte {self._end}: {message}", RecapWarning, stacklevel=2)

    def _batch(self, run: Run) -> Batch:
        """Return the frames of a run."""
        index, offset, count, stride, packets, preamble, data, base = run
        start = offset - base
        if count == 1:
            return Batch.of(self._frame(index, start, packets, data, base, preamble=preamble))
        origin = self.location, base
        columns: list[Column] = []
        for id, offset, size in packets:
            offset += start
            empty = self._empty.get((id, data[offset : offset + size])) if size <= len(EMPTY_LIST) else None
            if empty is not None:
                columns.append(ConstantColumn(empty, count))
            else:
                columns.append(PackedColumn(self._ids[id], self._types[id], size, data, offset, stride, count, origin))
        starts = np.ndarray((count,), _STARTS, data, start + PACKET.size, (stride,))
        return Batch(index, starts["id"], starts["elapsed"], starts["duration"], columns)

    def _frame(
        self, index: int, start: int, spans: Sequence[PacketSpan], data: bytes, base: int, *, preamble: bool
    ) -> Frame:
        """Return the frame that starts at an index of some data, which are at `base` in the file."""
        types, ids, empty = self._types, self._ids, self._empty
        packets = []
        for id, offset, size in spans:
            offset += start
            if size > 2 or (ready := empty.get((id, data[offset : offset + size]))) is None:
                # Bytes of its own: few packets that are kept do not keep all bytes that were read.
                payload = data[offset : offset + size]
                packets.append(Packet(ids[id], types[id], payload, None, (self.location, base + offset)))
            else:
                packets.append(ready)
        if self._lenient:
            packets = self._sound(packets)
        if preamble:
            return Frame(index, 0, 0.0, 0.0, packets, preamble=True)
        id, duration, elapsed = START.unpack_from(data, start + PACKET.size)
        return Frame(index, id, elapsed, duration, packets)

    def _sound(self, packets: list[Packet]) -> list[Packet]:
        """Return those packets that are sound, and count the bytes of the others as lost."""
        kept = [packet for packet in packets if is_sound(packet.type, packet.payload)]
        self.lost_bytes += sum(len(packet.payload) for packet in packets) - sum(len(packet.payload) for packet in kept)
        return kept

    # --- random access -------------------------------------------------------------------------------------------------

    def _indexed(self) -> tuple[array[float], array[int]]:
        """Return the elapsed seconds and the offsets of all frames."""
        if self._elapsed is None:
            elapsed = array("d")
            for run in self._runs(0, self._start, frozenset()):
                if run.preamble:
                    elapsed.append(0.0)
                else:
                    shape, stride = (run.frames,), (run.stride,)
                    starts = np.ndarray(shape, _STARTS, run.data, run.offset - run.base + PACKET.size, stride)
                    elapsed.frombytes(starts["elapsed"].tobytes())
            self._elapsed = elapsed
        assert self._offsets is not None
        return self._elapsed, self._offsets

    def _first_at(self, start: float) -> tuple[int, int] | None:
        """Return the position and the offset of the first frame at or after a time."""
        times, offsets = self._indexed()
        later = np.flatnonzero(np.frombuffer(times) >= start)
        return (int(later[0]), offsets[int(later[0])]) if len(later) else None


def _read_text(data: bytes, offset: int) -> tuple[bytes, int]:
    end = offset + 2 + U16.unpack_from(data, offset)[0]
    if end > len(data):
        raise IndexError
    return data[offset + 2 : end], end


def _is_shifted(id: int, payload: bytes, after: bool) -> bool | None:
    """Return whether a packet with one of the ambiguous ids is of a build with shifted ids; None if both are possible.

    Doors come before transforms; what else has these ids comes after them, or after a later packet (`after`).
    """
    if len(payload) > len(EMPTY_LIST):
        plain, shifted = is_sound(UE4[id], payload), is_sound(UE4[SHIFT[id]], payload)
        if plain != shifted:
            return shifted
    if id == 22:
        return None
    return after if id == 23 else not after


def pack_header(header: Header) -> bytes:
    """Return the bytes of a header."""
    if header.raw is not None:
        return header.raw
    try:
        name = header.map_name.encode("utf-8", "surrogateescape")
        if len(name) > MAX_COUNT:
            found = f"{len(name)}: {header.map_name[:20]}…"
            raise RecordError(f"expected a map name of at most {MAX_COUNT} bytes, found {found}")
        start = U16.pack(header.version) + U16.pack(len(MAGIC)) + MAGIC
        return start + DATE.pack(header.date) + U16.pack(len(name)) + name
    except (struct.error, UnicodeEncodeError) as error:
        raise RecordError(
            f"a header of version {header.version}, date {header.date} and map {header.map_name!r:.40} "
            f"cannot be written: {error}"
        ) from None


class LogWriter(Writer):
    """Writes a CARLA log; if it is `live`, the frames every `SYNC_SECONDS` of recording. See `AtomicFile`."""

    def __init__(self, path: Path | str, header: Header, *, live: bool = False, force: bool = True) -> None:
        start = pack_header(header)
        super().__init__(path, live=live, force=force)
        self._shift = UNSHIFT if header.shifted else {}
        self._elapsed, self._unsynced = -math.inf, math.inf  # of the latest frame, and since a sync, in s
        self._begin(lambda: self._put(start))

    def write(self, frame: Frame) -> None:
        """Add a frame."""
        parts: list[Buffer] = []
        if not frame.preamble:
            parts += (START_HEAD, START.pack(frame.id, frame.duration, frame.elapsed))
        pack, shift = PACKET.pack, self._shift
        for packet in frame.packets:
            id, payload = packet.id, packet.payload
            parts.append(pack(shift.get(id, id), len(payload)))
            parts.append(payload)
        self._put(b"".join(parts))
        self._sync_from(frame.elapsed)

    def write_batch(self, batch: Batch) -> None:
        """Add the frames of a batch."""
        if batch.preamble or len(batch) == 1:
            for frame in batch:
                self.write(frame)
            return
        template = bytearray(START_HEAD + bytes(START.size))
        payloads = []
        for column in batch.columns:
            template += PACKET.pack(self._shift.get(column.id, column.id), column.size)
            payloads.append((len(template), column))
            template += bytes(column.size)
        data = np.empty((len(batch), len(template)), np.uint8)
        data[:] = np.frombuffer(template, np.uint8)
        starts = np.ndarray((len(batch),), _STARTS, data.data, PACKET.size, (len(template),))
        starts["id"], starts["duration"], starts["elapsed"] = batch.id, batch.duration, batch.elapsed
        for offset, column in payloads:
            if column.size:
                data[:, offset : offset + column.size] = column.payloads(len(batch))
        self._put(data.data)
        for elapsed in batch.elapsed.tolist() if self._live else ():
            self._sync_from(elapsed)

    def _sync_from(self, elapsed: float) -> None:
        self._unsynced += abs(elapsed - self._elapsed)
        self._elapsed = elapsed
        if self._live and not self._unsynced < SYNC_SECONDS:  # of a time that is no number, too
            self._sync()
            self._unsynced = 0.0

    def write_tail(self, piece: bytes) -> None:
        """Add bytes after the last complete packet."""
        self._put(piece)
