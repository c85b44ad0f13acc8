"""Reading parts of a file, and records, within bounds."""

from __future__ import annotations

import struct
import warnings

import lz4.frame
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap import records
from mcap.opcode import Opcode

from carla_recap import FormatError, NotARecording, open_recording, recover
from carla_recap.formats.mcap.index import (
    CHUNK_LIMIT,
    RECORDS_LIMIT,
    decompress,
    open_chunk,
    read_record,
    read_summary,
    split_records,
)
from carla_recap.formats.sources import LocalSource
from tests import strategies
from tests.formats.mcap.forge import Forge, data_records, packed, seal
from tests.samples import save, warnings_ignored
from tests.waiting import time_limit

CONTENT = bytes(range(256)) * 5


@pytest.fixture
def source(tmp_path):
    """A file of ten bytes."""
    opened = LocalSource(save(tmp_path / "ten", b"0123456789"))
    yield opened
    opened.close()


@pytest.mark.parametrize(("at", "size"), [(8, 3), (11, 0), (-1, 2), (0, -1), (1 << 63, 1), (0, 1 << 63)])
def test_a_place_outside_is_an_error(source, at, size):
    message = rf"ten: byte {at}: it of {size} bytes does not fit in the file of 10"
    with pytest.raises(FormatError, match=message):
        source.read(at, size, "it")


def test_a_record_of_another_kind_is_an_error(tmp_path):
    source = LocalSource(save(tmp_path / "one", packed(records.DataEnd(data_section_crc=7))))
    assert read_record(source, 0, Opcode.DATA_END, "the end") == struct.pack("<I", 7)
    with pytest.raises(FormatError, match="expected a chunk, found a record of kind 15 with 4 bytes"):
        read_record(source, 0, Opcode.CHUNK, "a chunk")
    with pytest.raises(FormatError, match="expected the end"):
        read_record(source, 0, Opcode.DATA_END, "the end", limit=3)
    source.close()


@pytest.mark.parametrize("rest", [b"\5", b"\5" + bytes(7), struct.pack("<BQ", 5, 1), b"\5" + b"\xff" * 8])
def test_a_record_that_is_not_whole_is_an_error(rest):
    with pytest.raises(ValueError, match=r"left behind the last record|goes beyond"):
        list(split_records(struct.pack("<BQ", 5, 1) + b"a" + rest))


def test_more_than_the_limit_is_an_error_before_anything_is_unpacked():
    with pytest.raises(ValueError, match=f"a chunk of {CHUNK_LIMIT + 1} bytes, at most {CHUNK_LIMIT} are read"):
        decompress("zstd", b"", CHUNK_LIMIT + 1)


def test_an_lz4_bomb_is_unpacked_no_further_than_announced():
    data = lz4.frame.compress(bytes(100 << 20))
    with pytest.raises(ValueError, match="expected 1000 bytes after decompression, found 1001"):
        decompress("lz4", data, 1000)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@given(data=st.data())
def test_damaged_chunks_are_errors_or_unchanged(compression, data):
    whole = packed(seal(CONTENT, compression))[9:]
    damaged = strategies.damaged(whole, data.draw(strategies.mutations(len(whole))))
    try:
        assert open_chunk(damaged)[2] in (CONTENT, b"")
    except ValueError as error:
        assert "\n" not in str(error)  # noqa: PT017


@pytest.mark.parametrize("data", [b"", b"\x89MCAP", b"\x89MCAP1\r\n" + bytes(60)])
def test_what_has_no_magic_is_no_mcap(tmp_path, data):
    source = LocalSource(save(tmp_path / "x.mcap", data))
    with pytest.raises(NotARecording, match="is no MCAP file"):
        read_summary(source)
    source.close()


@given(data=st.data())
def test_any_summary_is_read_or_an_error(tmp_path, data):
    """The file ends in a footer without a checksum, so that damage gets through to where records are read."""
    items = [
        records.Schema(id=1, name="a", encoding="protobuf", data=b"abc"),
        records.Channel(id=1, schema_id=1, topic="/a", message_encoding="protobuf", metadata={"a": "b"}),
        records.MetadataIndex(offset=8, length=20, name="m"),
        records.ChunkIndex(
            chunk_start_offset=8,
            chunk_length=20,
            compression="zstd",
            compressed_size=9,
            message_start_time=1,
            message_end_time=2,
            message_index_length=0,
            message_index_offsets={1: 5},
            uncompressed_size=9,
        ),
    ]
    summary = packed(*items)
    summary = strategies.damaged(summary, data.draw(strategies.mutations(len(summary))))
    footer = packed(records.Footer(summary_start=8, summary_offset_start=0, summary_crc=0))
    magic = b"\x89MCAP0\r\n"
    source = LocalSource(save(tmp_path / "x.mcap", magic + summary + footer + magic))
    with time_limit(), warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read_summary(source)
        except FormatError as error:
            assert "\n" not in str(error)  # noqa: PT017
        finally:
            source.close()


def test_a_summary_of_more_channels_than_there_can_be(driven):
    forge = Forge(data_records(driven))
    forge.write(driven)
    channel = next(record for record in forge.described if isinstance(record, records.Channel))
    forge.write(driven, summary=[*forge.described, *forge.indexes, *[channel] * (RECORDS_LIMIT + 1)])
    with time_limit(), pytest.raises(FormatError, match="more than 131072 records beside chunk indexes"):
        open_recording(driven)


def test_metadata_of_thousands_of_entries(driven):
    parts = data_records(driven)
    entries = {f"{number:x}": "" for number in range(100_000)}
    for number, part in enumerate(parts):
        if isinstance(part, records.Metadata) and part.name == "carla_recap.header":
            parts[number] = records.Metadata(part.name, part.metadata | entries)
    Forge(parts).write(driven)
    with time_limit(), pytest.raises(FormatError, match=r"expected the metadata carla_recap\.header"):
        open_recording(driven)
    with time_limit(), warnings_ignored():
        recovery = recover(driven, driven.with_name("saved.mcap"))
    assert (recovery.frames, recovery.headless) == (600, True)
