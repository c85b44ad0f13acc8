"""What stands beside roads: traffic signs and lights, what stops cars, and trees."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.roads.barriers import barriers, left_handed
from carla_recap.roads.opendrive import LIGHT, SPEED_LIMIT, STOP, YIELD
from carla_recap.scene.materials import Material
from carla_recap.town.building import UP, circle
from carla_recap.town.markings import glyphs
from carla_recap.town.road_surfaces import KERB_HEIGHT

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.roads.lanes import LaneGeometry
    from carla_recap.roads.opendrive import Road
    from carla_recap.town.building import MeshBuilder, TriangleGrid
    from carla_recap.town.road_surfaces import SampledSection
    from carla_recap.town.terrain import Terrain
    from carla_recap.util.arrays import Floats, Integers


_MOST_SIGNS: Final = 20_000
_PLATE_HEIGHT: Final = 2.4  # m from the ground to the middle of a plate
_PLATE_RADIUS: Final = 0.38  # m
_POLE: Final = 0.04  # m
_LAYER: Final = 0.006  # m from one layer of a plate to the next
_SIGNS_APART: Final = 0.5  # m between two signs
_BEAMS: Final = {Material.GUARD_RAIL: ((0.45, 0.75),), Material.FENCE: ((0.42, 0.47), (0.90, 0.96))}
"""The heights in m of the lower and the upper side of beams."""
_BETWEEN: Final = {Material.GUARD_RAIL: 4.0, Material.FENCE: 2.5}  # m, at least, between posts
_BEAM_HALF: Final = {Material.GUARD_RAIL: 0.06, Material.FENCE: 0.03}  # m, half of it
_ROOT: Final = 0.5  # m by which posts reach below the line
_TREE_CELL: Final = 12.0  # m of a square with one tree at most
_NEAR_ROADS: Final = 3  # squares from a road, within which there are trees
_NEAR_JUNCTIONS: Final = 2  # squares from a junction, within which there is none
_SHARE: Final = 0.35  # of the squares have a tree
_TREE_ROOM: Final = 9.0  # m from any road or sidewalk
_MOST_TREES: Final = 2000
_STEEP: Final = 0.15
_SIDES: Final = 4  # of a trunk
_SEED: Final = 20  # the same trees in each run


@dataclass(frozen=True, eq=False)
class LightPost:
    """The position of a traffic light of a map."""

    id: str  # the OpenDRIVE id of the signal
    location: Floats  # the foot of the pole, in m, (3,)
    heading: float  # the direction that the light faces, towards the drivers, in radians


class _Sign(NamedTuple):
    kind: str
    text: str
    location: Floats
    heading: float


def light_posts(roads: Sequence[Road], ground: TriangleGrid) -> list[LightPost]:
    """Return the traffic lights of roads, on the ground."""
    lights: dict[str, LightPost] = {}
    for road in roads:
        for signal in road.signals:
            if signal.kind == LIGHT and signal.id not in lights and len(lights) < _MOST_SIGNS:
                point, heading = road.place_of(signal)
                if np.isfinite(point).all():
                    location = _grounded(point, ground)
                    lights[signal.id] = LightPost(signal.id, location, heading + np.pi)
    return list(lights.values())


def add_signs(builder: MeshBuilder, roads: Sequence[Road], ground: TriangleGrid, driving: TriangleGrid) -> None:
    """Add speed limits, yield and stop signs with their poles, but not those on lanes for cars."""
    known: set[tuple[int, ...]] = set()
    for sign in _signs(roads):
        key = tuple(np.rint(sign.location / _SIGNS_APART).astype(np.int64).tolist())
        if key in known or len(known) >= _MOST_SIGNS or np.isfinite(driving.highest(sign.location[None])[0]):
            continue
        known.add(key)
        foot = _grounded(sign.location, ground)
        _add_pole(builder, foot)
        for layer, (shape, material) in enumerate(_plate(sign)):
            _add_plate(builder, foot, sign.heading, shape, material, layer)


def _signs(roads: Sequence[Road]) -> Iterator[_Sign]:
    for road in roads:
        for signal in road.signals:
            if signal.kind in (SPEED_LIMIT, STOP, YIELD):
                point, heading = road.place_of(signal)
                text = f"{signal.value:.0f}" if 0 < signal.value < 1000 else ""
                yield _Sign(signal.kind, text, point, heading + np.pi)
        for thing in road.objects:
            if thing.speed_limit is not None:
                point, heading = road.at(thing.station, thing.offset)
                yield _Sign(SPEED_LIMIT, f"{thing.speed_limit:.0f}", point, heading + thing.heading + np.pi)


def _grounded(point: Floats, ground: TriangleGrid) -> Floats:
    height = ground.highest(point[None])[0]
    return np.array((point[0], point[1], height if np.isfinite(height) else point[2]))


def _plate(sign: _Sign) -> Iterator[tuple[Floats, Material]]:
    """Yield the layers of a plate from the back: polygons upwards and to the left, as seen by drivers."""
    if sign.kind == SPEED_LIMIT:
        yield _regular(18, _PLATE_RADIUS), Material.SIGN_RED
        yield _regular(18, 0.78 * _PLATE_RADIUS), Material.SIGN_WHITE
        width = (0.34 if len(sign.text) < 3 else 0.46) * (1 if len(sign.text) > 1 else 0.4)
        letters, material = glyphs(sign.text, width, 0.3), Material.SIGN_BLACK
    elif sign.kind == STOP:
        yield _regular(8, _PLATE_RADIUS * 1.05, np.pi / 8), Material.SIGN_WHITE
        yield _regular(8, _PLATE_RADIUS * 0.98, np.pi / 8), Material.SIGN_RED
        letters, material = glyphs("STOP", 0.54, 0.22), Material.SIGN_WHITE
    else:
        yield _regular(3, _PLATE_RADIUS * 1.25, np.pi), Material.SIGN_RED
        yield _regular(3, _PLATE_RADIUS * 0.75, np.pi), Material.SIGN_WHITE
        return
    for letter in letters:
        yield letter, material


def _regular(count: int, radius: float, turn: float = 0.0) -> Floats:
    return radius * circle(count, turn)[:-1, :2]


def _add_plate(builder: MeshBuilder, foot: Floats, heading: float, shape: Floats, material: Material, layer: int) -> None:
    forward = np.array((np.cos(heading), np.sin(heading), 0.0))  # towards the drivers
    left = np.array((np.sin(heading), -np.cos(heading), 0.0))  # as they see it
    middle = foot + _PLATE_HEIGHT * UP + (_POLE + (1 + min(layer, 2)) * _LAYER) * forward
    corners = middle + shape[:, :1] * UP + shape[:, 1:] * left
    builder.add_polygon(corners, forward, material)
    if layer == 0:
        builder.add_polygon(corners[::-1] - _LAYER * forward, -forward, Material.SIGN_BACK)


def _add_pole(builder: MeshBuilder, foot: Floats) -> None:
    around = circle(6)
    bottom = foot + _POLE * around - (0.0, 0.0, 0.3)
    top = foot + _POLE * around + (0.0, 0.0, _PLATE_HEIGHT + 0.3)
    builder.add_strip(top, bottom, around, Material.POLE, np.ones(6, np.bool_))
    builder.add_polygon(top[:6], UP, Material.POLE)


def add_barriers(builder: MeshBuilder, lanes: Sequence[LaneGeometry]) -> None:
    """Add the barriers that stop cars in the simulator."""
    for line, is_behind_sidewalk in barriers(lanes):
        points = left_handed(line)  # which turns it back
        material = Material.FENCE if is_behind_sidewalk else Material.GUARD_RAIL
        points[:, 2] += KERB_HEIGHT if is_behind_sidewalk else 0.0
        thickness = _BEAM_HALF[material]
        for low, high in _BEAMS[material]:
            _add_beams(builder, points, low, high, thickness, material)
        top = _BEAMS[material][-1][1]
        for start, stop in pairwise(points):
            along = stop - start
            length = float(np.linalg.norm(along))
            count = max(int(length / _BETWEEN[material]), 1)
            middles = start + np.arange(count + 1)[:, None] / count * along
            along *= thickness / max(length, 1e-6)
            across = np.array((-along[1], along[0], 0.0))
            for side in (along, across):
                _add_sides(builder, middles - side, middles + side, -_ROOT, top, thickness, material)


def _add_beams(builder: MeshBuilder, points: Floats, low: float, high: float, half: float, material: Material) -> None:
    """Add beams between successive points, from a height to another, without ends that are closed."""
    start, stop = points[:-1], points[1:]
    aside = half * _add_sides(builder, start, stop, low, high, half, material)
    top = np.stack((start - aside, stop - aside, stop + aside, start + aside), axis=1) + high * UP
    builder.add_quads(top, np.broadcast_to(UP, start.shape), material)


def _add_sides(
    builder: MeshBuilder, start: Floats, stop: Floats, low: float, high: float, half: float, material: Material
) -> Floats:
    """Add the left and the right side of beams, and return the directions to the left, (n, 3)."""
    along = stop - start
    left: Floats = np.stack((-along[:, 1], along[:, 0], np.zeros(len(along))), axis=1)
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)
    below, above = low * UP, high * UP
    for first, last, normals in ((stop, start, left), (start, stop, -left)):
        corners = np.stack((first + below, last + below, last + above, first + above), axis=1)
        builder.add_quads(corners + half * normals[:, None], normals, material)
    return left


def add_trees(builder: MeshBuilder, sections: Sequence[SampledSection], surfaces: TriangleGrid, terrain: Terrain) -> None:
    """Add trees at a distance from roads and junctions."""
    cells = _cells(sections)
    random = np.random.default_rng(_SEED)
    chances = random.random((len(cells), 6))
    feet = (cells + 0.2 + 0.6 * chances[:, :2]) * _TREE_CELL
    chosen = np.flatnonzero((chances[:, 2] < _SHARE) & _have_room(feet, surfaces) & ~_are_steep(feet, terrain))[:_MOST_TREES]
    heights = terrain.heights(feet[chosen])
    for (x, y), z, (size, turn, kind) in zip(feet[chosen], heights, chances[chosen, 3:], strict=True):
        _add_tree(builder, np.array((x, y, z)), 0.8 + 0.5 * size, 2 * np.pi * turn, is_conifer=kind < 0.3)


def _cells(sections: Sequence[SampledSection]) -> Integers:
    """Return the squares near roads and not near junctions, in an order that does not depend on the order of roads."""
    taken: dict[bool, set[tuple[int, int]]] = defaultdict(set)
    for section in sections:
        points = section.borders[[0, -1]].reshape(-1, 3)[:, :2]
        taken[section.road.in_junction].update((x, y) for x, y in np.floor(points / _TREE_CELL).astype(np.int64).tolist())
    near = _around(taken[False], _NEAR_ROADS) - _around(taken[True], _NEAR_JUNCTIONS)
    return np.array(sorted(near), np.int64).reshape(-1, 2)


def _around(cells: set[tuple[int, int]], distance: int) -> set[tuple[int, int]]:
    steps = range(-distance, distance + 1)
    return {(x + dx, y + dy) for x, y in cells for dx in steps for dy in steps}


def _have_room(feet: Floats, surfaces: TriangleGrid) -> NDArray[np.bool_]:
    ring = circle(12)[:-1, :2]
    offsets = np.concatenate((np.zeros((1, 2)), ring[::2] * _TREE_ROOM / 2, ring * _TREE_ROOM))
    index, _, _ = surfaces.hits((feet[:, None] + offsets).reshape(-1, 2))
    room = np.ones(len(feet), np.bool_)
    room[index // len(offsets)] = False
    return room


def _are_steep(feet: Floats, terrain: Terrain) -> NDArray[np.bool_]:
    slopes = [np.abs(terrain.heights(feet + step) - terrain.heights(feet - step)) for step in ((5.0, 0.0), (0.0, 5.0))]
    steep: NDArray[np.bool_] = np.maximum(*slopes) > 10 * _STEEP
    return steep


def _add_tree(builder: MeshBuilder, foot: Floats, size: float, turn: float, *, is_conifer: bool) -> None:
    around = circle(_SIDES, turn)
    top, bottom = (
        foot + around * radius * size + (0.0, 0.0, height * size) for radius, height in ((0.1, 2.6), (0.18, -0.4))
    )
    builder.add_strip(top, bottom, around, Material.TRUNK, np.ones(_SIDES, np.bool_))
    levels = ((1.9, 1.4), (1.1, 3.8), (0.0, 6.2)) if is_conifer else ((0.9, 1.9), (1.9, 3.2), (1.5, 4.6), (0.0, 5.6))
    count = 6
    around = circle(count, turn)
    rings = [foot + size * (radius * around + np.array((0.0, 0.0, height))) for radius, height in levels]
    middle = (levels[0][1] + levels[-1][1]) / 2
    for lower, upper in pairwise(rings):
        outwards = (lower + upper) / 2 - foot - (0.0, 0.0, size * middle)
        outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
        builder.add_strip(upper, lower, outwards, Material.FOLIAGE, np.ones(count, np.bool_))
    builder.add_polygon(rings[0][:count][::-1], np.array((0.0, 0.0, -1.0)), Material.FOLIAGE)
