"""Solids of polygons, which are put together from simple bodies and become meshes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from math import cos, pi, radians, sin
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.scene.materials import Material

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

Point = Sequence[float]
"""x forward, y left, z up, in m."""
MaterialOf = Material | Callable[[int, int], Material]
"""A material, or a function that returns that of the facet between two rings and between two points of a ring."""

_MIRRORED: Final = {
    Material.LEFT_INDICATOR: Material.RIGHT_INDICATOR,
    Material.RIGHT_INDICATOR: Material.LEFT_INDICATOR,
}
_CREASE: Final = 38.0  # degrees; facets that meet at a greater angle have an edge
_SAME: Final = 5  # decimals of m to which points are the same


class Group(NamedTuple):
    """Triangles that move together.

    Attributes:
        vertices: The number of each vertex: its position, its normal and its material.
        triangles: The corners of the triangles of each material.
    """

    vertices: dict[tuple[float, ...], int]
    triangles: dict[Material, list[tuple[int, int, int]]]


MODELS: Final[dict[str, Callable[[Solid], None]]] = {}
"""The functions that add the models to a solid, by name."""


class _Facet(NamedTuple):
    points: Floats
    material: Material
    body: int
    pivot: tuple[float, float] | None


class Solid:
    """A solid of convex polygons. Seen from outside, their points run counterclockwise."""

    def __init__(self) -> None:
        self._facets: list[_Facet] = []
        self._bodies = 0
        self._pivot: tuple[float, float] | None = None

    def facet(self, points: Sequence[Point] | Floats, material: Material, *, body: int | None = None) -> None:
        """Add a convex polygon; of points that are the same, one is kept.

        Args:
            points: Its corners.
            material: The material.
            body: The body that it belongs to: within one, facets that meet at a small angle are shaded smoothly.
        """
        rows = points.tolist() if isinstance(points, np.ndarray) else points
        distinct = [row for row, before in zip(rows, (rows[-1], *rows), strict=False) if not _same(row, before)]
        if len(distinct) >= 3:
            corners = np.array(distinct, np.float64)
            self._facets.append(_Facet(corners, material, self._new_body() if body is None else body, self._pivot))

    def loft(self, rings: Sequence[Sequence[Point]] | Floats, material: MaterialOf, *, caps: bool = True) -> int:
        """Add a body between rings of equally many points; return its number.

        Args:
            rings: Closed rings, one behind the other; seen from the last one, their points run counterclockwise.
            material: The material, or that of the facet from ring i to i + 1 and from point j to j + 1. Of the caps, the
                first one has the numbers -1, 0, and the last one the number of the last ring, and 0.
            caps: Whether the first and the last ring are closed.
        """
        rows = rings.tolist() if isinstance(rings, np.ndarray) else rings
        body = self._new_body()
        for i, (ring, following) in enumerate(pairwise(rows)):
            for j in range(len(ring)):
                k = (j + 1) % len(ring)
                self.facet((ring[j], ring[k], following[k], following[j]), _material(material, i, j), body=body)
        if caps:
            self.facet(rows[0][::-1], _material(material, -1, 0), body=body)
            self.facet(rows[-1], _material(material, len(rows) - 1, 0), body=body)
        return body

    def box(self, low: Point, high: Point, material: MaterialOf, *, top: tuple[float, float] = (1.0, 1.0)) -> None:
        """Add a box with edges along the axes.

        Args:
            low: The corner with the least coordinates.
            high: The corner with the greatest ones.
            material: The material, or that of -1, 0 (bottom), 1, 0 (top), and 0, side: 0 rear, 1 right, 2 front, 3 left.
            top: The size of the upper side along x and y, as a share of the lower one.
        """
        center, half = (np.add(low, high) / 2)[:2], (np.subtract(high, low) / 2)[:2]
        outline = np.array(((-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (1.0, 1.0)))
        rings = [
            np.column_stack((center + outline * half * share, np.full(4, z)))
            for z, share in ((low[2], np.ones(2)), (high[2], np.array(top)))
        ]
        self.loft(np.array(rings), material)

    def limb(
        self,
        start: Point,
        end: Point,
        radii: Sequence[float],
        material: MaterialOf,
        *,
        sides: int = 6,
        flat: float = 1.0,
        caps: bool = True,
    ) -> None:
        """Add a tapered prism along a line.

        Args:
            start: The middle of its first end.
            end: The middle of its other end.
            radii: The radius at its start, at equal distances, and at its end.
            material: The material.
            sides: The number of its sides.
            flat: The radius across the line and the vertical, as a share of the other radius.
            caps: Whether its ends are closed; those within other bodies need not be.
        """
        axis = np.subtract(end, start)
        axis = axis / np.linalg.norm(axis)
        across = np.cross((0, 0, 1) if abs(axis[2]) < 0.9 else (1, 0, 0), axis)
        across /= np.linalg.norm(across)
        other = np.cross(axis, across)
        angles = (np.arange(sides) + 0.5) * 2 * pi / sides
        circle = np.outer(np.cos(angles), across * flat) + np.outer(np.sin(angles), other)
        middles = np.linspace(start, end, len(radii))
        self.loft(middles[:, None] + circle * np.array(radii)[:, None, None], material, caps=caps)

    def bent_limb(self, points: Sequence[Point], radii: Sequence[float], material: MaterialOf, *, sides: int = 6) -> None:
        """Add a prism along lines between joints, without gaps at those.

        Args:
            points: The joints.
            radii: The radius at each.
            material: The material, or that of the facet between two joints.
            sides: The number of its sides.
        """
        middles = np.array(points, np.float64)
        steps = np.diff(middles, axis=0)
        steps /= np.linalg.norm(steps, axis=1, keepdims=True)
        axes = np.concatenate((steps[:1], steps[:-1] + steps[1:], steps[-1:]))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        first = np.cross((1.0, 0.0, 0.0) if abs(steps[0, 2]) > 0.7 else (0.0, 0.0, 1.0), axes[0])
        directions = []
        for axis in axes:  # without a twist from one to the next
            first = first - axis * (first @ axis)
            first = first / np.linalg.norm(first)
            directions.append(first)
        across = np.array(directions)
        other = np.cross(axes, across)
        angles = (np.arange(sides) + 0.5) * 2 * pi / sides
        rings = np.cos(angles)[None, :, None] * across[:, None] + np.sin(angles)[None, :, None] * other[:, None]
        self.loft(middles[:, None] + rings * np.array(radii)[:, None, None], material)

    def ball(self, center: Point, radii: Point, material: MaterialOf, *, sides: int = 8, rings: int = 5) -> None:
        """Add an ellipsoid; its rings are numbered from the bottom, and the first point of each is in front."""
        shape = []
        for number in range(rings + 1):
            angle = -pi / 2 + pi * number / rings
            turn = np.arange(sides) * 2 * pi / sides
            share = max(cos(angle), 0.0)
            shape.append(np.column_stack((np.cos(turn) * share, np.sin(turn) * share, np.full(sides, sin(angle)))))
        self.loft(np.array(center) + np.array(shape) * np.array(radii), material, caps=False)

    def tube(
        self,
        profile: Sequence[tuple[float, float]],
        center: Point,
        material: MaterialOf,
        *,
        sides: int = 12,
        caps: bool = True,
    ) -> None:
        """Add a body of revolution about an axis along y.

        Args:
            profile: Radius and y of its outline, along increasing y on the outside; it ends with the hub of the left side.
            center: The point of the axis that y counts from.
            material: The material; rings are those of the profile.
            sides: The number of its sides.
            caps: Whether its ends are closed.
        """
        angles = (np.arange(sides) + 0.5) * 2 * pi / sides
        rings = [
            np.column_stack((np.sin(angles) * radius, np.full(sides, y), np.cos(angles) * radius)) for radius, y in profile
        ]
        self.loft(np.array(center) + np.array(rings), material, caps=caps)

    @contextmanager
    def steered(self, x: float, y: float) -> Iterator[None]:
        """Let what is added within this context belong to a wheel that is steered about a vertical axis."""
        self._pivot = x, y
        yield
        self._pivot = None

    def add(self, other: Solid, offset: Point = (0.0, 0.0, 0.0), *, yaw: float = 0.0) -> None:
        """Add another solid, turned to the left by an angle in degrees and then moved."""
        cosine, sine = cos(radians(yaw)), sin(radians(yaw))
        matrix = np.array(((cosine, -sine, 0.0), (sine, cosine, 0.0), (0.0, 0.0, 1.0)))
        for facet in other._facets:
            pivot = None
            if facet.pivot is not None:
                x, y = matrix[:2, :2] @ facet.pivot + np.array(offset)[:2]
                pivot = float(x), float(y)
            self._facets.append(
                _Facet(facet.points @ matrix.T + np.array(offset), facet.material, facet.body + self._bodies, pivot)
            )
        self._bodies += other._bodies

    def add_both(self, left: Solid) -> None:
        """Add a solid and its mirror image on the other side; indicators are those of their side."""
        self.add(left)
        for facet in left._facets:
            points = facet.points[::-1] * (1, -1, 1)
            pivot = None if facet.pivot is None else (facet.pivot[0], -facet.pivot[1])
            material = _MIRRORED.get(facet.material, facet.material)
            self._facets.append(_Facet(points, material, facet.body + self._bodies, pivot))
        self._bodies += left._bodies

    def groups(self) -> dict[tuple[float, float] | None, Group]:
        """Return the triangles of each steered wheel, by its axis, and of all that is not steered, by None."""
        sizes = np.array([len(facet.points) for facet in self._facets])
        owner = np.repeat(np.arange(len(sizes)), sizes)  # of each corner, its facet
        points = np.concatenate([facet.points for facet in self._facets])
        bodies = np.array([facet.body for facet in self._facets])[owner]
        normals = _smooth(points, bodies, owner, sizes)
        found: dict[tuple[float, float] | None, Group] = {}
        first = (np.cumsum(sizes) - sizes).tolist()
        for number, facet in enumerate(self._facets):
            group = found.setdefault(facet.pivot, Group({}, {}))
            start, size = first[number], int(sizes[number])
            corners = []
            for row in range(start, start + size):
                point = *np.round(points[row], _SAME).tolist(), *np.round(normals[row], 3).tolist()
                vertex = *(value + 0.0 for value in point), facet.material
                corners.append(group.vertices.setdefault(vertex, len(group.vertices)))
            rows = group.triangles.setdefault(facet.material, [])
            rows += [(corners[0], corners[k], corners[k + 1]) for k in range(1, size - 1)]
        return found

    def _new_body(self) -> int:
        self._bodies += 1
        return self._bodies


def model(add: Callable[[Solid], None], name: str | None = None) -> Callable[[Solid], None]:
    """List a model by a name, or by that of the function that adds it to a solid."""
    MODELS[name or add.__name__.strip("_").replace("_", " ")] = add
    return add


def _material(material: MaterialOf, ring: int, point: int) -> Material:
    return material if isinstance(material, Material) else material(ring, point)


def _same(one: Point, other: Point) -> bool:
    return all(abs(a - b) < 10.0**-_SAME for a, b in zip(one, other, strict=True))


def _distinct(rows: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the indices of distinct rows, and for each row the index of its like among them."""
    packed = np.ascontiguousarray(rows + 0.0).view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1])))[:, 0]
    _, kept, among = np.unique(packed, return_index=True, return_inverse=True)
    return kept, among.reshape(-1)


def _smooth(points: Floats, bodies: NDArray[np.intp], owner: NDArray[np.intp], sizes: NDArray[np.intp]) -> Floats:
    """Return the normals of corners: the mean of those facets of the body that meet there at small angles.

    Args:
        points: The corners of all facets, one after the other.
        bodies: The body of each corner.
        owner: The facet of each corner.
        sizes: The number of corners of each facet.
    """
    first = np.cumsum(sizes) - sizes
    following = np.arange(len(points)) + 1
    following[first + sizes - 1] = first
    areas = np.add.reduceat(np.cross(points, points[following]), first)  # twice the area, along the normal
    directions = areas / np.maximum(np.linalg.norm(areas, axis=1, keepdims=True), 1e-12)
    _, where = _distinct(np.column_stack((bodies, np.round(points, _SAME))))
    order = np.argsort(where, kind="stable")
    counts = np.bincount(where)
    begin = np.repeat(np.cumsum(counts) - counts, counts)
    each = np.repeat(counts, counts)
    one = np.repeat(np.arange(len(points)), each)
    other = np.repeat(begin, each) + np.arange(len(one)) - np.repeat(np.cumsum(each) - each, each)
    one, other = order[one], order[other]
    near = (directions[owner[one]] * directions[owner[other]]).sum(axis=1) >= cos(radians(_CREASE))
    total = np.zeros_like(points)
    np.add.at(total, one[near], areas[owner[other[near]]])
    lengths = np.linalg.norm(total, axis=1, keepdims=True)
    normals: Floats = np.where(lengths > 1e-12, total / np.maximum(lengths, 1e-12), directions[owner])
    return normals
