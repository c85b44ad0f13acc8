"""CARLA's own binary `.log`: a header, then packets, each with an id and a size.

The format is little-endian and packed. Facts: CARLA's public documentation of the recorder's binary file format, and what
real recordings of 0.9.10 and 0.9.13 hold.
"""

from __future__ import annotations

import math
import mmap
import os
import stat
import struct
import warnings
from array import array
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import Closed, FormatError, NotARecording, RecapError, RecapWarning, RecordError
from carla_recap.formats.atomic import AtomicFile
from carla_recap.formats.base import PIECE
from carla_recap.frame import SAME_TIME, Extent, Frame, Header, Packet, Run
from carla_recap.payload import EMPTY_LIST, U16, Buffer, PayloadError, check
from carla_recap.records import FRAME_END, FRAME_START, UE4, UE5, Framing, RecordType

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

MAGIC: Final = b"CARLA_RECORDER"
PACKET: Final = struct.Struct("<BI")  # id, size of the payload
START: Final = struct.Struct("<Qdd")  # frame, duration, elapsed
DATE: Final = struct.Struct("<q")

SHIFT: Final = {21: 23, 22: 21, 23: 22}
"""Packet ids of the development builds that put the doors first, and what they are in all others."""
UNSHIFT: Final = {plain: shifted for shifted, plain in SHIFT.items()}

_SNIFFED_FRAMES: Final = 3  # builds that have the shifted packets write them in every frame
_SNIFFED_PACKETS: Final = 20_000
PACKETS_LIMIT: Final = 200_000
"""The most packets of a frame; CARLA writes some twenty."""
SYNC_SECONDS: Final = 5.0
"""How many seconds of a live recording may be lost when the process dies."""
_PACKETS_IN_A_FRAME: Final = 256
_FORGET: Final = 16 << 20  # mapped pages are given back every so many bytes

Place = tuple[int, int, int]  # packet id as in the file, offset and size of the payload


@dataclass(frozen=True)
class _Index:
    """Where each frame begins."""

    offsets: array[int]
    elapsed: array[float]


def is_log(start: bytes) -> bool:
    """Whether a file that starts so is a CARLA log; CARLA ignores the case of the magic."""
    return len(start) >= 4 and start[4 : 4 + U16.unpack_from(start, 2)[0]].upper() == MAGIC


class LogReader:
    """Reads a CARLA log.

    Args:
        path: The file.
        salvage: Leave out what contradicts the format, and go on with the next frame that looks whole.

    Attributes:
        lost_bytes: What salvage had to leave out so far.

    Raises:
        NotARecording: It is no CARLA log.
        FormatError: It contradicts the format.
    """

    def __init__(self, path: Path | str, *, salvage: bool = False) -> None:
        self.path = Path(path)
        self.lost_bytes = 0
        self._closed = False
        self._salvage = salvage
        try:
            with self.path.open("rb") as file:
                if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                    raise NotARecording(path, "is not a regular file")
                self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:
            raise NotARecording(path, "is empty, a CARLA log was expected") from None
        except OSError as error:
            raise RecapError(f"{path}: {error.strerror}") from None
        self._view = memoryview(self._map)
        self._warned: set[str] = set()
        self._extent: Extent | None = None
        self._next_whole: tuple[int, int | None] = (0, -1)  # from there on, the first frame that looks whole
        self._index: _Index | None = None
        self._end = len(self._view)  # of the last complete packet, once known
        header, self._start = self._read_header()
        self.header = header
        self._preamble = len(self._view) > self._start and self._view[self._start] != FRAME_START
        self._types: list[RecordType | None] = [None] * 256
        for type in header.table:
            self._types[UNSHIFT.get(type.id, type.id) if header.shifted else type.id] = type
        # Packets without records, which are in every frame; by id and payload.
        self._ready = {
            (id, payload): Packet(type.id, type, payload)
            for id, type in enumerate(self._types)
            if type is not None
            for payload in (b"" if type.framing is Framing.MARKER else EMPTY_LIST,)
            if type.framing is not Framing.SINGLE
        }

    def close(self) -> None:
        """Let go of the file; it is unmapped when the last array that came from it is gone."""
        self._closed = True
        self._view.release()

    def _check_open(self) -> None:
        if self._closed:
            raise Closed(self.path)

    def frames(
        self,
        types: Collection[str] | None = None,
        *,
        sparse: bool = False,
        start: float = -math.inf,
        stop: float = math.inf,
    ) -> Iterator[Frame]:
        """Stream the frames; see `Reader.frames`."""
        self._check_open()
        start, stop = start - SAME_TIME, stop - SAME_TIME
        if types is None:
            wanted = [True] * 256
            ignored_size = -1
        else:
            names = {self.header.table.named(name).name for name in types}
            wanted = [type is not None and type.name in names for type in self._types]
            ignored_size = len(EMPTY_LIST)
        first = (0, self._start) if start == -math.inf else self._first_at(start)
        if first is None:
            return
        for found in self._walk(wanted, ignored_size, sparse, *first):
            frame = self._frame(*found)
            if stop < math.inf and frame.elapsed >= stop:
                return
            if start == -math.inf or frame.elapsed >= start:
                yield frame
                self._check_open()

    def frame_at(self, elapsed: float) -> Frame | None:
        """The last frame that begins at or before a time; see `Reader.frame_at`."""
        self._check_open()
        elapsed += SAME_TIME
        times = np.frombuffer(self._indexed().elapsed, np.float64)
        earlier = np.flatnonzero(times <= elapsed)
        if not len(earlier):
            return None
        index = int(earlier[-1])
        wanted = [True] * 256
        walk = self._walk(wanted, -1, False, index, self._indexed().offsets[index])
        return self._frame(*next(walk))

    def extent(self) -> Extent:
        """How far the recording goes."""
        if self._extent is None:
            self._check_open()
            for _ in self._walk([False] * 256, -1, True, 0, self._start):
                pass
        assert self._extent
        return self._extent

    def stretches(self, min_time: float, min_distance: float) -> None:
        """None: only the frames of a log tell who stood still."""

    def tail(self) -> Iterator[bytes]:
        """Yield the bytes behind the last complete packet, in pieces."""
        self._check_open()
        self.extent()
        for at in range(self._end, len(self._view), PIECE):
            self._check_open()
            yield bytes(self._view[at : at + PIECE])

    # --- the header ----------------------------------------------------------------------------------------------------

    def _read_header(self) -> tuple[Header, int]:
        view = self._view
        try:
            (version,) = U16.unpack_from(view)
            magic, at = self._read_text(2)
            if magic.upper() != MAGIC:
                raise NotARecording(self.path, "is not a CARLA log (the magic CARLA_RECORDER is missing)")
            (date,) = DATE.unpack_from(view, at)
            name, end = self._read_text(at + DATE.size)
        except (struct.error, IndexError):
            if not is_log(bytes(view[:64])):
                raise NotARecording(self.path, "is not a CARLA log (the magic CARLA_RECORDER is missing)") from None
            raise FormatError(self.path, len(view), "the file ends inside the header") from None
        plain = Header(name.decode("utf-8", "surrogateescape"), date, version)
        raw = bytes(view[:end])
        wide, shifted = self._sniff(end)
        return Header(plain.map_name, date, version, wide, shifted, None if raw == pack_header(plain) else raw), end

    def _read_text(self, at: int) -> tuple[bytes, int]:
        end = at + 2 + U16.unpack_from(self._view, at)[0]
        if end > len(self._view):
            raise IndexError
        return bytes(self._view[at + 2 : end]), end

    def _sniff(self, at: int) -> tuple[bool, bool]:
        """Which family of builds wrote the file: whether lengths are doubles, whether the ids are shifted."""
        wide: bool | None = None
        shifted: bool | None = None
        spawns: memoryview | None = None
        after = False
        view, size = self._view, len(self._view)
        frames = 0
        for _ in range(_SNIFFED_PACKETS):
            sized = wide is not None or spawns is not None
            if at + PACKET.size > size or (sized and (shifted is not None or frames > _SNIFFED_FRAMES)):
                break
            id, length = PACKET.unpack_from(view, at)
            payload = view[at + PACKET.size : at + PACKET.size + length]
            if len(payload) < length or (id == FRAME_START and length != START.size):
                whole = self._next_frame(at + 1) if self._salvage else None
                if whole is None:
                    break
                at = whole
                continue
            at += PACKET.size + length
            if id == FRAME_START:
                after = False
                frames += 1
            elif 6 <= id <= 11:
                after = True
            if wide is None and id in (6, 12, 13, 17):
                wide = next((table.wide for table in (UE4, UE5) if length > 2 and _fits(table[id], payload)), None)
            elif id == 2 and spawns is None and length > 2:
                spawns = payload
            elif shifted is None and id in SHIFT:
                shifted = _is_shifted(id, payload, after)
        if wide is None and spawns is not None:
            wide = not _fits(UE4[2], spawns) and _fits(UE5[2], spawns)
        return bool(wide), bool(shifted)

    def _plain_id(self, id: int) -> int:
        return SHIFT.get(id, id) if self.header.shifted else id

    # --- the packets ---------------------------------------------------------------------------------------------------

    def _walk(
        self, wanted: list[bool], ignored_size: int, sparse: bool, number: int, at: int
    ) -> Iterator[tuple[int, int, list[Place]]]:
        """Hop over the packets from a frame's offset; yield each frame's number, its offset and its wanted packets.

        Packets before the first frame make a frame of their own, with offset -1.
        """
        view, last_head, size, head = (
            self._view,
            len(self._view) - PACKET.size,
            len(self._view),
            PACKET.unpack_from,
        )
        begun = self._preamble and at == self._start
        number -= not begun
        frame_at = -1
        places: list[Place] = []
        forget_at = at + _FORGET
        while at <= last_head:
            id, length = head(view, at)
            end = at + 5 + length
            if end > size:
                if self._salvage and (whole := self._next_frame(at + 1)) is not None:
                    at = self._lose(at, whole)
                    continue
                break
            if self._salvage and id > FRAME_END and (whole := self._frame_inside(id, at, end)) is not None:
                at = self._lose(at, whole)
                continue
            if id > FRAME_END:
                if wanted[id] and length != ignored_size:
                    places.append((id, at + 5, length))
                    if len(places) > PACKETS_LIMIT and self._salvage:
                        self.lost_bytes += PACKET.size + places.pop()[2]
                    elif len(places) > PACKETS_LIMIT:
                        raise FormatError(self.path, at, f"more than {PACKETS_LIMIT} packets in a frame")
            elif length != (0 if id else 24):
                if self._only_zeros(at):
                    break
                if self._salvage:
                    whole = self._next_frame(at + 1)
                    at = self._lose(at, size if whole is None else whole)
                    continue
                name, expected = ("FrameEnd", 0) if id else ("FrameStart", START.size)
                raise FormatError(self.path, at, f"{name} of {length} bytes, {expected} were expected")
            elif id:
                if wanted[FRAME_END]:
                    places.append((id, end, 0))
            else:
                if places or (begun and not sparse):
                    yield number, frame_at, places
                    places = []
                begun = True
                number += 1
                frame_at = at
                if at > forget_at:
                    self._forget(forget_at - _FORGET)
                    forget_at = at + _FORGET
            at = end
        self._note_end(at, number, frame_at)
        if places or (begun and not sparse):
            yield number, frame_at, places

    def _frame(self, number: int, frame_at: int, places: list[Place]) -> Frame:
        view, types, path = self._view, self._types, self.path
        id, duration, elapsed = 0, 0.0, 0.0
        packets = []
        if frame_at >= 0:
            id, duration, elapsed = START.unpack_from(view, frame_at + PACKET.size)
        for code, at, length in places:
            payload = view[at : at + length]
            if length < 3 and (empty := self._ready.get((code, bytes(payload)))):
                packets.append(empty)
            else:
                packets.append(Packet(self._plain_id(code), types[code], payload, None, (path, at)))
        if self._salvage:
            sound = [packet for packet in packets if self._is_sound(packet)]
            self.lost_bytes += sum(len(packet.payload) for packet in packets) - sum(len(p.payload) for p in sound)
            packets = sound
        return Frame(number, id, elapsed, duration, packets, preamble=frame_at < 0)

    def _lose(self, at: int, until: int) -> int:
        self.lost_bytes += until - at
        return until

    def _next_frame(self, at: int) -> int | None:
        """Return where the next frame begins that looks whole."""
        since, known = self._next_whole
        if since <= at and (known is None or at <= known):
            return known
        since = at
        while (at := self._map.find(_START_HEAD, at)) >= 0 and not self._looks_whole(at):
            at += 1
        self._next_whole = since, at if at >= 0 else None
        return self._next_whole[1]

    def _frame_inside(self, id: int, at: int, end: int) -> int | None:
        """Where a frame begins inside a packet that is not sound, or of unknown kind: its size is what is broken."""
        packet = Packet(id, self._types[id], self._view[at + PACKET.size : end])
        if packet.type is not None and not packet.type.opaque and self._is_sound(packet):
            return None
        inside = self._next_frame(at + 1)
        return inside if inside is not None and inside < end else None

    def _looks_whole(self, at: int) -> bool:
        at += PACKET.size + START.size
        for _ in range(_PACKETS_IN_A_FRAME):
            if at + PACKET.size > len(self._view):
                return False
            id, length = PACKET.unpack_from(self._view, at)
            if id < 2:
                return bool(length == (0 if id else START.size))
            at += PACKET.size + length
        return False

    def _is_sound(self, packet: Packet) -> bool:
        """Whether a packet holds what its type announces."""
        try:
            return packet.type is None or packet.type.opaque or check(packet.type, packet.payload) == 0
        except PayloadError:
            return False

    def _only_zeros(self, at: int) -> bool:
        """Whether nothing but zeros follows, as a machine that crashed leaves them."""
        return all(not any(self._view[piece : piece + PIECE]) for piece in range(at, len(self._view), PIECE))

    def _note_end(self, at: int, number: int, frame_at: int) -> None:
        self._end = at
        if frame_at < 0:
            self._extent = Extent()
        else:
            id, _, elapsed = START.unpack_from(self._view, frame_at + PACKET.size)
            self._extent = Extent(number + 1 - self._preamble, id, elapsed)
        if at < len(self._view):
            dropped = len(self._view) - at
            self._warn(
                "tail",
                f"byte {at}: the recording was cut short; the last {dropped} bytes are no complete packet",
            )

    def _warn(self, key: str, message: str) -> None:
        if key not in self._warned:
            self._warned.add(key)
            warnings.warn(f"{self.path}: {message}", RecapWarning, stacklevel=2)

    def _forget(self, at: int) -> None:
        """Give mapped pages back, so that memory does not grow with the file."""
        if hasattr(mmap, "MADV_DONTNEED"):
            page = at - at % mmap.PAGESIZE
            self._map.madvise(mmap.MADV_DONTNEED, page, _FORGET)

    # --- random access -------------------------------------------------------------------------------------------------

    def _indexed(self) -> _Index:
        if self._index is None:
            offsets, elapsed = array("q"), array("d")
            for _, at, _ in self._walk([False] * 256, -1, False, 0, self._start):
                offsets.append(at if at >= 0 else self._start)
                elapsed.append(START.unpack_from(self._view, at + PACKET.size)[2] if at >= 0 else 0.0)
            self._index = _Index(offsets, elapsed)
        return self._index

    def _first_at(self, start: float) -> tuple[int, int] | None:
        """Number and offset of the first frame at or after a time."""
        index = self._indexed()
        later = np.flatnonzero(np.frombuffer(index.elapsed, np.float64) >= start)
        return (int(later[0]), index.offsets[later[0]]) if len(later) else None


def _fits(type: RecordType, payload: memoryview) -> bool:
    try:
        return check(type, payload) == 0
    except PayloadError:
        return False


def _is_shifted(id: int, payload: memoryview, after: bool) -> bool | None:
    """Whether a packet with one of the ambiguous ids comes from a build with shifted ids; None if it could be either.

    Args:
        id: The packet id as in the file.
        payload: The payload.
        after: Whether transforms or later packets came before it in the frame: doors come before, the others after.
    """
    if len(payload) > len(EMPTY_LIST):
        plain, shifted = _fits(UE4[id], payload), _fits(UE4[SHIFT[id]], payload)
        if plain != shifted:
            return shifted
    if id == 22:
        return None
    return after if id == 23 else not after


def pack_header(header: Header) -> bytes:
    """A header's bytes."""
    if header.raw is not None:
        return header.raw
    try:
        name = header.map_name.encode("utf-8", "surrogateescape")
        return b"".join(
            (
                U16.pack(header.version),
                U16.pack(len(MAGIC)),
                MAGIC,
                DATE.pack(header.date),
                U16.pack(len(name)),
                name,
            )
        )
    except (struct.error, UnicodeEncodeError) as error:
        raise RecordError(
            f"a header of version {header.version}, date {header.date} and map {header.map_name!r:.40} "
            f"cannot be written: {error}"
        ) from None


class LogWriter(AtomicFile):
    """Writes a CARLA log.

    Args:
        path: The destination.
        header: The header.
        live: Write the frames every `SYNC_SECONDS` of recording; see `AtomicFile`.
        force: See `AtomicFile`.

    Raises:
        RecapError: The place cannot be written to.
    """

    def __init__(self, path: Path | str, header: Header, *, live: bool = False, force: bool = True) -> None:
        start = pack_header(header)
        super().__init__(path, live=live, force=force)
        self._shift = UNSHIFT if header.shifted else {}
        self._sync_at = 0.0
        self._begin(lambda: self._put(start))

    def write(self, frame: Frame) -> None:
        """Add a frame."""
        parts: list[Buffer] = []
        if not frame.preamble:
            parts += (_START_HEAD, START.pack(frame.id, frame.duration, frame.elapsed))
        for packet in frame.packets:
            payload = packet.payload
            parts += (PACKET.pack(self._shift.get(packet.id, packet.id), len(payload)), payload)
        self._put(b"".join(parts))
        if self._live and frame.elapsed >= self._sync_at:
            self._sync()
            self._sync_at = frame.elapsed + SYNC_SECONDS

    def write_run(self, run: Run) -> None:
        """See `Writer.write_run`."""
        for frame in run:
            self.write(frame)

    def write_tail(self, piece: bytes) -> None:
        """Add bytes behind the last complete packet."""
        self._put(piece)


_START_HEAD: Final = PACKET.pack(FRAME_START, START.size)
