"""Ways over roads beside the crossings: `World.set_pedestrians_cross_factor` says how many of the walkers may take them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.server.navmesh.ways import ROAD, SIDEWALK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.server.navmesh.ways import Ways
    from carla_recap.sim.town.town import Town

    Floats = NDArray[np.float64]

_EVERY: Final = 20.0  # m: between such ways, at least
_FACING: Final = 3.0  # m: by which places on both sides of a road may miss each other; their spacing is 5 m
_NARROWEST, _WIDEST = 5.0, 40.0  # m: between the sidewalks of a road
_LEVEL: Final = 1.5  # m: by which they may differ in height; else one is on a bridge
_LANES: Final = 0.3  # of a road is lanes, at least; the rest is verges, medians and a half of both sidewalks
_SAMPLES: Final = 21  # along a line over a road


def cross_roads(ways: Ways, town: Town) -> None:
    """Link places on sidewalks to those across the road."""
    nodes = [node for node in sorted(ways.areas) if list(ways.areas[node].values()) == [SIDEWALK, SIDEWALK]]
    nodes.sort(key=lambda node: ways.places[node][0])
    places = np.array([ways.places[node] for node in nodes]).reshape(-1, 3)
    starts = np.searchsorted(places[:, 0], places[:, 0] - _WIDEST)
    ends = np.searchsorted(places[:, 0], places[:, 0] + _WIDEST)
    free = np.ones(len(nodes), np.bool_)
    for number, node in enumerate(nodes):
        if not free[number]:
            continue
        near = slice(starts[number], ends[number])
        one, other = (np.array(ways.places[beside]) for beside in ways.areas[node])
        across = _across(places[near] - places[number], other - one)
        if across is None or not free[near][across]:
            continue
        opposite = near.start + across
        if _is_road(town, places[number], places[opposite]):
            ways.link(node, nodes[opposite], ROAD)
            for end in (number, opposite):
                around = slice(starts[end], ends[end])
                free[around] &= np.linalg.norm(places[around] - places[end], axis=1) >= _EVERY


def _across(away: Floats, along: Floats) -> int | None:
    """The nearest of some places that lies square to a sidewalk, and on its level."""
    distance = np.hypot(away[:, 0], away[:, 1])
    beside = np.abs(away[:, :2] @ along[:2]) / max(float(np.hypot(*along[:2])), _FACING)
    level = np.abs(away[:, 2]) < _LEVEL
    facing = np.flatnonzero(level & (beside < _FACING) & (distance > _NARROWEST) & (distance < _WIDEST))
    return int(facing[distance[facing].argmin()]) if len(facing) else None


def _is_road(town: Town, start: Floats, end: Floats) -> bool:
    """Whether enough of the line between two places lies on lanes for cars."""
    x, y, z = (start + np.linspace(0, 1, _SAMPLES)[:, None] * (end - start)).T
    lanes, s = town.nearest_lane(x, y, z=z)
    _, aside = town.project(lanes, x, y, s)
    half = np.array([town.lanes[lane].width / 2 for lane in lanes.tolist()])
    return float((np.abs(aside) < half).mean()) >= _LANES
