"""Who stood still, since when, and for how long."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from carla_recap.model.stationary import MIN_DISTANCE, MIN_TIME, TYPES, BlockedRow, StationaryTracker
from carla_recap.queries.answer import Answer

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader

__all__ = ["Blocked", "BlockedRow", "blocked"]


class Blocked(Answer[BlockedRow]):
    """The stretches in which actors of a recording stood still, the longest first."""

    row_type = BlockedRow
    row_units: ClassVar = {"start": "s", "duration": "s", "x": "cm", "y": "cm", "z": "cm"}


def blocked(
    source: Reader, min_time: float = MIN_TIME, min_distance: float = MIN_DISTANCE, *, compat: bool = False
) -> Blocked:
    """The actors that stood still.

    An actor stands still while it stays within a distance of the place where it last moved to. Everything that has a
    recorded transform counts: vehicles, walkers, props, the spectator; but no walker that was hit and lies on the ground
    (with `compat`, it does). On MCAP, the answer for the usual distance is read from the events alone.

    Args:
        source: The recording.
        min_time: The shortest stretch to tell of, in seconds.
        min_distance: The distance at which an actor has moved, in cm.
        compat: Answer as CARLA 0.9.16 does, with its slips.

    Raises:
        FormatError: The file contradicts its format.
    """
    rows = None if compat else source.stretches(min_time, min_distance)
    if rows is None:
        tracker = StationaryTracker(source.header.table, min_time, min_distance, compat=compat)
        for batch in source.batches(TYPES):
            tracker.batch(batch)
        rows = tracker.finish()
    if compat:
        rows.sort(key=lambda row: -row.duration)
    else:
        rows.sort(key=lambda row: (-row.duration, row.start, row.id))
    return Blocked(rows, source, compat=compat)
