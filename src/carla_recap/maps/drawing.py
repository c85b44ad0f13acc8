"""From the lanes of a town to lines that are light to draw."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.maps.opendrive import NO_JUNCTION
from carla_recap.maps.polylines import Surface, distances_to, join, simplify

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from carla_recap.maps.opendrive import Lane, Roads, Sign

    Floats = NDArray[np.float64]

_NOT_DRAWN: Final = "NONE"
_NARROW: Final = 0.3  # m: what is nowhere wider is no lane to look at
_STUB: Final = 1.0  # m: what is left of a border at the edge of a junction, and means nothing
_APART: Final = 0.15  # m: between the points that cover a junction
_DENSER: Final = 4  # times as many points along a lane
_MOST_ACROSS: Final = 400
_SAME_STOP: Final = 0.5  # m
_SAME_PAINT: Final = 6.0  # m


def draw(roads: Roads) -> dict[str, list[Floats]]:
    """The lines of a town by the names of the fields of a `RoadMap`; those with places that are no numbers are left out."""
    with np.errstate(all="ignore"):
        lanes = [lane for lane in roads.lanes if np.isfinite((lane.centre, lane.left, lane.right)).all()]
        surfaces = _surfaces(lanes)
        return {
            "lane_borders": _tidy(_borders(lanes, {junction: surface for junction, (surface, _) in surfaces.items()})),
            "centre_lines": _tidy(_ahead(lane, lane.centre) for lane in lanes if lane.is_driving),
            "junctions": [line for surface, ground in surfaces.values() for line in _outlines(surface, ground)],
            "crossings": [crossing for crossing in roads.crossings if np.isfinite(crossing).all()],
            "stop_lines": _tidy(_stop_lines(roads, lanes)),
        }


def _tidy(lines: Iterable[Floats]) -> list[Floats]:
    return [simplify(line) for line in join(list(lines))]


def _ahead(lane: Lane, line: Floats) -> Floats:
    """A line along a lane, in the direction in which one drives."""
    return line[::-1] if lane.reverse else line


def _surfaces(lanes: list[Lane]) -> dict[int, tuple[Surface, Floats]]:
    """The junctions: the ground for cars, and points on it."""
    grounds = defaultdict(list)
    for lane in lanes:
        if lane.junction != NO_JUNCTION and lane.is_driving:
            grounds[lane.junction].append(lane)
    return {
        junction: (
            Surface(np.concatenate([_cover(lane) for lane in parts])),
            np.concatenate([lane.centre for lane in parts]),
        )
        for junction, parts in grounds.items()
    }


def _cover(lane: Lane) -> Floats:
    """Points all over a lane, (n, 2)."""
    stations = np.interp(
        np.linspace(0, 1, _DENSER * (len(lane.stations) - 1) + 1), np.linspace(0, 1, len(lane.stations)), lane.stations
    )
    left, right = (
        np.stack([np.interp(stations, lane.stations, axis) for axis in border.T[:2]], axis=1)
        for border in (lane.left, lane.right)
    )
    width = np.linalg.norm(left - right, axis=1).max()
    shares = np.linspace(0, 1, min(int(width / _APART) + 2, _MOST_ACROSS))[:, None, None]
    points: Floats = (left + shares * (right - left)).reshape(-1, 2)
    return points


def _outlines(surface: Surface, ground: Floats) -> Iterator[Floats]:
    """The outlines of a junction, as high as the nearest lane."""
    for outline in surface.outlines():
        distances = np.linalg.norm(outline[:, None] - ground[None, :, :2], axis=2)
        yield np.column_stack((outline, ground[distances.argmin(axis=1), 2]))


def _borders(lanes: list[Lane], surfaces: dict[int, Surface]) -> Iterator[Floats]:
    """The borders of the lanes, each once; in junctions, only where they are the edge of the ground for cars."""
    drawn = set()
    within: dict[int, list[Floats]] = defaultdict(list)
    for lane in lanes:
        if lane.kind == _NOT_DRAWN or np.linalg.norm(lane.left - lane.right, axis=1).max() < _NARROW:
            continue
        for name, border in lane.borders():
            if name in drawn:
                continue
            drawn.add(name)
            if lane.junction in surfaces:
                within[lane.junction].append(_ahead(lane, border))
            else:
                yield _ahead(lane, border)
    for junction, lines in within.items():
        yield from _edges(lines, surfaces[junction])


def _edges(lines: list[Floats], surface: Surface) -> Iterator[Floats]:
    """The parts of lines that are not within a surface; where some are side by side, of the longest one."""
    for line in sorted(lines, key=lambda line: np.count_nonzero(surface.covers(line[:, :2])) - len(line)):
        covered = surface.covers(line[:, :2])
        for part in np.split(line, np.flatnonzero(np.diff(covered)) + 1):
            if not surface.covers(part[:1, :2])[0] and np.linalg.norm(np.diff(part, axis=0), axis=1).sum() > _STUB:
                surface.cover(part[:, :2])
                yield part


def _stop_lines(roads: Roads, lanes: list[Lane]) -> list[Floats]:
    """The painted stop lines, and one across each lane that has to stop and has none."""
    painted = [line for line in roads.painted if np.isfinite(line).all()]
    drawn: list[Floats] = []
    driving = defaultdict(list)
    for lane in lanes:
        if lane.is_driving:
            driving[lane.road].append(lane)
    for stop in roads.stops():
        for line in _lines_at(stop, driving[stop.road]):
            middle = line.mean(axis=0)[None]
            if all(distances_to(middle, *other)[0] > _SAME_PAINT for other in painted) and all(
                np.linalg.norm(other.mean(axis=0) - middle) > _SAME_STOP for other in drawn
            ):
                drawn.append(line)
    return painted + drawn


def _lines_at(stop: Sign, lanes: list[Lane]) -> Iterator[Floats]:
    """A line across each lane that stops: on the way, or where the lane enters a junction."""
    told = [lane for lane in lanes if any(first <= lane.id <= last for first, last in stop.lanes)]
    for number in dict.fromkeys(lane.id for lane in told):
        parts = [lane for lane in told if lane.id == number]
        stations = np.concatenate([lane.stations for lane in parts])
        left, right = (np.concatenate([getattr(lane, side) for lane in parts]) for side in ("left", "right"))
        if parts[0].junction == NO_JUNCTION:
            at = np.abs(stations - stop.station).argmin()
        else:
            at = stations.argmax() if parts[0].reverse else stations.argmin()
        yield np.array((left[at], right[at]))
