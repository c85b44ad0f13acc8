"""How recordings are stored in MCAP: chunks, times, channels, and what is left of a file that is given up."""

from __future__ import annotations

import math
import os
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap import records
from mcap.reader import make_reader

from carla_recap import RecapError, RecordError, clip, convert, open_recording, recover
from carla_recap.editing.author import packets_of
from carla_recap.formats import create_writer
from carla_recap.formats.mcap import writer
from carla_recap.formats.mcap.recovery import recover_summary
from carla_recap.formats.mcap.writer import CHUNK_SECONDS, CHUNK_SIZE, FRAME_SIZE
from carla_recap.formats.sources import LocalSource
from carla_recap.model.frame import Frame, Header, Packet
from carla_recap.model.records import UE4, Group
from tests.formats.mcap.forge import data_records, messages_in, read_records
from tests.samples import DATE, carla_log, drive, images, listed, names_in, save, small_log, write

SECOND = 1_000_000_000
HEADER = Header("Town01", 1_600_000_000)
LARGEST_MESSAGE = 20_000
DIGEST = {"/actors/stretches", "/vehicles/braking", "/collisions/contacts"}


@pytest.fixture(scope="module", params=["drive", "dense", "carla", "small"])
def recording(request, tmp_path_factory):
    """Recordings of many kinds: long, dense, real, and one with everything."""
    path = tmp_path_factory.mktemp("recordings") / f"{request.param}.mcap"
    if request.param in ("drive", "dense"):
        return write(path, HEADER, drive() if request.param == "drive" else drive(12, 20, 500))
    if request.param == "carla":
        convert(carla_log("carla-0.9.13-lane-center.log"), path)
    else:
        convert(save(path.with_suffix(".log"), small_log()), path)
    return path


def of_kind(found, kind):
    return [record for record in found if isinstance(record, kind)]


def chunks_of(path):
    return of_kind(data_records(path), records.Chunk)


def topics_of(path):
    return {channel.id: channel.topic for channel in of_kind(data_records(path), records.Channel)}


def times_in(path):
    """Sequence, log time and publish time of the messages of each frame, which are the same for all of them."""
    topics, messages = topics_of(path), [message for chunk in chunks_of(path) for message in messages_in(chunk)]
    every = {tuple(message[1:4]) for message in messages if topics[message[0]] not in DIGEST}
    assert len({sequence for sequence, *_ in every}) == len(every)
    return sorted(every)


# --- chunks ----------------------------------------------------------------------------------------------


def event_chunks(path):
    """Whether each chunk is one of events, which has no states."""
    events, topics = {type.topic for type in UE4 if type.group is Group.EVENTS} | DIGEST, topics_of(path)
    kinds = [{topics[channel] in events for channel, *_ in messages_in(chunk)} for chunk in chunks_of(path)]
    assert {len(kind) for kind in kinds} == {1}
    return [kind.pop() for kind in kinds]


def test_the_chunks_of_events_have_no_states_and_come_behind_all_others(recording):
    found = event_chunks(recording)
    assert found == sorted(found)
    assert any(found)


def test_the_chunks_of_events_of_a_live_file_come_in_order_of_time(tmp_path):
    with create_writer(tmp_path / "live.mcap", HEADER, live=True) as writer:
        for frame in drive(30):
            writer.write(frame)
        (partial,) = tmp_path.iterdir()
        source = LocalSource(partial)
        summary, _ = recover_summary(source)
        source.close()
    collisions = next(id for id, channel in summary.channels.items() if channel.topic == "/collisions")
    found = [collisions in chunk.channels for chunk in sorted(summary.chunks, key=lambda chunk: chunk.offset)]
    assert found.count(True) > 2
    assert found != sorted(found)


def test_too_many_events_come_in_order_of_time(tmp_path, monkeypatch):
    monkeypatch.setattr("carla_recap.formats.mcap.container._HELD_LIMIT", 500)
    frames = list(drive(30))
    path = write(tmp_path / "many.mcap", HEADER, frames)
    found = event_chunks(path)
    assert found != sorted(found)
    assert "events_at" not in metadata_of(path)["carla_recap.extent"]
    assert images(path) == images(write(tmp_path / "all.log", HEADER, frames))


def test_chunks_are_short_and_small(recording):
    for chunk in chunks_of(recording):
        assert chunk.message_end_time - chunk.message_start_time <= CHUNK_SECONDS * SECOND
        assert chunk.uncompressed_size <= CHUNK_SIZE + LARGEST_MESSAGE
        assert chunk.compression == "zstd"


def test_only_channels_that_are_used_are_declared(driven):
    assert sorted(topics_of(driven).values()) == ["/actors/transforms", "/collisions", "/collisions/contacts", "/frames"]


def test_a_frame_that_is_too_large_for_a_chunk_is_cut(tmp_path):
    packets = [Packet(150, None, os.urandom(1 << 20)) for _ in range(20)]
    frame = Frame(0, 1, 0.0, -1.0, packets)
    path = write(tmp_path / "large.mcap", HEADER, [frame])
    assert max(chunk.uncompressed_size for chunk in chunks_of(path)) < FRAME_SIZE + (2 << 20)
    assert len(images(path)[0][-1]) == 20


STEPS = st.lists(st.sampled_from((0.05, 0.05, 0.0, 2.0, -1.0)), min_size=20, max_size=40)


@given(st.lists(st.tuples(st.integers(1, 5), STEPS), min_size=1, max_size=3), st.sampled_from([3_000, 30_000]))
def test_batches_are_written_as_their_frames_are(tmp_path, parts, size):
    """The clock may stand still, or jump, and chunks end anywhere."""
    now, frames = 0.0, []
    for count, steps in parts:
        for number, step in enumerate(steps):
            now, ids = now + step, range(count)
            moved, lit, driven = ([(id, *[number % 2] * fields) for id in ids] for fields in (6, 3, 5))
            records = {"transforms": moved, "light_states": lit, "vehicle_controls": driven, "visual_time": number}
            packets = packets_of(UE4, records, additional_data=True)
            frames.append(Frame(len(frames), len(frames) + 1, now, 0.05, packets))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writer, "CHUNK_SIZE", size)
        patch.setattr(writer, "CHUNK_FRAMES", 17)
        one, all = (write(tmp_path / f"{name}", HEADER, frames) for name in ("one.mcap", "all.log"))
        convert(all, tmp_path / "all.mcap", force=True)
    assert (tmp_path / "all.mcap").read_bytes() == one.read_bytes()


# --- times -----------------------------------------------------------------------------------------------


def test_log_time_is_date_and_elapsed_and_sequence_is_the_index(recording):
    with open_recording(recording) as opened:
        base = opened.header.date * SECOND
        expected = [(f.index, *2 * (base + round(f.elapsed * SECOND),)) for f in opened]
    assert times_in(recording) == expected


@pytest.mark.parametrize(
    ("elapsed", "published"), [(3.0, 3.0), (7.0, 7.0), (-2.0, -2.0), (math.nan, None), (math.inf, None), (1e300, None)]
)
def test_log_times_grow_where_a_clock_does_not(tmp_path, elapsed, published):
    frames = [Frame(n, n, time, 0.0, []) for n, time in enumerate((0.0, 7.0, elapsed, elapsed, 1.0))]
    path = write(tmp_path / "jump.mcap", HEADER, frames)
    found = times_in(path)
    times = [log for _, log, _ in found]
    assert all(later > sooner for sooner, later in pairwise(times))
    assert found[2][2] == times[2] if published is None else (HEADER.date + published) * SECOND


# --- what the file says of itself ------------------------------------------------------------------------


def metadata_of(path):
    return {record.name: record.metadata for record in of_kind(data_records(path), records.Metadata)}


def test_metadata_tell_of_header_and_extent(small_mcap):
    metadata = metadata_of(small_mcap)
    header = {"map": "Town01", "date": str(DATE), "version": "1"}
    assert header.items() <= metadata["carla_recap.header"].items()
    extent = {"frames": "4", "last_frame": "4", "duration": "3.0", "hero_ids": "7", "additional_data": "1"}
    assert extent.items() <= metadata["carla_recap.extent"].items()


@pytest.mark.parametrize(("time", "steady"), [(9.0, "1"), (3.0, "0")])
def test_a_clock_that_jumps_is_known_as_such(tmp_path, time, steady):
    path = write(tmp_path / "run.mcap", HEADER, [Frame(n, n, time, 0.0, []) for n, time in enumerate((0.0, 7.0, time))])
    assert metadata_of(path)["carla_recap.extent"]["steady_clock"] == steady


def test_metadata_of_a_name_that_is_no_text_are_text(tmp_path):
    path = write(tmp_path / "odd.mcap", Header("Town\udcff", 5), [])
    assert metadata_of(path)["carla_recap.header"]["map"] == "Town\ufffd"


def test_statistics_and_footer_are_right(recording):
    found = read_records(recording)
    (statistics,) = of_kind(found, records.Statistics)
    messages = [message for chunk in chunks_of(recording) for message in messages_in(chunk)]
    assert statistics.message_count == len(messages) == sum(statistics.channel_message_counts.values())
    assert statistics.chunk_count == len(chunks_of(recording))
    assert statistics.message_start_time == min(message[2] for message in messages)
    assert statistics.message_end_time == max(message[2] for message in messages)
    assert statistics.metadata_count == 3
    assert (statistics.schema_count, statistics.channel_count) == (len(topics_of(recording)),) * 2
    assert found[0].library.startswith("carla-recap/")
    assert found[0].profile == ""
    (footer,) = of_kind(found, records.Footer)
    assert footer.summary_crc != 0
    assert of_kind(found, records.DataEnd)[0].data_section_crc != 0


# --- files that are given up, and files that cannot be ---------------------------------------------------


@pytest.mark.parametrize("suffix", [".mcap", ".log"])
@pytest.mark.parametrize(
    "header",
    [
        Header("Town01", 1 << 63),
        Header("Town01", 0, version=1 << 16),
        Header("Town01", 0, version=-1),
        Header("x" * 70_000, 0),
        Header("\ud800", 0),
    ],
    ids=lambda header: repr(header)[:40],
)
def test_a_header_that_no_log_can_have_is_refused(tmp_path, suffix, header):
    with pytest.raises(RecordError, match=r"cannot be written|at most 65535 bytes"):
        create_writer(tmp_path / f"never{suffix}", header)
    assert names_in(tmp_path) == []


def test_a_packet_that_contradicts_its_type_is_refused(tmp_path):
    frame = Frame(0, 1, 0.0, -1.0, [Packet(2, UE4[2], listed(b"short"))])
    with pytest.raises(RecapError, match="a packet: spawned"):
        write(tmp_path / "never.mcap", HEADER, [frame])
    assert names_in(tmp_path) == []


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
@pytest.mark.parametrize("before", [0.0, 100.0])
def test_a_live_file_can_be_recovered_while_it_is_written(tmp_path, suffix, before):
    with create_writer(tmp_path / f"live{suffix}", HEADER, live=True) as writer:
        for frame in (Frame(0, 0, before, 0.0, []), *drive(12)):
            writer.write(frame)
        (partial,) = tmp_path.iterdir()
        save(tmp_path / f"crashed{suffix}", partial.read_bytes())
    recovery = recover(tmp_path / f"crashed{suffix}", tmp_path / f"saved{suffix}")
    assert recovery.frames > 20 * (12 - 2 * CHUNK_SECONDS)
    assert images(tmp_path / f"saved{suffix}") == images(tmp_path / f"live{suffix}")[: recovery.frames]


@pytest.mark.parametrize("live", [False, True])
def test_parameters_are_metadata_and_are_kept_by_copies(tmp_path, live):
    header = Header("Town01", DATE, parameters={"seed": "7", "weather": "Großer Regen, 90 %"})
    with create_writer(tmp_path / "a.mcap", header, live=live) as writer:
        for frame in drive(1):
            writer.write(frame)
    with (tmp_path / "a.mcap").open("rb") as file:
        found = [record for record in make_reader(file).iter_metadata() if record.name == "carla_recap.parameters"]
    assert found[0].metadata.items() >= header.parameters.items()
    convert(tmp_path / "a.mcap", tmp_path / "b.mcap")
    clip(tmp_path / "a.mcap", tmp_path / "c.mcap", start=0.5)
    recover(tmp_path / "a.mcap", tmp_path / "d.mcap")
    for name in "abcd":
        with open_recording(tmp_path / f"{name}.mcap") as recording:
            assert recording.header.parameters == header.parameters


@pytest.mark.parametrize("parameters", [{"checksum": "1"}, {"text": "x" * 300_000}])
def test_parameters_that_cannot_be_recorded_are_an_error(tmp_path, parameters):
    with pytest.raises(RecordError, match="parameter"):
        create_writer(tmp_path / "a.mcap", Header("Town01", DATE, parameters=parameters))
    assert names_in(tmp_path) == []
