"""Edited recordings with further topics, such as those of sensors."""

from __future__ import annotations

import random
from contextlib import closing
from dataclasses import replace

import pytest

from carla_recap import RecapError, RecapWarning, clip, convert, open_recording, recover
from carla_recap.formats.base import LATCHED
from carla_recap.formats.mcap.reader import McapReader
from carla_recap.formats.mcap.recovery import recover_summary
from carla_recap.formats.mcap.writer import McapWriter
from carla_recap.formats.sources import LocalSource
from tests.formats.mcap.forge import chunk_places, rewrite
from tests.samples import drive, images, save, write
from tests.sensed import HEADER, camera, messages_of, noise, plain, sensed, topics_of
from tests.waiting import time_limit


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return sensed(tmp_path_factory.mktemp("sensed") / "run.mcap")


# --- convert ---------------------------------------------------------------------------------------------------


def test_a_log_is_written_without_them_and_says_so(run, tmp_path):
    words = r"run.mcap: 3 further topics \(/sensors/front/image, /sensors/imu/imu, /note\) left out, such as of sensors"
    with pytest.warns(RecapWarning, match=words) as told:
        convert(run, tmp_path / "run.log")
    assert len(told) == 1
    write(tmp_path / "plain.log", HEADER, drive(10.0))
    assert (tmp_path / "run.log").read_bytes() == (tmp_path / "plain.log").read_bytes()


@pytest.mark.parametrize("live", [False, True])
def test_a_copy_keeps_them(tmp_path, live):
    source = sensed(tmp_path / "run.mcap", live=live)
    convert(source, tmp_path / "copy.mcap")
    assert images(tmp_path / "copy.mcap") == images(source)
    assert topics_of(tmp_path / "copy.mcap") == topics_of(source)
    assert messages_of(tmp_path / "copy.mcap") == messages_of(source)


def test_a_copy_of_a_copy_is_the_same_file(run, tmp_path):
    convert(run, tmp_path / "copy.mcap")
    convert(tmp_path / "copy.mcap", tmp_path / "again.mcap")
    assert (tmp_path / "again.mcap").read_bytes() == (tmp_path / "copy.mcap").read_bytes()


def test_topics_of_a_group_share_chunks_in_a_copy_too(run, tmp_path):
    convert(run, tmp_path / "copy.mcap")
    copied, original = (len(chunk_places(path.read_bytes())) for path in (tmp_path / "copy.mcap", run))
    assert copied == original
    with open_recording(tmp_path / "copy.mcap") as recording:
        front, imu, note = recording.reader.further_topics().values()
        assert imu.group == note.group != front.group


# --- clip ------------------------------------------------------------------------------------------------------


def test_a_clip_has_those_of_its_time(run, tmp_path):
    clip(run, tmp_path / "clip.mcap", start=2.0, duration=3.0)
    with open_recording(tmp_path / "clip.mcap") as recording:
        frames = [frame.elapsed for frame in recording.frames()]
        found = list(recording.sensor_messages("front"))
        assert [message.elapsed for message in found] == pytest.approx(frames[::2], abs=1e-6)
        assert [message.data for message in found] == [noise(20_000, index) for index in range(40, 101, 2)]
        assert recording.reader.further_topics()["/sensors/imu/imu"].count == len(frames)
        assert list(recording.reader.messages("/note")) == [(0.0, b'"late"')]  # the only one, which was before


@pytest.mark.parametrize("start", [2.0, 2.5])
def test_a_clip_begins_with_the_latest_message_of_a_latched_topic(tmp_path, start):
    with McapWriter(tmp_path / "run.mcap", HEADER) as writer:
        for name, metadata in (("/lights", {LATCHED: "1"}), ("/log", {})):
            writer.add_topic(replace(plain(name), metadata=metadata))
        for frame in drive(6.0):
            writer.write(frame)
            if frame.elapsed in (0.0, 1.0, 2.0, 4.0):
                for name in ("/lights", "/log"):
                    writer.write_message(name, frame.elapsed, b"%d" % frame.elapsed)
    clip(tmp_path / "run.mcap", tmp_path / "clip.mcap", start=start, duration=3.0)
    with open_recording(tmp_path / "clip.mcap") as recording:
        assert list(recording.reader.messages("/lights")) == [(0.0, b"2"), (4.0 - start, b"4")]
        assert [data for _, data in recording.reader.messages("/log")] == [b"2", b"4"][int(start > 2.0) :]


def test_a_clip_as_a_log_is_without_them(run, tmp_path):
    with pytest.warns(RecapWarning, match="left out"):
        clip(run, tmp_path / "clip.log", start=2.0, duration=3.0)


# --- recover ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """What a writer left that was killed after 23 s, with an image in every frame."""
    writer = McapWriter(tmp_path_factory.mktemp("killed") / "run.mcap", HEADER, live=True)
    writer.add_topic(camera())
    writer.add_topic(plain("/note"))
    for frame in drive(23.0, size=4):
        writer.write(frame)
        writer.write_message("/sensors/front/image", frame.elapsed, noise(500, frame.index))
        if frame.elapsed < 2:
            writer.write_message("/note", frame.elapsed, b"early")
    return writer.abandon()


def test_all_but_the_last_seconds_come_back(killed, tmp_path):
    recovery = recover(killed, tmp_path / "saved.mcap")
    with open_recording(tmp_path / "saved.mcap") as recording:
        assert list(recording.reader.further_topics()) == ["/sensors/front/image", "/note"]
        found = list(recording.sensor_messages("front"))
        assert recording.sensors[0].spec["attributes"] == {"fov": 90.0}
        assert recording.reader.further_topics()["/sensors/front/image"].topic.schema() == b"image"
        assert recording.reader.further_topics()["/note"].count == 40
    assert recovery.duration >= 23 - 5 - 0.1
    assert found[-1].elapsed >= 23 - 5 - 0.1
    assert [message.data for message in found] == [noise(500, index) for index in range(len(found))]


def test_a_file_that_is_cut_anywhere_has_what_was_before(killed, tmp_path):
    data, choose = killed.read_bytes(), random.Random(7)
    places = sorted([*(choose.randrange(5000, len(data)) for _ in range(100)), len(data)])
    counts = []
    with time_limit():
        for number, place in enumerate(places):
            path = save(tmp_path / f"{number}.mcap", data[:place])
            source = LocalSource(path)
            summary, _ = recover_summary(source)
            with closing(McapReader(source, summary=summary)) as reader:
                if not reader.further_topics():
                    assert not counts or not max(counts)
                    continue
                found = [message.data for message in reader.further_messages() if message.topic != "/note"]
            assert found == [noise(500, index) for index in range(len(found))]
            counts.append(len(found))
            path.unlink()
    assert counts == sorted(counts)
    assert len(set(counts)) == 5
    assert max(counts) == 400


def test_what_is_declared_in_chunks_as_other_programs_do_is_recovered_without_a_summary(run, tmp_path):
    whole = rewrite(run, tmp_path / "whole.mcap", chunk_size=1 << 16)
    cut = save(tmp_path / "cut.mcap", whole.read_bytes()[:-40])
    assert recover(cut, tmp_path / "saved.mcap").frames == 200
    saved = tmp_path / "saved.mcap"
    assert (topics_of(saved), messages_of(saved), images(saved)) == (topics_of(run), messages_of(run), images(run))


def test_a_damaged_chunk_of_images_costs_only_its_images(tmp_path):
    source = sensed(tmp_path / "run.mcap", size=100_000)
    data = bytearray(source.read_bytes())
    data[data.index(noise(100_000, 10)[500:1000])] ^= 0xFF
    damaged = save(tmp_path / "damaged.mcap", bytes(data))
    assert images(damaged) == images(source)
    with pytest.raises(RecapError, match="damaged chunk"):
        messages_of(damaged)
    recovery = recover(damaged, tmp_path / "saved.mcap")
    assert recovery.frames == 200
    assert images(tmp_path / "saved.mcap") == images(source)
    saved = topics_of(tmp_path / "saved.mcap")
    assert 0 < saved["/sensors/front/image"][3] < 100
    assert saved["/sensors/imu/imu"][3] == 200
