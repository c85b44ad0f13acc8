"""The lines of a road map, drawn from the lanes of an OpenDRIVE file."""

from __future__ import annotations

import warnings
from collections import defaultdict
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import FormatError, RecapWarning
from carla_recap.roads.files import expecting, read_text
from carla_recap.roads.lanes import NO_JUNCTION, TownRoads
from carla_recap.roads.opendrive import read_opendrive
from carla_recap.roads.polylines import Surface, covering, join, simplify
from carla_recap.roads.stop_lines import drawn_stop_lines
from carla_recap.util.cache import kept

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from carla_recap.roads.lanes import LaneGeometry
    from carla_recap.util.arrays import Floats


_NOT_DRAWN: Final = "none"
_NARROW: Final = 0.3  # m; lanes that are nowhere wider are not drawn
_STUB: Final = 1.0  # m; shorter parts of borders at the edge of a junction are not drawn
_SPACING: Final = 0.15  # m between the points that cover a lane, from left to right
_DENSITY: Final = 4  # points that cover a lane for each of its points, along it
_MOST_ACROSS: Final = 400
_MOST_HEIGHTS: Final = 10_000  # points of a junction that are looked at


@dataclass(frozen=True, eq=False)
class RoadMap:
    """The roads of a town as lines: arrays (n, 3), in m, right-handed: x forward, y left, z up.

    Attributes:
        name: The name of the file, without its suffix.
        lane_borders: The borders of lanes, shoulders and pavements, each once; within junctions, only the outer ones.
        centre_lines: The centre lines of the lanes for cars, in driving direction.
        junctions: The outlines of junctions, as closed lines.
        crossings: Pedestrian crossings, as closed lines.
        stop_lines: Lines across the lanes at lights and stop signs.
        opendrive: The text of the file, from which its surfaces are made.
    """

    name: str
    lane_borders: list[Floats]
    centre_lines: list[Floats]
    junctions: list[Floats]
    crossings: list[Floats]
    stop_lines: list[Floats]
    opendrive: str = field(default="", repr=False)


def load_map(path: Path | str) -> RoadMap:
    """Return the roads of an OpenDRIVE file.

    Args:
        path: The file, such as `Town01.xodr`.

    Raises:
        RecapError: The file cannot be read, or is no OpenDRIVE map with lanes for cars.
    """
    path = Path(path)
    text = read_text(path)
    with expecting(path):
        lines = kept(text.encode("utf-8", "replace"), "lines", ("roads",), lambda: draw(TownRoads(read_opendrive(text))))
    if not lines["centre_lines"]:
        raise FormatError(path, None, "an OpenDRIVE map was expected, and no lane for cars is in it")
    return RoadMap(path.stem, **lines, opendrive=text)


def draw(roads: TownRoads) -> dict[str, list[Floats]]:
    """Return the lines of a road map, by the fields of `RoadMap`, without those that contain NaN or infinity."""
    with np.errstate(all="ignore"):
        lanes = [lane for lane in roads.lanes if np.isfinite((lane.centre, lane.left, lane.right)).all()]
        surfaces = _surfaces(lanes)
        return {
            "lane_borders": _tidy(_borders(lanes, {junction: surface for junction, (surface, _) in surfaces.items()})),
            "centre_lines": _tidy(_ahead(lane, lane.centre) for lane in lanes if lane.is_driving),
            "junctions": [line for surface, points in surfaces.values() for line in _outlines(surface, points)],
            "crossings": [crossing for crossing in roads.crossings if np.isfinite(crossing).all()],
            "stop_lines": _tidy(chain(*drawn_stop_lines(roads.content.roads))),
        }


def _tidy(lines: Iterable[Floats]) -> list[Floats]:
    return [simplify(line) for line in join(list(lines))]


def _ahead(lane: LaneGeometry, line: Floats) -> Floats:
    """Return a line along a lane in driving direction."""
    return line[::-1] if lane.reverse else line


def _surfaces(lanes: list[LaneGeometry]) -> dict[int, tuple[Surface, Floats]]:
    """Return the surface of each junction that cars drive on, and points on it."""
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


def _cover(lane: LaneGeometry) -> Floats:
    """Return points that cover a lane, (n, 2)."""
    left, right = lane.left[:, :2], lane.right[:, :2]
    across = int(np.linalg.norm(left - right, axis=1).max() / _SPACING) + 2
    if across > _MOST_ACROSS:
        message = f"of a lane of road {lane.road} that is {across * _SPACING:.0f} m wide, {_MOST_ACROSS} lines are drawn on"
        warnings.warn(message, RecapWarning, stacklevel=2)
    return covering(left, right, _DENSITY * (len(left) - 1) + 1, min(across, _MOST_ACROSS)).reshape(-1, 2)


def _outlines(surface: Surface, points: Floats) -> Iterator[Floats]:
    """Yield the outlines of a junction, at the height of the nearest lane."""
    for outline in surface.outlines():
        known = points[:: len(points) // _MOST_HEIGHTS + 1]
        nearest = [int(np.hypot(*(known[:, :2] - corner).T).argmin()) for corner in outline]
        yield np.column_stack((outline, known[nearest, 2]))


def _borders(lanes: list[LaneGeometry], surfaces: dict[int, Surface]) -> Iterator[Floats]:
    """Yield each border of the lanes once; in junctions, only at the edge of the surface."""
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
    """Yield the parts of lines outside a surface; of parts side by side, those of the longest line."""
    for line in sorted(lines, key=lambda line: np.count_nonzero(surface.covers(line[:, :2])) - len(line)):
        covered = surface.covers(line[:, :2])
        for part in np.split(line, np.flatnonzero(np.diff(covered)) + 1):
            if not surface.covers(part[:1, :2])[0] and np.linalg.norm(np.diff(part, axis=0), axis=1).sum() > _STUB:
                surface.cover(part[:, :2])
                yield part
