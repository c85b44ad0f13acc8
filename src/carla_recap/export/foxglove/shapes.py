"""Meshes and models as parts of entities: triangles of one colour each, which Foxglove shades flat."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.export.foxglove.messages import (
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
from carla_recap.formats.mcap.messages import LEN, tag, varint
from carla_recap.rendering.materials import MATERIALS, Material

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from numpy.typing import NDArray

    from carla_recap.export.style import Color as Rgb
    from carla_recap.rendering.mesh import Mesh

    Floats = NDArray[np.floating]
    Integers = NDArray[np.integer]

_POSE: Final = Pose(orientation=Quaternion(w=1.0))
"""The pose of what is where its points are."""


def color(rgb: Rgb, opacity: float = 1.0) -> Color:
    """Return a colour as Foxglove has it."""
    red, green, blue = (part / 255 for part in rgb)
    return Color(r=red, g=green, b=blue, a=opacity)


def triangles(points: Floats, corners: Integers, rgb: Rgb, opacity: float = 1.0) -> bytes:
    """Return a `TriangleListPrimitive`, as a field of an entity.

    Args:
        points: The points in m, (n, 3).
        corners: The indices of the corners, (m, 3).
        rgb: The colour.
        opacity: The opacity.
    """
    start = TriangleListPrimitive(pose=_POSE, color=color(rgb, opacity)).SerializeToString()
    rows = np.empty((len(points), len(_point().data)), np.uint8)
    rows[:] = np.frombuffer(_point().data, np.uint8)
    fields = rows.view(_point().dtype)[:, 0]
    for axis, column in zip("xyz", np.asarray(points, np.float32).T, strict=True):
        fields[axis] = column
    packed = corners.astype("<u4").tobytes()
    head = tag(TriangleListPrimitive.INDICES_FIELD_NUMBER, LEN) + varint(len(packed))
    return MessagePart(start + rows.tobytes() + head + packed).within(SceneEntity.TRIANGLES_FIELD_NUMBER).data


@cache
def _point() -> MessagePart:
    return numbers(Point3, "xyz").within(TriangleListPrimitive.POINTS_FIELD_NUMBER)


def cube(center: Floats, size: Floats, rgb: Rgb, opacity: float = 1.0) -> bytes:
    """Return a `CubePrimitive` along the axes of its frame, as a field of an entity."""
    x, y, z = np.asarray(center, np.float64).tolist()
    pose = Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(w=1.0))
    x, y, z = np.asarray(size, np.float64).tolist()
    shape = CubePrimitive(pose=pose, size=Vector3(x=x, y=y, z=z), color=color(rgb, opacity))
    return MessagePart(shape.SerializeToString()).within(SceneEntity.CUBES_FIELD_NUMBER).data


def mesh(found: Mesh, vertices: Floats, colors: dict[Material, Rgb] | None = None, opacity: float = 1.0) -> bytes:
    """Return a mesh, a primitive for each material.

    Args:
        found: The mesh.
        vertices: Its points in m, in the frame of the entity, (vertices, 3).
        colors: The colours of some materials, instead of their own.
        opacity: The opacity.
    """
    own = colors or {}
    return b"".join(
        triangles(points, corners, own.get(material, MATERIALS[material].color), opacity)
        for material, points, corners in _by_material(found, vertices)
    )


def _by_material(found: Mesh, vertices: Floats) -> Iterator[tuple[Material, Floats, Integers]]:
    """Yield the points and triangles of each material; points that are the same only once, since no normals are needed."""
    materials = found.materials[found.triangles[:, 0]] if len(found.triangles) else np.zeros(0, np.uint8)
    for number in np.unique(materials).tolist():
        corners = found.triangles[materials == number]
        used, corners = np.unique(corners, return_inverse=True)
        points, same = np.unique(np.asarray(vertices, np.float32)[used], axis=0, return_inverse=True)
        yield Material(number), points, same.reshape(-1)[corners.reshape(-1, 3)]


def groups(found: Mesh, vertices: Floats, materials: Collection[Material]) -> dict[Material, list[tuple[Floats, Floats]]]:
    """Return boxes around the parts of some materials: for each part, that is front, back, left or right, middle and size.

    Args:
        found: The mesh.
        vertices: Its points in m, (vertices, 3).
        materials: The materials.
    """
    parts: dict[Material, list[tuple[Floats, Floats]]] = {}
    width = max(float(np.abs(vertices[:, 1]).max(initial=0.0)), 1e-6)
    for material in materials:
        points = np.asarray(vertices, np.float64)[found.materials == material]
        ends, sides = points[:, 0] > 0, np.round(1.4 * points[:, 1] / width)
        for end in (True, False):
            for side in (-1, 0, 1):
                some = points[(ends == end) & (np.clip(sides, -1, 1) == side)]
                if len(some):
                    low, high = some.min(axis=0), some.max(axis=0)
                    parts.setdefault(material, []).append(((low + high) / 2, high - low))
    return parts
