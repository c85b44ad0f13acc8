"""How actors look: bodies, lit lamps, and what traffic lights show, as entities in the frames of the actors."""

from __future__ import annotations

import math
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.scene import materials, style
from carla_recap.scene.appearance import Look, look_of_present
from carla_recap.scene.lamps import state_of_lamps
from carla_recap.scene.materials import Material
from carla_recap.scene.models import MODELS
from carla_recap.show.foxglove import shapes
from carla_recap.show.foxglove.messages import (
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
    Vector3,
    timestamp,
)

if TYPE_CHECKING:
    from carla_recap.model.lives import ActorLife
    from carla_recap.scene.falls import Fall
    from carla_recap.util.arrays import Floats


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
    shade = shapes.color(style.light(state)[1])
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
        color=shapes.color((250, 250, 250)),
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
    return b"".join(
        shapes.triangles(geometry, look.color if part.material is Material.PAINT else part.color)
        for part, geometry in _geometries(look._replace(color=_ANY_COLOR), fall)
    )


@lru_cache(maxsize=256)
def _geometries(look: Look, fall: Fall | None) -> list[tuple[shapes.Surfaces, bytes]]:
    """Return the triangles of an actor by their materials and colours; the colour of its look does not matter."""
    vertices = vertices_of(look)
    if fall is not None:
        vertices = (vertices - look.center) @ fall.matrix.T + fall.offset
    return shapes.geometries(_surfaces(look.model), vertices)


@cache
def _surfaces(model: int) -> list[shapes.Surfaces]:
    return shapes.surfaces(MODELS[model].mesh)


@lru_cache(maxsize=1024)
def _box(look: Look) -> bytes:
    return shapes.cube(np.array(look.center), 2 * np.array(look.half_extents), look.color)


@lru_cache(maxsize=4096)
def _lit_shape(look: Look, lamps: int) -> bytes:
    vertices = vertices_of(look)
    return b"".join(
        shapes.box(middle, size + _MARGIN, finish.glow or finish.color)
        for part in _surfaces(look.model)
        for finish in [materials.MATERIALS[part.material]]
        if part.material in materials.LAMPS and lamps >> part.material & 1
        for middle, size in shapes.boxes(part, vertices)
    )


@lru_cache(maxsize=64)
def _signal_shape(look: Look, state: int) -> bytes:
    vertices = vertices_of(look)[MODELS[look.model].mesh.materials == materials.SIGNAL_LAMPS[state]]
    if not len(vertices):
        return b""
    x, y, z = ((vertices.min(axis=0) + vertices.max(axis=0)) / 2).tolist()
    pose = Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(w=1.0))
    size = Vector3(x=_SIGNAL, y=_SIGNAL, z=_SIGNAL)
    sphere = SpherePrimitive(pose=pose, size=size, color=shapes.color(style.light(state)[1]))
    return MessagePart(sphere.SerializeToString()).within(SceneEntity.SPHERES_FIELD_NUMBER).data
