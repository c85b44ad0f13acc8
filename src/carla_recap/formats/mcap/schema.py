"""How a recording is stored in an MCAP file, for writer, reader and recovery: layouts, channels, metadata, times.

Specification: https://mcap.dev/spec
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.errors import RecordError
from carla_recap.model.frame import Extent, Header
from carla_recap.model.layout import TEXT, Layout
from carla_recap.model.records import Group, RecordType

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from carla_recap.model.records import Table

MAGIC: Final = b"\x89MCAP0\r\n"
RECORD: Final = struct.Struct("<BQ")  # opcode, length
MESSAGE: Final = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
MESSAGE_FIELDS: Final = MESSAGE.size - RECORD.size
MESSAGE_DTYPE: Final = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
"""`MESSAGE` in arrays."""
CHUNK: Final = struct.Struct("<QQQII")  # start, end, uncompressed size, CRC, length of the compression's name
CHUNK_INDEX: Final = struct.Struct("<QQQQI")  # start, end, offset, length, bytes of the map of message indexes
CHUNK_OFFSETS: Final = struct.Struct("<HQ")  # channel, offset of its message index
MESSAGE_INDEX: Final = struct.Struct("<HI")  # channel, bytes of the entries: log time and offset, u64 each
FOOTER: Final = struct.Struct("<QQI")  # start of the summary, start of its offsets, CRC
U64: Final = struct.Struct("<Q")
SECOND: Final = 1_000_000_000
EXACT: Final = 1 << 62  # ns: up to here, whole numbers of 64 bits hold a time since 1970 and its sum with another
MAX_TIME: Final = (1 << 64) - 1
LATEST: Final = 1 << 63  # the latest beginning of a recording, so that its times do not overflow

FRAME_TOPIC: Final = "/frames"
RAW_TOPIC: Final = "/carla/raw"
TAIL_TOPIC: Final = "/carla/tail"
FRAME_MESSAGE: Final = "carla_recap.v1.Frame"
RAW_MESSAGE: Final = "carla_recap.v1.RawPacket"
TAIL_MESSAGE: Final = "carla_recap.v1.Tail"


class Interval(NamedTuple):
    """A stationary interval, with the fields of its message; see `BlockedRow`."""

    id: int
    type_id: str
    start: float
    duration: float
    x: float
    y: float
    z: float


class DigestType(RecordType):
    """A part of the digest, which is no packet, and in no table."""

    def __reduce__(self) -> tuple[Callable[..., RecordType], tuple[Any, ...]]:
        """Other processes have the same digest."""
        return _named_part, (self.name,)


def _named_part(name: str) -> RecordType:
    return next(type for type in DIGEST if type.name == name)


def _digest_type(name: str, topic: str, message: str, items: str, layout: Layout) -> DigestType:
    return DigestType(id=-1, name=name, topic=topic, message=message, items=items, layout=layout, group=Group.EVENTS)


_PLACE: Final = dict.fromkeys("xyz", "f8")
_MOTION: Final = [f"{name}{axis}{side}" for name in ("", "velocity_") for side in "12" for axis in "xyz"]
# The names are also those of the extent's metadata, where they stand for the parameters and the number of records.
STATIONARY: Final = _digest_type(
    "stretches",
    "/actors/stretches",
    "Stretches",
    "stretches",
    Layout({"id": "u4", "type_id": TEXT, "start": "f8", "duration": "f8", **_PLACE}, Interval),
)
"""Stationary intervals; the metadata have the least s, the cm, the number, and `STATIONARY_RULE`."""
STATIONARY_RULE: Final = 2
"""The rule of stationary intervals: an actor is first stationary at its first transform; by the first rule, whose files have
no such number, at the origin of the world."""
BRAKING: Final = _digest_type(
    "braking",
    "/vehicles/braking",
    "BrakingIntervals",
    "intervals",
    Layout({"id": "u4", "start": "f8", "stop": "f8", **_PLACE, "speed": "f8"}),
)
"""Hard braking; the metadata have the deceleration in m/s², the number, and `BRAKING_RULE`."""
BRAKING_RULE: Final = 2
"""The rule of hard braking: it lasts for 0.3 s, or loses as much speed in less; by the first rule, whose files have no such
number, it lasts for 0.3 s."""
CONTACTS: Final = _digest_type(
    "contacts",
    "/collisions/contacts",
    "Contacts",
    "contacts",
    Layout({"index": "u8", "actor1": "u4", "actor2": "u4", **dict.fromkeys(_MOTION, "f8")}),
)
"""Beginnings of contacts; the metadata have the number."""
DIGEST: Final = (STATIONARY, BRAKING, CONTACTS)
FRAMELESS: Final = frozenset((TAIL_TOPIC, *(type.topic for type in DIGEST)))
"""The topics whose messages belong to no frame."""

EMPTY, FILLED, RAW = 0, 1, 2
"""What a frame says of each of its packets: no records, a message on its topic, or pieces on the topic of raw packets."""

HEADER_METADATA: Final = "carla_recap.header"
EXTENT_METADATA: Final = "carla_recap.extent"
PARAMETERS_METADATA: Final = "carla_recap.parameters"
EXPORT_METADATA: Final = "carla_recap.export"
"""What a file has that shows a recording, but is none."""
EVENTS_AT: Final = "events_at"
"""In the extent's metadata: the offset from which on all chunks of events come; missing where they are among the others."""
WITHOUT_EVENTS: Final = "without_events"
"""In the extent's metadata: "1" if the recording was recovered without all of its events; else missing."""
CHECKSUM: Final = "checksum"
PARAMETERS_LIMIT: Final = 256 << 10
"""The most bytes of all parameters."""


@dataclass(frozen=True)
class ChannelSpec:
    """A channel that every recording has: its id is its position in `channel_specs`, from 1."""

    topic: str
    module: str
    message: str
    type: RecordType | None = None


def channel_specs(table: Table) -> list[ChannelSpec]:
    """Return the channels of a recording."""
    specs = [
        ChannelSpec(type.topic, type.name, type.message_name, type)
        for type in table
        if type.topic and not type.opaque and type.topic != FRAME_TOPIC
    ]
    return [
        ChannelSpec(FRAME_TOPIC, "frame", FRAME_MESSAGE),
        *specs,
        ChannelSpec(RAW_TOPIC, "raw_packet", RAW_MESSAGE),
        ChannelSpec(TAIL_TOPIC, "tail", TAIL_MESSAGE),
        *(ChannelSpec(type.topic, type.name, type.message_name) for type in DIGEST),
    ]


class LogClock:
    """Recording time as MCAP times: nanoseconds since 1970.

    Log times always grow, so that the order of a file is the order of time, even where a recording's clock jumps.
    """

    def __init__(self, header: Header) -> None:
        self._base = min(max(0, header.date) * SECOND, LATEST)
        self.last = self._base - 1  # the latest log time
        # Whether each log time is its frame's own so far: the recording's clock never stood still nor jumped.
        self.steady = True

    def at(self, elapsed: float) -> int | None:
        """Return the time of some elapsed seconds; None where MCAP has no such time."""
        nanoseconds = elapsed * SECOND
        time = self._base + round(nanoseconds) if abs(nanoseconds) < MAX_TIME else -1
        return time if 0 <= time <= MAX_TIME else None

    def elapsed(self, time: int) -> float:
        """Return the elapsed seconds of a log time that is a message's own."""
        return (time - self._base) / SECOND

    def times(self, elapsed: float) -> tuple[int, int]:
        """Return log time and publish time of the next frame."""
        time = self.at(elapsed)
        if time is None or time <= self.last:
            self.steady = False
            return self.next(), self.last if time is None else time
        self.last = time
        return time, time

    def times_of(self, elapsed: NDArray[np.float64]) -> NDArray[np.uint64] | None:
        """Return log times and publish times of the next frames, (frames, 2), unless one of them is out of order."""
        with np.errstate(all="ignore"):
            nanoseconds = np.rint(elapsed * SECOND)
        if self._base >= EXACT or not len(elapsed) or not np.abs(nanoseconds).max() < EXACT:
            return None
        times = nanoseconds.astype(np.int64) + self._base
        if times[0] <= self.last or times[-1] > MAX_TIME or not (times[1:] > times[:-1]).all():
            return None
        self.last = int(times[-1])
        return np.stack((times, times), axis=1).astype(np.uint64)

    def next(self) -> int:
        """Return the log time of what comes behind the latest frame."""
        self.last = min(self.last + 1, MAX_TIME)
        return self.last


def checked(values: dict[str, str]) -> dict[str, str]:
    """Return metadata with a checksum of themselves: MCAP has none for those that are read by index."""
    return values | {CHECKSUM: _checksum(values)}


def unchecked(values: dict[str, str]) -> dict[str, str]:
    """Return metadata without the checksum that they came with, or raise `ValueError`."""
    plain = {key: value for key, value in values.items() if key != CHECKSUM}
    if values.get(CHECKSUM) != _checksum(plain):
        raise ValueError("the checksum does not match")
    return plain


def _checksum(values: dict[str, str]) -> str:
    return f"{zlib.crc32(repr(sorted(values.items())).encode()):08x}"


def header_metadata(header: Header) -> dict[str, str]:
    """Return a header as MCAP metadata."""
    from carla_recap.formats.carla_log import pack_header

    raw = pack_header(header)  # and the check that it can be written
    plain = {
        "map": _unicode(header.map_name),
        "date": str(header.date),
        "version": str(header.version),
        "double_precision": str(int(header.wide)),
        "shifted_packet_ids": str(int(header.shifted)),
    }
    is_plain = replace(header, parameters={}, without_events=False) == parse_header(plain)
    return plain if is_plain else plain | {"carla_header": raw.hex()}


def parameters_metadata(header: Header) -> dict[str, str]:
    """Return the parameters of a header as MCAP metadata, or raise `RecordError`."""
    if CHECKSUM in header.parameters:
        raise RecordError(f"expected another name of a parameter than {CHECKSUM!r}")
    values = {_unicode(name): _unicode(value) for name, value in header.parameters.items()}
    size = sum(len(text.encode()) for pair in values.items() for text in pair)
    if size > PARAMETERS_LIMIT:
        raise RecordError(f"parameters of {size:,} bytes; at most {PARAMETERS_LIMIT:,} can be recorded")
    return values


def _unicode(text: str) -> str:
    return text.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def parse_header(metadata: dict[str, str]) -> Header:
    """Return the header that a file's metadata describe, or raise `ValueError`."""
    wide, shifted = metadata["double_precision"] == "1", metadata["shifted_packet_ids"] == "1"
    raw = bytes.fromhex(metadata["carla_header"]) if "carla_header" in metadata else None
    date, version = int(metadata["date"]), int(metadata["version"])
    if not (-(1 << 63) <= date < 1 << 63 and 0 <= version < 1 << 16):
        raise ValueError("date or version out of range")
    name = metadata["map"]
    if raw is not None:
        name = raw[2 + 2 + int.from_bytes(raw[2:4], "little") + 8 + 2 :].decode("utf-8", "surrogateescape")
    header = Header(name, date, version, wide, shifted)
    if raw is None:
        return header
    from carla_recap.formats.carla_log import pack_header

    try:
        return header if pack_header(header) == raw else Header(name, date, version, wide, shifted, raw)
    except RecordError as error:
        raise ValueError(str(error)) from None


def parse_extent(metadata: dict[str, str]) -> Extent:
    """Return how far the recording goes, from a file's metadata, or raise `ValueError`."""
    return Extent(int(metadata["frames"]), int(metadata["last_frame"]), float(metadata["duration"]))
