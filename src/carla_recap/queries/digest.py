"""What the digest of a recording lists, as the rows of queries that would else compute them from all frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

from carla_recap.model.braking import Braking
from carla_recap.model.contacts import Impact
from carla_recap.model.stationary import BlockedRow

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader


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


def listed_braking(source: Reader, deceleration: float) -> list[Braking] | None:
    """Return the hard braking from a deceleration in m/s² on, in no order; None if the file does not list it."""
    part = source.digest("braking")
    rows = part.read() if part is not None and part.limits == (deceleration,) else None
    return None if rows is None else [Braking(*row) for row in rows]


def listed_impacts(source: Reader) -> list[Impact] | None:
    """Return the impacts of all contacts; None if the file does not list them."""
    part = source.digest("contacts")
    rows = part.read() if part is not None else None
    if rows is None:
        return None
    return [Impact(row[0], row[1], row[2], (row[3:6], row[6:9]), (row[9:12], row[12:])) for row in rows]
