"""Blocked actors: when, where and for how long actors do not move."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from carla_recap.model.stationary import MIN_DISTANCE, MIN_TIME, TYPES, BlockedRow, StationaryTracker, check_limits
from carla_recap.queries import Answer

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.formats.base import Reader

__all__ = ["Blocked", "BlockedRow", "blocked", "listed_intervals"]


class Blocked(Answer[BlockedRow]):
    """The intervals in which actors of a recording did not move, the longest first."""

    row_type = BlockedRow
    row_units: ClassVar = {"start": "s", "duration": "s", "x": "cm", "y": "cm", "z": "cm"}


def blocked(
    source: Reader, min_time: float = MIN_TIME, min_distance: float = MIN_DISTANCE, *, compat: bool = False
) -> Blocked:
    """Return the intervals in which actors did not move; see `Recording.blocked`. One of 0 s needs `compat`.

    An actor does not move while it stays within a distance of the position that it last moved to; at first, that of its
    first transform (with `compat`, the origin of the world). Every actor with recorded transforms counts: vehicles, walkers,
    props, the spectator; but no walker that was hit and lies on the ground (with `compat`, it does). On MCAP, the answer for
    the default distance is read from the events alone.
    """
    if not compat:
        check_limits(min_time, min_distance)
    rows = None if compat else listed_intervals(source, min_time, min_distance)
    if rows is None:
        tracker = StationaryTracker(source.header.table, min_time, min_distance, compat=compat)
        for batch in source.batches(TYPES):
            tracker.batch(batch)
        rows = tracker.finish()
    # CARLA leaves rows of one duration in the order in which they were found.
    rows = sorted(rows, key=lambda row: -row.duration) if compat else longest_first(rows)
    return Blocked(rows, source, compat=compat)


def longest_first(rows: Iterable[BlockedRow]) -> list[BlockedRow]:
    """Return rows sorted by duration, the longest first, then by start and id."""
    return sorted(rows, key=lambda row: (-row.duration, row.start, row.id))


def listed_intervals(source: Reader, min_time: float, min_distance: float) -> list[BlockedRow] | None:
    """Return the stationary intervals for some limits, see `blocked`, in no order; None if the file does not list them."""
    part = source.digest("stretches")
    if part is None or not min_time >= part.limits[0] or min_distance != part.limits[1]:
        return None
    rows = part.read()
    if rows is None:
        return None
    found = (BlockedRow(start, duration, id, type_id, *place) for id, type_id, start, duration, *place in rows)
    return [row for row in found if row.duration >= min_time]
