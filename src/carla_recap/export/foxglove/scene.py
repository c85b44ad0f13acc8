"""The 3D scene: actors that have moved, actors that have not, and the road map."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.export import style
from carla_recap.export.foxglove.messages import (
    WORLD,
    Color,
    CubePrimitive,
    CylinderPrimitive,
    KeyValuePair,
    LinePrimitive,
    MessagePart,
    MessageTemplate,
    Point3,
    Pose,
    SceneEntity,
    SceneEntityDeletion,
    SceneUpdate,
    TopicMessages,
    Vector3,
    fill_pose,
    pose_numbers,
    single,
    timestamp,
)
from carla_recap.formats.mcap.schema import MESSAGE
from carla_recap.model.records import ActorKind, Spawn
from carla_recap.replay import Present, quaternions, right_handed
from carla_recap.replay.pose import LOCATION, change
from carla_recap.replay.selection import NO_IDS, find
from carla_recap.v1.light_states_pb2 import TRAFFIC_LIGHT_COLOR_UNKNOWN

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.export.foxglove.messages import Floats, Indices, Stamps
    from carla_recap.maps import RoadMap
    from carla_recap.replay.scene import SceneBatch
    from carla_recap.replay.selection import Ids

MOVED: Final = "/scene"
STILL: Final = "/scene/still"
MAP: Final = "/map"

_MOVED_BY: Final = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])  # cm and degrees; an actor farther from its first pose has moved
_FAINT: Final = 0.35  # opacity of a box that only stands for something; Foxglove's cubes have no outlines
_FAR: Final = 1e9  # cm and degrees; a pose beyond is not shown

_CUBES: Final = SceneEntity.CUBES_FIELD_NUMBER
_SPHERES: Final = SceneEntity.SPHERES_FIELD_NUMBER
_POSE: Final = pose_numbers(Pose.POSITION_FIELD_NUMBER, Pose.ORIENTATION_FIELD_NUMBER).within(
    CubePrimitive.POSE_FIELD_NUMBER
)
_TIMESTAMP: Final = timestamp(SceneEntity.TIMESTAMP_FIELD_NUMBER)
_CHANGING: Final = _POSE + _TIMESTAMP
"""The end of an entity, the only part that differs from message to message: the pose of its cube or sphere, and the time."""


def entity_id(id: int) -> str:
    """Return the id of an actor's entity."""
    return f"actor {id}"


@dataclass(eq=False, slots=True)
class _ActorEntity:
    """An actor as an entity.

    Attributes:
        actor: The actor.
        state: The state of a traffic light.
        has_body: Whether the actor is no sensor.
        spawn_pose: The pose without a recorded one; NaN if the actor is attached to a parent.
        first: The first pose; NaN before.
        moved: Whether the actor has moved since.
        data: The serialized entity, with the actor at the origin.
        center: The centre of the box, or of the lamp, in the actor's own axes, in m.
    """

    actor: Present
    state: int = TRAFFIC_LIGHT_COLOR_UNKNOWN
    has_body: bool = True
    spawn_pose: Floats = field(default_factory=lambda: np.full(6, np.nan))
    first: Floats = field(default_factory=lambda: np.full(6, np.nan))
    moved: bool = False
    data: bytes = b""
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)

    _drawn: dict[int, bytes] = field(default_factory=dict)  # by state

    def draw(self, actor: Present) -> None:
        """Set the actor, and what depends on it."""
        self.actor = actor
        self.has_body = actor.kind != ActorKind.SENSOR and not actor.type_id.startswith("sensor.")
        self.spawn_pose = np.full(6, np.nan) if actor.attached else actor.spawn_pose
        self._drawn = {}
        self.set_state(self.state)

    def set_state(self, state: int) -> None:
        """Set the state of a traffic light, and what depends on it."""
        self.state = state
        if state not in self._drawn:
            self._drawn[state] = self._serialize()
        self.data = self._drawn[state]

    def _serialize(self) -> bytes:
        actor = self.actor
        metadata = {"actor": style.label_of(actor), "type_id": actor.type_id, "role_name": actor.role_name}
        if actor.kind == ActorKind.TRAFFIC_LIGHT:
            state, rgb = style.light(self.state)
            start = _start(actor, metadata | {"state": state}, _pole(actor))
            self.center = (0.0, 0.0, style.LAMP_UP)
            return _serialized(start, _SPHERES, (style.LAMP, style.LAMP, style.LAMP), _color(rgb))
        box = style.box_of(actor)
        size = (2 * box.extent_x, 2 * box.extent_y, 2 * box.extent_z)
        opacity = _FAINT if style.is_outlined(actor) else 1.0
        self.center = (box.x, box.y, box.z)
        return _serialized(_start(actor, metadata), _CUBES, size, _color(style.color_of(actor), opacity))


class _EntitiesTemplate:
    """A message with the entities of some actors, whose poses differ from message to message.

    Attributes:
        entities: The serialized entities.
    """

    def __init__(self, entities: Sequence[_ActorEntity]) -> None:
        self.entities = [entity.data for entity in entities]
        self._template = MessageTemplate(MessagePart(b"".join(self.entities)))
        self._ends = (MESSAGE.size + np.cumsum([len(entity.data) for entity in entities], dtype=np.intp)).tolist()
        self._centers = np.array([entity.center for entity in entities]).reshape(-1, 3)

    def messages(self, topic: str, rows: Indices, stamps: Stamps, poses: Floats) -> TopicMessages:
        """Return the messages of some scenes.

        Args:
            topic: The topic.
            rows: The positions of the scenes in the batch.
            stamps: The timestamp of each scene.
            poses: The poses of the actors, (scenes, actors, 6).
        """
        poses = right_handed(poses)
        turns = quaternions(poses)
        changing = np.empty((*turns.shape[:2], len(_CHANGING.data)), np.uint8)
        changing[:] = np.frombuffer(_CHANGING.data, np.uint8)
        ends = changing.view(_CHANGING.dtype)[..., 0]
        # Numbers of less precision, far below what can be seen, make a smaller file.
        with np.errstate(over="ignore"):
            positions = (poses[..., LOCATION] + _rotated(self._centers, turns)).astype(np.float32)
            fill_pose(ends, positions, turns.astype(np.float32))
        ends["timestamp"] = stamps[:, None]
        messages, _ = self._template.messages(topic, rows)
        for entity, end in enumerate(self._ends):
            messages.data[:, end - ends.itemsize : end] = changing[:, entity]
        return messages


class _ShownPoses:
    """The poses of the shown actors in some scenes.

    Args:
        recorded: The recorded poses, (scenes, actors, 6).
        others: The poses of the shown actors without recorded ones, (scenes, others, 6); of one scene if they are constant.
        columns: The position of each shown actor among both.
    """

    def __init__(self, recorded: Floats, others: Floats, columns: Indices) -> None:
        self._recorded = recorded
        self._others = others
        self._columns = columns

    def of(self, actors: Indices, scenes: slice) -> Floats:
        """Return the poses of some actors in some scenes, (scenes, actors, 6)."""
        columns = self._columns[actors]
        recorded = self._recorded[scenes]
        others = columns - recorded.shape[1]
        if not (others >= 0).any():
            return recorded.take(columns, axis=1)
        poses = np.empty((len(recorded), len(columns), 6))
        poses[:, others < 0] = recorded.take(columns[others < 0], axis=1)
        kept = self._others[scenes if len(self._others) > 1 else slice(None)]
        poses[:, others >= 0] = kept.take(others[others >= 0], axis=1)
        return poses

    def present(self) -> NDArray[np.bool_]:
        """Return whether each shown actor is near enough to be shown, (scenes, actors); NaN is not."""
        others = np.broadcast_to(_within(self._others, _FAR), (len(self._recorded), self._others.shape[1]))
        return np.concatenate((_within(self._recorded, _FAR), others), axis=1)[:, self._columns]

    def away(self, actors: Indices, first: Floats) -> NDArray[np.bool_]:
        """Return whether some actors are away from their first poses, (scenes, actors)."""
        found = np.zeros((len(self._recorded), len(actors)), np.bool_)
        columns = self._columns[actors]
        recorded = columns < self._recorded.shape[1]
        columns[~recorded] -= self._recorded.shape[1]
        for poses, some in ((self._recorded, recorded), (self._others, ~recorded)):
            now, before = poses.take(columns[some], axis=1), first[some]
            if not (now == before).all():
                with np.errstate(invalid="ignore", over="ignore"):
                    found[:, some] = (np.abs(change(before, now)) > _MOVED_BY).any(axis=2)
        return found


class ActorEntities:
    """The messages of the actors, on two topics. Sensors, which have no body, are left out."""

    def __init__(self) -> None:
        self._actors: list[Present] = []
        self._unknown: list[int] = []  # the ids of recorded poses without actors
        self._ids: Ids | None = None
        self._entities: dict[int, _ActorEntity] = {}
        self._shown: list[_ActorEntity] = []  # those with a body
        self._shown_ids = NO_IDS
        self._columns: Indices = np.zeros(0, np.intp)  # see `_ShownPoses`
        self._others: Floats = np.zeros((0, 6))  # the poses of the shown actors without recorded ones
        self._spawn_poses: Floats = np.zeros((0, 6))  # see `_ActorEntity`
        self._carried: list[tuple[int, int]] = []  # position and id of those of them that are attached to a parent
        self._first: Floats = np.zeros((0, 6))  # the first finite poses
        self._moved: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._lights: tuple[bytes, bytes] | None = None  # the latest ids and states
        self._before = {MOVED: NO_IDS, STILL: NO_IDS}  # the actors of the latest message
        self._templates = {MOVED: _EntitiesTemplate([]), STILL: _EntitiesTemplate([])}  # and its template

    def messages(self, batch: SceneBatch, rows: Indices, stamps: Stamps) -> Iterator[TopicMessages]:
        """Yield the messages of some scenes of a batch.

        Args:
            batch: The scenes.
            rows: The positions of the scenes that are shown.
            stamps: The timestamp of each of these.
        """
        changed = self._take_actors(batch)
        poses = self._poses(batch, rows)
        present = poses.present()
        moves = self._find_moves(poses, present)
        ids, states = batch.light_states["id"][0], batch.light_states["state"][rows]
        starts = {0, *moves[moves < len(rows)].tolist()}
        for values in (present, states):
            starts.update((np.flatnonzero((values[1:] != values[:-1]).any(axis=1)) + 1).tolist())
        edges = [*sorted(starts), len(rows)]
        for start, stop in pairwise(edges):
            changed |= self._take_lights(ids, states[start])
            for index in np.flatnonzero(moves == start).tolist():
                self._shown[index].moved = self._moved[index] = changed = True
            fresh = batch.fresh and not rows[start]
            indices = np.flatnonzero(present[start] & self._moved)
            gone = self._take_shown(MOVED, indices)
            if len(indices) or gone or fresh:
                some = slice(start, stop if len(indices) else start + 1)
                yield from self._messages(MOVED, indices, gone or (), rows[some], stamps[some], poses.of(indices, some))
            indices = np.flatnonzero(present[start] & ~self._moved)
            gone = self._take_shown(STILL, indices)
            if changed or gone is not None or fresh:
                some = slice(start, start + 1)
                yield from self._messages(STILL, indices, gone or (), rows[some], stamps[some], poses.of(indices, some))
            changed = False

    def _take_actors(self, batch: SceneBatch) -> bool:
        """Set what depends on the actors of a batch; return whether they have changed."""
        actors = list(batch.actors.values())
        if actors == self._actors and batch.ids is self._ids:
            return False
        unknown = sorted(set(batch.ids.tolist()).difference(batch.actors))
        if actors != self._actors or unknown != self._unknown:
            self._take_entities([*actors, *(Present(Spawn(id), batch.time[0].item()) for id in unknown)])
        self._actors, self._unknown, self._ids = actors, unknown, batch.ids
        self._lights = None
        self._columns, recorded = find(self._shown_ids, batch.ids)
        others = np.flatnonzero(~recorded)
        self._columns[others] = len(batch.ids) + np.arange(len(others))
        self._others = self._spawn_poses[others]
        carried = np.flatnonzero(np.isnan(self._others[:, 0]))
        self._carried = list(zip(carried.tolist(), self._shown_ids[others[carried]].tolist(), strict=True))
        return True

    def _take_entities(self, actors: Iterable[Present]) -> None:
        """Set the entities, given all actors."""
        entities: dict[int, _ActorEntity] = {}
        for actor in actors:
            entity = self._entities.get(actor.id)
            if entity is None or (entity.actor is not actor and entity.actor.spawn != actor.spawn):
                entity = _ActorEntity(actor)
            if not entity.data or (entity.actor is not actor and entity.actor != actor):
                entity.draw(actor)
            entities[actor.id] = entity
        self._entities = entities
        self._shown = [entity for entity in entities.values() if entity.has_body]
        self._shown_ids = np.array([entity.actor.id for entity in self._shown], np.uint32)
        self._spawn_poses = np.array([entity.spawn_pose for entity in self._shown]).reshape(-1, 6)
        self._first = np.array([entity.first for entity in self._shown]).reshape(-1, 6)
        self._moved = np.array([entity.moved for entity in self._shown], np.bool_)

    def _poses(self, batch: SceneBatch, rows: Indices) -> _ShownPoses:
        """Return the poses of all shown actors in some scenes."""
        others = self._others[None]
        if self._carried:
            others = np.repeat(others, len(rows), axis=0)
            for column, id in self._carried:
                poses = batch.pose_of(id)
                others[:, column] = np.nan if poses is None else poses[rows]
        recorded = batch.poses if len(rows) == len(batch) else batch.poses[rows]
        return _ShownPoses(recorded, others, self._columns)

    def _find_moves(self, poses: _ShownPoses, present: NDArray[np.bool_]) -> Indices:
        """Return the position of the scene in which each actor moves for the first time; the number of scenes if in none."""
        for index in np.flatnonzero(np.isnan(self._first[:, 0]) & present.any(axis=0)).tolist():
            scene = int(present[:, index].argmax())
            first = poses.of(np.array([index]), slice(scene, scene + 1))[0, 0]
            self._first[index] = self._shown[index].first = first
        still = np.flatnonzero(~self._moved)
        away = poses.away(still, self._first[still]) & present[:, still]
        moves = np.full(len(self._shown), len(present))
        moves[still[away.any(axis=0)]] = away.argmax(axis=0)[away.any(axis=0)]
        return moves

    def _take_lights(self, ids: NDArray[np.integer], states: NDArray[np.integer]) -> bool:
        """Set the states of the traffic lights; return whether one of them has changed."""
        lights = (ids.tobytes(), states.tobytes())
        if lights == self._lights:
            return False
        self._lights = lights
        changed = False
        for id, state in zip(ids.tolist(), states.tolist(), strict=True):
            entity = self._entities.get(id)
            if entity is not None and entity.state != state:
                entity.set_state(state)
                changed = True
        return changed

    def _take_shown(self, topic: str, indices: Indices) -> list[str] | None:
        """Set the actors that a topic shows; return the entities that it no longer shows, None if all are the same."""
        before, now = self._before[topic], self._shown_ids[indices]
        self._before[topic] = now
        if np.array_equal(before, now):
            return None
        return [entity_id(id) for id in sorted(set(before.tolist()).difference(now.tolist()))]

    def _messages(
        self, topic: str, indices: Indices, gone: Iterable[str], rows: Indices, stamps: Stamps, poses: Floats
    ) -> Iterator[TopicMessages]:
        """Yield messages that show the same actors; the first of them deletes the entities that are gone."""
        entities = [self._shown[index] for index in indices.tolist()]
        template = self._templates[topic]
        if template.entities != [entity.data for entity in entities]:
            template = self._templates[topic] = _EntitiesTemplate(entities)
        messages = template.messages(topic, rows, stamps, poses)
        if gone:
            update = messages.data[0, MESSAGE.size :].tobytes()
            yield single(topic, int(rows[0]), _deletions(gone, stamps[0]) + update)
            messages = TopicMessages(topic, rows[1:], messages.data[1:])
        yield messages


def map_message(road_map: RoadMap | None, time: int) -> SceneUpdate:
    """Return all lines of a map, one entity for each kind.

    Args:
        road_map: The map; None: the message is empty.
        time: The beginning of the recording, in ns since 1970.
    """
    if road_map is None:
        return SceneUpdate()
    entities = [_lines(name, getattr(road_map, name), rgb, width) for name, rgb, width in style.ROADS]
    for entity in entities:
        entity.timestamp.FromNanoseconds(time)
    return SceneUpdate(entities=entities)


def _lines(name: str, lines: list[Floats], rgb: style.Color, width: float) -> SceneEntity:
    pieces = [np.repeat(line, 2, axis=0)[1:-1] for line in lines]
    points = np.concatenate(pieces).tolist() if pieces else []
    primitive = LinePrimitive(
        type=LinePrimitive.LINE_LIST,
        thickness=width,
        color=_color(rgb),
        points=[Point3(x=x, y=y, z=z) for x, y, z in points],
    )
    primitive.pose.orientation.w = 1.0
    return SceneEntity(frame_id=WORLD, id=name.replace("_", " "), lines=[primitive])


def _within(values: Floats, limit: float) -> NDArray[np.bool_]:
    """Return whether all numbers along the last axis are below a limit."""
    if values.min(initial=0) > -limit and values.max(initial=0) < limit:
        return np.ones(values.shape[:-1], np.bool_)
    return np.asarray((np.abs(values) < limit).all(axis=-1))


def _rotated(vectors: Floats, quaternions: Floats) -> Floats:
    """Return vectors that are rotated by quaternions x, y, z, w."""
    (x, y, z, w), (a, b, c) = np.moveaxis(quaternions, -1, 0), vectors.T
    d, e, f = y * c - z * b, z * a - x * c, x * b - y * a
    rotated = np.empty((*quaternions.shape[:-1], 3))
    rotated[..., 0] = a + 2 * (w * d + y * f - z * e)
    rotated[..., 1] = b + 2 * (w * e + z * d - x * f)
    rotated[..., 2] = c + 2 * (w * f + x * e - y * d)
    return rotated


def _color(rgb: style.Color, opacity: float = 1.0) -> Color:
    red, green, blue = (part / 255 for part in rgb)
    return Color(r=red, g=green, b=blue, a=opacity)


def _start(actor: Present, metadata: Mapping[str, str], *fixed: CylinderPrimitive) -> SceneEntity:
    """Return the part of an entity that never moves, with the metadata that a viewer shows of it."""
    pairs = [KeyValuePair(key=key, value=value) for key, value in metadata.items() if value]
    return SceneEntity(frame_id=WORLD, id=entity_id(actor.id), metadata=pairs, cylinders=fixed)


def _pole(actor: Present) -> CylinderPrimitive:
    """Return the pole of a traffic light, which never moves."""
    x, y, z = right_handed(actor.spawn_pose)[LOCATION].tolist()
    pole = CylinderPrimitive(bottom_scale=1.0, top_scale=1.0, color=_color(style.POLE))
    pole.pose.position.x, pole.pose.position.y, pole.pose.position.z = x, y, z + style.LAMP_UP / 2
    pole.pose.orientation.w = 1.0
    pole.size.x = pole.size.y = style.POLE_WIDTH
    pole.size.z = style.LAMP_UP
    return pole


def _serialized(start: SceneEntity, field: int, size: tuple[float, float, float], shade: Color) -> bytes:
    """Return an entity with a cube or a sphere that moves, as a field of a `SceneUpdate`.

    Args:
        start: The rest of the entity.
        field: `_CUBES` or `_SPHERES`; the primitives have the same fields.
        size: The size of the primitive along its axes, in m.
        shade: The colour of the primitive.
    """
    shape = CubePrimitive(size=Vector3(x=size[0], y=size[1], z=size[2]), color=shade).SerializeToString()
    primitive = (MessagePart(shape) + _POSE).within(field)
    return (MessagePart(start.SerializeToString()) + primitive + _TIMESTAMP).within(SceneUpdate.ENTITIES_FIELD_NUMBER).data


def _deletions(ids: Iterable[str], stamp: Stamps) -> bytes:
    """Return the part of a `SceneUpdate` that deletes entities, given the timestamp."""
    time = MessagePart(stamp.tobytes()).within(SceneEntityDeletion.TIMESTAMP_FIELD_NUMBER)
    deletions = [SceneEntityDeletion(type=SceneEntityDeletion.MATCHING_ID, id=id).SerializeToString() for id in ids]
    field = SceneUpdate.DELETIONS_FIELD_NUMBER
    return b"".join((time + MessagePart(deletion)).within(field).data for deletion in deletions)
