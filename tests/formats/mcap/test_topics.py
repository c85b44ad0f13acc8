"""Further topics of a recording, such as those of sensors: chunks of their own, which no query reads."""

from __future__ import annotations

import json
import math
import tracemalloc
from contextlib import closing, contextmanager
from itertools import pairwise

import pytest
from mcap import records
from mcap.reader import make_reader
from mcap.writer import IndexType

from carla_recap import FormatError, RecapError, RecapWarning, RecordError, convert, open_recording
from carla_recap.formats import open_reader
from carla_recap.formats.mcap.index import ChannelRecord, ChunkIndex, Summary
from carla_recap.formats.mcap.recovery import recover_summary
from carla_recap.formats.mcap.schema import LogClock
from carla_recap.formats.mcap.topics import FurtherTopics
from carla_recap.formats.mcap.writer import (
    FURTHER_CHUNK_SECONDS,
    FURTHER_CHUNK_SIZE,
    FURTHER_OPEN_LIMIT,
    MESSAGE_LIMIT,
    McapWriter,
)
from carla_recap.formats.sources import LocalSource
from carla_recap.model.frame import Header
from tests.formats.mcap.forge import MAGIC, Forge, data_records, message, messages_in, packed, read_records, rewrite, seal
from tests.samples import contents, drive, images, reading, write
from tests.sensed import HEADER, camera, noise, plain, sensed
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


def grouped(path, *chunks):
    """Return the groups of the topics of a file without content, whose chunks have messages of some channels."""
    summary, source = Summary(), LocalSource(path)
    summary.chunks = [ChunkIndex(0, 0, 0, 0, frozenset(channels)) for channels in chunks]
    for id in frozenset[int]().union(*chunks):
        summary.channels[id], summary.counts[id] = ChannelRecord(id, 0, f"/{id}", "json"), 1
    with closing(source):
        topics = FurtherTopics(source, summary, (), (), LogClock(HEADER), lambda _: iter(())).topics
    return {int(name[1:]): topic.group for name, topic in topics.items()}


def test_groups_are_of_topics_that_share_chunks(tmp_path):
    path = tmp_path / "empty"
    path.touch()
    assert grouped(path, (4, 5), (1, 9), (5, 9), (2, 3), (3, 2), (6,)) == {
        **dict.fromkeys((1, 4, 5, 9), "1"),
        2: "2",
        3: "2",
        6: "",
    }
    with time_limit():
        groups = grouped(path, *((id, id + 1) for id in range(0, 60_000, 2)))
    assert groups == {id: f"{id - id % 2}" for id in range(60_000)}


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


def test_a_live_file_has_all_but_the_last_seconds(tmp_path):
    writer = McapWriter(tmp_path / "run.mcap", HEADER, live=True)
    writer.add_topic(plain("/a"))
    writer.add_topic(plain("/b"))
    for frame in drive(23.0):
        writer.write(frame)
        writer.write_message("/a", frame.elapsed, b"1")
        if frame.elapsed < 2:
            writer.write_message("/b", frame.elapsed, b"1")
    last = frame.elapsed
    partial = writer.abandon()
    with closing(LocalSource(partial)) as source:
        summary, damage = recover_summary(source)
    assert (damage.chunks, damage.bytes, damage.finished) == (0, 0, False)
    ids = {channel.topic: id for id, channel in summary.channels.items()}
    ends = {name: max(chunk.end for chunk in summary.chunks if ids[name] in chunk.channels) for name in ("/a", "/b")}
    assert ends["/a"] / SECOND - HEADER.date >= last - 5
    assert summary.counts[ids["/b"]] == 40


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


def test_a_topic_without_messages_has_no_times(tmp_path):
    with told(tmp_path / "run.mcap", []) as reader:
        (found,) = reader.further_topics().values()
        assert (found.count, found.first, found.last) == (0, None, None)
        assert not list(reader.messages("/a"))


@pytest.mark.parametrize("live", [False, True])
def test_messages_are_those_that_were_written(tmp_path, live):
    with open_recording(sensed(tmp_path / "run.mcap", live=live)) as recording:
        found = list(recording.reader.messages("/sensors/front/image"))
        assert [data for _, data in found] == [noise(20_000, index) for index in range(0, 200, 2)]
        assert [time for time, _ in found] == pytest.approx([number / 10 for number in range(100)], abs=1e-6)
        part = list(recording.reader.messages("/sensors/imu/imu", 2.0, 3.0))
        assert [time for time, _ in part] == pytest.approx([2 + number / 20 for number in range(20)], abs=1e-6)
        every = list(recording.reader.further_messages())
        assert len(every) == 100 + 200 + 1
        assert all(a.elapsed <= b.elapsed for a, b in pairwise(every))
        assert sorted(every) == sorted(recording.reader.further_messages(in_order=False))


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


def test_the_latest_messages_are_those_of_a_moment(tmp_path):
    with open_recording(sensed(tmp_path / "run.mcap")) as recording:
        reader, names = recording.reader, ["/sensors/front/image", "/sensors/imu/imu", "/note"]
        latest = reader.latest_messages(names, 5.07)
        assert {name: (elapsed, data) for name, elapsed, data in latest} == {
            "/sensors/front/image": (5.0, noise(20_000, 100)),
            "/sensors/imu/imu": (pytest.approx(5.05), b"{}"),
            "/note": (1.0, b'"late"'),
        }
        assert all(a.elapsed <= b.elapsed for a, b in pairwise(latest))
        assert {message.topic for message in reader.latest_messages(names, 0.5)} == {*names} - {"/note"}
        assert reader.latest_messages(names, -1.0) == []
        assert [message.elapsed for message in reader.latest_messages(names[:1], 1e6)] == [pytest.approx(9.9)]
        with pytest.raises(RecapError, match="has no further topic '/none'"):
            reader.latest_messages(["/none"], 1.0)


@pytest.mark.parametrize(("elapsed", "expected"), [(-1.0, []), (math.nan, []), (0.15, [b"1"]), (1e12, [b"4"])])
def test_a_time_that_mcap_does_not_have_is_before_or_behind_all_messages(tmp_path, elapsed, expected):
    messages = [(number / 10, b"%d" % number) for number in range(5)]
    with told(tmp_path / "run.mcap", messages, header=Header("Town01", 0)) as reader:
        assert [message.data for message in reader.latest_messages(["/a"], elapsed)] == expected
        assert [message.data for message in reader.further_messages(["/a"], stop=elapsed)][-1:] == expected


def test_the_first_and_the_last_time_are_those_of_all_chunks_that_overlap(tmp_path):
    with McapWriter(tmp_path / "run.mcap", HEADER) as writer:
        writer.add_topic(plain("/a"), group="both")
        writer.add_topic(plain("/b"), group="both")
        for topic, time, size in [
            ("/b", 2.0, 1),
            ("/a", 1.0, 1),
            ("/a", 3.0, FURTHER_CHUNK_SIZE),
            ("/b", 1.5, 1),
            ("/b", 2.5, 1),
        ]:
            writer.write_message(topic, time, noise(size, 0))
    with open_recording(tmp_path / "run.mcap") as recording:
        topics = recording.reader.further_topics().values()
        assert [(topic.first, topic.last) for topic in topics] == [(1.0, 3.0), (1.5, 2.5)]


@pytest.mark.parametrize("unit", [1, 1 / 128], ids=["several chunks", "one chunk"])
def test_messages_that_came_late_are_put_in_order_and_the_latest_is_found(tmp_path, unit):
    times = [unit * time for time in (0.0, 40.0, 80.0, 10.0, 50.0, 20.0)]
    with told(tmp_path / "run.mcap", [(time, f"{time}".encode()) for time in times]) as reader:
        assert [time for time, _ in reader.messages("/a")] == sorted(times)
        topic = reader.further_topics()["/a"]
        assert (topic.first, topic.last) == (0.0, 80.0 * unit)
        for moment, time in [(5.0, 0.0), (15.0, 10.0), (45.0, 40.0), (79.0, 50.0), (81.0, 80.0)]:
            assert [message.elapsed for message in reader.latest_messages(["/a"], moment * unit)] == [time * unit]


def test_of_messages_at_one_time_the_last_is_the_latest(tmp_path):
    messages = [(10.0, noise(FURTHER_CHUNK_SIZE * 2 // 3, number)) for number in range(3)]
    with told(tmp_path / "run.mcap", messages) as reader:
        (latest,) = reader.latest_messages(["/a"], 20.0)
        *_, last = reader.further_messages(["/a"])
        assert latest == last


def test_an_unknown_topic_is_an_error_with_those_that_there_are(tmp_path, small):
    with open_recording(sensed(tmp_path / "run.mcap")) as recording:
        with pytest.raises(RecapError, match="has no further topic '/none'; it has /note, "):
            list(recording.reader.messages("/none"))
        with pytest.raises(RecapError, match="has no further topic '/frames'"):
            list(recording.reader.messages("/frames"))
    with open_recording(small) as recording:
        assert recording.reader.further_topics() == {}
        assert not list(recording.reader.further_messages())
        assert recording.reader.latest_messages([], 1.0) == []
        with pytest.raises(RecapError, match="only MCAP files have some"):
            list(recording.reader.messages("/none"))
        with pytest.raises(RecapError, match="only MCAP files have some"):
            recording.reader.latest_messages(["/none"], 1.0)


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


def further(path):
    """What a file has of further topics, and their messages."""
    with open_recording(path) as recording:
        topics = recording.reader.further_topics()
        described = {
            name: (topic.topic.message, topic.topic.schema(), topic.topic.metadata, topic.count, topic.first, topic.last)
            for name, topic in topics.items()
        }
        return described, {name: list(recording.reader.messages(name)) for name in topics}


@pytest.mark.parametrize("options", [{}, {"index_types": IndexType.ALL & ~IndexType.MESSAGE}, {"use_statistics": False}])
@pytest.mark.parametrize("chunk_size", [10_000, 1 << 20])
def test_topics_that_another_program_has_merged_are_further_topics(tmp_path, options, chunk_size):
    ours = sensed(tmp_path / "ours.mcap")
    other = rewrite(ours, tmp_path / "other.mcap", chunk_size=chunk_size, **options)
    assert images(other) == images(ours)
    described, messages = further(ours)
    assert further(other)[0].items() >= described.items()
    assert further(other)[1] == messages


def with_chunk(path, content, topics=(), **false):
    """A recording with one more chunk behind the others, of channel 99 unless there are other topics."""
    topics = topics or [records.Channel(99, "/sensors/bad/image", "json", {"sensor": "{"}, 0)]
    chunk = seal(content, message_start_time=HEADER.date * SECOND, message_end_time=HEADER.date * SECOND + 7 * SECOND)
    for name, value in false.items():
        setattr(chunk, name, value)
    return Forge([*data_records(path), *topics, chunk]).write(path)


def test_a_message_that_claims_a_gigabyte_is_an_error(tmp_path):
    content = bytearray(message(99, 0, HEADER.date * SECOND, b"x"))
    content[1:9] = (1 << 30).to_bytes(8, "little")
    path = with_chunk(write(tmp_path / "run.mcap", HEADER, drive(2.0)), bytes(content))
    with open_recording(path) as recording, pytest.raises(FormatError, match="damaged chunk: a record of 1073741824 bytes"):
        list(recording.reader.messages("/sensors/bad/image"))


def test_an_index_that_names_other_chunks_yields_what_these_have(tmp_path):
    path = sensed(tmp_path / "run.mcap", seconds=4.0)
    found = read_records(path)
    summary = found[next(n for n, record in enumerate(found) if isinstance(record, records.DataEnd)) + 1 :]
    ids = {record.topic: record.id for record in summary if isinstance(record, records.Channel)}
    chunks = [record for record in summary if isinstance(record, records.ChunkIndex)]
    image = ids["/sensors/front/image"]
    for chunk in chunks:
        if image not in chunk.message_index_offsets:
            chunk.message_index_offsets |= {image: 1 << 40}
        else:
            del chunk.message_index_offsets[image]
            chunk.message_index_offsets |= {ids["/frames"]: 5}
    data = path.read_bytes()
    start = summary[-1].summary_start
    kept = [record for record in summary if not isinstance(record, (records.Footer, records.SummaryOffset))]
    tail = packed(records.Footer(summary_start=start, summary_offset_start=0, summary_crc=0))
    path.write_bytes(data[:start] + packed(*kept) + tail + MAGIC)
    with open_recording(path) as recording:
        assert not list(recording.reader.messages("/sensors/front/image"))
        assert recording.sensors[0].count == 40  # as the file says


def with_cameras(path, count):
    """Write a recording with a message of each of many cameras."""
    spec = json.dumps({"type": "sensor.camera.rgb"})
    topics = [records.Channel(100 + n, f"/sensors/{n}/image", "json", {"sensor": spec}, 0) for n in range(count)]
    content = b"".join(message(100 + n, 0, HEADER.date * SECOND + n, b"x") for n in range(count))
    return with_chunk(write(path, HEADER, drive(2.0)), content, topics)


def test_ten_thousand_channels_take_little_time(tmp_path):
    path = with_cameras(tmp_path / "run.mcap", 10_000)
    with time_limit(), open_recording(path) as recording:
        assert len(recording.sensors) == 10_000
        assert [message.data for message in recording.sensor_messages("77")] == [b"x"]
    with time_limit():
        convert(path, tmp_path / "copy.mcap")
    with open_recording(tmp_path / "copy.mcap") as recording:
        assert sum(sensor.count for sensor in recording.sensors) == 10_000


def test_a_thousand_channels_take_little_memory(tmp_path):
    path = with_cameras(tmp_path / "run.mcap", 1_000)
    tracemalloc.start()
    try:
        with open_recording(path) as recording:
            assert len(recording.sensors) == 1_000
            assert [message.data for message in recording.sensor_messages("77")] == [b"x"]
        assert tracemalloc.get_traced_memory()[1] < 10 << 20
    finally:
        tracemalloc.stop()


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
