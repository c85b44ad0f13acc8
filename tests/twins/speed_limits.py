"""Speed limits by hand: of everything that says one before a place, what counts most."""

from __future__ import annotations

from typing import NamedTuple


class Said(NamedTuple):
    """A limit that a map says from a station on: in km/h, None for no limit."""

    station: float
    limit: float | None


def limit_at(station: float, *, is_left: bool, signs: list[Said], own: list[Said], road: list[Said]) -> float | None:
    """Return the limit of a lane at a station, in km/h: of the last sign passed, else of the lane, else of the road.

    Traffic on the left drives against the stations.
    """
    passed = [sign for sign in signs if (sign.station >= station if is_left else sign.station <= station)]
    if passed:
        return min(passed, key=lambda sign: abs(sign.station - station)).limit
    for records in (own, road):
        before = [each for each in records if each.station <= station]
        if before and max(before, key=lambda each: each.station).limit is not None:
            return max(before, key=lambda each: each.station).limit
    return None
