"""The traffic lights and signs of roads, and their stop lines."""

from __future__ import annotations

import warnings
from collections import defaultdict
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.roads import network as roads
from carla_recap.roads import opendrive
from carla_recap.roads.network import LANE_KINDS
from carla_recap.roads.opendrive import BEFORE_END, borders_at, defined_signals
from carla_recap.roads.polylines import distances_to

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.roads.opendrive import Road, RoadObject, RoadSection, RoadSignal
    from carla_recap.util.arrays import Floats


_SIGNALS: Final = {opendrive.LIGHT: roads.LIGHT, opendrive.STOP: roads.STOP, opendrive.YIELD: roads.YIELD}
_MOST_LINES: Final = 20_000
_MOST_PLACES: Final = 200  # at which a signal applies
_AT_SIGN: Final = 1.0  # m beyond the ends of a section within which a signal belongs to it
_TO_JUNCTION: Final = 30.0  # m from a signal to the junction at whose border its stop line is
_SAME_LINE: Final = 0.5  # m between the middles of stop lines that are one
_SAME_PAINT: Final = 6.0  # m from a painted stop line, within which no other one is drawn
_SAME_HEADING: Final = np.cos(np.radians(15))
_NARROW: Final = 0.02  # m


def signal_tables(found: Sequence[Road]) -> tuple[NDArray[np.void], NDArray[np.void], tuple[str, ...]]:
    """Return the signals and the stop lines of roads, for a `RoadNetwork`, and the ids of the signals."""
    places: dict[str, list[tuple[Road, RoadSignal]]] = defaultdict(list)
    for road in found:
        for signal in road.signals:
            places[signal.id].append((road, signal))
    rows: list[tuple[float, ...]] = []
    lines: list[tuple[float, ...]] = []
    ids: list[str] = []
    for id, (road, signal) in defined_signals(found).items():
        if signal.kind not in _SIGNALS:
            continue
        if len(lines) >= _MOST_LINES:
            message = f"signals from {id} on are left out: those before have {_MOST_LINES:,} stop lines"
            warnings.warn(message, RecapWarning, stacklevel=2)
            break
        if len(places[id]) > _MOST_PLACES:
            message = f"of {len(places[id]):,} places of signal {id}, {_MOST_PLACES} are looked at"
            warnings.warn(message, RecapWarning, stacklevel=2)
        (x, y, z), heading = road.place_of(signal)
        if np.isfinite((x, y, z, heading)).all():
            own = _lines_at(places[id][:_MOST_PLACES])
            lines += [(len(rows), line.heading, *line.left, *line.right) for line in own]
            rows.append((_SIGNALS[signal.kind], x, y, z, own[0].heading if own else heading))
            ids.append(id)
    return np.array(rows, roads.SIGNAL), np.array(lines, roads.STOP_LINE), tuple(ids)


def drawn_stop_lines(found: Sequence[Road]) -> tuple[list[Floats], list[Floats]]:
    """Return the stop lines that are painted on roads, and one for each lane with a light or stop sign that has none.

    Each is two points, (2, 3); the latter are at the stop lines of the road network, the left end first.
    """
    painted = [_painted(road, thing) for road in found for thing in road.objects if thing.name == "StopLine"]
    painted = [line for line in painted if np.isfinite(line).all()]
    if len(painted) > _MOST_LINES:
        warnings.warn(f"of {len(painted):,} painted stop lines, {_MOST_LINES:,} are drawn", RecapWarning, stacklevel=2)
        del painted[_MOST_LINES:]
    signals, table, _ = signal_tables(found)
    table = table[np.isin(signals["kind"][table["signal"]], (roads.LIGHT, roads.STOP))]
    lines = np.stack([np.stack([table[f"{axis}{end}"] for axis in "xyz"], axis=1) for end in "01"], axis=1)
    middles, wanted = lines.mean(axis=1), np.ones(len(lines), np.bool_)
    starts, stops = np.array(painted).reshape(-1, 2, 3).swapaxes(0, 1)
    for row, middle in enumerate(middles):
        others = middles[:row][wanted[:row]]
        wanted[row] = np.linalg.norm(others - middle, axis=1).min(initial=np.inf) > _SAME_LINE and (
            distances_to(np.broadcast_to(middle, starts.shape), starts, stops).min(initial=np.inf) > _SAME_PAINT
        )
    return painted, list(lines[wanted])


def _painted(road: Road, thing: RoadObject) -> Floats:
    point, heading = road.at(thing.station, thing.offset)
    direction = heading + thing.heading
    half = thing.length / 2 * np.array((np.cos(direction), np.sin(direction), 0.0))
    return np.array((point - half, point + half))


def _lines_at(places: Sequence[tuple[Road, RoadSignal]]) -> list[_Cross]:
    """Return the stop lines of a signal at places where it applies."""
    lanes = [each for place in places for each in _lanes(*place, place[1].lanes)]
    if not lanes:  # it says that it is for no lane, and no other road refers to it
        lanes = [each for place in places for each in _lanes(*place, ())]
    lines: list[_Cross] = []
    for road, place, section, lane in lanes:
        found = _line(road, place, section, lane)
        if found is not None and not any(_is_same(found, other) for other in lines):
            lines.append(found)
    return lines


def _lanes(
    road: Road, place: RoadSignal, ranges: Sequence[tuple[int, int]]
) -> Iterator[tuple[Road, RoadSignal, RoadSection, int]]:
    """Yield the lanes at a signal, by section and number, that are in ranges; without any, those that it faces."""
    for section in road.sections:
        if section.start - _AT_SIGN <= place.station <= section.end + _AT_SIGN:
            for lane in (*section.left, *section.right):
                is_for_cars = LANE_KINDS.get(lane.kind) in (roads.DRIVING, roads.BOTH_WAYS)
                if is_for_cars and applies_to(lane.id, ranges or road.lanes_ahead(place.ahead)):
                    yield road, place, section, lane.id


def _line(road: Road, place: RoadSignal, at: RoadSection, lane: int) -> _Cross | None:
    """Return the stop line of a signal on a lane."""
    ahead = not road.is_reverse(lane)
    if road.in_junction:  # at its border
        station = 0.0 if ahead else road.length
    elif road.links[ahead] and (road.length - place.station if ahead else place.station) <= _TO_JUNCTION:
        station = road.length if ahead else 0.0
    else:
        station = min(max(place.station, 0.0), road.length)
    sections = sorted(road.sections, key=lambda section: max(section.start - station, station - section.end))
    section = next((each for each in sections if any(other.id == lane for other in each.lanes)), at)
    station = min(max(station, section.start), section.end - BEFORE_END)
    points, _, _, headings = borders_at(road, section, np.array((station, station)))
    position = [other.id for other in section.lanes].index(lane)
    left, right = points[position, 0], points[position + 1, 0]
    if not np.isfinite((left, right)).all() or np.hypot(*(left - right)[:2]) < _NARROW:
        return None
    heading = float(headings[0])
    return _Cross(left, right, heading) if ahead else _Cross(right, left, heading + np.pi)


def _is_same(line: _Cross, other: _Cross) -> bool:
    apart = (line.left + line.right - other.left - other.right) / 2
    return bool(np.cos(line.heading - other.heading) > _SAME_HEADING and np.hypot(*apart[:2]) < _SAME_LINE)


def applies_to(lane: int, ranges: Sequence[tuple[int, int]]) -> bool:
    """Return whether a lane is within ranges of lanes."""
    return lane != 0 and any(low <= lane <= high for low, high in ranges)


class _Cross(NamedTuple):
    """A line across a lane: its left end, its right end, and the driving direction."""

    left: Floats
    right: Floats
    heading: float
