"""The speed limits of lanes, for queries and the simulator: those of signs, of the lanes themselves, and of their roads."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from carla_recap.roads.opendrive import SPEED_LIMIT, defined_signals, in_metres_per_second
from carla_recap.roads.stop_lines import applies_to

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from carla_recap.roads.opendrive import Road, RoadLane, RoadSection
    from carla_recap.util.arrays import Floats


class LimitSign(NamedTuple):
    """A place at which a speed-limit sign applies: the station, the limit in m/s, and the ranges of lanes."""

    station: float
    limit: float
    lanes: tuple[tuple[int, int], ...]


def sign_limit(value: float | None) -> float | None:
    """Return the limit on a sign in m/s, or None: as in CARLA, the value is in km/h, whatever its unit says."""
    return in_metres_per_second(value, "km/h")


def limit_signs(roads: Iterable[Road]) -> list[list[LimitSign]]:
    """Return the speed-limit signs along each road: signals, references to those of other roads, and objects."""
    found = list(roads)
    values = {id: signal.value for id, (_, signal) in defined_signals(found).items() if signal.kind == SPEED_LIMIT}
    return [list(_signs(road, values)) for road in found]


def _signs(road: Road, values: dict[str, float]) -> Iterator[LimitSign]:
    for place in road.signals:
        if (limit := sign_limit(values.get(place.id))) is not None:
            yield LimitSign(place.station, limit, place.lanes or road.lanes_ahead(place.ahead))
    for thing in road.objects:
        if (limit := sign_limit(thing.speed_limit)) is not None:  # in CARLA, + is the left side
            ahead = None if thing.ahead is None else thing.ahead == road.keeps_left
            yield LimitSign(thing.station, limit, road.lanes_ahead(ahead))


def lane_limits(road: Road, section: RoadSection, lane: RoadLane, signs: Sequence[LimitSign], stations: Floats) -> Floats:
    """Return the speed limits of a lane at stations, in m/s: that of the sign before, its own, or that of the road.

    A limit is NaN where there is none.
    """
    own = _stepwise(lane.limits, stations - section.start)
    unsigned = np.where(np.isfinite(own), own, _stepwise(road.limits, stations))
    of_lane = [(sign.station, sign.limit) for sign in signs if applies_to(lane.id, sign.lanes)]
    if road.is_reverse(lane.id):
        signed = _stepwise([(road.length - station, limit) for station, limit in of_lane], road.length - stations)
    else:
        signed = _stepwise(of_lane, stations)
    return np.where(np.isfinite(signed), signed, unsigned)


def _stepwise(steps: Iterable[tuple[float, float]], stations: Floats) -> Floats:
    """Return the values of a function that is constant from each step to the next one; NaN before the first one."""
    starts, values = np.array(sorted(steps, key=lambda step: step[0])).reshape(-1, 2).T
    found: Floats = np.append(values, np.nan)[np.searchsorted(starts, stations, "right") - 1]
    return found
