"""The frames of a CARLA log, found a packet at a time."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

from carla_recap.model.layout import PayloadError, unpack
from carla_recap.model.records import RecordType


@dataclass
class FoundFrame:
    """A frame, and its packets: the id and payload of each as in the file."""

    id: int = 0
    duration: float = 0.0
    elapsed: float = 0.0
    preamble: bool = False
    packets: list[tuple[int, bytes]] = field(default_factory=list)


@dataclass
class FoundFrames:
    """The frames; the offset after the last whole packet, and that of a packet that makes the whole read an error."""

    frames: list[FoundFrame] = field(default_factory=list)
    end: int = 0
    broken: int | None = None


def read(data: bytes, offset: int) -> FoundFrames:
    """Return the frames from an offset on, until one is broken, which is not among them."""
    found = FoundFrames(_preamble(data, offset))
    while (packet := _packet(data, offset)) is not None:
        id, payload, end = packet
        if end > len(data):
            break
        if id == 0 and len(payload) == 24:
            found.frames.append(FoundFrame(*struct.unpack("<Qdd", payload)))
        elif _has_size(id, payload):
            found.frames[-1].packets.append((id, payload))
        elif any(data[offset:]):
            found.broken = offset
            del found.frames[-1:]
            break
        else:
            break
        offset = end
    found.end = offset
    return found


def read_leniently(data: bytes, offset: int, types: Sequence[RecordType | None]) -> list[FoundFrame]:
    """Return the frames from an offset on; after what is broken, those from the next one on that looks complete."""
    frames = _preamble(data, offset)
    while (packet := _packet(data, offset)) is not None:
        id, payload, end = packet
        if id <= 1 and end <= len(data) and not _has_size(id, payload) and not any(data[offset:]):
            break
        if id == 0 and len(payload) == 24:
            frames.append(FoundFrame(*struct.unpack("<Qdd", payload)))
        else:
            following = _next_frame(data, offset + 1)
            is_sound = _has_size(id, payload) and _is_sound(types[id], payload)
            type = types[id]
            is_checked = type is not None and not type.opaque
            if end > len(data):
                if following is None:
                    break
                end = following
            elif not _has_size(id, payload):
                end = len(data) if following is None else following
            elif following is not None and following < end and not (is_sound and is_checked):
                end = following  # the size of this packet is what is broken
            elif is_sound:
                frames[-1].packets.append((id, payload))
        offset = end
    return frames


def _preamble(data: bytes, offset: int) -> list[FoundFrame]:
    return [FoundFrame(preamble=True)] if len(data) >= offset + 5 and data[offset] else []


def _packet(data: bytes, offset: int) -> tuple[int, bytes, int] | None:
    """Return id, payload as far as there is one, and end of the packet at an offset."""
    if offset + 5 > len(data):
        return None
    id, size = struct.unpack_from("<BI", data, offset)
    return id, data[offset + 5 : offset + 5 + size], offset + 5 + size


def _has_size(id: int, payload: bytes) -> bool:
    return id > 1 or len(payload) == (24 if id == 0 else 0)


def _is_sound(type: RecordType | None, payload: bytes) -> bool:
    if type is None or type.opaque:
        return True
    try:
        return not unpack(type, payload)[1]
    except PayloadError:
        return False


def _next_frame(data: bytes, offset: int) -> int | None:
    """Return where the next frame begins that ends with another one, or the end of a frame, after at most 256 packets."""
    for start in range(offset, len(data) - 28):
        if data[start : start + 5] == b"\0\x18\0\0\0":
            at = start + 29
            for _ in range(256):
                packet = _packet(data, at)
                if packet is None or packet[0] <= 1:
                    if packet is not None and packet[2] - at - 5 == (24 if packet[0] == 0 else 0):
                        return start
                    break
                at = packet[2]
    return None
