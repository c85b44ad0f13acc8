"""Further topics of a recording, such as those of sensors: chunks of their own, which no query reads."""

from __future__ import annotations

import json
import math
import tracemalloc
from contextlib import contextmanager

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mcap import records
from mcap.reader import make_reader
from mcap.writer import IndexType

from carla_recap import FormatError, RecapError, RecapWarning, RecordError, convert, open_recording
from carla_recap.formats import open_reader
from carla_recap.formats.mcap.writer import (
    FURTHER_CHUNK_SECONDS,
    FURTHER_CHUNK_SIZE,
    FURTHER_OPEN_LIMIT,
    MESSAGE_LIMIT,
    McapWriter,
)
from carla_recap.model.frame import Header
from tests.formats.mcap.forge import MAGIC, Forge, data_records, message, messages_in, packed, rewrite, seal
from tests.samples import contents, drive, image, images, reading, write
from tests.sensed import HEADER, camera, messages_of, noise, plain, sensed, topics_of
from tests.waiting import time_limit

SECOND = 1_000_000_000
QUERIES = {
    "collisions": lambda recording: recording.collisions(),
    "blocked": lambda recording: recording.blocked(1.0),
    "incidents": lambda recording: recording.incidents(),
    "trajectories": lambda recording: recording.trajectories(),
    "actors": lambda recording: recording.actors,
    "part": lambda recording: [frame.id for frame in recording.frames(3.0, 5.0)],
    "moment": lambda recording: [recording.frame_at(7.03).id],
}


def chunk_topics(path):
    """The topics of each chunk, in the order of the file."""
    found = data_records(path)
    names = {record.id: record.topic for record in found if isinstance(record, records.Channel)}
    for chunk in (record for record in found if isinstance(record, records.Chunk)):
        yield chunk, {names[channel] for channel, *_ in messages_in(chunk)}


@contextmanager
def told(path, messages, *, topic=None, header=HEADER):
    """Yield the reader of a recording with messages of one topic, given as times and data."""
    topic = topic or plain("/a")
    with McapWriter(path, header) as writer:
        writer.add_topic(topic)
        for elapsed, data in messages:
            writer.write_message(topic.name, elapsed, data)
    with reading(path) as reader:
        yield reader


# --- writing -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("live", [False, True])
def test_topics_share_chunks_with_their_group_alone(tmp_path, live):
    found = {frozenset(topics) for _, topics in chunk_topics(sensed(tmp_path / "run.mcap", live=live))}
    own = {topics for topics in found if not topics & {"/sensors/front/image", "/sensors/imu/imu", "/note"}}
    others = [{"/sensors/front/image"}, {"/sensors/imu/imu", "/note"}]
    assert found - own == set(map(frozenset, others if not live else [*others, {"/sensors/imu/imu"}]))


def test_chunks_are_cut_by_size_and_time(tmp_path):
    with McapWriter(tmp_path / "run.mcap", HEADER) as writer:
        for name in ("/large", "/small"):
            writer.add_topic(plain(name))
        for number in range(100):
            writer.write_message("/large", float(number), noise(300_000, number))
            writer.write_message("/small", float(number), b"1")
    spans = {"/large": [], "/small": []}
    for chunk, (name,) in chunk_topics(tmp_path / "run.mcap"):
        spans[name].append((chunk.message_end_time - chunk.message_start_time) / SECOND)
        assert chunk.uncompressed_size <= FURTHER_CHUNK_SIZE
    assert set(spans["/large"][:-1]) == {12.0}
    assert spans["/small"] == [FURTHER_CHUNK_SECONDS - 1] * 3 + [9.0]


def test_chunks_that_are_being_filled_are_bounded_together(tmp_path):
    with McapWriter(tmp_path / "run.mcap", HEADER) as writer:
        topics = [f"/{number}" for number in range(60)]
        for name in topics:
            writer.add_topic(plain(name))
        for number in range(2):
            for name in topics:
                writer.write_message(name, float(number), bytes(1_500_000))
            held = sum(chunk.size for chunk in writer._further_chunks.values())
            assert held <= FURTHER_OPEN_LIMIT
            assert held == writer._further_size
    reader = open_reader(tmp_path / "run.mcap")
    assert {topic.count for topic in reader.further_topics().values()} == {2}
    reader.close()


@pytest.mark.parametrize(
    ("act", "error", "text"),
    [
        (lambda writer: writer.add_topic(camera()), RecapError, "has a topic '/sensors/front/image' already"),
        (lambda writer: writer.add_topic(plain("/frames")), RecapError, "has a topic '/frames' already"),
        (lambda writer: writer.write_message("/none", 1.0, b""), RecapError, "no topic '/none' was added"),
        (lambda writer: writer.write_message("/frames", 1.0, b""), RecapError, "no topic '/frames' was added"),
        (
            lambda writer: writer.write_message("/sensors/front/image", math.nan, b""),
            RecapError,
            "at nan s, which is no time",
        ),
        (lambda writer: writer.write_message("/sensors/front/image", -2e9, b""), RecapError, "which is no time"),
        (
            lambda writer: writer.write_message("/sensors/front/image", 1.0, bytes(MESSAGE_LIMIT + 1)),
            RecordError,
            f"of {MESSAGE_LIMIT + 1} bytes; at most {MESSAGE_LIMIT} are written",
        ),
    ],
)
def test_what_cannot_be_written_is_an_error_and_the_rest_stays_whole(tmp_path, act, error, text):
    with McapWriter(tmp_path / "run.mcap", HEADER) as writer:
        writer.add_topic(camera())
        with pytest.raises(error, match=text):
            act(writer)
        writer.write_message("/sensors/front/image", 1.0, b"1")
    with open_recording(tmp_path / "run.mcap") as recording:
        assert list(recording.reader.messages("/sensors/front/image")) == [(1.0, b"1")]


def test_a_message_of_the_largest_size_is_read_again(tmp_path):
    with told(tmp_path / "run.mcap", [(time, bytes(MESSAGE_LIMIT)) for time in (0.0, 1.0)]) as reader:
        assert [(time, len(data)) for time, data in reader.messages("/a")] == [(0.0, MESSAGE_LIMIT), (1.0, MESSAGE_LIMIT)]


# --- reading -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("live", [False, True])
def test_queries_answer_as_without_further_topics_and_read_the_same_chunks(tmp_path, live):
    with McapWriter(tmp_path / "plain.mcap", HEADER, live=live) as writer:
        for frame in drive(10.0):
            writer.write(frame)
    sensed(tmp_path / "sensed.mcap", live=live)
    assert images(tmp_path / "sensed.mcap") == images(tmp_path / "plain.mcap")
    for query in QUERIES.values():
        with open_recording(tmp_path / "plain.mcap") as one, open_recording(tmp_path / "sensed.mcap") as other:
            opened = other.reader.bytes_read - one.reader.bytes_read  # a longer summary
            assert repr(contents(query(one))) == repr(contents(query(other)))
            # The offset of the events, which metadata have, is a longer number.
            assert abs(other.reader.bytes_read - one.reader.bytes_read - opened) < 10


def test_topics_are_described(tmp_path):
    with open_recording(sensed(tmp_path / "run.mcap")) as recording:
        found = recording.reader.further_topics()
        assert list(found) == ["/sensors/front/image", "/sensors/imu/imu", "/note"]
        front, imu, note = found.values()
        assert (front.topic.message, front.topic.schema(), front.topic.encoding) == (
            "foxglove.CompressedImage",
            b"image",
            "protobuf",
        )
        assert json.loads(front.topic.metadata["sensor"])["type"] == "sensor.camera.rgb"
        assert (imu.topic.message, imu.topic.encoding, imu.topic.metadata) == ("", "json", {})
        assert (front.count, imu.count, note.count) == (100, 200, 1)
        assert (front.first, imu.first, imu.last) == (0.0, 0.0, pytest.approx(9.95, abs=1e-6))
        assert note.first == note.last == pytest.approx(1.0, abs=1e-6)
        assert imu.group == note.group != front.group


@pytest.mark.parametrize(
    "read",
    [lambda reader: list(reader.messages("/a", 5.0, 5.1)), lambda reader: reader.latest_messages(["/a"], 5.0)],
    ids=["of a part", "latest"],
)
def test_messages_are_read_of_the_chunks_of_their_time_alone(tmp_path, read):
    with told(tmp_path / "run.mcap", [(number / 10, noise(300_000, number)) for number in range(100)]) as reader:
        before = reader.bytes_read
        assert len(read(reader)) == 1
        assert reader.bytes_read - before < FURTHER_CHUNK_SIZE + 10_000


TIMES = st.sampled_from([0.0, 0.5, 1.0, 10.0, 39.0, 40.0, 80.0])


@given(
    told=st.lists(st.tuples(st.sampled_from(["/a", "/b"]), TIMES, st.integers(0, 90)), max_size=15),
    group=st.sampled_from(["", "both"]),
    moment=st.one_of(TIMES, st.sampled_from([-1.0, 45.0, 1e12, math.nan])),
)
@example(told=[("/b", 2.0, 1), ("/a", 1.0, 1), ("/a", 3.0, 200), ("/b", 1.5, 1), ("/b", 2.5, 1)], group="both", moment=2.5)
def test_messages_are_those_of_a_list(tmp_path, told, group, moment):
    """They come late, at one time, in chunks that overlap, and are asked for at times that MCAP does not have."""
    expected = [(topic, elapsed, b"%d" % number + bytes(size)) for number, (topic, elapsed, size) in enumerate(told)]
    with pytest.MonkeyPatch.context() as patch, McapWriter(tmp_path / "run.mcap", Header("Town01", 0), force=True) as writer:
        patch.setattr("carla_recap.formats.mcap.writer.FURTHER_CHUNK_SIZE", 200)
        for name in ("/a", "/b"):
            writer.add_topic(plain(name), group=group)
        for message in expected:
            writer.write_message(*message)
    with reading(tmp_path / "run.mcap") as reader:
        every = list(reader.further_messages())
        assert [message.elapsed for message in every] == sorted(elapsed for _, elapsed, _ in expected)
        assert sorted(every) == sorted(expected) == sorted(reader.further_messages(in_order=False))
        assert list(reader.further_messages(stop=moment)) == [each for each in every if each.elapsed < moment]
        latest = []
        for name, topic in reader.further_topics().items():
            own = [message for message in every if message.topic == name]
            times = [message.elapsed for message in own] or [None]
            assert (topic.count, topic.first, topic.last) == (len(own), times[0], times[-1])
            latest += [message for message in own if message.elapsed <= moment][-1:]
        found = reader.latest_messages(["/a", "/b"], moment)
        assert sorted(found) == sorted(latest)
        assert [message.elapsed for message in found] == sorted(message.elapsed for message in latest)


def test_an_unknown_topic_is_an_error_with_those_that_there_are(tmp_path, small):
    for path, name, told in (
        (sensed(tmp_path / "run.mcap"), "/none", "has no further topic '/none'; it has /note, "),
        (tmp_path / "run.mcap", "/frames", "has no further topic '/frames'"),
        (small, "/none", "only MCAP files have some"),
    ):
        with open_recording(path) as recording:
            for ask in (recording.reader.messages, lambda name: recording.reader.latest_messages([name], 1.0)):
                with pytest.raises(RecapError, match=told):
                    list(ask(name))
    with open_recording(small) as recording:
        assert recording.reader.further_topics() == {}
        assert not list(recording.reader.further_messages())


def test_mcaps_own_reader_reads_all_messages(tmp_path):
    path = sensed(tmp_path / "run.mcap")
    with path.open("rb") as file, open_recording(path) as recording:
        reader = make_reader(file, validate_crcs=True)
        for name, topic in recording.reader.further_topics().items():
            found = list(reader.iter_messages([name]))
            assert len(found) == topic.count
            assert [each.data for _, _, each in found] == [data for _, data in recording.reader.messages(name)]
            assert [each.sequence for _, _, each in found] == list(range(topic.count))


# --- files of other programs, and hostile ones ------------------------------------------------------------------


@pytest.mark.parametrize("options", [{}, {"index_types": IndexType.ALL & ~IndexType.MESSAGE}, {"use_statistics": False}])
@pytest.mark.parametrize("chunk_size", [10_000, 1 << 20])
def test_topics_that_another_program_has_merged_are_further_topics(tmp_path, options, chunk_size):
    ours = sensed(tmp_path / "ours.mcap")
    other = rewrite(ours, tmp_path / "other.mcap", chunk_size=chunk_size, **options)
    assert images(other) == images(ours)
    assert topics_of(other).items() >= topics_of(ours).items()
    assert messages_of(other) == messages_of(ours)


def with_chunk(path, content, topics=()):
    """A recording with one more chunk behind the others, of channel 99 unless there are other topics."""
    topics = topics or [records.Channel(99, "/sensors/bad/image", "json", {"sensor": "{"}, 0)]
    chunk = seal(content, message_start_time=HEADER.date * SECOND, message_end_time=HEADER.date * SECOND + 7 * SECOND)
    return Forge([*data_records(path), *topics, chunk]).write(path)


def test_a_message_that_claims_a_gigabyte_is_an_error(tmp_path):
    content = bytearray(message(99, 0, HEADER.date * SECOND, b"x"))
    content[1:9] = (1 << 30).to_bytes(8, "little")
    path = with_chunk(write(tmp_path / "run.mcap", HEADER, drive(2.0)), bytes(content))
    with open_recording(path) as recording, pytest.raises(FormatError, match="damaged chunk: a record of 1073741824 bytes"):
        list(recording.reader.messages("/sensors/bad/image"))


def test_thousands_of_channels_take_little_time_and_memory(tmp_path):
    count, spec = 5_000, json.dumps({"type": "sensor.camera.rgb"})
    topics = [records.Channel(100 + n, f"/sensors/{n}/image", "json", {"sensor": spec}, 0) for n in range(count)]
    content = b"".join(message(100 + n, 0, HEADER.date * SECOND + n, b"x") for n in range(count))
    path = with_chunk(write(tmp_path / "run.mcap", HEADER, drive(2.0)), content, topics)
    tracemalloc.start()
    try:
        with time_limit(), open_recording(path) as recording:
            assert len(recording.sensors) == count
            assert [message.data for message in recording.sensor_messages("77")] == [b"x"]
        assert tracemalloc.get_traced_memory()[1] < 50 << 20
    finally:
        tracemalloc.stop()
    with time_limit():
        convert(path, tmp_path / "copy.mcap")
    with open_recording(tmp_path / "copy.mcap") as recording:
        assert sum(sensor.count for sensor in recording.sensors) == count


def test_more_messages_than_the_file_can_mean_are_an_error(tmp_path, monkeypatch):
    monkeypatch.setattr("carla_recap.formats.mcap.topics.MESSAGES_LIMIT", 5_000)
    path = write(tmp_path / "run.mcap", HEADER, drive(2.0))
    with_chunk(path, message(99, 0, HEADER.date * SECOND, b"") * 6_000)
    with open_recording(path) as recording, pytest.raises(FormatError, match="more than 5000 messages"):
        list(recording.reader.messages("/sensors/bad/image"))


def test_channels_that_are_left_out_are_said(tmp_path):
    channels = [records.Channel(id, topic, form, {}, 0) for id, topic, form in ((97, "/a", "json"), (98, "/a", "cbor"))]
    content = b"".join(message(id, 0, HEADER.date * SECOND, b"%d" % id) for id in (97, 98, 99))
    path = with_chunk(
        write(tmp_path / "run.mcap", HEADER, drive(2.0)),
        content,
        [*channels, records.Channel(99, "/weather", "json", {}, 0)],
    )
    assert images(path) == list(map(image, drive(2.0)))
    with open_recording(path) as recording:
        with pytest.warns(RecapWarning, match="are left out: /a, /weather$"):
            assert [*recording.reader.further_topics()] == ["/a"]
        assert [message.data for message in recording.reader.further_messages()] == [b"97"]


def test_a_schema_that_is_damaged_hides_its_topic_alone(tmp_path):
    path = write(tmp_path / "run.mcap", HEADER, drive(2.0))
    schema = records.Schema(id=99, data=b"x" * 100, encoding="e", name="bad.Message")
    channels = [records.Channel(99, "/bad", "json", {}, 99), records.Channel(100, "/good", "json", {}, 0)]
    with_chunk(path, message(100, 0, HEADER.date * SECOND, b"x"), [schema, *channels])
    data = path.read_bytes()
    broken = packed(schema).replace((100).to_bytes(4, "little") + b"xxxx", (10_000).to_bytes(4, "little") + b"xxxx")
    path.write_bytes(without_crc(data.replace(packed(schema), broken)))
    with open_recording(path) as recording, pytest.warns(RecapWarning, match="schemas are left out: /bad$"):
        assert list(recording.reader.further_topics()) == ["/good"]


def without_crc(data):
    """A file whose summary has no checksum."""
    return data[: -len(MAGIC) - 4] + bytes(4) + data[-len(MAGIC) :]
