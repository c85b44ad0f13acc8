"""Stationary intervals: what `queries.test_blocked` does not cover."""

from __future__ import annotations

import sys

import numpy as np

from carla_recap.model.frame import Frame, Header, Packet
from carla_recap.model.stationary import StationaryTracker

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
        [(4.0 * stop + 1, 3.0, 100.0 * stop) for stop in range(250)]
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
