"""A recording in a notebook: its summary, and a drawing of where its vehicles and walkers move."""

from __future__ import annotations

from html import escape
from itertools import islice
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.lives import ROAD_USERS, heroes_of
from carla_recap.model.motion import possible_step
from carla_recap.model.records import CM
from carla_recap.output.text import text
from carla_recap.queries.incidents import IncidentOptions
from carla_recap.queries.kinds import KINDS
from carla_recap.queries.summary import SummarySearch
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.incidents import Incident
    from carla_recap.util.arrays import Floats


_STEP: Final = 0.5  # s between two points of a path
_SIZE: Final = (640, 400)  # pixels of the drawing, at most
_MARGIN: Final = 5.0  # m
_SHORTEST: Final = 0.3  # the short side of the drawing, as a share of its long side, at least
_FAR: Final = 100_000.0  # m; nothing is farther from the origin of a map
_LINE, _HERO, _DOT = 1.2, 3.0, 5.0  # pixels
_MOST_POINTS: Final = 20_000  # of the lines of a drawing: about 250 kB
_CELLS: Final = (2, 4, 8, 16, 32, 64)  # pixels; the sizes of the cells in which lines that repeat others are left out
_MOST_DOTS: Final = 1_000  # the first incidents
_BITS: Final = 12  # of the number of a cell along an axis


def recording_html(reader: Reader) -> str:
    """Return the summary of a recording, with its quick kinds of incidents, above a drawing of all paths."""
    search = SummarySearch(reader, IncidentOptions())
    places = _PlaceCollector(search.actors)
    search.read(places.add)
    words = "".join(text(search.finish()))
    lines = "\n".join(visible(line) for line in [reader.location, *words.split("\n")])
    heroes = {hero.id for hero in heroes_of(search.actors)}
    return f"<pre>{escape(lines)}</pre>{_drawing(places.paths(), heroes, search.incidents)}"


def _drawing(paths: dict[int, Floats], heroes: set[int], found: Iterable[Incident]) -> str:
    """Return the paths from above, x to the right and y down, as CARLA's axes are; nothing if nothing moves."""
    paths = {id: path for id, path in paths.items() if np.ptp(path[:, 1:], axis=0).max() > 0}
    if not paths:
        return ""
    points = np.concatenate(list(paths.values()))[:, 1:]
    low, high = points.min(axis=0) - _MARGIN, points.max(axis=0) + _MARGIN
    short = np.maximum((high - low).max() * _SHORTEST - (high - low), 0.0) / 2
    low, high = low - short, high + short
    scale = float(min(_SIZE / (high - low)))
    strips = [(id in heroes, strip) for id, path in paths.items() for strip in _strips(path, low, scale)]
    lines = "".join(
        f'<polyline points="{points}" stroke-width="{width}" opacity="{opacity}"/>'
        for is_hero, strip in _thinned(strips)
        for width, opacity in [(_HERO, 1.0) if is_hero else (_LINE, 0.5)]
        for points in [" ".join(f"{x:.1f},{y:.1f}" for x, y in strip.tolist())]
    )
    dots = "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{_DOT}" fill="{KINDS[incident.kind].light}">'
        f"<title>{incident.start:.2f} s: {escape(visible(incident.text))}</title></circle>"
        for incident in islice(found, _MOST_DOTS)
        for x, y in [(scale * (np.array((incident.x, -incident.y)) - low)).tolist()]
        if np.isfinite((x, y)).all()
    )
    width, height = (scale * (high - low)).round().tolist()
    return (
        f'<svg width="{width:.0f}" height="{height:.0f}" xmlns="http://www.w3.org/2000/svg">'
        f'<g fill="none" stroke="currentColor" stroke-linejoin="round">{lines}</g>{dots}</svg>'
    )


class _PlaceCollector:
    """Collects where vehicles and walkers are, every half second."""

    def __init__(self, lives: Iterable[ActorLife]) -> None:
        self._wanted = np.array([life.id for life in lives if life.kind in ROAD_USERS], np.uint32)
        self._ids, self._points = [np.empty(0, np.uint32)], [np.empty((0, 3))]
        self._due = -np.inf

    def add(self, batch: Batch) -> None:
        """Process the next frames."""
        rows, records = [], batch.records("transforms")
        for row, time in enumerate(batch.elapsed.tolist() if records.size else ()):
            if time >= self._due:
                rows.append(row)
                self._due = time + _STEP
        records = records[rows]
        times = np.broadcast_to(batch.elapsed[rows, None], records.shape)
        points = np.stack((times, records["x"] * CM, records["y"] * CM), axis=-1)
        kept = np.isin(records["id"], self._wanted) & (np.abs(points[..., 1:]) < _FAR).all(axis=-1)
        self._ids.append(records["id"][kept])
        self._points.append(points[kept])

    def paths(self) -> dict[int, Floats]:
        """Return time, x and y in s and m of each, (points, 3)."""
        ids, points = np.concatenate(self._ids), np.concatenate(self._points)
        return {id: points[ids == id] for id in dict.fromkeys(ids.tolist())}


def _strips(path: Floats, low: Floats, scale: float) -> Iterator[Floats]:
    """Yield a path as points in pixels, cut where it jumps."""
    jumps = np.linalg.norm(np.diff(path[:, 1:], axis=0), axis=1) > possible_step(np.diff(path[:, 0]))
    for part in np.split(scale * (path[:, 1:] - low), np.flatnonzero(jumps) + 1):
        moved = np.append(True, (np.diff(part.round(), axis=0) != 0).any(axis=1))
        yield part[moved]


def _thinned(strips: list[tuple[bool, Floats]]) -> list[tuple[bool, Floats]]:
    """Return what is drawn of lines, each of a hero or not: if they are too long, not what repeats another line."""
    for size in _CELLS:
        if sum(len(points) for _, points in strips) <= _MOST_POINTS:
            break
        strips = _without_repeats(strips, size)
    return strips


def _without_repeats(strips: list[tuple[bool, Floats]], size: int) -> list[tuple[bool, Floats]]:
    """Return lines without the segments within a cell of some pixels, and between two cells that an earlier one joins."""
    points = np.concatenate([points for _, points in strips])
    lengths = [len(points) for _, points in strips]
    is_hero = np.repeat([is_hero for is_hero, _ in strips], lengths)
    strip = np.repeat(np.arange(len(strips)), lengths)
    x, y = np.floor(points.T / size).astype(np.int64)
    cells = x << _BITS | y
    ends = np.sort(np.stack((cells[:-1], cells[1:])), axis=0)
    keys = (is_hero[:-1].astype(np.int64) << 2 * _BITS | ends[0]) << 2 * _BITS | ends[1]
    candidates = np.flatnonzero((strip[:-1] == strip[1:]) & (ends[0] != ends[1]))
    kept = candidates[np.sort(np.unique(keys[candidates], return_index=True)[1])]
    runs = np.split(kept, np.flatnonzero(np.diff(kept) != 1) + 1) if len(kept) else []
    return [(bool(is_hero[run[0]]), points[run[0] : run[-1] + 2]) for run in runs]
