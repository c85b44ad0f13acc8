"""The 3D scene: the actors as entities in frames of their own, and the transforms that move these frames.

An entity is written when it changes: when an actor appears, disappears or falls, or a lamp goes on or off. Only transforms
are written in each scene.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.formats.mcap.schema import MESSAGE
from carla_recap.model.actors import ActorLife
from carla_recap.model.presence import FAR
from carla_recap.model.records import CM, Spawn
from carla_recap.replay import quaternions, right_handed
from carla_recap.replay.pose import LOCATION, change
from carla_recap.replay.selection import NO_IDS, find
from carla_recap.scene.appearance import look_of_present
from carla_recap.show.foxglove import bodies
from carla_recap.show.foxglove.messages import (
    WORLD,
    FrameTransform,
    FrameTransforms,
    MessagePart,
    MessageTemplate,
    SceneEntityDeletion,
    SceneUpdate,
    TopicMessages,
    fill_pose,
    pose_numbers,
    single,
    timestamp,
)
from carla_recap.v1.light_states_pb2 import TRAFFIC_LIGHT_COLOR_UNKNOWN

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.replay.scene import SceneBatch
    from carla_recap.replay.selection import Ids
    from carla_recap.scene.appearance import Look
    from carla_recap.scene.description import LookColumns, SceneDescription
    from carla_recap.scene.falls import Fall, FallChange
    from carla_recap.show.foxglove.messages import Floats, Indices, Stamps

MOVED: Final = "/tf/actors"
STILL: Final = "/tf/still"

_MOVED_BY: Final = np.array([1.0, 1.0, 1.0, 0.1, 0.1, 0.1])  # cm and degrees; an actor farther from its first pose has moved
_FAR: Final = FAR / CM  # cm and degrees
_MOST_MODELS: Final = 300  # of the present actors; further ones are boxes
_MOST_BYTES: Final = 1 << 29  # of models; a recording whose actors come and go that often has boxes from then on

_POSE: Final = pose_numbers(FrameTransform.TRANSLATION_FIELD_NUMBER, FrameTransform.ROTATION_FIELD_NUMBER)
_CHANGING: Final = _POSE + timestamp(FrameTransform.TIMESTAMP_FIELD_NUMBER)
"""The end of a transform, the only part that differs from message to message."""


@dataclass(eq=False, slots=True)
class _ShownActor:
    """An actor with a body.

    Attributes:
        actor: The actor.
        look: Its look.
        detailed: Whether its model is shown, not only its box.
        topic: The topic of its body.
        spawn_pose: The pose without a recorded one; NaN if the actor is attached to a parent.
        first: The first pose; NaN before.
        moved: Whether the actor has moved since.
        fall: How it lies; None while it stands.
        body: The serialized entity of its body.
        transform: The serialized transform of its frame, with the frame at the origin.
    """

    actor: ActorLife
    look: Look
    detailed: bool
    topic: str = ""
    spawn_pose: Floats = field(default_factory=lambda: np.full(6, np.nan))
    first: Floats = field(default_factory=lambda: np.full(6, np.nan))
    moved: bool = False
    fall: Fall | None = None
    body: bytes = b""
    transform: bytes = b""

    _lit: dict[int, bytes] = field(default_factory=dict)

    def draw(self, actor: ActorLife, look: Look) -> None:
        """Set the actor, and what depends on it."""
        self.actor, self.look = actor, look
        self.topic = bodies.topic_of(actor)
        self.spawn_pose = np.full(6, np.nan) if actor.attached else actor.spawn_pose
        self._lit = {}
        frame = FrameTransform(parent_frame_id=WORLD, child_frame_id=bodies.frame_of(actor.id)).SerializeToString()
        self.transform = (MessagePart(frame) + _CHANGING).within(FrameTransforms.TRANSFORMS_FIELD_NUMBER).data
        self.set_fall(self.fall)

    def set_fall(self, fall: Fall | None) -> None:
        """Let a walker lie, or stand."""
        self.fall = fall
        self.body = bodies.body(self.actor, self.look, fall, detailed=self.detailed)

    def lit(self, lamps: int) -> bytes:
        """Return the entity of the lit lamps; see `ActorEntities._lit_lamps`."""
        if lamps not in self._lit:
            is_signal = self.actor.kind == "traffic_light"
            make = bodies.signal if is_signal else bodies.lamps
            self._lit[lamps] = make(self.actor, self.look, lamps - is_signal)
        return self._lit[lamps]


class _TransformsTemplate:
    """A message with the transforms of some actors, whose poses differ from message to message.

    Attributes:
        transforms: The serialized transforms.
    """

    def __init__(self, transforms: list[bytes]) -> None:
        self.transforms = transforms
        self._template = MessageTemplate(MessagePart(b"".join(transforms)))
        self._ends = (MESSAGE.size + np.cumsum([len(data) for data in transforms], dtype=np.intp)).tolist()

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
            fill_pose(ends, poses[..., LOCATION].astype(np.float32), turns.astype(np.float32))
        ends["timestamp"] = stamps[:, None]
        messages, _ = self._template.messages(topic, rows)
        for index, end in enumerate(self._ends):
            messages.data[:, end - ends.itemsize : end] = changing[:, index]
        return messages


class _TopicEntities:
    """The entities that a topic shows; each of its messages has all of them."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._shown: dict[str, bytes] = {}

    def messages(self, entities: dict[str, bytes], row: int, stamp: Stamps, *, fresh: bool) -> Iterator[TopicMessages]:
        """Yield a message if the entities have changed, or if it is the first one.

        Args:
            entities: The serialized entities by their ids.
            row: The position of the scene in the batch.
            stamp: Its timestamp.
            fresh: Whether it is the first scene.
        """
        if entities == self._shown and not fresh:
            return
        time = stamp.tobytes()
        gone = _deletions([id for id in self._shown if id not in entities], time)
        self._shown = entities
        yield single(self._topic, row, gone + b"".join(data[: -len(time)] + time for data in entities.values()))


class _ShownPoses:
    """The poses of the shown actors in some scenes.

    Args:
        recorded: The recorded poses, (scenes, actors, 6).
        away: Whether each of these is so far from the roads that it is not there, (scenes, actors).
        others: The poses of the shown actors without recorded ones, (scenes, others, 6); of one scene if they are constant.
        columns: The position of each shown actor among both.
    """

    def __init__(self, recorded: Floats, away: NDArray[np.bool_], others: Floats, columns: Indices) -> None:
        self._recorded = recorded
        self._away = away
        self._others = others
        self._columns = columns

    def take(self, actors: Indices, scenes: slice) -> Floats:
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
        return np.concatenate((_within(self._recorded, _FAR) & ~self._away, others), axis=1)[:, self._columns]

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
    """The messages of the actors: transforms, bodies, lamps. Sensors, which have no body, are left out."""

    def __init__(self) -> None:
        self._actors: list[ActorLife] = []
        self._unknown: list[int] = []  # the ids of recorded poses without actors
        self._ids: Ids | None = None
        self._all: dict[int, tuple[ActorLife, _ShownActor | None]] = {}
        self._shown: list[_ShownActor] = []
        self._shown_ids = NO_IDS
        self._columns: Indices = np.zeros(0, np.intp)  # see `_ShownPoses`
        self._others: Floats = np.zeros((0, 6))  # the poses of the shown actors without recorded ones
        self._spawn_poses: Floats = np.zeros((0, 6))  # see `_ShownActor`
        self._carried: list[tuple[int, int]] = []  # position and id of those of them that are attached to a parent
        self._first: Floats = np.zeros((0, 6))  # the first finite poses
        self._moved: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._falls: dict[int, Fall] = {}  # how walkers lie
        self._written = 0  # bytes of bodies
        self._bodies_shown: bytes | None = None  # which of the shown actors were present in the latest scene
        self._order: Indices = np.zeros(0, np.intp)  # the shown actors, by their ids
        self._sorted_ids = NO_IDS
        self._signals: Indices = np.zeros(0, np.intp)  # the positions of the traffic lights among the shown actors
        self._lit: tuple[bytes, bytes] | None = None  # the ids and the lit lamps of the latest message
        self._before = NO_IDS  # the actors of the latest message of those that have not moved
        self._templates = {MOVED: _TransformsTemplate([]), STILL: _TransformsTemplate([])}
        self._bodies = {topic: _TopicEntities(topic) for topic in (bodies.VEHICLES, bodies.WALKERS, bodies.OTHERS)}
        self._lamps = _TopicEntities(bodies.LAMPS)
        self._states = _TopicEntities(bodies.SIGNALS)

    def messages(
        self, description: SceneDescription, rows: Indices, stamps: Stamps, falls: Sequence[FallChange]
    ) -> Iterator[TopicMessages]:
        """Yield the messages of some scenes of a batch.

        Args:
            description: The scenes.
            rows: The positions of the scenes that are shown.
            stamps: The timestamp of each of these.
            falls: The walkers that fall or get up, until the last of these.
        """
        batch, changed = description.batch, self._take_actors(description)
        fall_rows = np.searchsorted(rows, [fall.row for fall in falls]).tolist()
        if changed:
            self._bodies_shown = None
        poses = self._poses(batch, rows)
        present = poses.present()
        moves = self._find_moves(poses, present)
        starts = {0, *moves[moves < len(rows)].tolist()}
        starts.update(fall_rows)
        starts.update((np.flatnonzero((present[1:] != present[:-1]).any(axis=1)) + 1).tolist())
        for start, stop in pairwise([*sorted(starts), len(rows)]):
            for index in np.flatnonzero(moves == start).tolist():
                self._shown[index].moved = self._moved[index] = True
            self._take_falls([fall for row, fall in zip(fall_rows, falls, strict=True) if row == start])
            fresh = batch.fresh and not rows[start]
            indices = np.flatnonzero(present[start] & self._moved)
            if len(indices):
                some = slice(start, stop)
                yield self._transforms(MOVED, indices, rows[some], stamps[some], poses.take(indices, some))
            indices = np.flatnonzero(present[start] & ~self._moved)
            ids = self._shown_ids[indices]
            if changed or fresh or not np.array_equal(ids, self._before):
                self._before = ids
                some = slice(start, start + 1)
                yield self._transforms(STILL, indices, rows[some], stamps[some], poses.take(indices, some))
            yield from self._show_bodies(present[start], int(rows[start]), stamps[start], fresh=fresh)
            changed = False
        yield from self._show_lamps(description, rows, stamps, present)

    def _show_bodies(self, present: NDArray[np.bool_], row: int, stamp: Stamps, *, fresh: bool) -> Iterator[TopicMessages]:
        now = present.tobytes()
        if now == self._bodies_shown and not fresh:
            return
        self._bodies_shown = now
        entities: dict[str, dict[str, bytes]] = {topic: {} for topic in self._bodies}
        for index in np.flatnonzero(present).tolist():
            shown = self._shown[index]
            entities[shown.topic][bodies.frame_of(shown.actor.id)] = shown.body
        for topic, found in entities.items():
            for message in self._bodies[topic].messages(found, row, stamp, fresh=fresh):
                self._written += message.data.size
                yield message
        if self._written > _MOST_BYTES and any(shown.detailed for shown in self._shown):
            for shown in self._shown:  # from the next message on
                shown.detailed = False
                shown.set_fall(shown.fall)

    def _show_lamps(
        self, description: SceneDescription, rows: Indices, stamps: Stamps, present: NDArray[np.bool_]
    ) -> Iterator[TopicMessages]:
        """Yield the messages of the lamps, whenever one goes on or off."""
        lit = self._lit_lamps(description, rows)
        lit[~present] = 0
        starts = (0, *(np.flatnonzero((lit[1:] != lit[:-1]).any(axis=1)) + 1).tolist())
        for start in starts:
            fresh = description.batch.fresh and not rows[start]
            known = (self._shown_ids.tobytes(), lit[start].tobytes())
            if known == self._lit and not fresh:
                continue
            self._lit = known
            lamps: dict[str, bytes] = {}
            states: dict[str, bytes] = {}
            for index in np.flatnonzero(lit[start]).tolist():
                shown = self._shown[index]
                data = shown.lit(int(lit[start, index]))
                if shown.actor.kind == "traffic_light":
                    states[bodies.frame_of(shown.actor.id)] = data
                else:
                    lamps[bodies.lamps_id(shown.actor.id)] = data
            yield from self._lamps.messages(lamps, int(rows[start]), stamps[start], fresh=fresh)
            yield from self._states.messages(states, int(rows[start]), stamps[start], fresh=fresh)

    def _lit_lamps(self, description: SceneDescription, rows: Indices) -> NDArray[np.int64]:
        """Return CARLA's VehicleLightState of each vehicle, and 1 more than the state of each light, (scenes, actors)."""
        lit = np.zeros((len(rows), len(self._shown)), np.int64)
        lit[:, self._signals] = 1 + TRAFFIC_LIGHT_COLOR_UNKNOWN
        columns, known = self._columns_of(description.vehicles)
        lit[:, columns] = description.flags[rows][:, known]
        light_states = description.batch.light_states
        columns, known = self._columns_of(light_states["id"][0])
        states = light_states["state"][rows][:, known].astype(np.int64)
        states[(states < 0) | (states > TRAFFIC_LIGHT_COLOR_UNKNOWN)] = TRAFFIC_LIGHT_COLOR_UNKNOWN
        signals = np.isin(columns, self._signals)
        lit[:, columns[signals]] = 1 + states[:, signals]
        return lit

    def _columns_of(self, ids: NDArray[np.integer]) -> tuple[Indices, NDArray[np.bool_]]:
        """Return the positions of actors among the shown ones, and whether each is among them."""
        columns, known = find(ids.astype(np.uint32), self._sorted_ids)
        return self._order[columns[known]] if len(self._order) else columns[known], known

    def _take_falls(self, changes: Sequence[FallChange]) -> None:
        """Let walkers fall and get up."""
        for _, id, fall in changes:
            self._falls.pop(id, None)
            if fall is not None:
                self._falls[id] = fall
        for shown in self._shown if self._falls or changes else ():
            now = self._falls.get(shown.actor.id)
            if now != shown.fall:
                shown.set_fall(now)
                self._bodies_shown = None

    def _take_actors(self, description: SceneDescription) -> bool:
        """Set what depends on the actors of a batch; return whether they have changed."""
        batch = description.batch
        actors = list(batch.actors.values())
        if actors == self._actors and batch.ids is self._ids:
            return False
        unknown = sorted(set(batch.ids.tolist()).difference(batch.actors))
        if actors != self._actors or unknown != self._unknown:
            self._take_entities(
                [*actors, *(ActorLife.of(Spawn(id), batch.time[0].item()) for id in unknown)], description.actors
            )
        self._actors, self._unknown, self._ids = actors, unknown, batch.ids
        self._columns, recorded = find(self._shown_ids, batch.ids)
        others = np.flatnonzero(~recorded)
        self._columns[others] = len(batch.ids) + np.arange(len(others))
        self._others = self._spawn_poses[others]
        carried = np.flatnonzero(np.isnan(self._others[:, 0]))
        self._carried = list(zip(carried.tolist(), self._shown_ids[others[carried]].tolist(), strict=True))
        return True

    def _take_entities(self, actors: Iterable[ActorLife], looks: LookColumns) -> None:
        """Set the shown actors, given all actors, and the looks of those that are known."""
        known, self._all = self._all, {}
        models = sum(shown.detailed for _, shown in known.values() if shown is not None)
        for actor in actors:
            before, shown = known.get(actor.id, (None, None))
            if before is None or (before is not actor and before.spawn != actor.spawn):
                look = looks.look_of(actor.id) if actor.type_id else look_of_present(actor)
                shown = None
                if look is not None:
                    shown = _ShownActor(actor, look, models < _MOST_MODELS and self._written <= _MOST_BYTES)
                    models += shown.detailed
                    shown.draw(actor, look)
            elif shown is not None and before is not actor and before != actor:
                shown.draw(actor, looks.look_of(actor.id) or shown.look)
            self._all[actor.id] = actor, shown
        self._shown = [shown for _, shown in self._all.values() if shown is not None]
        self._shown_ids = np.array([shown.actor.id for shown in self._shown], np.uint32)
        self._order = np.argsort(self._shown_ids)
        self._sorted_ids = self._shown_ids[self._order]
        self._spawn_poses = np.array([shown.spawn_pose for shown in self._shown]).reshape(-1, 6)
        self._first = np.array([shown.first for shown in self._shown]).reshape(-1, 6)
        self._moved = np.array([shown.moved for shown in self._shown], np.bool_)
        lights = [shown.actor.kind == "traffic_light" for shown in self._shown]
        self._signals = np.flatnonzero(lights)

    def _poses(self, batch: SceneBatch, rows: Indices) -> _ShownPoses:
        """Return the poses of all shown actors in some scenes."""
        others = self._others[None]
        if self._carried:
            others = np.repeat(others, len(rows), axis=0)
            for column, id in self._carried:
                poses = batch.pose_of(id)
                others[:, column] = np.nan if poses is None else poses[rows]
        recorded = batch.poses if len(rows) == len(batch) else batch.poses[rows]
        away = batch.away if len(rows) == len(batch) else batch.away[rows]
        return _ShownPoses(recorded, away, others, self._columns)

    def _find_moves(self, poses: _ShownPoses, present: NDArray[np.bool_]) -> Indices:
        """Return the position of the scene in which each actor moves for the first time; the number of scenes if in none."""
        for index in np.flatnonzero(np.isnan(self._first[:, 0]) & present.any(axis=0)).tolist():
            scene = int(present[:, index].argmax())
            first = poses.take(np.array([index]), slice(scene, scene + 1))[0, 0]
            self._first[index] = self._shown[index].first = first
        still = np.flatnonzero(~self._moved)
        away = poses.away(still, self._first[still]) & present[:, still]
        moves = np.full(len(self._shown), len(present))
        moves[still[away.any(axis=0)]] = away.argmax(axis=0)[away.any(axis=0)]
        return moves

    def _transforms(self, topic: str, indices: Indices, rows: Indices, stamps: Stamps, poses: Floats) -> TopicMessages:
        """Return messages with the transforms of the same actors."""
        transforms = [self._shown[index].transform for index in indices.tolist()]
        template = self._templates[topic]
        if template.transforms != transforms:
            template = self._templates[topic] = _TransformsTemplate(transforms)
        return template.messages(topic, rows, stamps, poses)


def _within(values: Floats, limit: float) -> NDArray[np.bool_]:
    """Return whether all numbers along the last axis are below a limit."""
    if values.min(initial=0) > -limit and values.max(initial=0) < limit:
        return np.ones(values.shape[:-1], np.bool_)
    return np.asarray((np.abs(values) < limit).all(axis=-1))


def _deletions(ids: Sequence[str], stamp: bytes) -> bytes:
    """Return the part of a `SceneUpdate` that deletes entities, given the timestamp."""
    time = MessagePart(stamp).within(SceneEntityDeletion.TIMESTAMP_FIELD_NUMBER)
    deletions = [SceneEntityDeletion(type=SceneEntityDeletion.MATCHING_ID, id=id).SerializeToString() for id in ids]
    field = SceneUpdate.DELETIONS_FIELD_NUMBER
    return b"".join((time + MessagePart(deletion)).within(field).data for deletion in deletions)
