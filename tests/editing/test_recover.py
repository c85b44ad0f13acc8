"""Recovery of recordings that are damaged or were never finished."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap import RecapError, RecapWarning, Recovery, convert, open_recording, recover
from carla_recap.formats import create_writer
from carla_recap.model.frame import Header
from carla_recap.queries.score.scoring import score
from carla_recap.rules.rule_sets import check, make_rules
from carla_recap.v1.frame_pb2 import Frame
from carla_recap.v1.raw_packet_pb2 import RawPacket
from tests import strategies
from tests.formats.mcap.forge import MAGIC, chunk_places, edited
from tests.samples import (
    END,
    SAMPLES,
    carla_log,
    drive,
    images,
    log_header,
    names_in,
    packet,
    save,
    small_log,
    start,
    warnings_ignored,
    write,
)
from tests.waiting import time_limit

# --- MCAP ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".mcap", ".log"])
def test_an_intact_file_is_saved_completely(driven, tmp_path, suffix):
    saved = tmp_path / f"saved{suffix}"
    assert recover(driven, saved) == Recovery(600, 0, 0, 29.95, True)
    assert images(saved) == images(driven)


@pytest.mark.parametrize("kept", [0.99, 0.5, 0.2])
def test_a_file_without_an_end_is_saved_up_to_the_cut(driven, tmp_path, kept):
    whole = images(driven)
    data = driven.read_bytes()
    save(driven, data[: int(len(data) * kept)])
    with warnings_ignored():
        recovery = recover(driven, tmp_path / "saved.mcap")
        saved = images(tmp_path / "saved.mcap")
    assert not recovery.finished
    assert recovery.frames == len(saved)
    assert 600 * (kept - 0.25) < len(saved) <= 600
    assert [frame[0] for frame in saved] == [frame[0] for frame in whole[: len(saved)]]


@pytest.mark.parametrize("has_some", [False, True])
def test_what_is_saved_without_all_events_says_so_and_no_rule_about_them_passes(tmp_path, has_some):
    data = (SAMPLES / "crash.mcap").read_bytes()
    save(tmp_path / "cut.mcap", data[: chunk_places(data)[-3][0] if has_some else int(len(data) * 0.9)])
    with warnings_ignored():
        recovery = recover(tmp_path / "cut.mcap", tmp_path / "saved.mcap")
    assert recovery.without_events
    assert "spawns, collisions and other events lost" in str(recovery)
    same = {"baseline": str(tmp_path / "saved.mcap")}
    rules = make_rules(collisions={"max": 9}, actors={"max": 999}, blocked={"max": 90}, same_as=same, frames={"min": 1})
    told = r"saved\.mcap: was recovered without all of its events: spawns, collisions and others may be missing"
    with pytest.warns(RecapWarning, match=told):
        convert(tmp_path / "saved.mcap", tmp_path / "again" / "saved.mcap")
    with pytest.warns(RecapWarning, match=told):
        recording = open_recording(tmp_path / "again" / "saved.mcap")
    expected = "expected a recording with all of its events, found one that was recovered without some of them"
    with recording:
        verdicts = check(recording, rules)
        assert bool(recording.actors) == has_some
        with pytest.raises(RecapError, match=expected):
            score(recording.reader, None)
    assert [verdict.status for verdict in verdicts] == [*["error"] * 4, "pass"]
    assert {verdict.message for verdict in verdicts[:4]} == {expected}


def test_a_lost_chunk_costs_only_its_frames(driven, tmp_path):
    whole = images(driven)
    data = bytearray(driven.read_bytes())
    at, size = sorted(chunk_places(data), key=lambda place: -place[1])[2]
    data[at + size - 5] ^= 0xFF
    save(driven, bytes(data))
    with pytest.raises(RecapError, match="damaged chunk"):
        images(driven)
    recovery = recover(driven, tmp_path / "saved.mcap")
    saved = images(tmp_path / "saved.mcap")
    assert recovery.finished
    assert recovery.lost_bytes == size
    assert 0 < recovery.lost_frames <= 101
    assert recovery.frames + recovery.lost_frames == 600
    ids = {frame[1]: frame[2:] for frame in whole}
    assert sum(ids[frame[1]] == frame[2:] for frame in saved) >= 499 - 101


def test_a_lost_chunk_of_events_is_reported(driven, tmp_path):
    data = bytearray(driven.read_bytes())
    at, size = min(chunk_places(data), key=lambda place: place[1])
    data[at + size - 1] ^= 0xFF
    save(driven, bytes(data))
    with pytest.warns(RecapWarning, match=r"drive\.mcap: messages of frame \d+, and maybe of others, are missing"):
        recovery = recover(driven, tmp_path / "saved.mcap")
    assert (recovery.frames, recovery.lost_frames, recovery.without_events) == (600, 0, True)


@pytest.mark.parametrize("other", [4, 200])
def test_a_channel_that_is_declared_under_another_number_is_known_by_the_summary(driven, tmp_path, other):
    whole = images(driven)
    data = bytearray(driven.read_bytes())
    data[data.index(b"/actors/transforms") - 8] = other
    save(driven, bytes(data))
    assert recover(driven, tmp_path / "saved.mcap").losses == []
    assert images(tmp_path / "saved.mcap") == whole


@pytest.mark.parametrize("data", [b"", b"\x89MCAP", MAGIC, bytes(1000), b"\1\0\x0e\0CARLA"])
def test_a_file_without_chunks_is_an_error(tmp_path, data):
    path = save(tmp_path / "nothing.mcap", data)
    with pytest.raises(RecapError, match=r"nothing\.mcap: nothing can be saved") as caught:
        recover(path, tmp_path / "saved.mcap")
    assert "\n" not in str(caught.value)
    assert names_in(tmp_path) == ["nothing.mcap"]


@pytest.mark.parametrize("suffix", [".mcap", ".log"])
@pytest.mark.parametrize(("topic", "frames", "lost"), [("/actors/transforms", 600, "packets"), ("/frames", 599, "frames")])
def test_a_broken_message_costs_only_its_packet_or_its_frame(driven, tmp_path, suffix, topic, frames, lost):
    whole = images(driven)
    edited(driven, lambda where, number, data: data[:-20] + b"\xff" * 20 if (where, number) == (topic, 10) else data)
    with pytest.raises(RecapError):
        images(driven)
    recovery = recover(driven, tmp_path / f"saved{suffix}")
    assert (recovery.frames, recovery.lost_frames, recovery.lost_packets) == (frames, 600 - frames, frames - 599)
    assert f"1 {lost} lost" in str(recovery)
    saved = images(tmp_path / f"saved{suffix}")
    assert [frame[1:] for frame in saved if frame[1] != 11] == [frame[1:] for frame in whole if frame[1] != 11]
    assert [len(frame[-1]) for frame in saved if frame[1] == 11] == [len(whole[10][-1]) - 1] * (frames - 599)


@pytest.mark.parametrize("id", [0, 256])
def test_impossible_raw_packets_are_left_out(tmp_path, id):
    """A packet of id 0 would begin a frame."""

    def change(topic, sequence, data):
        raw = RawPacket.FromString(data if topic == "/carla/raw" else b"")
        raw.id = id
        return raw.SerializeToString() if (topic, sequence) == ("/carla/raw", 2) else data

    frames = [start(n, n / 10) + packet(150, bytes((n,)) * 50) + END for n in range(1, 6)]
    log, path = save(tmp_path / "raw.log", log_header() + b"".join(frames)), tmp_path / "raw.mcap"
    convert(log, path)
    edited(path, change)
    with pytest.raises(RecapError, match=f"raw packet of an id from 1 to 255, found {id}"):
        convert(path, tmp_path / "out.log")
    recovery = recover(path, tmp_path / "saved.log")
    assert (recovery.frames, recovery.lost_frames) == (4, 1)
    assert [frame[1] for frame in images(tmp_path / "saved.log")] == [1, 2, 4, 5]


def test_packets_that_contradict_their_type_are_not_written_to_a_log(driven, tmp_path):
    """A clock without a number is no packet that a log can be read with."""

    def change(topic, sequence, data):
        if topic != "/frames" or sequence != 3:
            return data
        frame = Frame.FromString(data)
        frame.packets, frame.filled = frame.packets + bytes((14,)), frame.filled + bytes((0,))
        return frame.SerializeToString()

    whole = images(driven)
    edited(driven, change)
    recovery = recover(driven, tmp_path / "saved.log")
    assert recovery.lost_packets == 1
    assert images(tmp_path / "saved.log") == whole


# --- logs ------------------------------------------------------------------------------------------------


def test_an_intact_log_is_saved_completely(small, tmp_path):
    assert recover(small, tmp_path / "saved.log") == Recovery(4, 0, 0, 3.0, True)
    assert (tmp_path / "saved.log").read_bytes() == small_log()


@pytest.mark.parametrize(("name", "dropped"), [("cut_in_position", 53), ("cut_in_add_string", 48)])
def test_a_cut_log_is_saved_up_to_the_cut(tmp_path, name, dropped):
    with pytest.warns(RecapWarning, match="cut short"):
        recovery = recover(carla_log(f"{name}.log"), tmp_path / "saved.log")
    assert (recovery.frames, recovery.lost_bytes, recovery.finished) == (2, dropped, False)
    assert len(images(tmp_path / "saved.log")) == 2


def test_a_torn_frame_of_a_log_is_left_out(tmp_path):
    frames = [start(n, n / 10) + packet(150, bytes((n,)) * 50) + END for n in range(1, 6)]
    torn = frames[2][:-30]
    path = save(tmp_path / "torn.log", log_header() + b"".join([*frames[:2], torn, *frames[3:]]))
    with warnings_ignored():
        assert len(images(path)) == 3
        recovery = recover(path, tmp_path / "saved.log")
    saved = images(tmp_path / "saved.log")
    assert {1, 2, 5} <= {frame[1] for frame in saved}
    assert recovery.frames == len(saved)


def test_a_packet_that_contradicts_its_type_is_left_out(tmp_path):
    data = log_header() + start(1, 0.0) + packet(6, b"\x09\0abc") + packet(150, b"kept") + END
    recovery = recover(save(tmp_path / "bad.log", data), tmp_path / "saved.log")
    assert (recovery.frames, recovery.lost_bytes) == (1, 5)
    assert (tmp_path / "saved.log").read_bytes() == log_header() + start(1, 0.0) + packet(150, b"kept") + END


def test_thousands_of_unknown_packets_take_little_time(tmp_path):
    """After each, the next frame is searched, in vain."""
    data = log_header() + start(1, 0.0) + END + start(2, 0.1) + packet(150, b"") * 50_000 + bytes(1_000_000)
    with time_limit(), warnings_ignored():
        recovery = recover(save(tmp_path / "many.log", data), tmp_path / "saved.log")
    assert recovery.frames == 2


def test_a_frame_of_too_many_packets_is_cut(tmp_path, monkeypatch):
    for module in ("editing.recover", "formats.log_scan"):
        monkeypatch.setattr(f"carla_recap.{module}.PACKETS_LIMIT", 2_000)
    data = log_header() + start(1, 0.0) + packet(150, b"") * 2_010 + END + start(2, 0.1) + END
    with time_limit(), warnings_ignored():
        recovery = recover(save(tmp_path / "many.log", data), tmp_path / "saved.log")
    assert recovery.frames == len(images(tmp_path / "saved.log")) == 2


# --- both ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [".log", ".mcap"])
@given(data=st.data())
def test_any_damage_ends_in_a_recording_or_a_recap_error(tmp_path, kind, data):
    original = tmp_path / f"whole{kind}"
    if not original.exists():
        write(original, Header("T", 5), drive(8, 5, 2))
    whole = original.read_bytes()
    damaged = strategies.damaged(whole, data.draw(strategies.mutations(len(whole))))
    path, saved = save(tmp_path / f"damaged{kind}", damaged), tmp_path / "saved.mcap"
    saved.unlink(missing_ok=True)
    with warnings_ignored(), time_limit():
        try:
            recovery = recover(path, saved)
        except RecapError as error:
            assert "\n" not in str(error)  # noqa: PT017
            assert not saved.exists()
        else:
            found = images(saved)
            assert len(found) == recovery.frames
            with open_recording(saved) as recording:
                assert recording.info.frames == sum(not frame[4] for frame in found)
            convert(saved, tmp_path / "saved.log", force=True)
    assert {name for name in names_in(tmp_path) if name.endswith(".partial")} == set()


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
@pytest.mark.parametrize("is_there", [False, True], ids=["missing", "without frames"])
def test_of_an_unfinished_recording_the_partial_file_is_recovered(driven, tmp_path, suffix, is_there):
    path, partial = tmp_path / f"k{suffix}", tmp_path / f".k{suffix}.0123abcd.partial"
    convert(driven, tmp_path / f"whole{suffix}")
    data = (tmp_path / f"whole{suffix}").read_bytes()
    partial.write_bytes(data[: len(data) // 2])
    if is_there:
        create_writer(path, Header("Town01", 0)).close()
    told = f"{path}: was never finished; what was written of it until then is in {partial}, which is recovered"
    with pytest.warns(RecapWarning) as warned:
        assert recover(path, tmp_path / "saved.log").frames > 100
    assert told in {str(warning.message) for warning in warned}
    assert partial.exists()


def test_which_of_several_partial_files_is_recovered_is_for_the_caller_to_say(tmp_path):
    partials = [tmp_path / f".k.mcap.{number}.partial" for number in (1, 2)]
    for partial in partials:
        partial.touch()
    told = f"k.mcap: was never finished; what was written of it until then is in {partials[0]} and {partials[1]}"
    with pytest.raises(RecapError, match=re.escape(told)):
        recover(tmp_path / "k.mcap", tmp_path / "b.mcap")


def test_a_repeated_chunk_is_saved_once(driven, tmp_path):
    data = driven.read_bytes()
    twice, at = bytearray(data[:8]), 8
    while data[at] != 0x0F:  # up to the end of the data section
        record = data[at : at + 9 + int.from_bytes(data[at + 1 : at + 9], "little")]
        twice += record * (2 if record[0] == 6 else 1)
        at += len(record)
    saved = recover(save(tmp_path / "twice.mcap", bytes(twice)), tmp_path / "saved.log")
    assert (saved.frames, saved.lost_frames) == (600, 0)
    assert images(tmp_path / "saved.log") == images(driven)
