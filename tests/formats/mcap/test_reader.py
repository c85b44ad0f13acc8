"""Reading MCAP: files of other writers, files with false statements, and files with a flipped bit."""

from __future__ import annotations

import tracemalloc
import warnings
from functools import cache

import numpy as np
import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap import records
from mcap.stream_reader import breakup_chunk
from mcap.writer import CompressionType, Writer

from carla_recap import (
    FormatError,
    NotARecording,
    RecapError,
    RecapWarning,
    convert,
    create_recording,
    create_writer,
    formats,
    open_recording,
    recover,
)
from carla_recap.formats.mcap import codec, writer
from carla_recap.formats.mcap import frames as frames_module
from carla_recap.formats.mcap.codec import encode
from carla_recap.formats.mcap.index import CHUNK_LIMIT
from carla_recap.formats.mcap.reader import McapReader
from carla_recap.formats.mcap.schema import BRAKING, BRAKING_RULE
from carla_recap.model.frame import Frame, Header, Packet
from carla_recap.model.layout import pack
from carla_recap.model.records import NO_ACTOR, UE4, Spawn, WheelSet
from carla_recap.queries.blocked import blocked, listed_intervals
from carla_recap.queries.contacts import listed_impacts
from carla_recap.queries.detectors import listed_braking
from tests import strategies
from tests.formats.mcap import forge
from tests.formats.mcap.forge import Forge, chunk_records, data_records, messages_in, resealed, rewrite, seal
from tests.samples import DATE, drive, explore, image, images, reading, save, small_log, warnings_ignored, write
from tests.waiting import time_limit


def chunks_of(parts):
    return [part for part in parts if isinstance(part, records.Chunk)]


def with_chunks(path, change):
    """A file whose chunks went through a function."""
    parts = data_records(path)
    return Forge([change(part) if isinstance(part, records.Chunk) else part for part in parts]).write(path)


# --- what other programs write ---------------------------------------------------------------------------


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunk_size", [1, 2000, 1 << 20])
def test_messages_rewritten_by_another_program_read_equal(small_mcap, tmp_path, compression, chunk_size):
    other = rewrite(small_mcap, tmp_path / "other.mcap", compression=compression, chunk_size=chunk_size)
    assert explore(other)[1:] == [a.replace("small.mcap", "other.mcap") for a in explore(small_mcap)[1:]]


@given(strategies.recordings(), st.sampled_from([50, 400, 1 << 20]))
def test_any_recording_rewritten_by_another_program_reads_equal(tmp_path, recording, chunk_size):
    with warnings_ignored():
        ours = write(tmp_path / "ours.mcap", *recording)
        other = rewrite(ours, tmp_path / "other.mcap", chunk_size=chunk_size)
        assert images(other) == images(ours)


def test_schemas_and_channels_within_chunks_are_passed_over(small_mcap):
    before = images(small_mcap)
    parts = data_records(small_mcap)
    inside = forge.packed(
        *[part for part in parts if isinstance(part, (records.Schema, records.Channel))],
        records.Channel(id=900, schema_id=0, topic="", message_encoding="", metadata={}),
    )

    def stuffed(chunk):
        times = {"message_start_time": chunk.message_start_time, "message_end_time": chunk.message_end_time}
        return seal(inside + chunk_records(chunk) + inside, **times)

    with_chunks(small_mcap, stuffed)
    assert images(small_mcap) == before


def test_channels_of_others_are_passed_over(small_mcap, tmp_path):
    before = images(small_mcap)
    parts = data_records(small_mcap)
    schema = records.Schema(id=500, name="other.Thing", encoding="protobuf", data=b"")
    own = next(part for part in parts if isinstance(part, records.Channel))
    others = [
        records.Channel(id=500, schema_id=500, topic="/camera", message_encoding="protobuf", metadata={}),
        records.Channel(id=501, schema_id=0, topic=own.topic, message_encoding="json", metadata={}),
        records.Channel(id=502, schema_id=own.schema_id, topic="/copy", message_encoding="protobuf", metadata={}),
    ]
    noise = seal(b"".join(forge.message(channel.id, 0, 1, b"noise") for channel in others))
    Forge([*parts, schema, *others, noise]).write(tmp_path / "more.mcap")
    assert images(tmp_path / "more.mcap") == before


def test_a_foreign_file_is_no_recording(tmp_path):
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("a", "protobuf", b"")
        writer.add_message(writer.register_channel("/a", "protobuf", schema), 1, b"", 1)
        writer.add_metadata("other", {"a": "b"})
        writer.finish()
    with pytest.raises(NotARecording, match=r"foreign\.mcap: holds no recording \(MCAP metadata"):
        open_recording(path)


@pytest.mark.parametrize(
    "changes",
    [
        {"date": "yesterday"},
        {"date": str(1 << 63)},
        {"version": "-1"},
        {"version": "65536"},
        {"carla_header": "xyz"},
        {"carla_header": ""},
        {"carla_header": "0100"},
        {"map": None},
        {"double_precision": None},
        {"checksum": None},
        {"checksum": "00000000"},
    ],
    ids=str,
)
@pytest.mark.parametrize("sealed", [True, False], ids=["sealed", "torn"])
def test_a_broken_header_is_an_error_or_a_header(small_mcap, changes, sealed):
    from carla_recap.formats.mcap.schema import checked, unchecked

    parts = data_records(small_mcap)
    for part in parts:
        if isinstance(part, records.Metadata) and part.name == "carla_recap.header":
            changed = unchecked(part.metadata) | {k: v for k, v in changes.items() if k != "checksum"}
            changed = {key: value for key, value in changed.items() if value is not None}
            if not sealed or "checksum" in changes:
                part.metadata = changed | {k: v for k, v in changes.items() if v and k == "checksum"}
            else:
                part.metadata = checked(changed)
    Forge(parts).write(small_mcap)
    try:
        open_recording(small_mcap).close()
    except FormatError as error:
        assert "carla_recap.header" in str(error)  # noqa: PT017
    else:
        assert sealed
        assert "carla_header" in changes


def test_a_header_of_another_kind_of_lengths_is_seen(small_mcap):
    """A recording in single precision whose channels are in double: none of its own are left."""
    parts = data_records(small_mcap)
    from carla_recap.formats.mcap.schema import checked, unchecked

    for part in parts:
        if isinstance(part, records.Metadata) and part.name == "carla_recap.header":
            part.metadata = checked(unchecked(part.metadata) | {"double_precision": "1"})
    Forge(parts).write(small_mcap)
    with (
        pytest.warns(RecapWarning, match=r"small\.mcap: messages of frame 1, and maybe of others, are missing"),
        reading(small_mcap) as reader,
    ):
        list(reader.frames())


# --- false statements ------------------------------------------------------------------------------------


@cache
def bomb(size, *, announced):
    """Return so many zeros, compressed; whether their number is announced."""
    packer = zstandard.ZstdCompressor(write_content_size=announced).compressobj(size if announced else -1)
    piece = bytes(1 << 20)
    parts = [packer.compress(piece) for _ in range(size >> 20)]
    return b"".join(parts) + packer.flush()


@pytest.mark.parametrize("claimed", [100, CHUNK_LIMIT, CHUNK_LIMIT + 1, 1 << 40])
@pytest.mark.parametrize("announced", [True, False])
def test_a_bomb_is_an_error_and_takes_no_memory(small_mcap, claimed, announced):
    data = bomb(256 << 20, announced=announced)
    with_chunks(small_mcap, lambda _: seal(b"", data=data, uncompressed_size=claimed))
    tracemalloc.start()
    try:
        with pytest.raises(FormatError, match="damaged chunk"):
            images(small_mcap)
        assert tracemalloc.get_traced_memory()[1] < 1.5 * CHUNK_LIMIT
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"uncompressed_size": 5}, "announce another size than the chunk"),
        ({"uncompressed_crc": 1}, "the checksum does not match"),
        ({"data": b""}, "damaged"),
        ({"data": b"\x28\xb5\x2f\xfd"}, "damaged"),
        ({"compression": "gzip"}, "unknown compression 'gzip'"),
        ({"compression": "lz4"}, "damaged data"),
        ({"compression": ""}, "bytes after decompression"),
        ({"compression": "x" * 17}, "broken compression name"),
        ({"compression": "\n"}, r"unknown compression '\\n'"),
    ],
    ids=str,
)
def test_a_chunk_that_lies_is_an_error(small_mcap, changes, reason):
    offset = None

    def changed(chunk):
        return resealed(chunk, "zstd", **changes)

    forged = Forge([changed(p) if isinstance(p, records.Chunk) else p for p in data_records(small_mcap)])
    forged.write(small_mcap)
    offset = forged.indexes[0].chunk_start_offset
    with pytest.raises(FormatError, match=reason) as caught:
        images(small_mcap)
    assert f"{small_mcap}: byte {offset}: damaged chunk" in str(caught.value)
    assert "\n" not in str(caught.value)


def tampered(path, change):
    """Return a file with a chunk index that says something else."""
    forged = Forge(data_records(path))
    forged.write(path)
    return forged.write(path, summary=[*forged.described, *change(forged.indexes)])


def without_start(data):
    own = codec.parse("frame", frames_module.FRAME_MESSAGE, data)
    own.packets, own.filled = own.packets[1:], own.filled[1:]
    return own.SerializeToString()


@pytest.mark.parametrize(
    ("topic", "change", "reason"),
    [
        ("/collisions", lambda n, data: (n + 3 * (n == 14), data), "has messages that are not among its packets"),
        ("/collisions", lambda n, data: (n, data[:10] + b"\1" + data[11:]), "has messages of another frame or time"),
        ("/frames", lambda n, data: (n + 10**6 * (n == 14), data), "at position 14 have no frame"),
        ("/frames", lambda n, data: (n % 300, data), "come after those of frame"),
        ("/frames", lambda n, data: (n, without_start(data) if n == 14 else data), "has no start, and is not the first"),
    ],
)
def test_a_frame_that_contradicts_its_messages_is_an_error(driven, topic, change, reason):
    parts = data_records(driven)
    (id,) = (part.id for part in parts if isinstance(part, records.Channel) and part.topic == topic)

    def changed(chunk):
        content = b""
        for channel, sequence, time, _, data in messages_in(chunk):
            sequence, data = change(sequence, data) if channel == id else (sequence, data)
            content += forge.message(channel, sequence, time, data)
        return seal(content, message_start_time=chunk.message_start_time, message_end_time=chunk.message_end_time)

    with_chunks(driven, changed)
    with pytest.raises(FormatError, match=reason), warnings_ignored():
        images(driven)


@pytest.mark.parametrize("later", [1, 10**18])
def test_messages_of_a_frame_with_several_times_are_an_error_of_each_answer(driven, later, tmp_path):
    before = images(driven)
    (id,) = (part.id for part in data_records(driven) if isinstance(part, records.Channel) and part.topic == "/frames")

    def changed(chunk):
        content = b""
        for channel, sequence, time, _, data in messages_in(chunk):
            content += forge.message(channel, sequence, time + later * ((channel, sequence) == (id, 14)), data)
        return seal(content, message_start_time=chunk.message_start_time, message_end_time=chunk.message_end_time)

    with_chunks(driven, changed)
    with open_recording(driven) as recording:
        for question in (lambda: list(recording), lambda: recording.table("spawned"), lambda: recording.table("transforms")):
            with pytest.raises(FormatError, match="the messages at position 14 have several log times"):
                question()
    recover(driven, tmp_path / "saved.mcap")
    assert images(tmp_path / "saved.mcap") == before


def test_frames_without_their_channel_are_an_error(small_mcap):
    parts = data_records(small_mcap)
    kept = [part for part in parts if not (isinstance(part, records.Channel) and part.topic == "/frames")]
    Forge(kept).write(small_mcap)
    with pytest.raises(FormatError, match="the channel of its frames is missing"):
        open_recording(small_mcap)


def with_first(**fields):
    """Return a change of the chunk indexes: other values in the first one."""

    def change(indexes):
        for name, value in fields.items():
            setattr(indexes[0], name, value)
        return indexes

    return change


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (with_first(message_index_offsets={1: 0}), "that it has not in the index"),
        (with_first(message_end_time=1), "that it has not in the index"),
        (lambda indexes: [*indexes, indexes[0]], "the summary names a chunk twice"),
        *((with_first(chunk_start_offset=offset), "a chunk") for offset in (0, 8, 100, 1 << 30, (1 << 64) - 1)),
    ],
)
def test_chunk_indexes_that_contradict_the_chunks_are_an_error(small_mcap, change, reason):
    tampered(small_mcap, change)
    with pytest.raises(FormatError, match=reason):
        images(small_mcap)


def test_a_chunk_index_with_other_times_is_an_error_or_an_answer(driven):
    def elsewhen(indexes):
        for index in indexes:
            index.message_start_time, index.message_end_time = 5, 9
        return indexes

    tampered(driven, elsewhen)
    for time in (0.0, 12.0):
        with open_recording(driven) as recording:
            try:
                assert recording.frame_at(time).elapsed == time
            except RecapError as error:
                assert "index" in str(error) or "no frame" in str(error)  # noqa: PT017


def test_statistics_that_name_more_chunks_are_an_error(small_mcap):
    stated = next(r for r in forge.read_records(small_mcap) if isinstance(r, records.Statistics))
    tampered(small_mcap, lambda indexes: [stated, *indexes[1:]])
    with pytest.raises(FormatError, match=r"names 1 of 2 chunks; 'carla-recap recover' makes a new one"):
        open_recording(small_mcap)


def test_messages_outside_chunks_are_an_error(small_mcap, tmp_path):
    other = rewrite(small_mcap, tmp_path / "other.mcap", use_chunking=False)
    with pytest.raises(FormatError, match=r"\d+ messages lie outside chunks"):
        open_recording(other)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        *(({"summary_start": at}, f"said to begin at byte {at}, which cannot be") for at in (1, 7, 1 << 20, (1 << 64) - 1)),
        ({"summary_start": 0}, "has no summary; 'carla-recap recover' makes one"),
        ({"summary_crc": 1}, "its checksum does not match"),
    ],
)
def test_a_wrong_summary_is_an_error(small_mcap, options, reason):
    Forge(data_records(small_mcap)).write(small_mcap, **options)
    with pytest.raises(FormatError, match=reason):
        open_recording(small_mcap)


def test_a_summary_that_begins_within_something_is_an_error(small_mcap):
    size = small_mcap.stat().st_size
    Forge(data_records(small_mcap)).write(small_mcap, summary_start=size // 3)
    with pytest.raises(FormatError, match="the summary is damaged"):
        open_recording(small_mcap)


@pytest.mark.parametrize("kept", [20, 0.5, -1, -37])
def test_a_file_without_an_end_says_what_to_do(small_mcap, kept):
    data = small_mcap.read_bytes()
    save(small_mcap, data[: int(len(data) * kept) if kept == 0.5 else kept])
    with pytest.raises(FormatError, match=r"has no valid end.*'carla-recap recover' saves what it holds"):
        open_recording(small_mcap)


def test_a_summary_without_its_checksum_is_read(small_mcap):
    before = images(small_mcap)
    Forge(data_records(small_mcap), crc=False).write(small_mcap)
    assert images(small_mcap) == before


# --- chunks that overlap in time -------------------------------------------------------------------------


def overlapping(path):
    """All messages at random in chunks that each claim the whole time."""
    parts = data_records(path)
    rest = [part for part in parts if not isinstance(part, (records.Chunk, records.Metadata))]
    metadata = [part for part in parts if isinstance(part, records.Metadata)]
    chunks = [resealed(chunk, "zstd", message_start_time=0) for chunk in chunks_of(parts)]
    return Forge([*rest, *reversed(chunks), *metadata]).write(path)


def test_chunks_that_all_overlap_are_read(driven):
    before = images(driven)
    overlapping(driven)
    assert images(driven) == before


def test_chunks_that_all_overlap_are_not_held_without_bound(driven, monkeypatch):
    monkeypatch.setattr(frames_module, "PENDING_LIMIT", 100_000)
    overlapping(driven)
    with pytest.raises(FormatError, match=r"more than 100000 bytes or .* overlap in time"):
        images(driven)


def test_a_long_recording_is_not_taken_for_one_that_overlaps(tmp_path, monkeypatch):
    monkeypatch.setattr(frames_module, "PENDING_LIMIT", 4 << 20)
    path = write(tmp_path / "long.mcap", Header("Town01", 1_600_000_000), drive(60, 20, 600))
    assert sum(chunk.uncompressed_size for chunk in chunks_of(data_records(path))) > 20 << 20
    with reading(path) as reader:
        assert sum(1 for _ in reader.frames()) == 1200


# --- damage ----------------------------------------------------------------------------------------------


@pytest.fixture
def plain_mcap(tmp_path):
    """A file of few channels, so that a change seldom hits a schema."""
    return write(tmp_path / "plain.mcap", Header("Town01", 1_600_000_000), drive(0.3, 20, 2))


def frames_of(path):
    """The frames and the header, or None where there is an error or a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            with reading(path) as reader:
                return reader.header, reader.extent(), [image(frame) for frame in reader.frames()]
        except (RecapError, RecapWarning):
            return None


@pytest.mark.parametrize("bit", range(8))
def test_a_flipped_bit_never_changes_the_answer(plain_mcap, bit):
    data, before = bytearray(plain_mcap.read_bytes()), frames_of(plain_mcap)
    assert before
    noticed = 0
    for at in range(bit, len(data), 17):
        data[at] ^= 1 << bit
        plain_mcap.write_bytes(data)
        after = frames_of(plain_mcap)
        assert after in (None, before), f"bit {bit} of byte {at}"
        noticed += after is None
        data[at] ^= 1 << bit
    assert noticed > len(data) / 17 / 4


@given(data=st.data())
def test_any_damage_ends_in_an_answer_or_in_an_error_of_ours(tmp_path, data):
    path, source = tmp_path / "small.mcap", tmp_path / "small.log"
    if not path.exists():
        convert(save(source, small_log()), path)
        (tmp_path / "kept").write_bytes(path.read_bytes())
    whole = (tmp_path / "kept").read_bytes()
    save(tmp_path / "damaged.mcap", strategies.damaged(whole, data.draw(strategies.mutations(len(whole)))))
    with warnings_ignored(), time_limit():
        answers = explore(tmp_path / "damaged.mcap")
    assert not [text for text in answers if "\n" in text and "Error: " in text]


# --- by the index ----------------------------------------------------------------------------------------


def test_parts_are_read_where_chunks_of_state_and_of_events_end_at_other_frames(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "CHUNK_SIZE", 20_000)
    path = write(tmp_path / "run.mcap", Header("Town01", DATE), drive(20))
    with reading(path) as reader:
        assert [reader.frame_at(number / 20).index for number in range(90, 110)] == [*range(90, 110)]


def test_the_extent_is_known_without_reading(driven):
    with reading(driven) as reader:
        at_rest = reader.bytes_read
        assert (reader.extent().frames, reader.extent().duration) == (600, 29.95)
        assert reader.bytes_read == at_rest


def test_frames_of_some_types_hold_these_alone(small_mcap):
    with reading(small_mcap) as reader:
        found = [[p.type.name for p in frame.packets] for frame in reader.frames(("collisions", "destroyed"))]
        assert found == [["collisions"], [], ["collisions"], ["destroyed"]]
        sparse = [f.index for f in reader.frames(("collisions", "destroyed"), sparse=True)]
        assert sparse == [0, 2, 3]


def test_an_unknown_type_is_an_error(small_mcap):
    with reading(small_mcap) as reader, pytest.raises(RecapError, match="no record type 'wings'; there are frame, "):
        list(reader.frames(("wings",)))


# --- stretches, summed up by the writer --------------------------------------------------------------------


@pytest.mark.parametrize("frames", [1, 40], ids=["a frame", "frames that are alike"])
@pytest.mark.parametrize("name", ["transforms", "wheels", "spawned"])
def test_bytes_that_contradict_their_layout_are_an_error_of_their_frame(tmp_path, name, frames):
    """A message may have anything in `raw`, which stands for its records; it is kept as it is."""
    path, raw = tmp_path / "a.mcap", b"\5\0\1"
    wheels = [WheelSet(7, [(0, 0.5, 1.5)])]
    with create_recording(path, map_name="Town01") as recorder:
        for frame in range(frames):
            recorder.add_frame(frame / 20, spawned=[Spawn(7)], transforms=[(7, *6 * (0.0,))], wheels=wheels)
    topic = UE4.named(name).topic
    forge.edited(path, lambda where, _, data: data + b"\x22\3" + raw if where == topic else data)
    with open_recording(path) as recording:
        for number, frame in enumerate(recording, 1):
            (packet,) = [packet for packet in frame.packets if packet.type.name == name]
            with pytest.raises(
                FormatError, match=rf"a\.mcap: {topic} of frame {number}: {name}: .* need \d+ bytes, the packet has 3$"
            ):
                frame[name]
            assert bytes(packet.payload) == raw
        if name == "transforms":
            with pytest.raises(FormatError, match=f"{topic} of frame 1: "):
                recording.trajectory(7)
    with pytest.raises(FormatError, match=f"{topic} of frame 1: "):
        convert(path, tmp_path / "b.mcap", force=True)


@pytest.fixture
def struck(tmp_path):
    """A car that brakes hard, and then touches something, and one that stands; the velocity of the first is recorded."""
    path = tmp_path / "struck.mcap"
    with create_recording(path, map_name="Town01") as recorder:
        for number in range(60):
            speed = max(0.0, 20.0 - 0.4 * number)
            more = {"collisions": {"actor1": [7], "actor2": [NO_ACTOR]}} if number == 50 else {}
            more |= {} if number else {"spawned": [Spawn(id, 1, type_id="vehicle.a") for id in (7, 8)]}
            more |= {"velocities": {"id": [7], "x": [speed]}} if number else {}
            recorder.add_frame(number / 20, transforms={"id": [7, 8], "x": [5.0 * number, 900.0]}, **more)
    return path


def digest_of(path):
    with reading(path) as reader:
        return listed_braking(reader, 6), listed_impacts(reader), listed_intervals(reader, 1, 10)


def test_braking_contacts_and_stops_are_read_from_the_events(struck):
    ((braking,), (contact,), (stop,)) = digest_of(struck)
    assert (braking.id, braking.speed) == (7, pytest.approx(19.6, abs=1.0))
    assert (contact.key, contact.positions[0][0]) == ((50, 7, NO_ACTOR), 250.0)
    assert contact.velocities[0] == (pytest.approx(0.4), 0.0, 0.0)
    assert (stop.id, stop.duration) == (8, pytest.approx(2.9))
    with reading(struck) as reader:
        assert listed_braking(reader, 7) is None


@pytest.mark.parametrize(("odd", "kept"), [(6, [False, False, False]), (12, [False, False, True])])
def test_odd_packets_leave_the_digest_out(tmp_path, struck, odd, kept):
    with reading(struck) as reader, create_writer(tmp_path / "odd.mcap", reader.header) as writer:
        for frame in reader.frames():
            packets = [Packet(p.id, p.type, bytes(p.payload) + b"!" * (p.id == odd)) for p in frame.packets]
            with warnings_ignored():
                writer.write(Frame(frame.index, frame.id, frame.elapsed, frame.duration, packets))
    assert [found is not None for found in digest_of(tmp_path / "odd.mcap")] == kept


def test_hard_braking_by_the_first_rule_is_missed(struck, monkeypatch):
    assert digest_of(struck)[0] is not None
    monkeypatch.setattr(McapReader, "metadata", {"braking": "6 1"})
    assert digest_of(struck)[0] is None


@pytest.mark.parametrize(
    ("topic", "kept"),
    [
        ("/vehicles/braking", [False, True, True]),
        ("/collisions/contacts", [True, False, True]),
        ("/actors/stretches", [True, True, False]),
    ],
)
def test_a_digest_that_another_program_left_out_is_missed(struck, topic, kept):
    parts = data_records(struck)
    (gone,) = (part.id for part in parts if isinstance(part, records.Channel) and part.topic == topic)

    def without(part):
        if not isinstance(part, records.Chunk):
            return part
        found = list(breakup_chunk(part))
        rest = [record for record in found if not (isinstance(record, records.Message) and record.channel_id == gone)]
        return part if len(rest) == len(found) else resealed_with(part, rest)

    Forge([without(part) for part in parts]).write(struck)
    assert [found is not None for found in digest_of(struck)] == kept
    with reading(struck) as reader:
        assert [row.id for row in blocked(reader, 1)] == [8]


def test_a_digest_of_more_rows_than_a_file_can_mean_is_missed(tmp_path):
    body = encode(BRAKING, pack(BRAKING, np.zeros(0xFFFF, BRAKING.dtype)))
    with create_writer(tmp_path / "bomb.mcap", Header("Town01", 0)) as writer:
        writer.write(Frame(0, 1, 0.0, 1.0, []))
        writer._add_digest([(BRAKING.topic, body)] * 2, codec.head(1, 0.0), (1, 1))
        writer._digest.metadata = lambda: {"braking": f"6 {2 * 0xFFFF} {BRAKING_RULE}"}
    with reading(tmp_path / "bomb.mcap") as reader:
        assert reader.digest("braking") is None


def resealed_with(chunk, messages):
    times = {"message_start_time": chunk.message_start_time, "message_end_time": chunk.message_end_time}
    return seal(forge.packed(*messages), **times)


def test_a_digest_without_a_checksum_is_missed(struck):
    with_chunks(struck, lambda chunk: resealed(chunk, "zstd", uncompressed_crc=0))
    assert digest_of(struck) == (None, None, None)


def test_a_vehicle_that_spawns_behind_its_first_transform_leaves_braking_out(tmp_path):
    path = tmp_path / "late.mcap"
    with create_recording(path, map_name="Town01") as recorder:
        recorder.add_frame(0.0, transforms={"id": [7]})
        recorder.add_frame(0.1, spawned=[Spawn(7, 1, type_id="vehicle.a")], transforms={"id": [7]})
    assert digest_of(path)[:2] == (None, [])


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_the_frames_of_a_recording_that_has_begun_are_waited_for_whatever_its_header(tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(formats, "_PATIENCE", 0.1)
    path = write(tmp_path / f"run{suffix}", Header("M" * 5000, DATE), [])
    save(tmp_path / f".run{suffix}.0a0b0c0d.partial", b"")
    with pytest.warns(RecapWarning, match="is being recorded, or was interrupted"), open_recording(path) as recording:
        assert list(recording) == []
