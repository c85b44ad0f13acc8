"""CARLA's log: dialects, what is cut, what is broken, and finding frames."""

from __future__ import annotations

import os
import struct
import tracemalloc
from contextlib import closing

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap import FormatError, NotARecording, RecapError, RecapWarning, convert, open_recording
from carla_recap.formats import create_writer, open_reader
from carla_recap.formats.carla_log import LogReader
from carla_recap.model.frame import Frame, Header
from tests import strategies
from tests.samples import (
    DATE,
    END,
    collision,
    drive,
    explore,
    image,
    images,
    listed,
    log_header,
    packet,
    reading,
    save,
    small_log,
    start,
    text,
    transform,
    warnings_ignored,
    write,
)
from tests.waiting import time_limit


def header_of(path):
    with reading(path) as reader:
        return reader.header


# --- the header ------------------------------------------------------------------------------------------


@given(strategies.headers())
def test_any_header_comes_back(tmp_path, header):
    path = write(tmp_path / "any.log", header, [])
    assert header_of(path) == header
    again = write(tmp_path / "again.log", header_of(path), [])
    assert again.read_bytes() == path.read_bytes()


@pytest.mark.parametrize("length", [18, 19, 25, 26, 27, 28, 33])
def test_a_file_that_ends_inside_the_header_is_an_error(tmp_path, length):
    path = save(tmp_path / "cut.log", log_header()[:length])
    with pytest.raises(FormatError, match=rf"cut\.log: byte {length}: the file ends inside the header"):
        open_reader(path)


@pytest.mark.parametrize("data", [b"\1", b"\1\0\x0e\0CARLA", b"PK\3\4" + bytes(100), b"\1\0\5\0CARLA_RECORDER"])
def test_what_is_no_log_is_no_recording(tmp_path, data):
    with pytest.raises(NotARecording, match=r"x\.log: is not a recording \(neither CARLA's log nor MCAP\)"):
        open_reader(save(tmp_path / "x.log", data))
    with pytest.raises(NotARecording, match="is not a CARLA log"):
        LogReader(tmp_path / "x.log")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("empty.log", r"empty\.log: is empty; a CARLA log or an MCAP recording was expected"),
        (".", "is a folder; a recording was expected"),
        ("missing.log", r"missing\.log: No such file or directory"),
    ],
)
def test_what_is_not_there_is_an_error_with_its_path(tmp_path, name, message):
    save(tmp_path / "empty.log", b"")
    with pytest.raises(RecapError, match=message) as caught:
        open_reader(tmp_path / name)
    assert str(tmp_path) in str(caught.value)


# --- dialects --------------------------------------------------------------------------------------------

DOORS = struct.pack("<IBB", 7, 2, 1)
WHEELS = struct.pack("<IIBff", 7, 1, 0, 1.5, 90)
BIKERS = struct.pack("<Iff", 7, 500, 0.5)


@pytest.mark.parametrize(
    ("packets", "shifted"),
    [
        ([(23, listed()), (6, listed()), (21, listed()), (22, listed())], False),
        ([(21, listed()), (6, listed()), (22, listed()), (23, listed())], True),
        ([(23, listed(DOORS))], False),
        ([(21, listed(DOORS))], True),
        ([(6, listed()), (21, listed(WHEELS))], False),
        ([(6, listed()), (22, listed(WHEELS))], True),
        ([(6, listed()), (22, listed(BIKERS))], False),
        ([(6, listed()), (23, listed(BIKERS))], True),
        ([(6, listed())], False),
        ([], False),
    ],
)
def test_shifted_ids_are_recognised_by_content_and_position(tmp_path, packets, shifted):
    body = start(1, 0.0) + b"".join(packet(*each) for each in packets) + END
    path = save(tmp_path / "ids.log", log_header() + body)
    assert header_of(path).shifted == shifted
    with reading(path) as reader:
        types = [p.type.name for frame in reader.frames() for p in frame.packets]
        found = {p.id: list(p.records) for frame in reader.frames() for p in frame.packets if len(p.records)}
    plain = {21: "wheels", 22: "bikers", 23: "doors"}
    moved = {21: "doors", 22: "wheels", 23: "bikers"}
    names = (moved if shifted else plain) | {6: "transforms", 1: "frame_end"}
    assert types == [names[id] for id, _ in [*packets, (1, b"")]]
    assert all(id in (21, 22, 23) for id in found)


WIDE = struct.pack("<I6d", 7, 1, 2, 3, 4, 5, 6)


def wide_spawn(attributes=0):
    place = struct.pack("<IB6dI", 7, 1, 100, 200, 50, 0, 0, 90, 7)
    return place + text("vehicle.a") + listed(*[b"\3" + text("role_name") + text("hero")] * attributes)


@pytest.mark.parametrize(
    ("packets", "wide"),
    [
        ([(6, listed(WIDE))], True),
        ([(6, listed(WIDE, WIDE))], True),
        ([(6, listed(transform(7)))], False),
        ([(6, listed(*[transform(7)] * 13))], False),
        ([(6, listed()), (12, listed(WIDE))], True),
        ([(13, listed(WIDE))], True),
        ([(17, listed(WIDE))], True),
        ([(2, listed(wide_spawn(1)))], True),
        ([(2, listed(wide_spawn())), (6, listed())], True),
        ([(6, listed())], False),
    ],
)
def test_double_precision_is_recognised_by_sizes(tmp_path, packets, wide):
    path = save(tmp_path / "wide.log", log_header() + start(1, 0.0) + b"".join(packet(*p) for p in packets))
    assert header_of(path).wide == wide


# --- cut and broken --------------------------------------------------------------------------------------


@pytest.mark.parametrize("zeros", [1, 4, 5, 100, 3 << 20])
def test_zeros_at_the_end_are_left_out(tmp_path, zeros):
    path = save(tmp_path / "zeros.log", small_log() + bytes(zeros))
    with pytest.warns(RecapWarning, match=f"the last {zeros} bytes are no complete packet"):
        assert len(images(path)) == 4


@pytest.mark.parametrize(("id", "name", "size", "found"), [(0, "Start", 24, 16), (0, "Start", 24, 25), (1, "End", 0, 1)])
def test_a_frame_of_the_wrong_size_is_an_error_with_its_offset(tmp_path, id, name, size, found):
    path = save(tmp_path / "broken.log", small_log() + packet(id, bytes(found)) + END)
    with pytest.raises(FormatError, match=f"expected a Frame{name} of {size} bytes, found {found}") as caught:
        images(path)
    assert caught.value.offset == len(small_log())
    assert str(caught.value).startswith(f"{path}: byte {len(small_log())}: ")


def test_a_spawn_that_ends_within_a_text_is_an_error_with_its_offset(tmp_path):
    before = log_header() + start(1, 0.0)
    torn = listed(struct.pack("<IB6fI", 7, 1, 0, 0, 0, 0, 0, 0, 1) + b"\xff\0vehicle")
    path = save(tmp_path / "torn.log", before + packet(2, torn) + END)
    with open_recording(path) as recording, pytest.raises(FormatError, match="spawned: type_id need") as caught:
        _ = recording.actors
    assert len(before) < caught.value.offset <= len(before) + 5 + 2 + 33 + 2 + 255


def test_an_impossible_count_is_an_error_and_takes_no_memory(tmp_path):
    wheels = listed(struct.pack("<II", 7, 0xFFFFFFFF))
    path = save(tmp_path / "many.log", log_header() + start(1, 0.0) + packet(6, listed()) + packet(21, wheels))
    with reading(path) as reader, time_limit():
        (frame,) = reader.frames()
        with pytest.raises(FormatError, match="wheels"):
            frame["wheels"]


@pytest.mark.parametrize("id", [id for id in range(2, 25) if id not in (14, 18, 20)])
def test_surplus_bytes_behind_no_records_do_not_matter(tmp_path, id):
    more = save(tmp_path / "more.log", log_header() + start(1, 0.0) + packet(id, listed() + b"abc") + END)
    with warnings_ignored(), open_recording(more) as recording:
        assert (list(recording.collisions()), list(recording.blocked()), recording.actors) == ([], [], {})
        assert all(len(p.records) == 0 for frame in recording for p in frame.packets)


@given(data=st.data())
def test_any_damage_ends_in_an_answer_or_in_an_error_of_ours(tmp_path, data):
    whole = small_log()
    damaged = strategies.damaged(whole, data.draw(strategies.mutations(len(whole))))
    path = save(tmp_path / "damaged.log", damaged)
    with warnings_ignored(), time_limit():
        answers = explore(path)
        assert not [answer for answer in answers if "Error: " in answer and "\n" in answer]
        try:
            convert(path, tmp_path / "there.mcap", force=True)
            convert(tmp_path / "there.mcap", tmp_path / "back.log", force=True)
        except RecapError as error:
            assert "\n" not in str(error)  # noqa: PT017
        else:
            assert (tmp_path / "back.log").read_bytes() == damaged


# --- frames ----------------------------------------------------------------------------------------------


def test_events_that_are_kept_do_not_keep_what_is_between_them(tmp_path):
    rest = [packet(200, bytes(1 << 20)), packet(5, listed(collision(1, 7, 8))), END]
    frames = b"".join(part for number in range(64) for part in (start(number, float(number)), *rest))
    tracemalloc.start()
    with open_recording(save(tmp_path / "big.log", log_header() + frames)) as recording:
        del frames
        events = list(recording.reader.frames(["collisions"], sparse=True))
        assert len(events) == 64
    assert tracemalloc.get_traced_memory()[0] < 16 << 20
    tracemalloc.stop()


@pytest.mark.parametrize("lenient", [False, True])
@pytest.mark.parametrize("window", [64, 1000, 2 << 20])
def test_frames_by_index_are_those_of_a_whole_read(tmp_path, monkeypatch, window, lenient):
    monkeypatch.setattr("carla_recap.formats.log_scan._WINDOW", window)
    data = log_header() + packet(6, listed(transform(1))) + busy_log(60, 40)[len(log_header()) :]
    with closing(LogReader(save(tmp_path / "busy.log", data), lenient=lenient)) as reader:
        assert reader.frames_by_index([0], ["transforms"]) is None
        frames = list(reader.frames(["transforms", "collisions"]))
        assert frames[0].preamble
        indexes = [0, 1, 2, 39, 40, 41, 7, len(frames) - 1]
        found = list(reader.frames_by_index(indexes, ["transforms", "collisions"]))
    assert [image(frame) for frame in found] == [image(frames[index]) for index in indexes]
    assert [frame.index for frame in found] == indexes


def test_the_frames_of_a_part_are_not_taken_for_all(tmp_path):
    with closing(LogReader(save(tmp_path / "busy.log", busy_log(60, 40)))) as reader:
        next(reader.frames(["transforms"]))
        assert reader.frames_by_index([0], ["transforms"]) is None


def busy_log(frames: int, alike: int) -> bytes:
    """Return a log with a collision in every seventh frame, and other counts after some frames that are alike."""
    data = log_header()
    for n in range(frames):
        struck = listed(collision(n, 7, 8)) if n % 7 == 3 else listed()
        actors = (transform(id, n) for id in range(n // alike % 5 + 1))
        data += start(n + 1, n / 10) + packet(4, listed()) + packet(5, struck) + packet(6, listed(*actors)) + END
    return data


def test_a_frame_of_many_packets_is_read_up_to_a_limit(tmp_path):
    """Such a frame is larger than what the scan takes for an ordinary one, but not than a window."""
    many = start(2, 0.1) + 200_000 * packet(200)
    path = save(tmp_path / "many.log", log_header() + start(1, 0.0) + END + many + start(3, 0.2) + END)
    with reading(path) as reader:
        assert [len(frame.packets) for frame in reader.frames()] == [1, 200_000, 1]
        assert [frame.id for frame in reader.frames(("frame_end",), sparse=True)] == [1, 3]
    path = save(tmp_path / "too-many.log", log_header() + start(1, 0.0) + END + many + packet(200) + start(3, 0.2))
    for types in (None, ("collisions",)):
        with reading(path) as reader, pytest.raises(FormatError, match="more than 200000 packets in a frame"):
            list(reader.frames(types, sparse=True))


def test_packets_of_one_size_with_other_numbers_of_records_are_apart(tmp_path):
    """A packet may have bytes behind its records: its size alone does not say how many there are."""
    two, one = listed(transform(7), transform(8)), listed(transform(7)) + bytes(28)
    frames = [start(n + 1, n / 10) + packet(6, (two, one)[n % 5 == 4]) for n in range(20)]
    path = save(tmp_path / "odd.log", log_header() + b"".join(frames))
    with reading(path) as reader, warnings_ignored():
        assert [len(frame["transforms"]) for frame in reader.frames()] == [2, 2, 2, 2, 1] * 4


def test_a_log_that_shrinks_while_it_is_read_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setattr("carla_recap.formats.log_scan._WINDOW", 1 << 12)
    path = write(tmp_path / "shrinking.log", Header("Town01", DATE), drive(60, 20, 20))
    with reading(path) as reader:
        frames = reader.frames()
        next(frames)
        os.truncate(path, 1 << 13)
        with pytest.raises(FormatError, match=r"shrinking\.log: byte \d+: the file has become shorter while it was read"):
            list(frames)


@pytest.mark.parametrize(("share", "change"), [(0, "become shorter"), (1, "changed")])
def test_a_log_that_changes_before_a_frame_is_read_again_is_an_error(tmp_path, share, change):
    path = write(tmp_path / "odd.log", Header("Town01", DATE), drive(60, 20, 20))
    with reading(path) as reader, warnings_ignored():
        assert reader.frame_at(30.0) is not None
        path.write_bytes(b"\xff" * share * path.stat().st_size)
        for ask in (lambda: reader.frame_at(30.0), lambda: list(reader.frames_by_index([40], ["transforms"]))):
            with pytest.raises(FormatError, match=rf"odd\.log: byte \d+: the file has {change} while it was read"):
                ask()


# --- writing ---------------------------------------------------------------------------------------------


def test_the_latest_suffix_says_the_format(tmp_path):
    with create_writer(tmp_path / "a.mcap.LOG", Header("Town01", DATE)) as writer:
        writer.write(Frame(0, 1, 0.0, -1.0, []))
    assert (tmp_path / "a.mcap.LOG").read_bytes() == log_header() + start(1, 0.0)
