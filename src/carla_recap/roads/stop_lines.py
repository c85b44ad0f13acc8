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
    return _Signals(found).tables()


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


class _Signals:
    """Makes the signals and stop lines of roads."""

    def __init__(self, found: Sequence[Road]) -> None:
        self._roads = found
        self._rows: list[tuple[int, float, float, float, float]] = []
        self._lines: list[tuple[int | float, ...]] = []
        self._ids: list[str] = []
        places: dict[str, list[tuple[int, RoadSignal]]] = defaultdict(list)
        for number, road in enumerate(found):
            for signal in road.signals:
                places[signal.id].append((number, signal))
        for id, (road, signal) in defined_signals(found).items():
            if signal.kind not in _SIGNALS:
                continue
            if len(self._lines) >= _MOST_LINES:
                message = f"signals from {id} on are left out: those before have {_MOST_LINES:,} stop lines"
                warnings.warn(message, RecapWarning, stacklevel=3)
                break
            if len(places[id]) > _MOST_PLACES:
                message = f"of {len(places[id]):,} places of signal {id}, {_MOST_PLACES} are looked at"
                warnings.warn(message, RecapWarning, stacklevel=3)
            self._add(id, road, signal, places[id][:_MOST_PLACES])

    def tables(self) -> tuple[NDArray[np.void], NDArray[np.void], tuple[str, ...]]:
        """Return the signals, the stop lines, and the ids of the signals."""
        return np.array(self._rows, roads.SIGNAL), np.array(self._lines, roads.STOP_LINE), tuple(self._ids)

    def _add(self, id: str, road: Road, signal: RoadSignal, places: Sequence[tuple[int, RoadSignal]]) -> None:
        (x, y, z), along = road.at(signal.station, signal.offset)
        if not np.isfinite((x, y, z, along)).all():
            return
        lanes = [(number, place, lane) for number, place in places for lane in self._governed(number, place)]
        if not lanes:  # it says that it is for no lane, and no other road refers to it
            lanes = [(number, place, lane) for number, place in places for lane in self._facing(number, place)]
        lines: list[_Cross] = []
        for number, place, lane in lanes:
            found = self._line(number, place, *lane)
            if found is not None and not any(_is_same(found, other) for other in lines):
                lines.append(found)
        heading = lines[0].heading if lines else along + signal.heading
        self._lines += [(len(self._rows), line.heading, *line.left, *line.right) for line in lines]
        self._rows.append((_SIGNALS[signal.kind], x, y, z, heading))
        self._ids.append(id)

    def _governed(self, number: int, place: RoadSignal) -> Iterator[tuple[int, int]]:
        """Yield the section and number of each lane of a road that a signal names, at its station."""
        return self._lanes(number, place, place.lanes or self._roads[number].lanes_ahead(place.ahead))

    def _facing(self, number: int, place: RoadSignal) -> Iterator[tuple[int, int]]:
        return self._lanes(number, place, self._roads[number].lanes_ahead(place.ahead))

    def _lanes(self, number: int, place: RoadSignal, ranges: Sequence[tuple[int, int]]) -> Iterator[tuple[int, int]]:
        for index, section in enumerate(self._roads[number].sections):
            if section.start - _AT_SIGN <= place.station <= section.end + _AT_SIGN:
                for lane in (*section.left, *section.right):
                    if applies_to(lane.id, ranges) and LANE_KINDS.get(lane.kind) in (roads.DRIVING, roads.BOTH_WAYS):
                        yield index, lane.id

    def _line(self, number: int, place: RoadSignal, index: int, lane: int) -> _Cross | None:
        """Return the stop line of a signal on a lane."""
        road = self._roads[number]
        ahead = not road.is_reverse(lane)
        if road.in_junction:  # at its border
            station = 0.0 if ahead else road.length
        elif road.links[ahead] and (road.length - place.station if ahead else place.station) <= _TO_JUNCTION:
            station = road.length if ahead else 0.0
        else:
            station = min(max(place.station, 0.0), road.length)
        sections = sorted(road.sections, key=lambda section: max(section.start - station, station - section.end))
        numbers = [*(section for section in sections if _has(section, lane)), road.sections[index]]
        section = numbers[0]
        station = min(max(station, section.start), section.end - BEFORE_END)
        points, _, _, headings = borders_at(road, section, np.array((station, station)))
        position = [other.id for other in (*section.left[::-1], *section.right)].index(lane)
        left, right = points[position, 0], points[position + 1, 0]
        if not np.isfinite((left, right)).all() or np.hypot(*(left - right)[:2]) < _NARROW:
            return None
        heading = float(headings[0])
        return _Cross(left, right, heading) if ahead else _Cross(right, left, heading + np.pi)


def _has(section: RoadSection, lane: int) -> bool:
    return any(other.id == lane for other in (*section.left, *section.right))


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
