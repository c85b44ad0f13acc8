"""Finds the frames of a CARLA log: runs of frames that have the same packets of the same sizes, at equal distances.

Two frames are compared packet by packet; where they are alike, those that follow are compared with them all at once, by the
bytes of their packet headers.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import FormatError, RecapError
from carla_recap.model.batch import equal_rows
from carla_recap.model.layout import U16, Framing, PayloadError, check
from carla_recap.model.records import FRAME_END, FRAME_START

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path
    from threading import Lock
    from typing import BinaryIO

    from numpy.typing import NDArray

    from carla_recap.model.records import RecordType

PACKET: Final = struct.Struct("<BI")  # id, size of the payload
START: Final = np.dtype([("id", "<u8"), ("duration", "<f8"), ("elapsed", "<f8")])
START_HEAD: Final = PACKET.pack(FRAME_START, START.itemsize)

PACKETS_LIMIT: Final = 200_000
"""The most packets of a frame; CARLA writes some twenty."""
FRAME_LIMIT: Final = 1 << 30
"""The largest frame that is read, in bytes."""
_WINDOW: Final = 2 << 20  # bytes that are read at once
_PACKETS_IN_A_FRAME: Final = 256  # at most, where a frame is searched for in a damaged file
_BEHIND_START: Final = PACKET.size + START.itemsize

Place = tuple[int, int, int]  # packet id as in the file, offset in the frame and size of the payload


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """Frames of one shape that follow each other in a file.

    Attributes:
        index: The position of the first one in the recording.
        offset: Where it begins in the file, in bytes.
        count: The number of frames.
        stride: Bytes from one frame to the next.
        places: The packets of each frame, behind the one that starts it.
        preamble: Whether these are packets before the first frame starts.
        data: The bytes of the frames, and what surrounds them.
        base: Where the data begin in the file.
    """

    index: int
    offset: int
    count: int
    stride: int
    places: tuple[Place, ...]
    preamble: bool
    data: bytes
    base: int

    @property
    def starts(self) -> NDArray[np.void]:
        """What the frames say of themselves, (count,): id, duration and elapsed time."""
        if self.preamble:
            return np.zeros(1, START)
        return np.ndarray((self.count,), START, self.data, self.offset - self.base + PACKET.size, (self.stride,))


class Window:
    """A part of a file in memory, moved along as needed.

    Reading copies, unlike a mapping of the file; but a file that shrinks meanwhile is an error then, instead of a signal
    that ends the process.

    Args:
        path: The file, for messages.
        file: The file, unbuffered.
        size: Its size, in bytes.
        lock: Held while a part of the file is read, as several windows may share the file.

    Attributes:
        base: Where in the file the data begin.
        data: The bytes.
        size: The size of the file, in bytes.
    """

    def __init__(self, path: Path, file: BinaryIO, size: int, lock: Lock) -> None:
        self._path = path
        self._file = file
        self._lock = lock
        self.size = size
        self.base = 0
        self.data = b""

    def read(self, at: int, size: int) -> bytes:
        """Return some bytes of the file, fewer at its end; they need not be in memory, nor will they be."""
        if self.base <= at and at + size <= self.base + len(self.data):
            return self.data[at - self.base : at - self.base + size]
        return self._bytes(at, min(size, self.size - at))

    def begin(self, at: int) -> None:
        """Have the bytes from a place on in memory, unless a fair part of them is there."""
        if not self.base <= at < self.base + len(self.data):
            self._read(at, 0)

    def grow(self, at: int, size: int = 0) -> bool:
        """Have more bytes from a place on in memory than now.

        Args:
            at: The place.
            size: How many are needed at least.

        Returns:
            Whether the file has more.

        Raises:
            FormatError: That would be more than `FRAME_LIMIT`, or the file has shrunk.
        """
        have = max(self.base + len(self.data) - at, 0)
        if at + have >= self.size or at + size > self.size:
            return False
        if max(have, size) > FRAME_LIMIT:
            raise FormatError(self._path, at, f"a frame of at most {FRAME_LIMIT} bytes was expected")
        self._read(at, max(2 * have, size) if self.base == at else size)
        return True

    def _read(self, at: int, size: int) -> None:
        size = min(max(size, _WINDOW), self.size - at)
        self.data, self.base = self._bytes(at, size), at
        if len(self.data) < size:
            raise FormatError(self._path, at + len(self.data), "the file has become shorter while it was read")

    def _bytes(self, at: int, size: int) -> bytes:
        """Read some bytes, fewer if the file ends before."""
        try:
            with self._lock:
                self._file.seek(at)
                data = self._file.read(size)
                while len(data) < size and (more := self._file.read(size - len(data))):
                    data += more
        except OSError as error:
            raise RecapError(f"{self._path}: {error.strerror}") from None
        return data


class Scanner:
    """Scans a log for its frames.

    Args:
        path: The file, for messages.
        window: The file.
        types: The record types by packet id, as in the file.
        salvage: Leave out what contradicts the format, and go on with the next frame that looks whole.

    Attributes:
        end: Where the last complete packet ends, once the scan has come to it.
        lost_bytes: Bytes that salvage has left out so far.
    """

    def __init__(self, path: Path, window: Window, types: Sequence[RecordType | None], *, salvage: bool = False) -> None:
        self._path = path
        self._window = window
        self._counted = [type is not None and type.framing is Framing.LIST for type in types]
        self._types = types
        self._salvage = salvage
        self._next_whole: tuple[int, int | None] = (0, -1)  # from there on, the first frame that looks whole
        self.end: int | None = None
        self.lost_bytes = 0

    def runs(self, index: int, at: int, *, preamble: bool) -> Iterator[Run]:
        """Yield the runs from a place on.

        Args:
            index: The position of the frame there in the recording.
            at: Where that frame begins, in bytes.
            preamble: Whether there are packets before the first frame.

        Raises:
            FormatError: The file contradicts its format.
        """
        if not preamble and at + PACKET.size <= self._window.size:
            id, length = PACKET.unpack(self._window.read(at, PACKET.size))
            start = self._next_place(at, id, length)
            if start is None:
                self.end = at
                return
            if start != at + _BEHIND_START:
                self.lost_bytes += start - at
                at = start
        window, found = self._window, self._frame(at, preamble=preamble)
        while found is not None:
            places, end = found
            run = Run(index, at, 1, end - at, places, preamble, window.data, window.base)
            try:
                following = self._frame(end, preamble=False)
            except FormatError:
                yield run
                raise
            if following is not None and following[0] == places and not (preamble or self._salvage):
                run = self._extended(run)
                if run.count > 1:
                    following = None
            yield run
            preamble = False
            index, at = index + run.count, run.offset + run.stride * run.count
            found = following or self._frame(at, preamble=False)
        self.end = at

    def _extended(self, run: Run) -> Run:
        """Return a run with the frames that follow it and are like it, as far as they are in memory."""
        window, at, stride = self._window, run.offset, run.stride
        if at < window.base:  # to find the second frame, the window has moved on
            return run
        data, start = window.data, at - window.base
        room = (len(data) - start) // stride
        places = self._header_bytes(run.places)
        frames = np.ndarray((room, stride), np.uint8, data, start, (stride, 1))
        same = equal_rows(frames, places)
        behind = start + same * stride
        ends = data.startswith(START_HEAD, behind) or window.base + behind + PACKET.size > window.size
        same -= not ends
        if same < 2:
            return run
        return Run(run.index, at, same, stride, run.places, run.preamble, data, window.base)

    def _header_bytes(self, places: tuple[Place, ...]) -> NDArray[np.intp]:
        """Return where the bytes of a frame are that make its shape: packet headers, and numbers of records."""
        offsets = list(range(PACKET.size))
        for id, offset, size in places:
            counted = U16.size if self._counted[id] and size >= U16.size else 0
            offsets += range(offset - PACKET.size, offset + counted)
        return np.array(offsets, np.intp)

    def _frame(self, at: int, *, preamble: bool) -> tuple[tuple[Place, ...], int] | None:
        """Find the packets of the frame at a place.

        Returns:
            The packets, and where the frame ends; None where none begins.
        """
        window, head, salvage = self._window, PACKET.unpack_from, self._salvage
        size = window.size
        here = at if preamble else at + _BEHIND_START
        if at + (PACKET.size if preamble else _BEHIND_START) > size:
            return None
        window.begin(at)
        data, base = window.data, window.base
        if not preamble and not data.startswith(START_HEAD, at - base):
            return None
        last = base + len(data) - PACKET.size
        places: list[Place] = []
        while True:
            if here > last:
                if not window.grow(at, here + PACKET.size - at):
                    break
                data, base = window.data, window.base
                last = base + len(data) - PACKET.size
            id, length = head(data, here - base)
            if id == FRAME_START and length == START.itemsize:
                break
            end = here + PACKET.size + length
            if (id <= FRAME_END and length) or not id or end > size or salvage:
                step = self._next_place(here, id, length)
                if step is None:
                    break
                if step != end:
                    self.lost_bytes += step - here
                    here = step
                    continue
            places.append((id, here + PACKET.size - at, length))
            if len(places) > PACKETS_LIMIT and salvage:
                self.lost_bytes += PACKET.size + places.pop()[2]
            elif len(places) > PACKETS_LIMIT:
                raise FormatError(self._path, here, f"more than {PACKETS_LIMIT} packets in a frame")
            here = end
        if base + len(data) < here:
            window.grow(at, here - at)
        return tuple(places), here

    def _next_place(self, here: int, id: int, length: int) -> int | None:
        """Return where to go on from a packet: behind it if it is sound, else None at the end of what is readable.

        Raises:
            FormatError: The packet contradicts the format, and nothing is to be salvaged.
        """
        end = here + PACKET.size + length
        if end > self._window.size:
            return self.next_frame(here + 1) if self._salvage else None
        if id > FRAME_END:
            inside = self._frame_inside(here, id, length) if self._salvage else None
            return end if inside is None else inside
        if length == (START.itemsize if id == FRAME_START else 0):
            return end
        if self._only_zeros(here):
            return None
        if self._salvage:
            return self.next_frame(here + 1) or self._window.size
        name, expected = ("FrameEnd", 0) if id else ("FrameStart", START.itemsize)
        raise FormatError(self._path, here, f"{name} of {length} bytes, {expected} were expected")

    def _only_zeros(self, at: int) -> bool:
        """Return whether nothing but zeros follows, as a machine that crashed leaves them."""
        return all(not any(self._window.read(piece, _WINDOW)) for piece in range(at, self._window.size, _WINDOW))

    # --- what is damaged -----------------------------------------------------------------------------------------------

    def next_frame(self, at: int) -> int | None:
        """Return where the next frame begins that looks whole; None where there is none."""
        since, known = self._next_whole
        if since <= at and (known is None or at <= known):
            return known
        found = self._find_frame(at)
        self._next_whole = at, found
        return found

    def _find_frame(self, at: int) -> int | None:
        while at < self._window.size:
            piece = self._window.read(at, _WINDOW)
            found = piece.find(START_HEAD)
            while found >= 0:
                if self._looks_whole(at + found):
                    return at + found
                found = piece.find(START_HEAD, found + 1)
            at += max(len(piece) - len(START_HEAD) + 1, 1)
        return None

    def _frame_inside(self, here: int, id: int, length: int) -> int | None:
        """Return where a frame begins inside a packet that is unsound or unknown: then its size is what is broken."""
        type = self._types[id]
        payload = self._window.read(here + PACKET.size, length)
        if type is not None and not type.opaque and is_sound(type, payload):
            return None
        inside = self.next_frame(here + 1)
        return inside if inside is not None and inside < here + PACKET.size + length else None

    def _looks_whole(self, at: int) -> bool:
        at += _BEHIND_START
        for _ in range(_PACKETS_IN_A_FRAME):
            if at + PACKET.size > self._window.size:
                return False
            id, length = PACKET.unpack(self._window.read(at, PACKET.size))
            if id <= FRAME_END:
                return bool(length == (START.itemsize if id == FRAME_START else 0))
            at += PACKET.size + length
        return False


def is_sound(type: RecordType | None, payload: bytes | memoryview) -> bool:
    """Return whether a payload holds exactly what its type announces; what cannot be checked does."""
    try:
        return type is None or type.opaque or check(type, payload) == 0
    except PayloadError:
        return False
