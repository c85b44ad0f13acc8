from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.model.batch import Batch, packed
from carla_recap.model.frame import Frame, Packet
from carla_recap.model.records import UE4
from carla_recap.model.segment import SegmentBuffer, last_of_each, segments


def frames(*listed: tuple[int, ...]) -> np.ndarray:
    records = np.zeros((len(listed), len(listed[0])), UE4.named("velocities").dtype)
    records["id"] = listed
    records["x"] = np.arange(records.size).reshape(records.shape)
    return records


def test_segments_are_cut_where_the_ids_change() -> None:
    records = frames((7, 8), (7, 8), (8, 7), (8, 7), (8, 7), (9, 7))
    found = list(segments(records))
    assert [(each.first, len(each), each.ids.tolist()) for each in found] == [(0, 2, [7, 8]), (2, 3, [8, 7]), (5, 1, [9, 7])]
    assert [each.frames for each in found] == [slice(0, 2), slice(2, 5), slice(5, 6)]
    assert np.concatenate([each.field("x") for each in found]).tolist() == records["x"].tolist()


def test_a_segment_of_some_actors() -> None:
    (segment,) = segments(frames((7, 8, 9), (7, 8, 9)))
    some = segment.only(segment.ids != 8)
    assert some.ids.tolist() == [7, 9]
    assert some.field("x").tolist() == [[0, 2], [3, 5]]
    assert some.only(np.array([1])).field("x").tolist() == [[2], [5]]


def test_no_frames_and_no_records() -> None:
    assert not list(segments(np.zeros((0, 3), UE4.named("velocities").dtype)))
    (segment,) = segments(np.zeros((4, 0), UE4.named("velocities").dtype))
    assert (len(segment), segment.ids.tolist()) == (4, [])


def test_the_last_record_of_an_actor_counts() -> None:
    assert last_of_each(np.array([3, 5, 8])).tolist() == [0, 1, 2]
    assert last_of_each(np.array([8, 3, 8, 3, 5])).tolist() == [3, 4, 2]


@given(
    parts=st.lists(st.tuples(st.lists(st.integers(5, 9), max_size=3), st.integers(1, 3)), max_size=6),
    dropped=st.lists(st.integers(0, 4), max_size=2),
    wanted=st.lists(st.integers(5, 9), min_size=1, unique=True).map(sorted),
    window=st.tuples(st.integers(0, 8), st.integers(0, 8)).map(sorted),
)
def test_a_buffer_is_as_a_list_of_frames(
    parts: list[tuple[list[int], int]], dropped: list[int], wanted: list[int], window: list[int]
) -> None:
    buffer, rows = SegmentBuffer(), list[dict[int, float]]()
    for ids, count in parts:
        part = frames(*[tuple(ids)] * count)
        buffer.add(segments(part), len(part))
        rows += [dict(frame[["id", "x"]].tolist()) for frame in part]  # the last one of two counts
    for count in dropped:
        buffer.drop(min(count, len(rows)))
        rows = rows[count:]
    first, stop = (min(frame, len(rows)) for frame in window)
    assert buffer.frames == len(rows)
    assert buffer.ids().tolist() == sorted(set().union(*rows))
    assert buffer.ids(first, stop).tolist() == sorted(set().union(*rows[first:stop]))
    (x, y), known = buffer.dense("xy", np.array(wanted), first, stop)
    assert known.tolist() == [[id in row for row in rows[first:stop]] for id in wanted]
    assert x[known].tolist() == [row[id] for id in wanted for row in rows[first:stop] if id in row]
    assert not y.any()


# --- batches ---------------------------------------------------------------------------------------------


def frame(*packets: list[tuple[float, ...]]) -> Frame:
    type = UE4.named("transforms")
    return Frame(3, 4, 1.5, 0.05, [Packet(type.id, type, records=type.records(rows)) for rows in packets])


def pose(id: int, x: float) -> tuple[float, ...]:
    return (id, x, 0.0, 0.0, 0.0, 0.0, 0.0)


def batch_of(parts: int) -> Batch:
    """Return three frames with packets of poses: of the actors 0, 1, …, one each, at 10 m times the frame."""
    type = UE4.named("transforms")
    columns = [packed(type, np.stack([type.records([pose(part, 10.0 * row)]) for row in range(3)])) for part in range(parts)]
    return Batch(0, np.arange(1, 4, dtype=np.uint64), np.arange(3.0), np.ones(3), columns)


@pytest.mark.parametrize("parts", [1, 2, 3])
def test_records_of_several_packets_follow_each_other(parts: int) -> None:
    for batch, rows in ((batch_of(parts), 3), (Batch.of(frame(*([pose(part, 0.0)] for part in range(parts)))), 1)):
        records = batch.records("transforms")
        assert records["id"].tolist() == [list(range(parts))] * rows
        assert records["x"].tolist() == [[10.0 * row] * parts for row in range(rows)]
        assert not records.flags.writeable


def test_records_of_a_type_without_packets_are_none() -> None:
    assert Batch.of(frame()).records("velocities").shape == (1, 0)
    assert Batch.of(frame()).records("transforms").dtype == UE4.named("transforms").dtype
