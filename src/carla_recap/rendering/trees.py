"""Trees beside the roads, where there is room: not in maps, but they let distance and speed be seen."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.scene.materials import Material

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.rendering.building import MeshBuilder
    from carla_recap.rendering.heights import TriangleGrid
    from carla_recap.rendering.surfaces import SampledSection
    from carla_recap.rendering.terrain import Terrain

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

_CELL: Final = 12.0  # m of a square with one tree at most
_NEAR: Final = 3  # squares from a road, within which there are trees
_JUNCTION: Final = 2  # squares from a junction, within which there is none
_SHARE: Final = 0.35  # of the squares have a tree
_ROOM: Final = 9.0  # m from any road or sidewalk
_MOST: Final = 2000
_STEEP: Final = 0.15
_SIDES: Final = 4  # of a trunk
_SEED: Final = 20  # the same trees in each run


def add_trees(builder: MeshBuilder, sections: Sequence[SampledSection], surfaces: TriangleGrid, terrain: Terrain) -> None:
    """Add trees at a distance from roads and junctions.

    Args:
        builder: Collects the triangles.
        sections: The sections of roads.
        surfaces: All surfaces of roads.
        terrain: The ground.
    """
    cells = _cells(sections)
    random = np.random.default_rng(_SEED)
    chances = random.random((len(cells), 6))
    feet = (cells + 0.2 + 0.6 * chances[:, :2]) * _CELL
    chosen = np.flatnonzero((chances[:, 2] < _SHARE) & _have_room(feet, surfaces) & ~_are_steep(feet, terrain))[:_MOST]
    heights = terrain.heights(feet[chosen])
    for (x, y), z, (size, turn, kind) in zip(feet[chosen], heights, chances[chosen, 3:], strict=True):
        _add_tree(builder, np.array((x, y, z)), 0.8 + 0.5 * size, 2 * np.pi * turn, is_conifer=kind < 0.3)


def _cells(sections: Sequence[SampledSection]) -> Integers:
    """Return the squares near roads and not near junctions, in an order that does not depend on the order of roads."""
    taken: dict[bool, set[tuple[int, int]]] = defaultdict(set)
    for section in sections:
        points = section.borders[[0, -1]].reshape(-1, 3)[:, :2]
        taken[section.road.in_junction].update((x, y) for x, y in np.floor(points / _CELL).astype(np.int64).tolist())
    near = _around(taken[False], _NEAR) - _around(taken[True], _JUNCTION)
    return np.array(sorted(near), np.int64).reshape(-1, 2)


def _around(cells: set[tuple[int, int]], distance: int) -> set[tuple[int, int]]:
    steps = range(-distance, distance + 1)
    return {(x + dx, y + dy) for x, y in cells for dx in steps for dy in steps}


def _have_room(feet: Floats, surfaces: TriangleGrid) -> NDArray[np.bool_]:
    angles = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    ring = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    offsets = np.concatenate((np.zeros((1, 2)), ring[::2] * _ROOM / 2, ring * _ROOM))
    index, _, _ = surfaces.hits((feet[:, None] + offsets).reshape(-1, 2))
    room = np.ones(len(feet), np.bool_)
    room[index // len(offsets)] = False
    return room


def _are_steep(feet: Floats, terrain: Terrain) -> NDArray[np.bool_]:
    slopes = [np.abs(terrain.heights(feet + step) - terrain.heights(feet - step)) for step in ((5.0, 0.0), (0.0, 5.0))]
    steep: NDArray[np.bool_] = np.maximum(*slopes) > 10 * _STEEP
    return steep


def _add_tree(builder: MeshBuilder, foot: Floats, size: float, turn: float, *, is_conifer: bool) -> None:
    angles = turn + np.arange(_SIDES + 1) * 2 * np.pi / _SIDES
    around = np.stack((np.cos(angles), np.sin(angles), np.zeros(_SIDES + 1)), axis=1)
    top, bottom = (
        foot + around * radius * size + (0.0, 0.0, height * size) for radius, height in ((0.1, 2.6), (0.18, -0.4))
    )
    builder.add_strip(top, bottom, around, Material.TRUNK, np.ones(_SIDES, np.bool_))
    levels = ((1.9, 1.4), (1.1, 3.8), (0.0, 6.2)) if is_conifer else ((0.9, 1.9), (1.9, 3.2), (1.5, 4.6), (0.0, 5.6))
    count = 6
    angles = turn + np.arange(count + 1) * 2 * np.pi / count
    around = np.stack((np.cos(angles), np.sin(angles), np.zeros(count + 1)), axis=1)
    rings = [foot + size * (radius * around + np.array((0.0, 0.0, height))) for radius, height in levels]
    middle = (levels[0][1] + levels[-1][1]) / 2
    for lower, upper in pairwise(rings):
        outwards = (lower + upper) / 2 - foot - (0.0, 0.0, size * middle)
        outwards /= np.linalg.norm(outwards, axis=1, keepdims=True)
        builder.add_strip(upper, lower, outwards, Material.FOLIAGE, np.ones(count, np.bool_))
    builder.add_polygon(rings[0][:count][::-1], np.array((0.0, 0.0, -1.0)), Material.FOLIAGE)
