"""What the scene stands on: the roads of a map, or where there is none, the ways that vehicles drove."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.records import ActorKind

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from carla_recap.export.report.tracks import Tracks
    from carla_recap.maps import RoadMap

    Floats = NDArray[np.float64]

ROAD_WIDTH: Final = 3.7  # m
WAY_WIDTH: Final = 2.6
STEP: Final = 1.0  # m between points of a way
CELL: Final = 1.5  # m; where a way was drawn already, it is not drawn again
MOST: Final = 100_000  # points of ways


class Lines:
    """Lines that are looked up by place.

    Args:
        lines: Rows of x, y; none of them is empty.
    """

    def __init__(self, lines: Iterable[Floats] = ()) -> None:
        self.lines = list(lines)
        self._low = np.array([line.min(axis=0) for line in self.lines]).reshape(-1, 2)
        self._high = np.array([line.max(axis=0) for line in self.lines]).reshape(-1, 2)

    def within(self, low: Floats, high: Floats) -> list[Floats]:
        """The lines that may be seen in a rectangle, given by two corners."""
        near = ((self._low <= high) & (self._high >= low)).all(axis=1)
        return [self.lines[place] for place in np.flatnonzero(near).tolist()]


@dataclass(frozen=True)
class Ground:
    """Lines to draw below the actors: x, y in m, right-handed.

    Attributes:
        width: How broad lanes are, in m.
        lanes: Their middles.
        junctions, crossings: Outlines.
        borders, stops: Thin lines, and stop lines.
    """

    width: float
    lanes: Lines
    junctions: Lines = field(default_factory=Lines)
    crossings: Lines = field(default_factory=Lines)
    borders: Lines = field(default_factory=Lines)
    stops: Lines = field(default_factory=Lines)


def ground(road_map: RoadMap | None, tracks: Tracks) -> Ground:
    """The roads of a map, or without one, what vehicles drove on."""
    if road_map is None:
        return Ground(WAY_WIDTH, Lines(_worn(tracks)))
    return Ground(
        ROAD_WIDTH,
        Lines(_flat(road_map.centre_lines)),
        Lines(_flat(road_map.junctions)),
        Lines(_flat(road_map.crossings)),
        Lines(_flat(road_map.lane_borders)),
        Lines(_flat(road_map.stop_lines)),
    )


def _flat(lines: Iterable[Floats]) -> Iterator[Floats]:
    for line in lines:
        if len(line) > 1 and np.isfinite(line[:, :2]).all():
            yield line[:, :2]


def _worn(tracks: Tracks) -> Iterator[Floats]:
    """The ways of all vehicles, each place once."""
    vehicles = {place for place, life in enumerate(tracks.lives) if life.actor and life.actor.kind == ActorKind.VEHICLE}
    ways = [thinned(track.rows[:, :2], STEP) for track in tracks.tracks if track.life in vehicles and not track.is_still]
    if not ways:
        return
    points = np.concatenate(ways)
    cells = np.rint(points / CELL).astype(np.int64)
    _, firsts = np.unique(cells, axis=0, return_index=True)
    fresh = np.zeros(len(points), np.bool_)
    fresh[firsts] = True
    left = MOST
    for way, new in zip(ways, np.split(fresh, np.cumsum([len(way) for way in ways])[:-1]), strict=True):
        for run in runs(way, new):
            if left <= 0:
                return
            left -= len(run)
            yield run


def thinned(line: Floats, step: float) -> Floats:
    """A line with a point for each step of its length, in m, and its last one."""
    far = np.cumsum(np.hypot(*np.diff(line, axis=0, prepend=line[:1]).T)) // step
    kept = np.flatnonzero(np.diff(far, prepend=-1.0) > 0)
    thin: Floats = line[np.union1d(kept, [len(line) - 1])]
    return thin


def runs(line: Floats, wanted: NDArray[np.bool_]) -> Iterator[Floats]:
    """The parts of a line that hold the wanted points, and the points next to these."""
    near = wanted.copy()
    near[1:] |= wanted[:-1]
    near[:-1] |= wanted[1:]
    ends = np.flatnonzero(np.diff(np.concatenate(([0], near.astype(np.int8), [0]))))
    for first, last in ends.reshape(-1, 2).tolist():
        if last - first > 1:
            yield line[first:last]
