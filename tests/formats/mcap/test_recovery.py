"""The summary of MCAP files, and what is found in files that are damaged or were never finished."""

from __future__ import annotations

import struct
import warnings
from contextlib import closing, nullcontext

import lz4.frame
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap import records

from carla_recap import FormatError, RecapWarning, open_recording, recover
from carla_recap.formats.mcap.index import decompress, open_chunk, read_summary
from carla_recap.formats.mcap.recovery import Damage, recover_summary
from carla_recap.formats.sources import LocalSource
from carla_recap.model.frame import Frame, Header, Packet
from carla_recap.model.records import UE4
from tests import strategies
from tests.formats.mcap.forge import (
    MAGIC,
    Forge,
    chunk_places,
    chunk_records,
    data_records,
    message,
    packed,
    seal,
    with_header,
)
from tests.samples import listed, save, transform, warnings_ignored, write
from tests.waiting import time_limit

MIB = 1 << 20


def recovered(path):
    with time_limit(), closing(LocalSource(path)) as source:
        return recover_summary(source)


def bytes_read(path):
    """How many bytes a recovery reads."""
    with time_limit(), closing(LocalSource(path)) as source:
        recover_summary(source)
        return source.bytes_read


def offsets_of(data):
    """Where the chunks of a file begin."""
    return [at for at, _ in chunk_places(data)]


@pytest.mark.parametrize("repeated", [True, False])
def test_declarations_that_chunks_repeat_cost_nothing_and_too_many_are_said(driven, monkeypatch, repeated):
    """Those of 300 bytes, of which memory has room for one."""
    monkeypatch.setattr("carla_recap.formats.mcap.recovery._DECLARED", 500)
    parts, number = data_records(driven), 0
    for index, part in enumerate(parts):
        if isinstance(part, records.Chunk):
            schema = records.Schema(id=99, data=bytes(200), encoding="e", name=f"{0 if repeated else number:0100}")
            parts[index], number = seal(packed(schema) + chunk_records(part)), number + 1
    whole = Forge(parts).write(driven).read_bytes()
    save(driven, whole[: offsets_of(whole)[-1]])
    with warnings.catch_warnings(record=True, action="always") as caught:
        summary, damage = recovered(driven)
    assert (len(summary.chunks), damage.chunks, damage.bytes) == (number - 1, 0, 0)
    assert summary.schemas[99] == f"{0:0100}"
    left_out = f"{number - 2} schemas and channels are left out, as they are too many or too large"
    assert [str(each.message) for each in caught] == ([] if repeated else [f"{driven}: {left_out}"])


@pytest.mark.parametrize("place", [0, 1, 5, 40, 60, 200])
def test_a_chunk_that_is_hit_is_lost_and_no_other(driven, place):
    data = bytearray(driven.read_bytes())
    whole = offsets_of(data)
    data[whole[3] + place] ^= 0xFF
    save(driven, bytes(data))
    summary, damage = recovered(driven)
    assert sorted(chunk.offset for chunk in summary.chunks) == whole[:3] + whole[4:]
    assert damage.bytes > 0
    assert damage.finished


@pytest.mark.parametrize("place", [9, 16, 17, 24])
def test_the_times_of_a_chunk_are_those_of_its_messages(driven, place):
    own = recovered(driven)[0].chunks
    data = bytearray(driven.read_bytes())
    data[offsets_of(data)[3] + place] ^= 0xFF
    save(driven, bytes(data))
    summary, damage = recovered(driven)
    assert (summary.chunks, damage.chunks) == (own, 0)


JUNK = [b"\xee" * 1000 + b"zstd" + b"\x04\0\0\0zstd" * 3, *(b"\xff" * (MIB + more) for more in (-40, 0, 7, 2 * MIB))]


@pytest.mark.parametrize("junk", JUNK, ids=len)
def test_bytes_in_between_cost_nothing_but_themselves(driven, junk):
    data = driven.read_bytes()
    chunks = offsets_of(data)
    summary, damage = recovered(save(driven, data[: chunks[1]] + junk + data[chunks[1] :]))
    assert (len(summary.chunks), damage.bytes, damage.finished) == (len(chunks), len(junk), False)


def test_messages_whose_schema_is_damaged_are_found_without_a_summary(driven):
    data = driven.read_bytes()
    hit = data.index(b"carla_recap.v1.Transforms")
    save(driven, data[:hit] + b"C" + data[hit + 1 : offsets_of(data)[-1]])
    summary, _ = recovered(driven)
    (channel,) = (each for each in summary.channels.values() if each.topic == "/actors/transforms")
    assert summary.schemas[channel.schema] == "carla_recap.v1.Transforms"


def test_a_long_recording_of_a_thousand_actors_that_stand_is_all_found(tmp_path, monkeypatch):
    monkeypatch.setattr("carla_recap.formats.mcap.recovery._UNPACKED_LEAST", 0)
    poses = Packet(6, UE4[6], listed(*(transform(id, id) for id in range(1000))))
    frames = [Frame(index, index + 1, index / 20, 0.05, [poses]) for index in range(200)]
    summary, damage = recovered(write(tmp_path / "standing.mcap", Header("Town01", 0), frames))
    assert damage == Damage()
    assert summary.counts[1] == 200


def test_a_lost_magic_does_not_matter(driven):
    count = len(offsets_of(driven.read_bytes()))
    save(driven, bytes(8) + driven.read_bytes()[8:])
    assert len(recovered(driven)[0].chunks) == count


# --- what is made to cost time ---------------------------------------------------------------------------


def head_of_a_chunk(length: int, stored: int, size: int, compressed: bytes = b"\x28\xb5\x2f\xfd") -> bytes:
    """The beginning of a chunk that claims some length."""
    fields = struct.pack("<QQQII", 0, 1, size, 1, 4) + b"zstd" + struct.pack("<Q", stored)
    return struct.pack("<BQ", 6, length) + fields + compressed


@pytest.mark.parametrize("honest", [True, False])
def test_false_heads_of_chunks_cost_little(driven, honest):
    """Each claims all behind it, up to some zeros; only `honest` ones could be chunks, as far as their fields say."""
    data = driven.read_bytes()
    chunks = offsets_of(data)
    count, each = 20_000, 61
    junk = bytearray()
    for number in range(count):
        length = (count - number) * each + 50_000 - 9
        junk += head_of_a_chunk(length, length - 44 if honest else 7, 1000).ljust(each, b"\0")
    assert len(junk) == count * each
    path = save(driven, data[: chunks[1]] + bytes(junk) + bytes(100_000) + data[chunks[1] :])
    assert bytes_read(path) < 12 * path.stat().st_size + 64 * MIB
    summary, damage = recovered(path)
    assert damage.bytes >= len(junk)
    assert len(summary.chunks) == len(chunks)


def test_messages_of_a_channel_that_is_not_declared_are_said_to_be_left_out(tmp_path):
    with pytest.warns(RecapWarning, match="messages of 1 channels are left out, as their declarations are lost"):
        recovered(save(tmp_path / "x.mcap", MAGIC + packed(seal(message(999, 0, 0, b"")))))


# --- limits ----------------------------------------------------------------------------------------------


def messages(count: int, size: int = 0) -> bytes:
    """Some messages of a channel, each with some bytes of data."""
    return message(1, 0, 0, bytes(size)) * count


def test_how_much_is_unpacked(tmp_path):
    """512 MiB and a thousand times the file."""
    bomb = packed(seal(messages(1, (64 << 20) - 31)))
    data = (MAGIC + bomb * 12).ljust(130_000, b"\xff")
    summary, damage = recovered(save(tmp_path / "x.mcap", data))
    assert len(summary.chunks) == (512 * MIB + 1000 * len(data)) // (64 * MIB) == 9
    assert damage.chunks == 3


@pytest.mark.parametrize("more", [0, 1])
def test_how_many_messages_are_counted(tmp_path, monkeypatch, more):
    """Some, and one for each four bytes of the file."""
    monkeypatch.setattr("carla_recap.formats.mcap.recovery._MESSAGES_LEAST", 10_000)
    size = 60_000
    chunks = packed(seal(messages(10_000)), seal(messages(size // 4 + more)))
    summary, damage = recovered(save(tmp_path / "x.mcap", (MAGIC + chunks).ljust(size, b"\xff")))
    assert (len(summary.chunks), damage.chunks) == (2 - more, more)


@pytest.mark.parametrize("more", [0, 1])
def test_how_many_records_beside_chunks_are_read(tmp_path, monkeypatch, more):
    monkeypatch.setattr("carla_recap.formats.mcap.index.RECORDS_LIMIT", 1_000)
    channel = packed(records.Channel(id=7, topic="", message_encoding="", metadata={}, schema_id=0))
    schema = packed(records.Schema(id=3, data=b"", encoding="", name="last"))
    with pytest.warns(RecapWarning, match="1 schemas and channels are left out") if more else nullcontext():
        summary, _ = recovered(save(tmp_path / "x.mcap", MAGIC + channel * (999 + more) + schema))
    assert summary.schemas == ({} if more else {3: "last"})


# --- what the summary is read with ----------------------------------------------------------------------

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


@given(data=st.data())
def test_any_summary_is_read_or_an_error(small_mcap, data):
    """The file ends in a footer without a checksum, so that damage gets through to where records are read."""
    path = small_mcap.with_name("forged.mcap")
    forged = Forge(data_records(small_mcap), crc=False)
    whole = forged.write(path).read_bytes()
    summary = packed(*forged.described, *forged.indexes)
    start = whole.index(summary)
    damaged = strategies.damaged(summary, data.draw(strategies.mutations(len(summary))))
    source = LocalSource(save(path, whole[:start] + damaged + whole[start + len(summary) :]))
    with time_limit(), closing(source), warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            read_summary(source)
        except FormatError as error:
            assert "\n" not in str(error)  # noqa: PT017


def test_a_summary_of_more_channels_than_there_can_be(driven, monkeypatch):
    monkeypatch.setattr("carla_recap.formats.mcap.index.RECORDS_LIMIT", 1_000)
    forge = Forge(data_records(driven))
    forge.write(driven)
    channel = next(record for record in forge.described if isinstance(record, records.Channel))
    forge.write(driven, summary=[*forge.described, *forge.indexes, *[channel] * 1_001])
    with time_limit(), pytest.raises(FormatError, match="more than 1000 records beside chunk indexes"):
        open_recording(driven)


def test_metadata_of_thousands_of_entries(driven):
    with_header(driven, lambda metadata: metadata | {f"{number:x}": "" for number in range(100_000)})
    with time_limit(), pytest.raises(FormatError, match=r"expected the metadata carla_recap\.header"):
        open_recording(driven)
    with time_limit(), warnings_ignored():
        recovery = recover(driven, driven.with_name("saved.mcap"))
    assert (recovery.frames, recovery.headless) == (600, True)
