from __future__ import annotations

import numpy as np

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


def test_segments_as_dense_arrays() -> None:
    buffer = SegmentBuffer()
    for part in (frames((7, 8), (7, 8)), frames((8, 9), (8, 9), (9, 9))):
        buffer.add(segments(part), len(part))
    assert buffer.frames == 5
    assert buffer.ids().tolist() == [7, 8, 9]
    assert buffer.ids(0, 2).tolist() == [7, 8]
    (x,), known = buffer.dense("x", np.array([7, 9]))
    assert known.tolist() == [[True, True, False, False, False], [False, False, True, True, True]]
    assert x[known].tolist() == [0, 2, 1, 3, 5]  # the last one of two
    (x,), known = buffer.dense("x", np.array([8]), 1, 4)
    assert (x.tolist(), known.all()) == ([[3, 0, 2]], True)


def test_frames_that_are_dropped() -> None:
    buffer = SegmentBuffer()
    for part in (frames((7, 8), (7, 8), (7, 8)), frames((8, 9), (8, 9))):
        buffer.add(segments(part), len(part))
    buffer.drop(2)
    assert (buffer.frames, buffer.ids().tolist()) == (3, [7, 8, 9])
    assert buffer.dense("x", np.array([7, 8]))[0].tolist() == [[[4, 0, 0], [5, 0, 2]]]
    buffer.drop(1)
    assert (buffer.frames, buffer.ids().tolist()) == (2, [8, 9])
    values, known = buffer.dense("xy", np.array([5]))
    assert (values.shape, known.any()) == ((2, 1, 2), False)


def test_frames_of_different_ids() -> None:
    buffer = SegmentBuffer()
    for part in (frames((7, 8)), frames((9, 8, 9)), frames((6, 7), (6, 7)), frames((9,))):
        buffer.add(segments(part), len(part))
    assert buffer.ids().tolist() == [6, 7, 8, 9]
    assert buffer.ids(2, 4).tolist() == [6, 7]
    (x,), known = buffer.dense("x", np.array([7, 9]))
    assert known.tolist() == [[True, False, True, True, False], [False, True, False, False, True]]
    assert x[known].tolist() == [0, 1, 3, 2, 0]
    (x,), known = buffer.dense("x", np.array([8]), 1)
    assert (x.tolist(), known.tolist()) == ([[1, 0, 0, 0]], [[True, False, False, False]])
