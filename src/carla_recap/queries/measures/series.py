"""The measures of some actors over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.motion import slope
from carla_recap.queries.measures.boxes import required_deceleration, time_headway
from carla_recap.queries.measures.definitions import MeasureSeries
from carla_recap.queries.measures.pairs import PairFrames, ahead, near_pairs
from carla_recap.queries.measures.paths_ahead import on_collision_course

if TYPE_CHECKING:
    from carla_recap.queries.measures.motion_table import MotionTable
    from carla_recap.util.arrays import Floats, Indices


RANGE: Final = 100.0
"""The distance of centres up to which others count for gaps and headways, in m."""
HORIZON: Final = 10.0
"""The longest time to collision that is computed, in s."""
SPEED_WINDOW: Final = 0.125
"""The time before and after a moment, of which the speeds count for its acceleration, in s."""
JERK_WINDOW: Final = 0.25
"""The time before and after a moment, of which the accelerations count for its jerk, in s."""

NO_OTHER: Final = -1
"""The row of no actor."""
MARGIN: Final = 2.0
"""The time around a frame that the measures of an actor alone depend on, in s."""


def series_of(
    table: MotionTable, subjects: Indices, other: int | None = None, *, shortest: Floats | None = None
) -> MeasureSeries:
    """Return the measures of some actors in the frames of a table, (subjects, frames); margins have no values.

    Args:
        table: The motion.
        subjects: The rows of the actors.
        other: The id of the only other actor that counts; None for all.
        shortest: For times to collision of actors that also meet on the paths that they take alone, see
            `on_collision_course`: the least times that are known, in s; longer ones are inf. None: all times count.
    """
    shape = len(subjects), len(table.time)
    position = np.full(len(table.ids), -1)
    position[subjects] = np.arange(len(subjects))
    gaps, times, headways = _Least(shape), _Least(shape), _Least(shape)
    for pairs in near_pairs(table, position >= 0, np.maximum(RANGE / 2, table.radius + table.fastest * HORIZON)):
        if other is not None:
            pairs = pairs.take((table.ids[pairs.one] == other) | (table.ids[pairs.other] == other))
        near = pairs.take(pairs.distance <= RANGE)
        for each in (near, near.turned()):
            each = each.take(position[each.one] >= 0)
            _add_gaps(gaps, position[each.one], each)
            following, distance = ahead(each)
            headways.add(position[following.one], following, distance)
        pairs, seconds = pairs.colliding(HORIZON)
        if shortest is not None:
            shortest = np.minimum(shortest, times.value.min(axis=1, initial=np.inf))
            limits = np.append(shortest, -np.inf)
            kept = np.flatnonzero(seconds < np.maximum(limits[position[pairs.one]], limits[position[pairs.other]]))
            kept = kept[on_collision_course(pairs.take(kept), seconds[kept])]
            pairs, seconds = pairs.take(kept), seconds[kept]
        for each in (pairs, pairs.turned()):
            known = position[each.one] >= 0
            times.add(position[each.one[known]], each.take(known), seconds[known])
    for one, second, frames in table.touching:
        for row, met in ((one, second), (second, one)):
            if position[row] >= 0 and other in (None, table.ids[met]):
                there = np.arange(frames.start, frames.stop)[~np.isnan(table.x[row, frames])]
                for least in (gaps, times):
                    least.value[position[row], there], least.other[position[row], there] = 0.0, met
    speed, yaw, frame = table.speed[subjects], table.yaw[subjects], np.arange(shape[1])
    leader, acceleration = headways.other, slope(table.time, speed, SPEED_WINDOW)
    along = np.cos(yaw) * table.vx[leader, frame] + np.sin(yaw) * table.vy[leader, frame]
    deceleration = required_deceleration(headways.value, speed, np.where(leader >= 0, along, 0.0))
    ids = np.append(table.ids, NO_OTHER)
    return MeasureSeries(
        time=np.broadcast_to(table.time, speed.shape),
        speed=speed,
        acceleration=acceleration,
        jerk=slope(table.time, acceleration, JERK_WINDOW),
        gap=gaps.value,
        nearest=ids[gaps.other],
        time_to_collision=times.value,
        threat=ids[times.other],
        distance_headway=headways.value,
        time_headway=time_headway(headways.value, speed),
        required_deceleration=np.where(leader >= 0, deceleration, 0.0),
        leader=ids[leader],
    )


class _Least:
    """The least value of each subject in each frame, and the other actor that it is in relation to."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.value = np.full(shape, np.inf)
        self.other = np.full(shape, NO_OTHER)

    def add(self, row: Indices, pairs: PairFrames, values: Floats) -> None:
        """Add values of pairs, whose first actors are the subjects in some rows."""
        kept = np.flatnonzero(values < np.inf)
        key = row[kept] * self.value.shape[1] + pairs.frame[kept]
        before = self.value.ravel()[key]
        np.minimum.at(self.value.ravel(), key, values[kept])
        is_least = (values[kept] == self.value.ravel()[key]) & (values[kept] < before)
        self.other.ravel()[key[is_least]] = pairs.other[kept[is_least]]


def _add_gaps(gaps: _Least, row: Indices, pairs: PairFrames) -> None:
    """Add the gaps of the pairs that may have the least one of a subject in a frame."""
    most = np.full(gaps.value.size, np.inf)
    key = row * gaps.value.shape[1] + pairs.frame
    np.minimum.at(most, key, pairs.distance - pairs.within())
    kept = pairs.distance - pairs.around() <= np.minimum(most, gaps.value.ravel())[key]
    pairs = pairs.take(kept)
    gaps.add(row[kept], pairs, pairs.gap())
