"""Meshes and models as parts of entities: triangles of one colour each, which Foxglove shades flat."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.formats.mcap.codec import LEN, tag, varint
from carla_recap.scene.materials import Material
from carla_recap.show.foxglove.messages import (
    Color,
    CubePrimitive,
    MessagePart,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    TriangleListPrimitive,
    Vector3,
    numbers,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.scene.materials import Color as Rgb
    from carla_recap.scene.mesh import Mesh

    Floats = NDArray[np.floating]
    Integers = NDArray[np.integer]

_POSE: Final = Pose(orientation=Quaternion(w=1.0))
"""The pose of what is where its points are."""
_CORNERS: Final = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_FACES: Final = np.array(
    [
        part
        for a, b, c, d in ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
        for part in ((a, b, c), (a, c, d))
    ]
)


def color(rgb: Rgb) -> Color:
    """Return a colour as Foxglove has it."""
    red, green, blue = (part / 255 for part in rgb)
    return Color(r=red, g=green, b=blue, a=1.0)


def triangles(geometry: bytes, rgb: Rgb) -> bytes:
    """Return a `TriangleListPrimitive`, as a field of an entity.

    For the points and corners, see `geometries`.
    """
    start = TriangleListPrimitive(pose=_POSE, color=color(rgb)).SerializeToString()
    return MessagePart(start + geometry).within(SceneEntity.TRIANGLES_FIELD_NUMBER).data


def _geometry(points: Floats, corners: Integers) -> bytes:
    """Return points in m, (n, 3), and the indices of corners, (m, 3), as fields of a `TriangleListPrimitive`."""
    rows = np.empty((len(points), len(_point().data)), np.uint8)
    rows[:] = np.frombuffer(_point().data, np.uint8)
    fields = rows.view(_point().dtype)[:, 0]
    for axis, column in zip("xyz", np.asarray(points, np.float32).T, strict=True):
        fields[axis] = column
    packed = corners.astype("<u4").tobytes()
    return rows.tobytes() + tag(TriangleListPrimitive.INDICES_FIELD_NUMBER, LEN) + varint(len(packed)) + packed


@cache
def _point() -> MessagePart:
    return numbers(Point3, "xyz").within(TriangleListPrimitive.POINTS_FIELD_NUMBER)


def cube(center: Floats, size: Floats, rgb: Rgb) -> bytes:
    """Return a `CubePrimitive` along the axes of its frame, as a field of an entity."""
    x, y, z = np.asarray(center, np.float64).tolist()
    pose = Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(w=1.0))
    x, y, z = np.asarray(size, np.float64).tolist()
    shape = CubePrimitive(pose=pose, size=Vector3(x=x, y=y, z=z), color=color(rgb))
    return MessagePart(shape.SerializeToString()).within(SceneEntity.CUBES_FIELD_NUMBER).data


def box(center: Floats, size: Floats, rgb: Rgb) -> bytes:
    """Return the triangles of a box along the axes of its frame, which has no outlines, unlike a cube."""
    return triangles(_geometry(center + _CORNERS * size, _FACES), rgb)


class Surfaces(NamedTuple):
    """The triangles of a mesh that have one material and colour."""

    material: Material
    color: Rgb  # red, green and blue
    vertices: Integers  # the positions of their points among the vertices of the mesh; points that are the same only once
    corners: Integers  # the indices of the corners among these points, (m, 3)


def surfaces(found: Mesh) -> list[Surfaces]:
    """Return the triangles of a mesh by their materials and colours."""
    keys = np.column_stack((found.materials, found.painted())).astype(np.uint8).view("<u4")[:, 0][found.triangles[:, 0]]
    parts = []
    for key in np.unique(keys).tolist():
        number, red, green, blue = key.to_bytes(4, "little")
        used, corners = np.unique(found.triangles[keys == key], return_inverse=True)
        first, same = _points(found.vertices[used])
        parts.append(Surfaces(Material(number), (red, green, blue), used[first], same[corners.reshape(-1, 3)]))
    return parts


def _points(vertices: Floats) -> tuple[Integers, Integers]:
    """Return the first vertex at each point, and the point of each vertex, by their indices."""
    order = np.lexsort(vertices.T[::-1])  # which is faster than np.unique of rows
    fresh = np.ones(len(order), np.bool_)
    fresh[1:] = (vertices[order[1:]] != vertices[order[:-1]]).any(axis=1)
    same = np.empty(len(order), np.intp)
    same[order] = np.cumsum(fresh) - 1
    return order[fresh], same


def geometries(parts: Iterable[Surfaces], vertices: Floats) -> list[tuple[Surfaces, bytes]]:
    """Return the points and corners of triangles.

    The points of the mesh are in m, in the frame of the entity, (vertices, 3).
    """
    return [(part, _geometry(vertices[part.vertices], part.corners)) for part in parts]


def mesh(found: Mesh) -> bytes:
    """Return a mesh, a primitive for each material and colour."""
    return b"".join(triangles(geometry, part.color) for part, geometry in geometries(surfaces(found), found.vertices))


def boxes(part: Surfaces, vertices: Floats) -> list[tuple[Floats, Floats]]:
    """Return boxes around connected triangles: the middle and the size of each."""
    points, labels = np.asarray(vertices, np.float64)[part.vertices], np.arange(len(part.vertices))
    while True:  # each point gets the least label of its triangles, until nothing changes
        least = labels[part.corners].min(axis=1)
        new = labels.copy()
        np.minimum.at(new, part.corners, least[:, None])
        if (new == labels).all():
            break
        labels = new
    found = [points[labels == label] for label in np.unique(labels).tolist()]
    return [((some.min(axis=0) + some.max(axis=0)) / 2, np.ptp(some, axis=0)) for some in found]
