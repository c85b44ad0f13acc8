"""Solids of polygons, which are put together from simple bodies and become meshes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, pi, radians, sin
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.rendering.materials import Material
from carla_recap.rendering.mesh import Mesh

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


@dataclass(frozen=True, eq=False)
class Model:
    """A mesh that stands for actors of a class.

    Attributes:
        name: A short name, such as `sedan`.
        mesh: The mesh, which fills the box from -1 to 1 along each axis: x forward, y left, z up. Its normals are those of
            the scaled-down mesh: divided by the half extents of a box and normalised, they are those in the box.
        steered: Whether each vertex belongs to a steered wheel, (vertices,).
        pivots: The x and y of the axis about which each vertex is steered, 0 of one that is not, (vertices, 2).
        size: The size in m, along each axis, of which its proportions are right.
        center: The middle of the box of that size, from the origin of the actor that it stands for, in m.
    """

    name: str
    mesh: Mesh
    steered: NDArray[np.bool_]
    pivots: NDArray[np.float32]
    size: tuple[float, float, float]
    center: tuple[float, float, float]


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
        corners = np.array(points, np.float64)
        distinct = np.abs(corners - np.roll(corners, 1, axis=0)).max(axis=1) > 10.0**-_SAME
        if distinct.sum() >= 3:
            self._facets.append(_Facet(corners[distinct], material, self._new_body() if body is None else body, self._pivot))

    def loft(self, rings: Sequence[Sequence[Point]] | Floats, material: MaterialOf, *, caps: bool = True) -> int:
        """Add a body between rings of equally many points; return its number.

        Args:
            rings: Closed rings, one behind the other; seen from the last one, their points run counterclockwise.
            material: The material, or that of the facet from ring i to i + 1 and from point j to j + 1. Of the caps, the
                first one has the numbers -1, 0, and the last one the number of the last ring, and 0.
            caps: Whether the first and the last ring are closed.
        """
        points = np.array(rings, np.float64)
        body = self._new_body()
        count = points.shape[1]
        for i in range(len(points) - 1):
            for j in range(count):
                k = (j + 1) % count
                corners = (points[i, j], points[i, k], points[i + 1, k], points[i + 1, j])
                self.facet(np.array(corners), _material(material, i, j), body=body)
        if caps:
            self.facet(points[0, ::-1], _material(material, -1, 0), body=body)
            self.facet(points[-1], _material(material, len(points) - 1, 0), body=body)
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
        self, start: Point, end: Point, radii: Sequence[float], material: MaterialOf, *, sides: int = 6, flat: float = 1.0
    ) -> None:
        """Add a tapered prism along a line.

        Args:
            start: The middle of its first end.
            end: The middle of its other end.
            radii: The radius at its start, at equal distances, and at its end.
            material: The material.
            sides: The number of its sides.
            flat: The radius across the line and the vertical, as a share of the other radius.
        """
        axis = np.subtract(end, start)
        axis = axis / np.linalg.norm(axis)
        across = np.cross((0, 0, 1) if abs(axis[2]) < 0.9 else (1, 0, 0), axis)
        across /= np.linalg.norm(across)
        other = np.cross(axis, across)
        angles = (np.arange(sides) + 0.5) * 2 * pi / sides
        circle = np.outer(np.cos(angles), across * flat) + np.outer(np.sin(angles), other)
        middles = np.linspace(start, end, len(radii))
        self.loft(middles[:, None] + circle * np.array(radii)[:, None, None], material)

    def ball(self, center: Point, radii: Point, material: MaterialOf, *, sides: int = 8, rings: int = 5) -> None:
        """Add an ellipsoid; its rings are numbered from the bottom, and the first point of each is in front."""
        shape = []
        for number in range(rings + 1):
            angle = -pi / 2 + pi * number / rings
            turn = np.arange(sides) * 2 * pi / sides
            share = max(cos(angle), 0.0)
            shape.append(np.column_stack((np.cos(turn) * share, np.sin(turn) * share, np.full(sides, sin(angle)))))
        self.loft(np.array(center) + np.array(shape) * np.array(radii), material, caps=False)

    def tube(self, profile: Sequence[tuple[float, float]], center: Point, material: MaterialOf, *, sides: int = 12) -> None:
        """Add a body of revolution about an axis along y.

        Args:
            profile: Radius and y of its outline, along increasing y on the outside; it ends with the hub of the left side.
            center: The point of the axis that y counts from.
            material: The material; rings are those of the profile.
            sides: The number of its sides.
        """
        angles = (np.arange(sides) + 0.5) * 2 * pi / sides
        rings = [
            np.column_stack((np.sin(angles) * radius, np.full(sides, y), np.cos(angles) * radius)) for radius, y in profile
        ]
        self.loft(np.array(center) + np.array(rings), material)

    def steered(self, x: float, y: float) -> _Steered:
        """Return a context: what is added in it belongs to a wheel that is steered about a vertical axis."""
        return _Steered(self, (x, y))

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

    def model(self, name: str) -> Model:
        """Return the model: scaled to fill the box from -1 to 1 along each axis."""
        everything = np.concatenate([facet.points for facet in self._facets])
        low, high = everything.min(axis=0), everything.max(axis=0)
        center, half = (low + high) / 2, np.maximum((high - low) / 2, 1e-6)
        normals = [_normal(facet.points) for facet in self._facets]
        smooth = self._smooth(normals)
        vertices: list[Floats] = []
        directions: list[Floats] = []
        materials: list[int] = []
        pivots: list[tuple[float, float] | None] = []
        triangles: list[tuple[int, int, int]] = []
        known: dict[tuple[object, ...], int] = {}
        for facet, corners in zip(self._facets, smooth, strict=True):
            index = []
            for point, normal in zip(facet.points, corners, strict=True):
                key = (*np.round(point, _SAME), *np.round(normal, 3), facet.material, facet.pivot)
                if key not in known:
                    known[key] = len(vertices)
                    vertices.append((point - center) / half)
                    directions.append(normal * half)
                    materials.append(facet.material)
                    pivots.append(facet.pivot)
                index.append(known[key])
            triangles += [(index[0], index[i], index[i + 1]) for i in range(1, len(index) - 1)]
        steering = np.array([(0.0, 0.0) if pivot is None else pivot for pivot in pivots])
        steered = np.array([pivot is not None for pivot in pivots])
        stretched = np.array(directions)
        mesh = Mesh(
            np.clip(np.array(vertices), -1, 1).astype(np.float32),
            (stretched / np.linalg.norm(stretched, axis=1, keepdims=True)).astype(np.float32),
            np.array(materials, np.uint8),
            np.array(triangles, np.uint32),
        )
        axes = np.where(steered[:, None], (steering - center[:2]) / half[:2], 0.0).astype(np.float32)
        length, width, height = (2 * half).tolist()
        x, y, z = center.tolist()
        return Model(name, mesh, steered, axes, (length, width, height), (x, y, z))

    def _smooth(self, normals: list[Floats]) -> list[Floats]:
        """Return the normals of the corners of each facet: the mean of those facets that meet at small angles."""
        around: defaultdict[tuple[object, ...], list[int]] = defaultdict(list)
        keys = []
        for number, facet in enumerate(self._facets):
            keys.append([(facet.body, *point) for point in np.round(facet.points, _SAME).tolist()])
            for key in keys[-1]:
                around[key].append(number)
        directions = np.array(normals)
        directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-12)
        least = cos(radians(_CREASE))
        found = []
        for number, corners in enumerate(keys):
            mean = np.empty((len(corners), 3))
            for index, key in enumerate(corners):
                others = around[key]
                near = [other for other in others if directions[other] @ directions[number] >= least]
                total = sum((normals[other] for other in near), np.zeros(3))
                mean[index] = total / max(float(np.linalg.norm(total)), 1e-12) if near else directions[number]
            found.append(mean)
        return found

    def _new_body(self) -> int:
        self._bodies += 1
        return self._bodies


class _Steered:
    """Marks what is added to a solid as a steered wheel."""

    def __init__(self, solid: Solid, pivot: tuple[float, float]) -> None:
        self._solid = solid
        self._pivot = pivot

    def __enter__(self) -> None:
        self._solid._pivot = self._pivot

    def __exit__(self, *exception: object) -> None:
        self._solid._pivot = None


def _material(material: MaterialOf, ring: int, point: int) -> Material:
    return material if isinstance(material, Material) else material(ring, point)


def _normal(points: Floats) -> Floats:
    """Return the normal of a polygon; its length is twice the area."""
    normal: Floats = np.cross(points, np.roll(points, -1, axis=0)).sum(axis=0)
    return normal
