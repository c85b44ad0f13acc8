"""From one format to the other and back: not a byte may change."""

from __future__ import annotations

import math
import os
import resource
import warnings
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from carla_recap import RecapError, RecapWarning, Recording, clip, convert, open_recording, recover
from carla_recap.formats.mcap import codec, writer
from carla_recap.model.frame import Extent, Frame, Header, Packet
from carla_recap.model.records import UE4
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

CUT = {"cut_in_add_string": 48, "cut_in_position": 53}
NO_LOGS = ("magic_bad", "not_a_log", "zero_bytes")
LOGS = sorted({path.stem for path in CARLA_LOGS.glob("*.log")}.difference(NO_LOGS)) or ["all_packets"]


def there_and_back(log: Path) -> bytes:
    """A log's bytes after a detour by MCAP."""
    mcap, back = log.with_suffix(".mcap"), log.with_suffix(".back.log")
    convert(log, mcap, force=True)
    convert(mcap, back, force=True)
    return back.read_bytes()


def extent_of(frames: list[Frame]) -> Extent:
    last = frames[-1] if frames and not frames[-1].preamble else None
    return Extent(sum(not frame.preamble for frame in frames), last.id, last.elapsed) if last else Extent()


@pytest.mark.parametrize("name", LOGS)
def test_a_log_survives_a_round_trip_byte_by_byte(name, tmp_path):
    log = carla_log(f"{name}.log")
    mcap, back = tmp_path / "there.mcap", tmp_path / "back.log"
    with pytest.warns(RecapWarning, match=f"last {CUT[name]} bytes") if name in CUT else nullcontext():
        extent = convert(log, mcap)
    assert convert(mcap, back) == extent  # the warning was given once
    assert back.read_bytes() == log.read_bytes()


@given(strategies.recordings(alike=(1, 2, 20, 20)))
@example((Header("Town01", 0), []))
def test_any_recording_survives_a_round_trip_with_the_same_records(tmp_path, recording):
    """Batches of frames that are alike are written as they are one by one."""
    header, frames = recording
    log = write(tmp_path / "any.log", header, frames)
    with pytest.MonkeyPatch.context() as patch, warnings_ignored(), time_limit():
        patch.setattr(writer, "CHUNK_FRAMES", 17)
        patch.setattr(writer, "CHUNK_SIZE", 3_000)
        assert there_and_back(log) == log.read_bytes()
        assert log.with_suffix(".mcap").read_bytes() == write(tmp_path / "one.mcap", header, frames).read_bytes()
        assert all_records(log) == all_records(log.with_suffix(".mcap"))
        for path in (log, log.with_suffix(".mcap")):
            assert images(path) == [image(frame) for frame in frames]
            with reading(path) as reader:
                assert reader.header == header
                assert repr(reader.extent()) == repr(extent_of(frames))


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


@pytest.mark.parametrize("edit", [convert, recover, partial(clip, start=0.0)], ids=["convert", "recover", "clip"])
@pytest.mark.parametrize(
    ("name", "link", "reason"),
    [
        ("small.log", None, "is the source itself"),
        ("other.log", "symlink_to", "is the source itself"),
        ("other.log", "hardlink_to", "is the source itself"),
        ("recording.xyz", None, r"unknown format '\.xyz'; \.log or \.mcap was expected"),
        ("recording", None, "no suffix, which says the format"),
    ],
)
def test_an_impossible_destination_is_an_error(small, tmp_path, edit, name, link, reason):
    destination = tmp_path / name
    if link:
        getattr(destination, link)(small)
    with pytest.raises(RecapError, match=reason) as caught:
        edit(small, destination, force=True)
    assert str(destination) in str(caught.value)
    assert small.read_bytes() == small_log()
    assert names_in(tmp_path) == sorted({"small.log", *([name] if link else [])})


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
@pytest.mark.parametrize("size", [100, 3_000_000])
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


def found_at(recording: Recording, elapsed: float) -> object:
    try:
        return image(recording.frame_at(elapsed))
    except RecapError as error:
        return str(error).partition(": ")[2]


@pytest.mark.parametrize("jumps", [False, True], ids=["growing", "jumping"])
@given(data=st.data())
def test_both_formats_find_the_same_frames_by_time(tmp_path, jumps, data):
    times = data.draw(strategies.clocks(jumps=jumps))
    moments = st.one_of(st.floats(-30, 70), st.sampled_from([*times, 0.0, math.nan]))
    asks = data.draw(st.lists(moments, min_size=1, max_size=4))
    header, spawned = Header("Town01", 1_600_000_000), Packet(3, UE4[3], listed(bytes(4)))
    frames = [Frame(n, n + 1, time, -1.0, [spawned, Packet(1, UE4[1], b"")]) for n, time in enumerate(times)]
    paths = [write(tmp_path / f"clock{suffix}", header, frames) for suffix in (".log", ".mcap")]
    with open_recording(paths[0]) as log, open_recording(paths[1]) as mcap:
        for at in asks:
            assert found_at(log, at) == found_at(mcap, at)
            for stop in (at + 0.5, at + 7):
                assert [image(f) for f in log.frames(at, stop)] == [image(f) for f in mcap.frames(at, stop)]


def test_warnings_are_given_once(tmp_path):
    log = save(tmp_path / "cut.log", small_log()[:-2])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with reading(log) as reader:
            for _ in range(3):
                list(reader.frames())
    assert ["cut short" in str(warning.message) for warning in caught] == [True]
