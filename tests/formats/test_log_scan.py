"""The frames of a log are those that are found a packet at a time, whatever the sizes of windows, runs and reads."""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.errors import FormatError
from carla_recap.formats.carla_log import SHIFT, LogReader
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.records import UE4, RecordType
from tests import strategies
from tests.samples import double, image, listed, log_header, packet, save, start, transform, warnings_ignored
from tests.twins import log_frames as twin

NAMES = ("spawned", "collisions", "transforms", "velocities", "frame_end", "weather")


@st.composite
def logs(draw: st.DrawFn) -> bytes:
    """Logs with runs of frames that are alike, but for numbers in them, and with damage; all packets of one size, often."""
    data = log_header() + draw(st.sampled_from([b"", b"", packet(6, listed(transform(1))), packet(1)]))
    number = 0
    for _ in range(draw(st.integers(0, 6))):
        found = draw(st.lists(strategies.packets(UE4), max_size=4))
        packets = [(each.id, bytearray(each.payload)) for each in found]
        for _ in range(draw(st.sampled_from([1, 1, 2, 3, 15, 17, 40]))):
            number += draw(st.sampled_from([1, 1, 1, 7]))
            data += start(number, draw(st.sampled_from([number / 20, number / 20, 0.3, math.nan])))
            for _, payload in packets:
                if payload and draw(st.integers(0, 9)) == 0:
                    payload[draw(st.integers(0, len(payload) - 1))] = draw(st.integers(0, 255))
            data += b"".join(packet(id, bytes(payload)) for id, payload in packets)
    head, body = data[: len(log_header())], data[len(log_header()) :]
    if draw(st.booleans()):
        body = strategies.damaged(body, draw(strategies.mutations(len(body))))
    return head + body + draw(st.sampled_from([b"", b"", b"\0\0\0", bytes(70), b"\0\x18\0\0\0"]))


def types_of(reader: LogReader) -> list[RecordType | None]:
    """The types by id as in the file."""
    table = [*reader.header.table, *[None] * 256][:256]
    return [table[SHIFT.get(id, id) if reader.header.shifted else id] for id in range(256)]


def expected_images(
    reader: LogReader, frames: list[twin.FoundFrame], names: set[str] | None, *, sparse: bool
) -> list[tuple[Any, ...]]:
    """The frames of the twin as `image` has them, with their packets of some types, unless these are empty."""
    names_by_id = [type and type.name for type in types_of(reader)]
    found = []
    for index, frame in enumerate(frames):
        packets = [
            (SHIFT.get(id, id) if reader.header.shifted else id, payload)
            for id, payload in frame.packets
            if names is None or (names_by_id[id] in names and len(payload) != 2)
        ]
        if packets or not sparse:
            found.append((index, frame.id, double(frame.elapsed), double(frame.duration), frame.preamble, packets))
    return found


def frames_within(frames: list[twin.FoundFrame], start: float, stop: float) -> list[int]:
    """The positions of the frames from the first one at a time or later, until the first one at another or later."""
    found: list[int] = []
    is_late, has_begun = False, False
    for position, frame in enumerate(frames):
        is_early = start > -math.inf and not frame.elapsed >= start
        has_begun = has_begun or not is_early
        is_late = is_late or (has_begun and frame.elapsed >= stop and stop < math.inf)
        if has_begun and not is_late:
            found.append(position)
    return found


@pytest.mark.parametrize("broken", [b"\0" * 5 + b"\1" * 24, b"\0\3\0\0\0abc", b"\1\3\0\0\0abc"])
@pytest.mark.parametrize("before", [b"", start(1, 0.0)])
def test_a_frame_that_begins_where_a_broken_packet_ends_is_kept(tmp_path: Path, before: bytes, broken: bytes) -> None:
    path = save(tmp_path / "broken.log", log_header() + before + broken + start(2, 0.05) + start(3, 0.1))
    with closing(LogReader(path, lenient=True)) as reader:
        found = [(frame.id, len(frame.packets)) for frame in reader.frames() if not frame.preamble]
    assert found == [*([(1, 0)] if before else []), (2, 0), (3, 0)]
    assert reader.lost_bytes == len(broken)


def test_packets_that_claim_the_rest_of_a_file_do_not_cost_reading_it_each_time(tmp_path: Path) -> None:
    count = 2000
    sizes = [39 * (count - number - 1) for number in range(count)]  # of all packets that follow
    frames = [start(n, n / 20) + b"\6" + size.to_bytes(4, "little") + packet(1) for n, size in enumerate(sizes)]
    path = save(tmp_path / "claims.log", log_header() + b"".join(frames))
    with patch("carla_recap.formats.log_scan._WINDOW", 4096), closing(LogReader(path, lenient=True)) as reader:
        assert sum(1 for _ in reader.frames()) == count
        assert reader._source.bytes_read < 200 * path.stat().st_size


@given(
    data=logs(),
    window=st.sampled_from([29, 64, 100, 500, 4000, 2 << 20]),
    names=st.one_of(st.none(), st.sets(st.sampled_from(NAMES))),
    sparse=st.booleans(),
    times=st.tuples(*[st.one_of(st.just(math.inf), st.floats(-0.1, 3), st.integers(0, 60).map(lambda n: n / 20))] * 2),
)
def test_frames_are_those_found_a_packet_at_a_time(
    tmp_path: Path, data: bytes, window: int, names: set[str] | None, sparse: bool, times: tuple[float, float]
) -> None:
    path, head = save(tmp_path / "some.log", data), len(log_header())
    whole = twin.read(data, head)
    with patch("carla_recap.formats.log_scan._WINDOW", window), warnings_ignored():
        with closing(LogReader(path)) as reader:
            found: list[tuple[Any, ...]] = []
            broken = None
            try:
                found.extend(image(frame) for frame in reader.frames(names, sparse=sparse))
            except FormatError as error:
                broken = error.offset
            assert broken == whole.broken
            expected = expected_images(reader, whole.frames, names, sparse=sparse)
            assert found == expected
            if broken is None:
                last = next((frame for frame in whole.frames[::-1] if not frame.preamble), twin.FoundFrame())
                extent = reader.extent()
                number = sum(not frame.preamble for frame in whole.frames)
                assert (extent.frames, extent.last_id, double(extent.duration)) == (number, last.id, double(last.elapsed))
                assert b"".join(reader.tail()) == data[whole.end :]
                start, stop = (-math.inf if times[0] == math.inf else times[0]), times[1]
                part = [image(frame) for frame in reader.frames(names, sparse=sparse, start=start, stop=stop)]
                inside = frames_within(whole.frames, start - SAME_TIME, stop - SAME_TIME)
                assert part == [each for each in expected if each[0] in inside]
                later = [n for n, frame in enumerate(whole.frames) if frame.elapsed > stop + SAME_TIME]
                at = reader.frame_at(stop)
                every = [None, *expected_images(reader, whole.frames, None, sparse=False)]
                assert (at and image(at)) == every[later[0] if later else -1]
        with closing(LogReader(path, lenient=True)) as reader:
            frames = twin.read_leniently(data, head, types_of(reader))
            found = [image(frame) for frame in reader.frames(names)]
            assert found == expected_images(reader, frames, names, sparse=False)
