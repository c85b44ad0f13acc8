"""Finds the frames of a CARLA log, in runs of frames that have the same packets of the same sizes, at equal distances.

A frame's packets are found one by one. Where the next frame has the same size, the headers of the frames that follow are
compared with those of the first all at once.
"""

from __future__ import annotations

import struct
from array import array
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.errors import FormatError
from carla_recap.model.batch import equal_rows
from carla_recap.model.layout import EMPTY_LIST, OBJECTS_LIMIT, U16, Framing, PayloadError, check
from carla_recap.model.records import FRAME_END, FRAME_START

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from carla_recap.formats.sources import ByteSource
    from carla_recap.model.records import RecordType

PACKET: Final = struct.Struct("<BI")  # id, size of the payload
START: Final = struct.Struct("<Qdd")  # id, duration and elapsed time of a frame
START_HEAD: Final = PACKET.pack(FRAME_START, START.size)

PACKETS_LIMIT: Final = 200_000
"""The largest number of packets in a frame; CARLA writes about twenty."""
FRAME_LIMIT: Final = 1 << 30
"""The largest frame that is read, in bytes."""
_WINDOW: Final = 2 << 20  # bytes that are read at once
_FIRST_PIECE: Final = 4 << 10  # bytes that are searched for a frame first; each piece is twice as large as the one before
_PACKETS_IN_A_FRAME: Final = 256  # at most, where a frame is searched for in a damaged file
_FIRST_PACKET: Final = PACKET.size + START.size  # its offset in a frame
_SHORT_RUN: Final = 16  # frames; fewer take longer to compare than to be found one by one
_LONGEST_WAIT: Final = 128  # frames after several short runs
_WORD: Final = 8  # bytes that are compared at once

PacketSpan = tuple[int, int, int]  # id of a packet as in the file, offset in the frame and size of its payload


class Run(NamedTuple):
    """Frames of one shape that follow each other in a file."""

    first: int  # the position of the first one in the recording
    offset: int  # the offset of the first one in the file, in bytes
    frames: int  # the number of frames
    stride: int  # bytes from one frame to the next
    packets: Sequence[PacketSpan]  # the wanted packets of each frame
    preamble: bool  # whether these are packets before the first frame starts
    data: bytes  # the bytes of the frames, and what surrounds them
    base: int  # the offset of the data in the file


class Window:
    """A part of a file in memory, moved along as needed; `piece` bytes are read at once, unless more are needed.

    Reading copies, unlike a mapping of the file; but a file that shrinks meanwhile is an error then, instead of a signal
    that ends the process.
    """

    def __init__(self, source: ByteSource, piece: int | None = None) -> None:
        self._source = source
        self._piece = piece or _WINDOW
        self.size = source.size  # the size of the file, in bytes
        self.base = 0  # the offset of the data in the file
        self.data = b""

    def read(self, offset: int, size: int) -> bytes:
        """Return some bytes of the file, fewer at its end; the window stays where it is."""
        if self.base <= offset and offset + size <= self.base + len(self.data):
            return self.data[offset - self.base : offset - self.base + size]
        return self._source.read(offset, min(size, self.size - offset), "a part")

    def begin(self, offset: int) -> None:
        """Move the window to an offset that is outside of it."""
        if not self.base <= offset < self.base + len(self.data):
            self.move(offset)

    def grow(self, offset: int, size: int = 0) -> bool:
        """Hold more bytes from an offset on than now, at least `size`; return whether the file has more."""
        held = max(self.base + len(self.data) - offset, 0)
        if offset + held >= self.size or offset + size > self.size:
            return False
        if max(held, size) > FRAME_LIMIT:
            raise FormatError(
                self._source.location, offset, f"expected a frame of at most {FRAME_LIMIT} bytes, found a larger one"
            )
        self.move(offset, max(2 * held, size) if self.base == offset else size)
        return True

    def move(self, offset: int, size: int = 0) -> None:
        """Move the window to an offset, and hold at least some bytes from there on."""
        size = min(max(size, self._piece), self.size - offset)
        self.data = b""  # so that its memory serves again
        self.data, self.base = self._source.read(offset, size, "a part"), offset


class Scanner:
    """Scans a log for its frames; messages name the location, a path or URL.

    By the packet id in the file are the record types, and whether packets with records are wanted, None for all packets.
    With `sparse`, frames without wanted packets are left out; with `lenient`, what contradicts the format, up to the next
    frame that looks complete.
    """

    def __init__(
        self,
        location: str,
        window: Window,
        types: Sequence[RecordType | None],
        *,
        wanted: Sequence[bool] | None = None,
        sparse: bool = False,
        lenient: bool = False,
    ) -> None:
        self._location = location
        self._window = window
        self._counted = [type is not None and type.framing is Framing.LIST for type in types]
        self._types = types
        self._wanted = [True] * 256 if wanted is None else wanted
        self._ignored = -1 if wanted is None else len(EMPTY_LIST)  # the size of packets that have no records
        self._sparse = sparse
        self._lenient = lenient
        self._next_complete: tuple[int, int | None] = (0, -1)  # an offset, and the first frame after it that looks complete
        self._offset = 0
        self.count = 0  # the position in the recording after the last frame that was found
        self.last: int | None = None  # the offset of that frame in the file; None before any
        self.end: int | None = None  # the offset after the last complete packet, once the scan has come to it
        self.lost_bytes = 0  # bytes that were left out so far
        self.offsets = array("q")  # the offset in the file of each frame that was found so far

    def runs(self, index: int, offset: int, *, preamble: bool) -> Iterator[Run]:
        """Yield the runs from the frame at an index on; `preamble`: whether it is the packets before the first frame."""
        window = self._window
        if not preamble and offset + PACKET.size <= window.size:
            id, size = PACKET.unpack(window.read(offset, PACKET.size))
            following = self._next_packet(offset, id, size)
            if following is None:
                self.end = offset
                return
            if (id, size) != (FRAME_START, START.size):
                self.lost_bytes += following - offset
                offset = following
        self.count, self._offset = index, offset
        short_runs = wait = 0  # in a row; the number of frames until the next run is searched for
        while (found := self._frame(self._offset, preamble=preamble)) is not None:
            packets, end = found
            stride, frames = end - self._offset, 1
            if wait:
                wait -= 1
            elif not (preamble or self._lenient):
                frames = self._alike(self._offset - window.base, stride)
                short_runs = short_runs + 1 if frames < _SHORT_RUN else 0
                wait = min(1 << short_runs, _LONGEST_WAIT) if short_runs > 1 else 0
            self.offsets.extend(self._offset + row * stride for row in range(frames))
            if packets or not self._sparse:
                yield Run(self.count, self._offset, frames, stride, packets, preamble, window.data, window.base)
            if not preamble:
                self.last = self._offset + (frames - 1) * stride
            self.count += frames
            self._offset, preamble = self._offset + frames * stride, False
        self.end = self._offset

    def _alike(self, start: int, stride: int) -> int:
        """Return the number of frames like the one of `stride` bytes that starts at an index of the window, whole.

        Of a frame of two packets, for example, these bytes are compared (`^^`), and nothing between them:

            00 18000000 (id, duration, elapsed) 06 8e000000 0500 (5 transforms) 01 00000000
            ^^ ^^^^^^^^                         ^^ ^^^^^^^^ ^^^^                ^^ ^^^^^^^^
        """
        data, limit = self._window.data, self._window.size - self._window.base - PACKET.size
        if not data.startswith(START_HEAD, start + 2 * stride) and start + 2 * stride <= limit:
            return 1
        # Headers, and numbers of records, are compared as the last bytes of words; words begin at every byte.
        where, masks = [0], [(1 << 8 * PACKET.size) - 1]
        end = start + _FIRST_PACKET
        while end < start + stride:
            id, size = PACKET.unpack_from(data, end)
            compared = PACKET.size + (U16.size if self._counted[id] and size >= U16.size else 0)
            where.append(end - start + compared - _WORD)
            masks.append((1 << 64) - (1 << 8 * (_WORD - compared)))
            end += PACKET.size + size
        words = np.ndarray(((len(data) - start) // stride, stride - _WORD + 1), "<u8", data, start, (stride, 1))
        same = equal_rows(words, np.array(where), np.array(masks, np.uint64))
        following = start + same * stride
        ends = data.startswith(START_HEAD, following) or following > limit
        return max(same if ends else same - 1, 1)

    def _frame(self, offset: int, *, preamble: bool) -> tuple[list[PacketSpan], int] | None:
        """Return the wanted packets of a frame, and where it ends; None where none begins."""
        window, header, unpack = self._window, PACKET.size, PACKET.unpack_from
        wanted, ignored, lenient = self._wanted, self._ignored, self._lenient
        if offset + (header if preamble else _FIRST_PACKET) > window.size:
            return None
        window.begin(offset)
        data, base = window.data, window.base
        if not preamble and not data.startswith(START_HEAD, offset - base):
            return None
        here = offset - base + (0 if preamble else _FIRST_PACKET)
        last, limit = len(data) - header, -1 if lenient else window.size - base
        packets: list[PacketSpan] = []
        number = 0
        while True:
            if here > last:
                data = b""  # so that its memory serves again
                if not window.grow(offset, base + here + header - offset):
                    break
                data, here, base = window.data, here + base - window.base, window.base
                last, limit = len(data) - header, -1 if lenient else window.size - base
            id, length = unpack(data, here)
            end = here + header + length
            if id <= FRAME_END or end > limit:
                if id == FRAME_START and length == START.size:
                    break
                step = self._next_packet(base + here, id, length)
                if step is None:
                    break
                if step != base + end or not id or (id == FRAME_END and length):
                    self.lost_bytes += step - base - here
                    here = step - base
                    continue
            number += 1
            if number > PACKETS_LIMIT and not lenient:
                raise FormatError(self._location, base + here, f"more than {PACKETS_LIMIT} packets in a frame")
            if number > PACKETS_LIMIT:
                self.lost_bytes += header + length
            elif wanted[id] and length != ignored:
                packets.append((id, base + here + header - offset, length))
            here = end
        here += base
        if window.base + len(window.data) < here:
            window.grow(offset, here - offset)
        return packets, here

    def _next_packet(self, here: int, id: int, size: int) -> int | None:
        """Return where to go on from a packet: after it if it is sound, else None at the end of what is readable."""
        end = here + PACKET.size + size
        if end > self._window.size:
            return self.next_frame(here + 1) if self._lenient else None
        if id > FRAME_END:
            inside = self._frame_inside(here, id, size) if self._lenient else None
            return end if inside is None else inside
        if size == (START.size if id == FRAME_START else 0):
            return end
        if not any(any(self._window.read(piece, _WINDOW)) for piece in range(here, self._window.size, _WINDOW)):
            return None  # nothing but zeros follows, as a machine that crashed leaves them
        if self._lenient:
            return self.next_frame(here + 1) or self._window.size
        name, expected = ("FrameEnd", 0) if id else ("FrameStart", START.size)
        raise FormatError(self._location, here, f"expected a {name} of {expected} bytes, found {size}")

    # --- what is damaged -----------------------------------------------------------------------------------------------

    def next_frame(self, offset: int) -> int | None:
        """Return where the next frame begins that looks complete; None where there is none."""
        since, known = self._next_complete
        if since <= offset and (known is None or offset <= known):
            return known
        found = self._find_frame(offset)
        self._next_complete = offset, found
        return found

    def _find_frame(self, offset: int) -> int | None:
        size = _FIRST_PIECE
        while offset < self._window.size:
            piece = self._window.read(offset, size)
            size = min(2 * size, _WINDOW)
            found = piece.find(START_HEAD)
            while found >= 0:
                if self._looks_complete(offset + found):
                    return offset + found
                found = piece.find(START_HEAD, found + 1)
            offset += max(len(piece) - len(START_HEAD) + 1, 1)
        return None

    def _frame_inside(self, here: int, id: int, size: int) -> int | None:
        """Return where a frame begins inside a packet that is unsound or unknown: then its size is what is broken."""
        type = self._types[id]
        if type is not None and not type.opaque and self._has_whole_records(type, here + PACKET.size, size):
            return None
        inside = self.next_frame(here + 1)
        return inside if inside is not None and inside < here + PACKET.size + size else None

    def _has_whole_records(self, type: RecordType, offset: int, size: int) -> bool:
        """Return whether a payload is sound; one whose size shows that it is not is not read."""
        if type.fixed and type.framing is Framing.LIST:
            count = self._window.read(offset, U16.size)
            return size >= U16.size and size == U16.size + U16.unpack(count)[0] * type.dtype.itemsize
        if size > OBJECTS_LIMIT:
            return False
        return is_sound(type, self._window.read(offset, size))

    def _looks_complete(self, offset: int) -> bool:
        offset += _FIRST_PACKET
        for _ in range(_PACKETS_IN_A_FRAME):
            if offset + PACKET.size > self._window.size:
                return False
            id, size = PACKET.unpack(self._window.read(offset, PACKET.size))
            if id <= FRAME_END:
                return bool(size == (START.size if id == FRAME_START else 0))
            offset += PACKET.size + size
        return False


def is_sound(type: RecordType | None, payload: bytes | memoryview) -> bool:
    """Return whether a payload holds exactly what its type announces; one that cannot be checked counts as sound."""
    try:
        return type is None or type.opaque or check(type, payload) == 0
    except PayloadError:
        return False
