"""From one format to the other and back: not a byte may change."""

from __future__ import annotations

import os
import resource
import warnings
from contextlib import contextmanager
from typing import TYPE_CHECKING

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from carla_recap import RecapError, RecapWarning, convert, open_recording
from carla_recap.formats.mcap import codec
from carla_recap.model.frame import Extent, Frame, Header, Packet
from carla_recap.model.records import UE4, UE5
from tests import strategies
from tests.samples import (
    CARLA_LOGS,
    END,
    all_records,
    carla_log,
    image,
    images,
    listed,
    log_header,
    names_in,
    packet,
    reading,
    save,
    small_log,
    start,
    warnings_ignored,
    write,
)
from tests.waiting import time_limit

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from carla_recap import Recording

READABLE = (
    "all_packets",
    "all_packets_dev2024",
    "blocked",
    "carla-0.9.10-lane-center",
    "carla-0.9.13-lane-center",
    "collisions",
    "cut_after_frame_start",
    "empty_frames",
    "events",
    "floats",
    "header_only",
    "no_frames",
    "physics_0910",
    "times",
    "town05-two-cars",
)
CUT = {"cut_in_add_string": 48, "cut_in_position": 53}
NOT_READABLE = ("magic_bad", "not_a_log", "zero_bytes")


def there_and_back(log: Path) -> bytes:
    """A log's bytes after a detour by MCAP."""
    mcap, back = log.with_suffix(".mcap"), log.with_suffix(".back.log")
    convert(log, mcap, force=True)
    convert(mcap, back, force=True)
    return back.read_bytes()


def extent_of(frames: list[Frame]) -> Extent:
    last = frames[-1] if frames and not frames[-1].preamble else None
    return Extent(sum(not frame.preamble for frame in frames), last.id, last.elapsed) if last else Extent()


def test_every_log_of_carla_is_covered():
    carla_log("all_packets.log")
    assert {path.stem for path in CARLA_LOGS.glob("*.log")} == {*READABLE, *CUT, *NOT_READABLE}


@pytest.mark.parametrize("name", READABLE)
def test_a_log_survives_a_round_trip_byte_by_byte(name, tmp_path):
    log = carla_log(f"{name}.log")
    mcap, back = tmp_path / "there.mcap", tmp_path / "back.log"
    extent = convert(log, mcap)
    assert convert(mcap, back) == extent
    assert back.read_bytes() == log.read_bytes()


@pytest.mark.parametrize(("name", "dropped"), CUT.items())
def test_a_cut_log_survives_a_round_trip_with_its_tail(name, dropped, tmp_path):
    log = carla_log(f"{name}.log")
    mcap, back = tmp_path / "there.mcap", tmp_path / "back.log"
    with pytest.warns(RecapWarning, match=f"cut short; the last {dropped} bytes"):
        convert(log, mcap)
    convert(mcap, back)  # the warning was given once
    assert back.read_bytes() == log.read_bytes()


@given(strategies.recordings())
@example((Header("Town01", 0), []))
def test_any_recording_survives_a_round_trip_with_the_same_records(tmp_path, recording):
    header, frames = recording
    log = write(tmp_path / "any.log", header, frames)
    with warnings_ignored(), time_limit():
        assert there_and_back(log) == log.read_bytes()
        assert all_records(log) == all_records(log.with_suffix(".mcap"))
        for path in (log, log.with_suffix(".mcap")):
            assert images(path) == [image(frame) for frame in frames]
            with reading(path) as reader:
                assert reader.header == header
                assert repr(reader.extent()) == repr(extent_of(frames))


@given(st.booleans(), st.data())
def test_any_frames_can_be_written_as_mcap_without_a_log(tmp_path, wide, data):
    table = UE5 if wide else UE4
    header = Header("Town01", 1_600_000_000, wide=wide, shifted=data.draw(st.booleans()))
    frames = data.draw(strategies.frame_lists(table, []))
    with warnings_ignored():
        mcap = write(tmp_path / "any.mcap", header, frames)
        assert images(mcap) == [image(frame) for frame in frames]
        with reading(mcap) as reader:
            assert reader.header == header


@given(data=st.binary(min_size=1, max_size=60), date=st.sampled_from([0, -5, 1_600_000_000]))
@example(data=b"\0\x18\0\0\0", date=0)
def test_any_tail_survives_a_round_trip(tmp_path, data, date):
    log = save(tmp_path / "cut.log", log_header(date=date) + data)
    with warnings_ignored():
        try:
            back = there_and_back(log)
        except RecapError:
            return
    assert back == log.read_bytes()


@pytest.mark.parametrize("frames", [b"", start(1, 0.0) + END], ids=["no frame", "a frame"])
def test_a_tail_of_megabytes_survives_a_round_trip(frames, tmp_path):
    torn = packet(6, bytes(3_000_000))[:-1]
    log = save(tmp_path / "cut.log", log_header() + frames + torn)
    with pytest.warns(RecapWarning, match="cut short"):
        assert there_and_back(log) == log.read_bytes()


def test_a_packet_larger_than_the_largest_chunk_survives_a_round_trip(tmp_path):
    log = save(tmp_path / "map.log", log_header() + start(1, 0.0) + packet(150, bytes(70 << 20)) + END)
    assert there_and_back(log) == log.read_bytes()


def test_packets_that_grow_beyond_the_parsing_limit_survive_a_round_trip(tmp_path, monkeypatch):
    limit = 4000
    monkeypatch.setattr("carla_recap.formats.mcap.codec.PIECE", 1000)
    for module in ("model.layout", "formats.mcap.codec", "formats.mcap.writer"):
        monkeypatch.setattr(f"carla_recap.{module}.OBJECTS_LIMIT", limit)
    wheel = bytes(4) + (1).to_bytes(4, "little") + bytes(9)
    packets = [packet(21, listed(*[wheel] * count)) for count in range(limit // 25, limit // 16)]
    log = save(tmp_path / "wheels.log", log_header() + start(1, 0.0) + b"".join(packets) + END)
    convert(log, tmp_path / "wheels.mcap")
    codec._templates.clear()  # as another process would find it
    convert(tmp_path / "wheels.mcap", tmp_path / "back.log")
    assert (tmp_path / "back.log").read_bytes() == log.read_bytes()


# --- destinations --------------------------------------------------------------------------------------


@pytest.mark.parametrize("link", [None, "symlink_to", "hardlink_to"])
def test_the_source_is_never_the_destination(small, tmp_path, link):
    other = small
    if link:
        other = tmp_path / "other.log"
        getattr(other, link)(small)
    with pytest.raises(RecapError, match="is the source itself"):
        convert(small, other, force=True)
    assert small.read_bytes() == small_log()


@pytest.mark.parametrize(
    ("destination", "reason"),
    [
        ("recording.xyz", r"unknown format '\.xyz'; \.log or \.mcap was expected"),
        ("recording", "no suffix, which says the format"),
    ],
)
def test_an_impossible_destination_is_an_error(small, tmp_path, destination, reason):
    with pytest.raises(RecapError, match=reason) as caught:
        convert(small, tmp_path / destination)
    assert str(tmp_path / destination) in str(caught.value)
    assert names_in(tmp_path) == ["small.log"]


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
@pytest.mark.parametrize("size", [100, 200_000, 3_000_000])
def test_a_full_disk_is_an_error_and_leaves_no_file(tmp_path, suffix, size):
    blobs = b"".join(start(n, n / 10) + packet(150, os.urandom(40_000)) + END for n in range(100))
    log = save(tmp_path / "large.log", log_header() + blobs)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        with pytest.raises(RecapError, match=r"copy\.\w+: cannot be written: File too large"):
            convert(log, tmp_path / f"copy{suffix}")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert names_in(tmp_path) == ["large.log"]


# --- clocks --------------------------------------------------------------------------------------------


def of_clock(times: list[float]) -> list[Frame]:
    table = UE4
    spawn = Packet(3, table[3], listed(bytes(4)))
    return [Frame(n, n + 1, time, -1.0, [spawn, Packet(1, table[1], b"")]) for n, time in enumerate(times)]


@contextmanager
def both(tmp_path: Path, times: list[float]) -> Iterator[tuple[Recording, Recording]]:
    """The same frames as a log and as MCAP."""
    header, frames = Header("Town01", 1_600_000_000), of_clock(times)
    log, mcap = (write(tmp_path / f"clock{suffix}", header, frames) for suffix in (".log", ".mcap"))
    with open_recording(log) as one, open_recording(mcap) as other:
        yield one, other


def found_at(recording: Recording, elapsed: float) -> object:
    try:
        return image(recording.frame_at(elapsed))
    except RecapError as error:
        return str(error).partition(": ")[2]


@pytest.mark.parametrize("jumps", [False, True], ids=["growing", "jumping"])
@given(data=st.data())
def test_both_formats_find_the_same_frames_by_time(tmp_path, jumps, data):
    times = data.draw(strategies.clocks(jumps=jumps))
    asks = data.draw(st.lists(st.one_of(st.floats(-30, 70), st.sampled_from([*times, 0.0])), min_size=1, max_size=4))
    with both(tmp_path, times) as (log, mcap):
        for at in asks:
            assert found_at(log, at) == found_at(mcap, at)
            for stop in (at + 0.5, at + 7):
                assert [image(f) for f in log.frames(at, stop)] == [image(f) for f in mcap.frames(at, stop)]


def test_a_time_before_a_chunk_belongs_to_the_chunk_before(tmp_path):
    with both(tmp_path, [0.0, 1.0, 5.0000011, 6.0]) as (_, mcap):
        assert mcap.frame_at(5.0).elapsed == 1.0
        assert mcap.frame_at(5.0000002).elapsed == 5.0000011  # within a microsecond


def test_of_frames_at_one_time_the_last_is_found(tmp_path):
    with both(tmp_path, [0.0, 0.0, 5.0, 5.0, 5.0]) as recordings:
        assert [recording.frame_at(5.5).index for recording in recordings] == [4, 4]
        assert [recording.frame_at(4.0).index for recording in recordings] == [1, 1]


def test_warnings_are_given_once(tmp_path):
    log = save(tmp_path / "cut.log", small_log()[:-2])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with reading(log) as reader:
            for _ in range(3):
                list(reader.frames())
    assert ["cut short" in str(warning.message) for warning in caught] == [True]
