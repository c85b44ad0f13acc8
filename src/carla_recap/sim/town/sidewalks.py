"""The walkways of pedestrians, as one connected graph."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from itertools import pairwise, product
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.roads.barriers import SIDEWALK, Ground, left_handed
from carla_recap.roads.lanes import NO_JUNCTION
from carla_recap.roads.polylines import stations
from carla_recap.sim.town.graph import components

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.roads.lanes import LaneGeometry, TownRoads
    from carla_recap.util.arrays import Floats

    Ends = tuple[int, int]


@dataclass(frozen=True, eq=False)
class WalkwayGraph:
    """The walkways: nodes, (n, 3), pairs of their indices, each once, (m, 2), and whether each crosses a road, (m,)."""

    nodes: Floats
    edges: NDArray[np.int64]
    crossing: NDArray[np.bool_]


_SPACING: Final = 5.0  # m: between nodes along a sidewalk
_SAME: Final = 1.0  # m: ends of sidewalks as near as that are one
_CORNER: Final = 25.0  # m: at most, between the ends of two sidewalks around a corner
_TO_SIDEWALK: Final = 10.0  # m: at most, from the end of a crossing
_WIDTH: Final = 3.0  # m: of a crossing that the map does not have
_BEYOND: Final = 2.5  # m: between the line where cars stop and the middle of such a crossing
_SAME_MOUTH: Final = 15.0  # m: a crossing of the map as near as that to where a road meets a junction is the one there
_WIDEST: Final = 40.0  # m: roads wider than that are not crossed
_MOST_NODES: Final = 50_000
_MOST_CORNERS: Final = 50_000  # pairs of ends of sidewalks near each other
_MOST_PARTS: Final = 300  # that are connected
_AROUND: Final = list(product((-1, 0, 1), repeat=3))


@dataclass
class Walks:
    """The graph of walkways while it is made.

    It has the middles of sidewalks, the closed outlines of crossings, the nodes, and pairs of their indices, the smaller one
    first, with whether they lead over a road.
    """

    sidewalks: list[Floats]
    crossings: list[Floats]
    nodes: list[Floats] = field(default_factory=list)
    edges: dict[tuple[int, int], bool] = field(default_factory=dict)

    def add(self, place: Floats) -> int:
        """Add a node, and return its index."""
        self.nodes.append(place)
        return len(self.nodes) - 1

    def graph(self) -> WalkwayGraph:
        """Return the graph as arrays."""
        return WalkwayGraph(
            np.array(self.nodes).reshape(-1, 3),
            np.array(list(self.edges), np.int64).reshape(-1, 2),
            np.array(list(self.edges.values()), np.bool_),
        )

    def link(self, one: int, other: int, *, crossing: bool = False) -> None:
        """Add an edge, if there is none."""
        if one != other:
            self.edges.setdefault((min(one, other), max(one, other)), crossing)


def make_walks(roads: TownRoads) -> Walks:
    """Return the walkways of a town, empty if it has no sidewalk; ValueError: there are too many for a town."""
    lanes = [lane for lane in roads.lanes if lane.kind == SIDEWALK and np.isfinite(lane.centre).all()]
    lanes.sort(key=lambda lane: (lane.road, lane.section, lane.id))
    given = [left_handed(crossing) for crossing in roads.crossings if np.isfinite(crossing).all()]
    walks = Walks([left_handed(lane.centre) for lane in lanes], given)
    if sum(len(line) for line in walks.sidewalks) > _MOST_NODES:
        raise ValueError("its sidewalks are longer than those of any town")
    road = Ground([lane for lane in roads.lanes if lane.is_driving])
    ends = _along_sidewalks(walks)
    _around_corners(walks, road)
    sidewalks = np.array(walks.nodes).reshape(-1, 3)
    for crossing in given:
        _over(walks, crossing, sidewalks)
    _over_mouths(walks, roads, lanes, ends)
    _connect(walks, road)
    return walks


def _along_sidewalks(walks: Walks) -> list[Ends]:
    """Add nodes and edges along the sidewalks, and return the nodes at the ends of each."""
    tips = np.array([line[end] for line in walks.sidewalks for end in (0, -1)]).reshape(-1, 3)
    before = {later: earlier for earlier, later in reversed(_near(tips, _SAME))}
    nodes: list[int] = []
    for number, tip in enumerate(tips):
        first = before.get(number, number)  # of those that are one
        nodes.append(walks.add(tip) if first == number else nodes[first])
    ends = list(zip(nodes[::2], nodes[1::2], strict=True))
    for line, (first, last) in zip(walks.sidewalks, ends, strict=True):
        at = stations(line)
        even = np.linspace(0, at[-1], int(at[-1] / _SPACING) + 2)[1:-1]
        between = np.stack([np.interp(even, at, column) for column in line.T], axis=1)
        for one, other in pairwise((first, *map(walks.add, between), last)):
            walks.link(one, other)
    return ends


def _around_corners(walks: Walks, road: Ground) -> None:
    """Link the open ends of sidewalks in pairs, the nearest first, where no lane for cars is between them."""
    counts = np.bincount(np.array(list(walks.edges), np.int64).ravel(), minlength=len(walks.nodes))
    ends = np.flatnonzero(counts == 1)
    places = np.array(walks.nodes).reshape(-1, 3)[ends]
    pairs = sorted(_near(places, _CORNER), key=lambda pair: float(np.linalg.norm(places[pair[0]] - places[pair[1]])))
    linked: set[int] = set()
    for one, other in pairs:
        if not linked & {one, other} and not road.crossed_by(places[one], places[other]):
            walks.link(int(ends[one]), int(ends[other]))
            linked |= {one, other}


def _near(places: Floats, reach: float) -> list[tuple[int, int]]:
    """Return the pairs of places that are nearer than a distance, in ascending order; there may be too many."""
    cells: dict[tuple[int, ...], list[int]] = defaultdict(list)
    pairs: list[tuple[int, int]] = []
    for number, cell in enumerate(map(tuple, np.floor(places / reach).astype(np.int64).tolist())):
        around = [other for step in _AROUND for other in cells[cell[0] + step[0], cell[1] + step[1], cell[2] + step[2]]]
        apart = np.linalg.norm(places[around] - places[number], axis=1)
        pairs += [(other, number) for other, distance in zip(around, apart.tolist(), strict=True) if distance < reach]
        if len(pairs) > _MOST_CORNERS:
            raise ValueError("more sidewalks meet than in any town")
        cells[cell].append(number)
    return sorted(pairs)


def _over(walks: Walks, outline: Floats, sidewalks: Floats) -> None:
    """Add a crossing of the map: from the middle of one short side to that of the other, and to the nodes of sidewalks."""
    corners = outline[:-1]
    middle = corners.mean(axis=0)
    _, _, axes = np.linalg.svd(corners[:, :2] - middle[:2], full_matrices=False)
    along = (corners[:, :2] - middle[:2]) @ axes[0]
    if not (along < 0).any():
        return  # it is a point
    nodes = [walks.add(corners[side].mean(axis=0)) for side in (along < 0, along >= 0)]
    walks.link(nodes[0], nodes[1], crossing=True)
    for node in nodes:
        distances = np.linalg.norm(sidewalks - walks.nodes[node], axis=1)
        if (distances < _TO_SIDEWALK).any():
            walks.link(int(distances.argmin()), node)


def _over_mouths(walks: Walks, roads: TownRoads, lanes: Sequence[LaneGeometry], ends: Sequence[Ends]) -> None:
    """Add crossings where roads with sidewalks on both sides meet junctions: just beyond the line where cars stop."""
    given = np.array([crossing[:-1].mean(axis=0) for crossing in walks.crossings]).reshape(-1, 3)
    sides = {
        (lane.road, lane.section, lane.id > 0): (line, pair, float(np.linalg.norm(lane.left - lane.right, axis=1).mean()))
        for lane, line, pair in zip(lanes, walks.sidewalks, ends, strict=True)
    }
    for road, section, at_end in sorted(_mouths(roads)):
        if (road, section, True) not in sides or (road, section, False) not in sides:
            continue
        (line, pair, width), (other_line, other_pair, other_width) = (sides[road, section, left] for left in (True, False))
        end = -1 if at_end else 0
        one, other = line[end], other_line[end]
        apart = float(np.linalg.norm(other - one))
        middle = (one + other) / 2
        if not width < apart < _WIDEST or (np.linalg.norm(given - middle, axis=1) < _SAME_MOUTH).any():
            continue
        ahead = one - line[-2 if at_end else 1]
        ahead /= max(float(np.linalg.norm(ahead)), 1e-6)
        nodes = [walks.add(place + _BEYOND * ahead) for place in (one, other)]
        walks.link(nodes[0], nodes[1], crossing=True)
        walks.link(nodes[0], pair[end])
        walks.link(nodes[1], other_pair[end])
        walks.crossings.append(_stripe(one + _BEYOND * ahead, other + _BEYOND * ahead, width / 2, other_width / 2))


def _mouths(roads: TownRoads) -> set[tuple[int, int, bool]]:
    """Return where roads meet junctions: road, section, and whether at its end, or at its beginning."""
    driving = {(lane.road, lane.section, lane.id): lane for lane in roads.lanes if lane.is_driving}
    mouths = set()
    for lane in driving.values():
        for name in lane.successors:
            after = driving.get(name)
            if after is None or (lane.junction == NO_JUNCTION) == (after.junction == NO_JUNCTION):
                continue
            if lane.junction == NO_JUNCTION:
                mouths.add((lane.road, lane.section, not lane.reverse))
            else:
                mouths.add((after.road, after.section, after.reverse))
    return mouths


def _stripe(start: Floats, stop: Floats, before: float = 0.0, after: float = 0.0) -> Floats:
    """Return the closed outline of a crossing from one location to another, shortened at both ends."""
    along = (stop - start) / max(float(np.linalg.norm(stop - start)), 1e-6)
    start, stop = start + before * along, stop - after * along
    aside = np.array((-along[1], along[0], 0.0)) * _WIDTH / 2
    return np.array((start - aside, start + aside, stop + aside, stop - aside, start - aside))


def _connect(walks: Walks, road: Ground) -> None:
    """Connect the components by crossings between their nearest nodes; remove components that are too far away."""
    places = np.array(walks.nodes).reshape(-1, 3)
    beside: list[list[int]] = [[] for _ in places]
    for one, other in walks.edges:
        beside[one].append(other)
        beside[other].append(one)
    apart = components(beside)
    if not apart:
        return
    whole, *apart = sorted(apart, key=len, reverse=True)[:_MOST_PARTS]
    links = [_nearest(places, whole, part) for part in apart]
    while apart:
        number = links.index(min(links))
        (distance, one, other), part = links.pop(number), apart.pop(number)
        if distance > _WIDEST:
            break
        over = road.crossed_by(places[one], places[other])
        walks.link(one, other, crossing=over)
        if over:
            walks.crossings.append(_stripe(places[one], places[other]))
        whole += part
        links = [min(link, _nearest(places, part, rest)) for link, rest in zip(links, apart, strict=True)]
    _keep(walks, sorted(whole))


def _nearest(places: Floats, whole: list[int], part: list[int]) -> tuple[float, int, int]:
    """Return the distance of the two nodes of two sets that are nearest to each other, and the nodes."""
    best = (np.inf, 0, 0)
    for number in part:
        distances = np.linalg.norm(places[whole] - places[number], axis=1)
        nearest = int(distances.argmin())
        best = min(best, (float(distances[nearest]), whole[nearest], number))
    return best


def _keep(walks: Walks, kept: list[int]) -> None:
    """Remove all other nodes."""
    numbers = {node: number for number, node in enumerate(kept)}
    walks.nodes = [walks.nodes[node] for node in kept]
    walks.edges = {
        (numbers[one], numbers[other]): crossing for (one, other), crossing in walks.edges.items() if one in numbers
    }
