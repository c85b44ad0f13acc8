"""Stationary intervals: what `queries.test_blocked` does not cover."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carla_recap.model.frame import Frame, Header, Packet
from carla_recap.model.stationary import StationaryTracker, _squared_limit

TABLE = Header("Town01", 0).table


def frame(number: int, x: float) -> Frame:
    transforms = TABLE.named("transforms")
    records = np.array([(7, x, 0, 0, 0, 0, 0)], transforms.dtype)
    return Frame(number, number, float(number), 1.0, [Packet(transforms.id, transforms, records=records)])


def test_intervals_can_be_taken_as_they_end() -> None:
    tracker = StationaryTracker(TABLE, min_time=2)
    taken = []
    for number in range(1000):
        tracker.frame(frame(number, 100.0 * (number // 4)))
        taken.append(tracker.take())
    assert sum(map(len, taken)) > 200
    rows = [row for rows in taken for row in rows] + tracker.finish()
    assert [(row.start, row.duration, row.x) for row in rows] == (
        [(0.0, 4.0, 0.0)] + [(4.0 * stop + 1, 3.0, 100.0 * stop) for stop in range(1, 250)]
    )


def test_frames_that_are_held() -> None:
    """A profiler holds the frames of what runs, with all that their variables refer to."""
    held = []
    tracker = StationaryTracker(TABLE, min_time=2)
    sys.setprofile(lambda frame, *_: held.append(frame))
    try:
        for number in range(1000):
            tracker.frame(frame(number, 100.0 * (number // 4)))
    finally:
        sys.setprofile(None)
    assert len(tracker.finish()) == 250


@pytest.mark.parametrize(("real", "width"), [("f4", 32), ("f8", 64)])
@given(data=st.data())
def test_squares_compare_as_distances_do(real: str, width: Any, data: st.DataObject) -> None:
    distance = data.draw(st.floats(-1, allow_nan=False))
    with np.errstate(all="ignore"):
        limit = _squared_limit(distance, np.dtype(real))
    near = [limit, np.nextafter(limit, limit.dtype.type(0)), np.nextafter(limit, limit.dtype.type(np.inf))]
    for square in [*near, np.dtype(real).type(data.draw(st.floats(0, width=width)))]:
        assert (square < limit) == (float(np.sqrt(square)) < distance)
