"""Reading MCAP: files of other writers, files with false statements, and files with a flipped bit."""

from __future__ import annotations

import struct
import tracemalloc
import warnings
from dataclasses import replace
from functools import cache
from itertools import groupby
from operator import itemgetter

import pytest
import zstandard
from hypothesis import example, given
from hypothesis import strategies as st
from mcap import records
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
from carla_recap.formats.mcap.index import CHUNK_LIMIT
from carla_recap.formats.mcap.reader import McapReader
from carla_recap.formats.mcap.runs import BrokenRecords, message_runs
from carla_recap.formats.mcap.schema import checked, unchecked
from carla_recap.model.frame import Frame, Header, Packet
from carla_recap.model.records import NO_ACTOR, UE4, Spawn, WheelSet
from carla_recap.queries.blocked import blocked, listed_intervals
from carla_recap.queries.contacts import listed_impacts
from carla_recap.queries.detectors import listed_braking
from tests import strategies
from tests.formats.mcap import forge
from tests.formats.mcap.forge import Forge, data_records, resealed, rewrite, seal
from tests.samples import DATE, drive, explore, image, images, reading, save, warnings_ignored, write
from tests.waiting import time_limit


def chunks_of(parts):
    return [part for part in parts if isinstance(part, records.Chunk)]


def with_chunks(path, change):
    """A file whose chunks went through a function."""
    parts = data_records(path)
    return Forge([change(part) if isinstance(part, records.Chunk) else part for part in parts]).write(path)


# --- what other programs write ---------------------------------------------------------------------------


@given(strategies.recordings(), st.sampled_from([50, 400, 1 << 20]), st.sampled_from(CompressionType))
def test_any_recording_written_without_a_log_and_rewritten_by_another_program(tmp_path, recording, chunk_size, compression):
    with warnings_ignored():
        ours = write(tmp_path / "ours.mcap", *recording)
        other = rewrite(ours, tmp_path / "other.mcap", chunk_size=chunk_size, compression=compression)
        assert images(other) == images(ours) == [image(frame) for frame in recording[1]]


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
        {"date": str(1 << 63)},
        {"version": "-1"},
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
    has_own = not sealed or "checksum" in changes

    def changed(metadata):
        found = ((metadata if has_own else unchecked(metadata)) | changes).items()
        metadata = {key: value for key, value in found if value is not None}
        return metadata if has_own else checked(metadata)

    forge.with_header(small_mcap, changed)
    try:
        open_recording(small_mcap).close()
    except FormatError as error:
        assert "carla_recap.header" in str(error)  # noqa: PT017
    else:
        assert sealed
        assert "carla_header" in changes


# --- false statements ------------------------------------------------------------------------------------


@cache
def bomb(size, *, announced):
    """Return so many zeros, compressed; whether their number is announced."""
    packer = zstandard.ZstdCompressor(write_content_size=announced).compressobj(size if announced else -1)
    piece = bytes(1 << 20)
    parts = [packer.compress(piece) for _ in range(size >> 20)]
    return b"".join(parts) + packer.flush()


@pytest.mark.parametrize("claimed", [100, CHUNK_LIMIT, CHUNK_LIMIT + 1])
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


def chunks(**changes):
    """Return a lie: chunks that say something else of their content."""
    return lambda path: with_chunks(path, lambda chunk: resealed(chunk, "zstd", **changes))


def indexes(change):
    """Return a lie: statistics of two chunks, and other chunk indexes."""

    def tamper(path):
        statistics = [record for record in forge.read_records(path) if isinstance(record, records.Statistics)]
        forged = Forge(data_records(path))
        forged.write(path)
        forged.write(path, summary=[*forged.described, *statistics, *change(forged.indexes)])

    return tamper


def first_index(**fields):
    return indexes(lambda found: [replace(found[0], **fields), *found[1:]])


def footer(**fields):
    return lambda path: Forge(data_records(path)).write(path, **fields)


def without_frames(path):
    parts = data_records(path)
    Forge([part for part in parts if not (isinstance(part, records.Channel) and part.topic == "/frames")]).write(path)


@pytest.mark.parametrize(
    ("lie", "reason"),
    [
        (chunks(uncompressed_size=5), "damaged chunk: .*announce another size than the chunk"),
        (chunks(uncompressed_crc=1), "damaged chunk: the checksum does not match"),
        (chunks(data=b""), "damaged chunk: .*damaged"),
        (chunks(data=b"\x28\xb5\x2f\xfd"), "damaged chunk: .*damaged"),
        (chunks(compression="gzip"), "damaged chunk: unknown compression 'gzip'"),
        (chunks(compression="lz4"), "damaged chunk: .*damaged data"),
        (chunks(compression=""), "damaged chunk: .*bytes after decompression"),
        (chunks(compression="x" * 17), "damaged chunk: .*broken compression name"),
        (chunks(compression="\n"), r"damaged chunk: unknown compression '\\n'"),
        (first_index(message_index_offsets={1: 0}), "that it has not in the index"),
        (first_index(message_end_time=1), "that it has not in the index"),
        (indexes(lambda found: [*found, found[0]]), "the summary names a chunk twice"),
        *((first_index(chunk_start_offset=offset), "a chunk") for offset in (0, 8, 100, 1 << 30, (1 << 64) - 1)),
        (indexes(lambda found: found[1:]), "names 1 of 2 chunks; 'carla-recap recover' makes a new one"),
        (without_frames, "the channel of its frames is missing"),
        (lambda path: rewrite(path, path, use_chunking=False), r"\d+ messages lie outside chunks"),
        *(
            (footer(summary_start=at), f"said to begin at byte {at}, which cannot be")
            for at in (1, 7, 1 << 20, (1 << 64) - 1)
        ),
        (footer(summary_start=1000), "the summary is damaged"),
        (footer(summary_start=0), "has no summary; 'carla-recap recover' makes one"),
        (footer(summary_crc=1), "its checksum does not match"),
        *(
            (
                lambda path, kept=kept: save(path, path.read_bytes()[:kept]),
                "has no valid end.*'carla-recap recover' saves",
            )
            for kept in (20, 2000, -1, -37)
        ),
    ],
)
def test_a_file_that_lies_is_an_error_of_one_line(small_mcap, lie, reason):
    lie(small_mcap)
    with pytest.raises(FormatError, match=reason) as caught:
        images(small_mcap)
    assert str(caught.value).startswith(f"{small_mcap}: ")
    assert "\n" not in str(caught.value)


DATA = b"".join(forge.message(2, sequence, 0, b"12345678") for sequence in range(3))
SHORT = struct.pack("<BQHIQQ", 5, 21, 2, 1, 0, 0) + b"12345678"


@pytest.mark.parametrize("data", [*(DATA[:-cut] for cut in range(1, 39)), SHORT], ids=len)
def test_a_record_that_is_cut_or_shorter_than_its_fields_is_an_error(data):
    with pytest.raises(BrokenRecords, match="no whole record at byte"):
        list(message_runs(data, 1))


MESSAGES = st.lists(st.tuples(st.sampled_from([1, 2, 3]), st.binary(max_size=2)), min_size=1, max_size=3)


@given(st.lists(st.tuples(st.integers(1, 2), MESSAGES, st.integers(1, 5)), max_size=5))
@example([(1, [(2, b"a")], 3), (1, [(2, b"a"), (2, b"b")], 1)])  # the last of frames that are alike has one more
def test_runs_have_the_frames_of_a_chunk(parts):
    """Each part is the step to the next sequence, the messages of a frame, and how often it is repeated."""
    rows, sequence = [], 0
    for step, messages, times in parts:
        for _ in range(times):
            sequence += step
            rows += [(channel, sequence, data) for channel, data in messages]
    chunk = b"".join(forge.message(channel, sequence, sequence * 10, data) for channel, sequence, data in rows)
    found = [
        [(slot[0], run.sequence + row, bytes(run.message(row, slot))) for slot in run.slots]
        for run in message_runs(chunk, 1)
        for row in range(run.number)
    ]
    assert found == [list(group) for _, group in groupby(rows, key=itemgetter(1))]


def without_start(data):
    own = codec.parse("frame", frames_module.FRAME_MESSAGE, data)
    own.packets, own.filled = own.packets[1:], own.filled[1:]
    return own.SerializeToString()


@pytest.mark.parametrize(
    ("topic", "change", "reason"),
    [
        (
            "/collisions",
            lambda n, time, data: (n + 3 * (n == 14), time, data),
            "messages that are not among its packets",
        ),
        ("/collisions", lambda n, time, data: (n, time, data[:10] + b"\1" + data[11:]), "messages of another frame or time"),
        ("/frames", lambda n, time, data: (n + 10**6 * (n == 14), time, data), "at position 14 have no frame"),
        ("/frames", lambda n, time, data: (n % 300, time, data), "come after those of frame"),
        ("/frames", lambda n, time, data: (n, time, without_start(data) if n == 14 else data), "has no start, and is not"),
        ("/frames", lambda n, time, data: (n, time + (n == 14), data), "the messages at position 14 have several log times"),
        ("/frames", lambda n, time, data: (n, time + 10**18 * (n == 14), data), "position 14 have several log times"),
    ],
)
def test_a_frame_that_contradicts_its_messages_is_an_error(driven, topic, change, reason):
    forge.retold(driven, lambda where, *told: change(*told) if where == topic else told)
    with pytest.raises(FormatError, match=reason), warnings_ignored():
        images(driven)


def test_messages_of_a_frame_with_several_times_are_an_error_of_each_answer(driven, tmp_path):
    before = images(driven)
    forge.retold(driven, lambda topic, n, time, data: (n, time + ((topic, n) == ("/frames", 14)), data))
    with open_recording(driven) as recording:
        for question in (lambda: recording.table("spawned"), lambda: recording.table("transforms")):
            with pytest.raises(FormatError, match="the messages at position 14 have several log times"):
                question()
    recover(driven, tmp_path / "saved.mcap")
    assert images(tmp_path / "saved.mcap") == before


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


def test_chunks_that_all_overlap_are_read_but_not_held_without_bound(driven, monkeypatch):
    before, whole = images(driven), driven.read_bytes()
    overlapping(driven)
    assert images(driven) == before
    monkeypatch.setattr(frames_module, "PENDING_LIMIT", 100_000)
    with pytest.raises(FormatError, match=r"more than 100000 bytes or .* overlap in time"):
        images(driven)
    assert images(save(driven, whole)) == before


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
def test_any_damage_ends_in_an_answer_or_in_an_error_of_ours(small_mcap, data):
    whole = small_mcap.read_bytes()
    damaged = strategies.damaged(whole, data.draw(strategies.mutations(len(whole))))
    with warnings_ignored(), time_limit():
        answers = explore(save(small_mcap.with_name("damaged.mcap"), damaged))
    assert not [text for text in answers if "\n" in text and "Error: " in text]


# --- by the index ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_frames_of_one_form_are_one_batch_each_time_the_form_changes(tmp_path, suffix):
    with create_recording(tmp_path / f"run{suffix}", map_name="", date=0) as recorder:
        for number in range(150):
            poses = [{"id": id, "x": 100.0 * number} for id in range(10 + number // 50)]
            recorder.add_frame(number / 10, transforms=poses)
    with open_recording(tmp_path / f"run{suffix}") as recording:
        batches = list(recording.reader.batches(("transforms",)))
    assert [len(batch) for batch in batches] == [50, 50, 50]
    assert [batch.records("transforms").shape for batch in batches] == [(50, 10), (50, 11), (50, 12)]
    assert [batch.records("transforms")["x"][-1, 0].item() for batch in batches] == [4900, 9900, 14900]


def test_parts_are_read_where_chunks_of_state_and_of_events_end_at_other_frames(tmp_path, monkeypatch):
    monkeypatch.setattr(writer, "CHUNK_SIZE", 20_000)
    path = write(tmp_path / "run.mcap", Header("Town01", DATE), drive(20))
    with reading(path) as reader:
        assert [reader.frame_at(number / 20).index for number in range(90, 110)] == [*range(90, 110)]


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
    forge.edited(struck, lambda where, _, data: None if where == topic else data)
    assert [found is not None for found in digest_of(struck)] == kept
    with reading(struck) as reader:
        assert [row.id for row in blocked(reader, 1)] == [8]


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
