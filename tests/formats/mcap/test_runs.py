"""Runs of frames in the records of a chunk."""

from __future__ import annotations

import struct
from itertools import groupby

import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.formats.mcap.runs import message_runs
from tests.formats.mcap.forge import message

FRAME, DATA = 1, 2
Row = tuple[int, int, bytes]  # channel, sequence, data


def chunk(rows: list[Row], between: bytes = b"") -> bytes:
    return between.join(message(channel, sequence, sequence * 10, data) for channel, sequence, data in rows)


def frames(data: bytes) -> list[list[Row]]:
    """Return the messages of each frame, as the runs have them."""
    found: list[list[Row]] = []
    for run in message_runs(data, FRAME):
        assert run.times.tolist() == [(run.sequence + row) * 10 for row in range(run.number)]
        found += [
            [(slot[0], run.sequence + row, bytes(run.message(row, slot))) for slot in run.slots] for row in range(run.number)
        ]
        if run.number > 1:
            rest = run.part(1, run.number)
            assert (rest.sequence, rest.number) == (run.sequence + 1, run.number - 1)
            assert [bytes(rest.message(0, slot)) for slot in rest.slots] == [
                bytes(run.message(1, slot)) for slot in run.slots
            ]
    return found


def expected(rows: list[Row]) -> list[list[Row]]:
    return [list(group) for _, group in groupby(rows, key=lambda row: row[1])]


@given(
    st.lists(
        st.tuples(
            st.integers(1, 2),  # the step to the next sequence
            st.lists(st.tuples(st.sampled_from([FRAME, DATA, 3]), st.binary(max_size=2)), min_size=1, max_size=3),
            st.integers(1, 5),  # how often it is repeated
        ),
        max_size=5,
    )
)
def test_runs_have_the_frames_of_a_chunk(parts: list[tuple[int, list[tuple[int, bytes]], int]]) -> None:
    rows, sequence = [], 0
    for step, messages, times in parts:
        for _ in range(times):
            sequence += step
            rows += [(channel, sequence, data) for channel, data in messages]
    assert frames(chunk(rows)) == expected(rows)


def test_like_frames_are_one_run() -> None:
    rows = [(DATA, sequence, bytes([sequence]) * 9) for sequence in range(8)]
    assert [(run.sequence, run.number) for run in message_runs(chunk(rows), FRAME)] == [(0, 8)]


@pytest.mark.parametrize("cut", range(1, 39))
def test_a_cut_record_is_an_error(cut: int) -> None:
    data = chunk([(DATA, sequence, b"12345678") for sequence in range(3)])
    with pytest.raises(Exception, match="no whole record at byte"):
        frames(data[:-cut])


def test_a_message_shorter_than_its_fields_is_an_error() -> None:
    short = struct.pack("<BQHIQQ", 5, 21, DATA, 1, 0, 0)
    with pytest.raises(Exception, match="no whole record at byte 0"):
        frames(short + b"12345678")
