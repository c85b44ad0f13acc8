"""How actors look: bodies, lit lamps, and what traffic lights show, as entities in the frames of the actors.

Meshes and models are triangles of one colour each, which Foxglove shades flat.
"""

from __future__ import annotations

import math
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.formats.mcap.codec import LEN, tag, varint
from carla_recap.scene import materials, style
from carla_recap.scene.appearance import Look, look_of_present
from carla_recap.scene.lamps import state_of_lamps
from carla_recap.scene.materials import Material
from carla_recap.scene.models import MODELS
from carla_recap.show.foxglove.messages import (
    Color,
    CubePrimitive,
    KeyValuePair,
    LinePrimitive,
    MessagePart,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    TextPrimitive,
    TriangleListPrimitive,
    Vector3,
    numbers,
    timestamp,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorLife
    from carla_recap.scene.falls import Fall
    from carla_recap.scene.materials import Color as Rgb
    from carla_recap.scene.mesh import Mesh
    from carla_recap.util.arrays import Floats

    Coordinates = NDArray[np.floating]
    Integers = NDArray[np.integer]

_POSE: Final = Pose(orientation=Quaternion(w=1.0))
"""The pose of what is where its points are."""
_POINT: Final = numbers(Point3, "xyz").within(TriangleListPrimitive.POINTS_FIELD_NUMBER)
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


def _triangles(points: Coordinates, corners: Integers, rgb: Rgb) -> bytes:
    """Return points in m, (n, 3), and the indices of corners, (m, 3), as a `TriangleListPrimitive`, a field of an entity."""
    start = TriangleListPrimitive(pose=_POSE, color=color(rgb)).SerializeToString()
    rows = np.empty((len(points), len(_POINT.data)), np.uint8)
    rows[:] = np.frombuffer(_POINT.data, np.uint8)
    fields = rows.view(_POINT.dtype)[:, 0]
    for axis, column in zip("xyz", np.asarray(points, np.float32).T, strict=True):
        fields[axis] = column
    packed = corners.astype("<u4").tobytes()
    indices = tag(TriangleListPrimitive.INDICES_FIELD_NUMBER, LEN) + varint(len(packed)) + packed
    return MessagePart(start + rows.tobytes() + indices).within(SceneEntity.TRIANGLES_FIELD_NUMBER).data


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


def _points(vertices: Coordinates) -> tuple[Integers, Integers]:
    """Return the first vertex at each point, and the point of each vertex, by their indices."""
    order = np.lexsort(vertices.T[::-1])  # which is faster than np.unique of rows
    fresh = np.ones(len(order), np.bool_)
    fresh[1:] = (vertices[order[1:]] != vertices[order[:-1]]).any(axis=1)
    same = np.empty(len(order), np.intp)
    same[order] = np.cumsum(fresh) - 1
    return order[fresh], same


def mesh_shape(found: Mesh) -> bytes:
    """Return a mesh, a primitive for each material and colour."""
    return b"".join(_triangles(found.vertices[part.vertices], part.corners, part.color) for part in surfaces(found))


def boxes(part: Surfaces, vertices: Coordinates) -> list[tuple[Coordinates, Coordinates]]:
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


VEHICLES: Final = "/scene/vehicles"
WALKERS: Final = "/scene/walkers"
OTHERS: Final = "/scene/others"
LAMPS: Final = "/scene/lamps"
SIGNALS: Final = "/scene/signals"

TIMESTAMP: Final = timestamp(SceneEntity.TIMESTAMP_FIELD_NUMBER)
"""The end of an entity, the only part of it that differs from message to message."""

_ANY_COLOR: Final = (0, 0, 0)
_MARGIN: Final = 0.03  # m by which a lit lamp is larger than the unlit one, within which it is
_SIGNAL: Final = 0.46  # m; the diameter of a lit lamp of a traffic light, which is seen from far away
_SIGNAL_HEIGHT: Final = 1.1  # m; from the lowest to the highest lamp's edge
_RING: Final = 1.0  # m; the radius of the ring around the light ahead
_RING_AHEAD: Final = 0.4  # m in front of the light
_RING_WIDTH: Final = 0.1  # m
_RING_POINTS: Final = 32
_LABEL: Final = 0.5  # m above the ring
_FONT: Final = 14.0  # pixels


def frame_of(id: int) -> str:
    """Return the frame of an actor, which is the id of its entity, too."""
    return f"actor {id}"


def lamps_id(actor: ActorLife) -> str:
    """Return the id of the entity of the lamps of a vehicle or traffic light."""
    return frame_of(actor.id) if actor.kind == "traffic_light" else f"lamps {actor.id}"


def topic_of(actor: ActorLife) -> str:
    """Return the topic of an actor's body."""
    return {"vehicle": VEHICLES, "walker": WALKERS}.get(actor.kind, OTHERS)


def body(actor: ActorLife, look: Look, fall: Fall | None = None, *, detailed: bool = True) -> bytes:
    """Return an actor as an entity, a field of a `SceneUpdate` whose end is a `TIMESTAMP`."""
    return entity(actor, frame_of(actor.id), _shape(look, fall) if detailed else _box(look))


def entity(actor: ActorLife, id: str, shape: bytes, **metadata: str) -> bytes:
    """Return an entity in the frame of an actor; see `body`."""
    known = {"actor": style.label_of(actor), "type_id": actor.type_id, "role_name": actor.role_name, **metadata}
    pairs = [KeyValuePair(key=key, value=value) for key, value in known.items() if value]
    start = SceneEntity(frame_id=frame_of(actor.id), frame_locked=True, id=id, metadata=pairs).SerializeToString()
    return (MessagePart(start + shape) + TIMESTAMP).within(SceneUpdate.ENTITIES_FIELD_NUMBER).data


def lit_lamps(actor: ActorLife, look: Look, lamps: int) -> bytes:
    """Return the lit lamps of a vehicle or traffic light as an entity; see `body`.

    There is a bit for each lamp that is lit; see `SceneDescription.lamps`.
    """
    if actor.kind != "traffic_light":
        return entity(actor, lamps_id(actor), _lit_shape(look._replace(color=_ANY_COLOR), lamps))
    state = state_of_lamps(lamps)
    return entity(actor, lamps_id(actor), _signal_shape(look, state), state=style.light(state)[0])


def ahead_entity(actor: ActorLife, state: int, text: str) -> bytes:
    """Return a ring around the lamps of the traffic light ahead, and its name above, as an entity; see `body`."""
    look = look_of_present(actor)
    top = 0.0 if look is None else look.center[2] + look.half_extents[2]
    middle = top - _SIGNAL_HEIGHT / 2
    shade = color(style.light(state)[1])
    angles = np.linspace(0, 2 * np.pi, _RING_POINTS, endpoint=False).tolist()
    ring = LinePrimitive(
        type=LinePrimitive.LINE_LOOP,
        pose=Pose(position=Vector3(y=-_RING_AHEAD, z=middle), orientation=Quaternion(w=1.0)),
        thickness=_RING_WIDTH,
        color=shade,
        points=[Point3(x=_RING * math.cos(angle), z=_RING * math.sin(angle)) for angle in angles],
    )
    label = TextPrimitive(
        pose=Pose(position=Vector3(z=middle + _RING + _LABEL), orientation=Quaternion(w=1.0)),
        billboard=True,
        font_size=_FONT,
        scale_invariant=True,
        color=color((250, 250, 250)),
        text=text,
    )
    shape = SceneEntity(lines=[ring], texts=[label]).SerializeToString()
    return entity(actor, "light ahead", shape)


def vertices_of(look: Look) -> Floats:
    """Return the points of the model of an actor in m, in the actor's own axes."""
    points: Floats = MODELS[look.model].mesh.vertices.astype(np.float64) * look.half_extents + look.center
    return points


@lru_cache(maxsize=1024)
def _shape(look: Look, fall: Fall | None) -> bytes:
    vertices = vertices_of(look)
    if fall is not None:
        vertices = (vertices - look.center) @ fall.matrix.T + fall.offset
    return b"".join(
        _triangles(vertices[part.vertices], part.corners, look.color if part.material is Material.PAINT else part.color)
        for part in _surfaces(look.model)
    )


@cache
def _surfaces(model: int) -> list[Surfaces]:
    return surfaces(MODELS[model].mesh)


@lru_cache(maxsize=1024)
def _box(look: Look) -> bytes:
    x, y, z = look.center
    pose = Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(w=1.0))
    x, y, z = (2 * half for half in look.half_extents)
    shape = CubePrimitive(pose=pose, size=Vector3(x=x, y=y, z=z), color=color(look.color))
    return MessagePart(shape.SerializeToString()).within(SceneEntity.CUBES_FIELD_NUMBER).data


@lru_cache(maxsize=4096)
def _lit_shape(look: Look, lamps: int) -> bytes:
    vertices = vertices_of(look)
    return b"".join(
        _triangles(middle + _CORNERS * (size + _MARGIN), _FACES, finish.glow or finish.color)  # a cube has outlines
        for part in _surfaces(look.model)
        for finish in [materials.MATERIALS[part.material]]
        if part.material in materials.LAMPS and lamps >> part.material & 1
        for middle, size in boxes(part, vertices)
    )


@lru_cache(maxsize=64)
def _signal_shape(look: Look, state: int) -> bytes:
    vertices = vertices_of(look)[MODELS[look.model].mesh.materials == materials.SIGNAL_LAMPS[state]]
    if not len(vertices):
        return b""
    x, y, z = ((vertices.min(axis=0) + vertices.max(axis=0)) / 2).tolist()
    pose = Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(w=1.0))
    size = Vector3(x=_SIGNAL, y=_SIGNAL, z=_SIGNAL)
    sphere = SpherePrimitive(pose=pose, size=size, color=color(style.light(state)[1]))
    return MessagePart(sphere.SerializeToString()).within(SceneEntity.SPHERES_FIELD_NUMBER).data
