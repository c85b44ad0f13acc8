"""Recordings of one's own."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap import Attribute, RecordError, Spawn, attributes, create_recording, open_recording
from carla_recap.model.records import ORDER, UE4

SUFFIXES = (".log", ".mcap")
both_formats = pytest.mark.parametrize("suffix", SUFFIXES)


@both_formats
def test_a_recording_contains_the_added_frames(tmp_path, suffix):
    path = tmp_path / f"own{suffix}"
    with create_recording(path, map_name="Town03", date=1_700_000_000.9) as recorder:
        hero = Spawn(7, 1, 0, 0, 0, 0, 0, 90, 0, "vehicle.a", [Attribute(3, "role_name", "hero")])
        recorder.add_frame(0.0, spawned=[hero], transforms={"id": [7], "x": 100.0}, platform_time=12.5)
        recorder.add_frame(0.05, transforms=[(7, 105, 0, 0, 0, 0, 90)])
        recorder.add_frame(0.15, collisions={"id": 1, "actor1": 7, "actor2": 9, "hero1": True})
        assert recorder.extent.frames == 3
    with open_recording(path) as recording:
        assert recording.info.map_name == "Town03"
        assert recording.header.date == 1_700_000_000
        first, second, third = recording
        assert first["spawned"] == [hero]
        assert first["platform_time"]["seconds"].tolist() == [12.5]
        assert second["transforms"].tolist() == [(7, 105.0, 0, 0, 0, 0, 90.0)]
        assert third["collisions"].tolist() == [(1, 7, 9, 1, 0)]
        assert [f.id for f in (first, second, third)] == [1, 2, 3]


@both_formats
@given(times=st.lists(st.floats(0, 1e6), min_size=1, max_size=8, unique=True).map(sorted))
def test_durations_end_at_the_next_frame(tmp_path, suffix, times):
    path = tmp_path / f"own{suffix}"
    with create_recording(path, map_name="T", date=0) as recorder:
        for elapsed in times:
            recorder.add_frame(elapsed)
    with open_recording(path) as recording:
        frames = list(recording)
    assert [frame.elapsed for frame in frames] == times
    steps = [later - sooner for sooner, later in pairwise(times)]
    assert [frame.duration for frame in frames] == [*steps, -1.0]


@both_formats
@pytest.mark.parametrize("additional", [False, True])
def test_packets_are_in_the_order_of_carla_including_empty_ones(tmp_path, suffix, additional):
    path = tmp_path / f"own{suffix}"
    with create_recording(path, map_name="T", date=0, additional_data=additional) as recorder:
        recorder.add_frame(0.0)
        recorder.add_frame(1.0, visual_time=1.0, weather={"fog_density": 5.0}, velocities={"id": 1})
    bare = [2, 3, 4, 5, 23, 6, 7, 8, 9, 10, 21, 22]
    with open_recording(path) as recording:
        empty, filled = ([packet.id for packet in frame.packets] for frame in recording)
    assert empty == [*bare, *([13, 19] if additional else []), 1]
    expected = {*empty, 20, 24, 12}
    assert filled == [*(id for id in ORDER if id in expected), 1]


@both_formats
def test_every_type_can_be_added(tmp_path, suffix):
    path = tmp_path / f"own{suffix}"
    clocks = {"platform_time": 1.5, "visual_time": 2.5, "frame_counter": 7}
    rows = {type.name: [(0,) * len(type.layout.fields)] for type in UE4 if type.fixed and type.id > 1}
    with create_recording(path, map_name="T", date=0) as recorder:
        recorder.add_frame(0.0, **rows | clocks)
    with open_recording(path) as recording:
        (frame,) = recording
        assert {name for name, _ in frame.items()} == set(rows)
        assert frame["frame_counter"]["count"].tolist() == [7]


@pytest.mark.parametrize(
    ("records", "reason"),
    [
        ({"wings": []}, "no record type 'wings'"),
        ({"frame": []}, "a frame's start and end are not given as records"),
        ({"transforms": {"wing": 1}}, "transforms: there is no field 'wing'"),
        ({"transforms": np.zeros(65_536, UE4[6].dtype)}, "65536 records, but a packet counts at most 65535"),
        ({"platform_time": [1, 2]}, "platform_time: expected one record, found 2"),
    ],
    ids=lambda value: str(value)[:40],
)
@both_formats
def test_invalid_records_are_refused_and_the_other_frames_kept(tmp_path, suffix, records, reason):
    path = tmp_path / f"own{suffix}"
    with create_recording(path, map_name="T", date=0) as recorder:
        recorder.add_frame(0.0)
        with pytest.raises(RecordError, match=reason):
            recorder.add_frame(0.5, **records)
        recorder.add_frame(1.0)
    with open_recording(path) as recording:
        assert [(f.id, f.elapsed, f.duration) for f in recording] == [(1, 0.0, 1.0), (2, 1.0, -1.0)]


@pytest.mark.parametrize("elapsed", [1.0, 0.5, -1.0, math.nan, math.inf, "0"])
def test_times_are_seconds_that_increase(tmp_path, elapsed):
    with create_recording(tmp_path / "own.log", map_name="T") as recorder:
        recorder.add_frame(1.0)
        told = "cannot follow one at 1 s" if elapsed in (1.0, 0.5) else "elapsed seconds of 0 or more"
        with pytest.raises(RecordError, match=told):
            recorder.add_frame(elapsed)


@both_formats
def test_a_closed_recording_refuses_frames(tmp_path, suffix):
    recorder = create_recording(tmp_path / f"own{suffix}", map_name="T")
    recorder.add_frame(0.0)
    recorder.close()
    recorder.close()
    with pytest.raises(RecordError, match="the recording is closed"):
        recorder.add_frame(1.0)


@both_formats
def test_a_recording_can_be_written_again_frame_by_frame(tmp_path, suffix):
    path = tmp_path / f"own{suffix}"
    spawn = Spawn(7, type_id="vehicle.a", attributes=attributes(role_name="hero", wheels=4, electric=True))
    with create_recording(path, map_name="T", date=0) as recorder:
        recorder.add_frame(0.0, spawned=[spawn], transforms=[{"id": 7, "x": 3}], platform_time=1.5, destroyed=[9])
        recorder.add_frame(0.5, transforms=[(7, 1, 2, 3, 4, 5, 6)])
    again = tmp_path / f"again{suffix}"
    with open_recording(path) as recording, create_recording(again, map_name="T", date=0) as recorder:
        for frame in recording:
            recorder.add_frame(frame.elapsed, **dict(frame.items()) | {"platform_time": frame["platform_time"]})
    assert again.read_bytes() == path.read_bytes()
