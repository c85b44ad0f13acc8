"""What is found in MCAP files that are damaged or were never finished."""

from __future__ import annotations

import struct
import warnings
from contextlib import nullcontext

import pytest
from mcap import records

from carla_recap.errors import RecapWarning
from carla_recap.formats.mcap.recovery import Damage, recover_summary
from carla_recap.formats.sources import LocalSource
from carla_recap.model.frame import Frame, Header, Packet
from carla_recap.model.records import UE4
from tests.formats.mcap.forge import MAGIC, Forge, chunk_places, chunk_records, data_records, message, packed, seal
from tests.samples import listed, save, transform, write
from tests.waiting import time_limit


def recovered(path):
    source = LocalSource(path)
    try:
        return recover_summary(source)
    finally:
        source.close()


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


def test_bytes_in_between_cost_nothing_but_themselves(driven):
    data = driven.read_bytes()
    at = offsets_of(data)[2]
    junk = b"\xee" * 1000 + b"zstd" + b"\x04\0\0\0zstd" * 3
    save(driven, data[:at] + junk + data[at:])
    summary, damage = recovered(driven)
    assert len(summary.chunks) == len(offsets_of(data))
    assert damage.bytes == len(junk)
    assert not damage.finished


def test_a_chunk_behind_megabytes_of_nothing_is_found(driven):
    data = driven.read_bytes()
    chunks = offsets_of(data)
    for size in ((1 << 20) - 40, 1 << 20, (1 << 20) + 7, 3 << 20):
        path = save(driven.with_name("gap.mcap"), data[: chunks[1]] + b"\xff" * size + data[chunks[1] :])
        summary, damage = recovered(path)
        assert len(summary.chunks) == len(chunks), size
        assert damage.bytes == size


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
    frames = [Frame(index, index + 1, index / 20, 0.05, [poses]) for index in range(1000)]
    path = write(tmp_path / "standing.mcap", Header("Town01", 0), frames)
    summary, damage = recovered(path)
    assert damage == Damage()
    assert summary.counts[1] == 1000


def test_a_summary_without_channels_does_not_matter(driven):
    forged = Forge(data_records(driven))
    forged.write(driven)
    forged.write(driven, summary=[])
    summary, _ = recovered(driven)
    assert len(summary.channels) == 4
    assert len(summary.chunks) == len(forged.indexes)


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
    save(driven, data[: chunks[1]] + bytes(junk) + bytes(100_000) + data[chunks[1] :])
    with time_limit():
        source = LocalSource(driven)
        summary, damage = recover_summary(source)
        source.close()
    assert source.bytes_read < 12 * source.size + (64 << 20)
    assert damage.bytes >= len(junk)
    assert len(summary.chunks) == len(chunks)


def test_small_false_heads_are_found_in_one_window(tmp_path):
    junk = (b"\x06" + bytes(36) + b"\x04\0\0\0zstd") * 50_000
    path = save(tmp_path / "x.mcap", MAGIC + junk)
    source = LocalSource(path)
    with time_limit():
        recover_summary(source)
    source.close()
    assert source.bytes_read < 4 * len(junk)


def test_messages_of_a_channel_that_is_not_declared_are_said_to_be_left_out(tmp_path):
    with pytest.warns(RecapWarning, match="messages of 1 channels are left out, as their declarations are lost"):
        recovered(save(tmp_path / "x.mcap", MAGIC + packed(seal(message(999, 0, 0, b"")))))


# --- limits ----------------------------------------------------------------------------------------------

MIB = 1 << 20


def messages(count: int, size: int = 0) -> bytes:
    """Some messages of a channel, each with some bytes of data."""
    return message(1, 0, 0, bytes(size)) * count


def other_record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


@pytest.mark.parametrize(("opcode", "size", "followed"), [(9, 64 << 10, False), (9, 16 * MIB, True)])
@pytest.mark.parametrize("more", [0, 1])
def test_a_record_that_is_too_long_is_not_believed(tmp_path, opcode, size, followed, more):
    """An attachment that contains a chunk: up to 64 KiB it is gone over, up to 16 MiB if a record follows it."""
    content = packed(seal(messages(3))).ljust(size + more, b"\0")
    end = packed(records.DataEnd(data_section_crc=0)) if followed else b"\xff" * 20
    summary, _ = recovered(save(tmp_path / "x.mcap", MAGIC + other_record(opcode, content) + end))
    assert len(summary.chunks) == more


@pytest.mark.parametrize("more", [0, 1])
def test_how_much_is_read_for_what_is_no_chunk(tmp_path, more):
    """16 MiB and four times the file: another false head in front of a chunk makes the scan go on behind what it claims.

    What is read of a sound chunk does not count.
    """
    length, distance, chunk = 2 * MIB, 100, packed(seal(messages(3)))
    sound, size = packed(seal(messages(1, MIB), "")), 4 * MIB + 1000
    count = (16 * MIB + 4 * size) // length + more
    heads = b"".join(head_of_a_chunk(length, length - 44, 1000).ljust(distance, b"\0") for _ in range(count))
    path = save(tmp_path / "x.mcap", (MAGIC + sound + heads + chunk).ljust(size, b"\0"))
    # The last head claims no more than there is.
    assert len(MAGIC + sound) + (count - 1) * distance + 9 + length < size
    assert len(recovered(path)[0].chunks) == 2 - more


def test_how_much_is_unpacked(tmp_path):
    """512 MiB and a thousand times the file."""
    bomb = packed(seal(messages(1, (64 << 20) - 31)))
    data = (MAGIC + bomb * 12).ljust(130_000, b"\xff")
    with time_limit():
        summary, damage = recovered(save(tmp_path / "x.mcap", data))
    assert len(summary.chunks) == (512 * MIB + 1000 * len(data)) // (64 * MIB) == 9
    assert damage.chunks == 3


@pytest.mark.parametrize("more", [0, 1])
def test_how_many_messages_are_counted(tmp_path, more):
    """A million, and one for each four bytes of the file."""
    size = 60_000
    chunks = packed(seal(messages(1_000_000)), seal(messages(size // 4 + more)))
    with time_limit():
        summary, damage = recovered(save(tmp_path / "x.mcap", (MAGIC + chunks).ljust(size, b"\xff")))
    assert (len(summary.chunks), damage.chunks) == (2 - more, more)


@pytest.mark.parametrize("more", [0, 1])
def test_how_many_records_beside_chunks_are_read(tmp_path, more):
    channel = packed(records.Channel(id=7, topic="", message_encoding="", metadata={}, schema_id=0))
    schema = packed(records.Schema(id=3, data=b"", encoding="", name="last"))
    with pytest.warns(RecapWarning, match="1 schemas and channels are left out") if more else nullcontext():
        summary, _ = recovered(save(tmp_path / "x.mcap", MAGIC + channel * (131_071 + more) + schema))
    assert summary.schemas == ({} if more else {3: "last"})


@pytest.mark.parametrize("more", [0, 1])
def test_how_large_metadata_are_read(tmp_path, more):
    empty = packed(records.Metadata(name="m", metadata={"k": ""}))
    found = packed(records.Metadata(name="m", metadata={"k": "v" * ((512 << 10) - len(empty) + 9 + more)}))
    assert len(found) - 9 == (512 << 10) + more
    end = packed(records.DataEnd(data_section_crc=0))
    summary, _ = recovered(save(tmp_path / "x.mcap", MAGIC + found + end))
    assert summary.metadata == ({} if more else {"m": len(MAGIC)})


@pytest.mark.parametrize("more", [0, 1])
def test_how_large_chunks_are_read(tmp_path, more):
    length = (64 << 20) + more
    path = save(tmp_path / "x.mcap", MAGIC + head_of_a_chunk(length, length - 44, 1000))
    with path.open("r+b") as file:
        file.truncate(70 << 20)  # zeros that take no space
    source = LocalSource(path)
    with time_limit():
        recover_summary(source)
    source.close()
    assert (source.bytes_read > source.size + (60 << 20)) != bool(more)
