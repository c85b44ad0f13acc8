"""What writer, reader and recovery share of the MCAP container: layouts, names, and reading a file within bounds.

Specification: https://mcap.dev/spec
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode

from carla_recap.errors import FormatError, RecapError, RecordError
from carla_recap.formats.carla_log import pack_header
from carla_recap.frame import Extent, Header
from carla_recap.records import RecordType, Table

MAGIC: Final = b"\x89MCAP0\r\n"
RECORD: Final = struct.Struct("<BQ")  # opcode, length
MESSAGE: Final = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
MESSAGE_FIELDS: Final = MESSAGE.size - RECORD.size
CHUNK: Final = struct.Struct("<QQQII")  # start, end, uncompressed size, CRC, length of the compression's name
CHUNK_INDEX: Final = struct.Struct("<QQQQI")  # start, end, offset, length, bytes of the map of message indexes
CHUNK_OFFSETS: Final = struct.Struct("<HQ")  # channel, offset of its message index
MESSAGE_INDEX: Final = struct.Struct("<HI")  # channel, bytes of the entries: log time and offset, u64 each
FOOTER: Final = struct.Struct("<QQI")  # start of the summary, start of its offsets, CRC
U64: Final = struct.Struct("<Q")
SECOND: Final = 1_000_000_000
MAX_TIME: Final = (1 << 64) - 1

CHUNK_LIMIT: Final = 64 << 20
"""The largest chunk that is read, in bytes, compressed or not; ours are about 1 MiB."""
SUMMARY_LIMIT: Final = 256 << 20
"""The largest summary that is read, in bytes."""

FRAME_TOPIC: Final = "/frames"
RAW_TOPIC: Final = "/carla/raw"
TAIL_TOPIC: Final = "/carla/tail"
FRAME_MESSAGE: Final = "carla_recap.v1.Frame"
RAW_MESSAGE: Final = "carla_recap.v1.RawPacket"
TAIL_MESSAGE: Final = "carla_recap.v1.Tail"

EMPTY, FILLED, RAW = 0, 1, 2
"""What a frame says of each of its packets: no records, a message on its topic, or pieces on the topic of raw packets."""

HEADER_METADATA: Final = "carla_recap.header"
EXTENT_METADATA: Final = "carla_recap.extent"


@dataclass(frozen=True)
class ChannelSpec:
    """A channel that every recording has: its id is its place in `channel_specs`, from 1."""

    topic: str
    module: str
    message: str
    type: RecordType | None = None


def channel_specs(table: Table) -> list[ChannelSpec]:
    """The channels of a recording."""
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
    ]


class LogClock:
    """Recording time as MCAP times: nanoseconds since 1970.

    Log times always grow, so that the order of a file is the order of time, even where a recording's clock jumps.

    Attributes:
        last: The latest log time.
    """

    def __init__(self, header: Header) -> None:
        self._base = max(0, header.date) * SECOND
        self.last = self._base - 1

    def at(self, elapsed: float) -> int | None:
        """The time of some elapsed seconds, None where there is no such time."""
        nanoseconds = elapsed * SECOND
        time = self._base + round(nanoseconds) if abs(nanoseconds) < MAX_TIME else -1
        return time if 0 <= time <= MAX_TIME else None

    def times(self, elapsed: float) -> tuple[int, int]:
        """Log time and publish time of the next frame."""
        time = self.at(elapsed)
        self.last = min(self.last + 1 if time is None else max(self.last + 1, time), MAX_TIME)
        return self.last, self.last if time is None else time


def header_metadata(header: Header) -> dict[str, str]:
    """A header as MCAP metadata."""
    plain = {
        "map": header.map_name.encode("utf-8", "surrogateescape").decode("utf-8", "replace"),
        "date": str(header.date),
        "version": str(header.version),
        "double_precision": str(int(header.wide)),
        "shifted_packet_ids": str(int(header.shifted)),
    }
    return plain if header == parse_header(plain) else plain | {"carla_header": pack_header(header).hex()}


def parse_header(metadata: dict[str, str]) -> Header:
    """The header that a file's metadata describe.

    Raises:
        ValueError: They do not.
    """
    wide, shifted = metadata["double_precision"] == "1", metadata["shifted_packet_ids"] == "1"
    raw = bytes.fromhex(metadata["carla_header"]) if "carla_header" in metadata else None
    date, version = int(metadata["date"]), int(metadata["version"])
    if not (-(1 << 63) <= date < 1 << 63 and 0 <= version < 1 << 16):
        raise ValueError("date or version out of range")
    name = metadata["map"]
    if raw is not None:
        name = raw[2 + 2 + int.from_bytes(raw[2:4], "little") + 8 + 2 :].decode("utf-8", "surrogateescape")
    header = Header(name, date, version, wide, shifted)
    try:
        return header if raw is None or pack_header(header) == raw else Header(name, date, version, wide, shifted, raw)
    except RecordError as error:
        raise ValueError(str(error)) from None


def parse_extent(metadata: dict[str, str]) -> Extent:
    """How far the recording goes, from a file's metadata.

    Raises:
        ValueError: They do not say.
    """
    return Extent(int(metadata["frames"]), int(metadata["last_frame"]), float(metadata["duration"]))


class Source:
    """A file read in places, each of them checked against its size.

    Attributes:
        bytes_read: How much was read so far.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        try:
            self._file = self.path.open("rb", buffering=0)
            self.size = self._file.seek(0, 2)
        except OSError as error:
            raise RecapError(f"{path}: {error.strerror}") from None
        self.bytes_read = 0

    def read(self, at: int, size: int, what: str) -> bytes:
        """Bytes of the file.

        Raises:
            FormatError: They lie outside; `what` says what they should be.
        """
        if at < 0 or size < 0 or at + size > self.size:
            raise FormatError(self.path, at, f"{what} of {size} bytes does not fit in the file of {self.size}")
        try:
            self._file.seek(at)
            data = self._file.read(size)
        except OSError as error:
            raise RecapError(f"{self.path}: {error.strerror}") from None
        self.bytes_read += len(data)
        if len(data) < size:
            raise FormatError(self.path, at + len(data), f"the file ends inside {what}")
        return data

    def record(self, at: int, opcode: Opcode, what: str, limit: int = CHUNK_LIMIT) -> bytes:
        """The content of the record at a place.

        Raises:
            FormatError: There is none of that kind, or it is too large.
        """
        found, size = RECORD.unpack(self.read(at, RECORD.size, what))
        if found != opcode or size > limit:
            raise FormatError(self.path, at, f"{what} was expected, found a record of kind {found} with {size} bytes")
        return self.read(at + RECORD.size, size, what)

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()


def split_records(data: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of each record in a run of whole records.

    Raises:
        ValueError: The last one is not whole.
    """
    at, size = 0, len(data)
    while at < size:
        if at + RECORD.size > size:
            raise ValueError(f"{size - at} bytes are left behind the last record")
        opcode, length = RECORD.unpack_from(data, at)
        start = at + RECORD.size
        at = start + length
        if at > size:
            raise ValueError(f"a record of {length} bytes goes beyond the {size} that there are")
        yield opcode, start, at


def parse_record(kind: Any, data: bytes | memoryview) -> Any:
    """A record's content as the `mcap` package's object of that kind.

    Raises:
        ValueError: The content is broken.
    """
    try:
        return kind.read(ReadDataStream(BytesIO(data)))
    except (McapError, UnicodeDecodeError, struct.error, OverflowError, MemoryError, KeyError, TypeError) as error:
        raise ValueError(f"broken {kind.__name__} record ({type(error).__name__})") from None


_zstd: Final = zstandard.ZstdDecompressor()


def decompress(compression: str, data: bytes | memoryview, size: int) -> bytes:
    """A chunk's records, never more than the chunk says.

    Raises:
        ValueError: They are not of the size that the chunk says, or damaged.
    """
    if size > CHUNK_LIMIT:
        raise ValueError(f"a chunk of {size} bytes, at most {CHUNK_LIMIT} are read")
    try:
        if compression == "":
            records = bytes(data)
        elif compression == "zstd":
            if zstandard.frame_content_size(data) not in (-1, size):
                raise ValueError("the compressed data announce another size than the chunk")
            records = _zstd.decompress(data, max_output_size=size) if size else b""
        elif compression == "lz4":
            records = bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1))
        else:
            raise ValueError(f"unknown compression {compression!r:.40}")
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        raise ValueError(f"damaged data ({error})") from None
    if len(records) != size:
        raise ValueError(f"{len(records)} bytes after decompression, {size} were expected")
    return records


def open_chunk(content: bytes) -> tuple[int, int, bytes]:
    """First and last log time, and the records, of a chunk record's content.

    Raises:
        ValueError: It is damaged.
    """
    if len(content) < CHUNK.size:
        raise ValueError("a chunk of less than its fixed fields")
    start, end, size, crc, name_size = CHUNK.unpack_from(content)
    at = CHUNK.size + name_size
    if at + U64.size > len(content) or name_size > 16:
        raise ValueError("a chunk with a broken compression name")
    compression = content[CHUNK.size : at].decode("ascii", "replace")
    (stored,) = U64.unpack_from(content, at)
    data = memoryview(content)[at + U64.size :]
    if stored != len(data):
        raise ValueError(f"{len(data)} bytes of records, the chunk says {stored}")
    records = decompress(compression, data, size)
    if crc and zlib.crc32(records) != crc:
        raise ValueError("the checksum does not match")
    return start, end, records
