"""The motion of one actor by a loop over its frames: the rule of `carla_recap.model.motion`, written out."""

from __future__ import annotations

import math
from collections.abc import Sequence

Vector = tuple[float, ...]
FAULTY = 150.0  # m/s


def belongs(times: Sequence[float], places: Sequence[Vector], recorded: Sequence[Vector], first: int) -> bool:
    """Return whether motion follows from a place and the next one: later by 1 s at most, and not by a jump."""
    seconds = times[first + 1] - times[first]
    metres = math.sqrt(sum((b - a) ** 2 for a, b in zip(places[first], places[first + 1], strict=True)))
    speeds = [math.sqrt(sum(each**2 for each in recorded[row])) for row in (first, first + 1)]
    known = [speed for speed in speeds if speed < FAULTY]
    farthest = max(3 * max(known) * seconds, 5.0) if known else 100.0 * seconds
    return 0 < seconds <= 1.0 and metres <= farthest


def velocities(times: Sequence[float], places: Sequence[Vector], recorded: Sequence[Vector]) -> list[Vector]:
    """Return the velocity at each place: recorded, else between its neighbours; NaN without any."""
    found = []
    for row in range(len(times)):
        if math.sqrt(sum(each**2 for each in recorded[row])) < FAULTY:
            found.append(recorded[row])
            continue
        before = row - 1 if row and belongs(times, places, recorded, row - 1) else row
        after = row + 1 if row + 1 < len(times) and belongs(times, places, recorded, row) else row
        seconds = times[after] - times[before] if after > before else math.nan
        velocity = tuple((b - a) / seconds for a, b in zip(places[before], places[after], strict=True))
        is_known = math.sqrt(sum(each**2 for each in velocity)) < FAULTY
        found.append(velocity if is_known else (math.nan,) * len(velocity))
    return found
