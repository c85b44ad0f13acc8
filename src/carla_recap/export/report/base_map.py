"""The base map of the incident page: the roads of a map, or without a map, the paths of vehicles."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.records import ActorKind

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.export.report.samples import SampledReplay
    from carla_recap.maps import RoadMap

    Floats = NDArray[np.float64]

ROAD_WIDTH: Final = 3.7  # m
PATH_WIDTH: Final = 2.6  # m
STEP: Final = 1.0  # m between points of a path
CELL: Final = 1.5  # m of a square in which one path is drawn
MOST: Final = 100_000  # points of paths


@dataclass(frozen=True)
class BaseMap:
    """The lines to draw below the actors: x, y in m, right-handed.

    Attributes:
        width: The width of the lanes, in m.
        lanes: The centre lines of lanes.
        junctions, crossings: Outlines.
        borders, stops: The borders of lanes, and stop lines.
    """

    width: float
    lanes: list[Floats]
    junctions: list[Floats] = field(default_factory=list)
    crossings: list[Floats] = field(default_factory=list)
    borders: list[Floats] = field(default_factory=list)
    stops: list[Floats] = field(default_factory=list)


def base_map(road_map: RoadMap | None, replays: Sequence[SampledReplay]) -> BaseMap:
    """Return the roads of a map, or without one, the paths of vehicles."""
    if road_map is None:
        return BaseMap(PATH_WIDTH, list(_driven(replays)))
    return BaseMap(
        ROAD_WIDTH,
        list(_flat(road_map.centre_lines)),
        list(_flat(road_map.junctions)),
        list(_flat(road_map.crossings)),
        list(_flat(road_map.lane_borders)),
        list(_flat(road_map.stop_lines)),
    )


def _flat(lines: Iterable[Floats]) -> Iterator[Floats]:
    for line in lines:
        if len(line) > 1 and np.isfinite(line[:, :2]).all():
            yield line[:, :2]


def _driven(replays: Sequence[SampledReplay]) -> Iterator[Floats]:
    """Yield the paths of all vehicles, without those parts where one is drawn already."""
    paths = []
    for replay in replays:
        vehicles = {i for i, actor in enumerate(replay.actors) if actor.details and actor.details.kind == ActorKind.VEHICLE}
        moving = (track for track in replay.tracks if track.actor in vehicles and not track.is_still)
        paths += [thinned(track.rows[:, :2], STEP) for track in moving]
    if not paths:
        return
    points = np.concatenate(paths)
    cells = np.rint(points / CELL).astype(np.int64)
    _, firsts = np.unique(cells, axis=0, return_index=True)
    fresh = np.zeros(len(points), np.bool_)
    fresh[firsts] = True
    left = MOST
    for path, new in zip(paths, np.split(fresh, np.cumsum([len(path) for path in paths])[:-1]), strict=True):
        for run in runs(path, new):
            if left <= 0:
                return
            left -= len(run)
            yield run


def thinned(line: Floats, step: float) -> Floats:
    """Return a line with a point for each step of its length, in m, and its last point."""
    far = np.cumsum(np.hypot(*np.diff(line, axis=0, prepend=line[:1]).T)) // step
    kept = np.flatnonzero(np.diff(far, prepend=-1.0) > 0)
    thin: Floats = line[np.union1d(kept, [len(line) - 1])]
    return thin


def runs(line: Floats, wanted: NDArray[np.bool_]) -> Iterator[Floats]:
    """Yield the parts of a line that contain the wanted points, with the points next to these."""
    near = wanted.copy()
    near[1:] |= wanted[:-1]
    near[:-1] |= wanted[1:]
    ends = np.flatnonzero(np.diff(np.concatenate(([0], near.astype(np.int8), [0]))))
    for first, last in ends.reshape(-1, 2).tolist():
        if last - first > 1:
            yield line[first:last]
