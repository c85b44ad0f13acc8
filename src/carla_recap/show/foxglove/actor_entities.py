"""The 3D scene: the actors as entities in frames of their own, and the transforms that move these frames.

An entity is written when it changes: when an actor appears, disappears or falls, or a lamp goes on or off. Only transforms
are written in each scene.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.replay import quaternions
from carla_recap.replay.pose import LOCATION, change
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

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorLife
    from carla_recap.scene.appearance import Look
    from carla_recap.scene.description import LookColumns, SceneDescription
    from carla_recap.scene.falls import Fall
    from carla_recap.show.foxglove.messages import ShownScenes, Stamps
    from carla_recap.util.arrays import Booleans, Floats, Indices

MOVED: Final = "/tf/actors"
STILL: Final = "/tf/still"

_MOVED_BY: Final = np.array(
    [0.01, 0.01, 0.01, 0.1, 0.1, 0.1]
)  # m and degrees; farther from its first pose, an actor has moved
_MOST_MODELS: Final = 300  # of the present actors; further ones are boxes

_POSE: Final = pose_numbers(FrameTransform.TRANSLATION_FIELD_NUMBER, FrameTransform.ROTATION_FIELD_NUMBER)
_CHANGING: Final = _POSE + timestamp(FrameTransform.TIMESTAMP_FIELD_NUMBER)
"""The end of a transform, the only part that differs from message to message."""


@dataclass(eq=False, slots=True)
class _ShownActor:
    """An actor with a body."""

    actor: ActorLife
    look: Look
    detailed: bool  # whether its model is shown, not only its box
    topic: str = ""  # the topic of its body
    # the first pose in m and degrees, right-handed; NaN before
    first: Floats = field(default_factory=lambda: np.full(6, np.nan))
    moved: bool = False  # whether the actor has moved since
    fall: Fall | None = None  # how it lies; None while it stands
    body: bytes = b""  # the serialized entity of its body
    transform: bytes = b""  # the serialized transform of its frame, with the frame at the origin

    _lit: dict[int, bytes] = field(default_factory=dict)

    def draw(self, actor: ActorLife, look: Look) -> None:
        """Set the actor, and what depends on it."""
        self.actor, self.look = actor, look
        self.topic = bodies.topic_of(actor)
        self._lit = {}
        frame = FrameTransform(parent_frame_id=WORLD, child_frame_id=bodies.frame_of(actor.id)).SerializeToString()
        self.transform = (MessagePart(frame) + _CHANGING).within(FrameTransforms.TRANSFORMS_FIELD_NUMBER).data
        self.set_fall(self.fall)

    def set_fall(self, fall: Fall | None) -> None:
        """Let a walker lie, or stand."""
        self.fall = fall
        self.body = bodies.body(self.actor, self.look, fall, detailed=self.detailed)

    def lit(self, lamps: int) -> bytes:
        """Return the entity of the lit lamps; see `bodies.lit_lamps`."""
        if lamps not in self._lit:
            self._lit[lamps] = bodies.lit_lamps(self.actor, self.look, lamps)
        return self._lit[lamps]


def _transform_messages(
    topic: str, transforms: Sequence[bytes], rows: Indices, stamps: Stamps, poses: Floats
) -> TopicMessages:
    """Return messages with the serialized transforms of the same actors.

    Poses are in m and degrees, right-handed, (scenes, actors, 6).
    """
    turns = quaternions(poses)
    changing = np.empty((*turns.shape[:2], len(_CHANGING.data)), np.uint8)
    changing[:] = np.frombuffer(_CHANGING.data, np.uint8)
    ends = changing.view(_CHANGING.dtype)[..., 0]
    # Numbers of less precision, far below what can be seen, make a smaller file.
    with np.errstate(over="ignore"):
        fill_pose(ends, poses[..., LOCATION].astype(np.float32), turns.astype(np.float32))
    ends["timestamp"] = stamps[:, None]
    messages, _ = MessageTemplate(MessagePart(b"".join(transforms))).messages(topic, rows)
    for index, end in enumerate(np.cumsum([len(data) for data in transforms], dtype=np.intp).tolist()):
        messages.data[:, end - ends.itemsize : end] = changing[:, index]
    return messages


class _TopicEntities:
    """The entities that a topic shows; each of its messages has all of them."""

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._shown: dict[str, bytes] = {}

    def messages(self, entities: dict[str, bytes], row: int, stamp: Stamps, *, fresh: bool) -> Iterator[TopicMessages]:
        """Yield a message if the entities have changed, or if it is the first one."""
        if entities == self._shown and not fresh:
            return
        time, before = stamp.tobytes(), self._shown
        gone = _deletions([id for id in before if id not in entities], time)
        self._shown = entities
        stamped = {id: data[: -len(time)] + time for id, data in entities.items()}
        changed = b"".join(data for id, data in stamped.items() if before.get(id) != entities[id])
        yield single(self._topic, row, gone + b"".join(stamped.values()))._replace(change=gone + changed)


class ActorEntities:
    """The messages of the actors: transforms, bodies, lamps. Sensors, which have no body, are left out.

    If actors come and go so often that the messages with models exceed some bytes, all are boxes from then on.
    """

    def __init__(self, most_bytes: float = math.inf) -> None:
        self._most_bytes = most_bytes
        self._lives: Mapping[int, ActorLife] = {}
        self._looks: LookColumns | None = None
        self._shown: list[_ShownActor] = []  # by their ids
        self._fallen: dict[int, Fall] = {}  # how walkers lie
        self._written = 0  # bytes of bodies
        self._before: list[int] = []  # the actors of the latest message of those that have not moved
        self._bodies = {topic: _TopicEntities(topic) for topic in (bodies.VEHICLES, bodies.WALKERS, bodies.OTHERS)}
        self._lamps = _TopicEntities(bodies.LAMPS)
        self._signals = _TopicEntities(bodies.SIGNALS)

    def messages(self, scenes: ShownScenes) -> Iterator[TopicMessages]:
        """Yield the messages of some scenes of a batch."""
        description, rows, stamps, _ = scenes
        batch, changed = description.batch, self._take_actors(description)
        shown = slice(None) if len(rows) == len(batch) else rows
        poses, present = description.poses[shown], description.shown[shown]
        moved = np.array([each.moved for each in self._shown], np.bool_)
        moves = self._find_moves(poses, present, moved)
        falls = np.searchsorted(rows, [fall.row for fall in description.falls])
        changes = np.flatnonzero((present[1:] != present[:-1]).any(axis=1)) + 1
        starts = {0, *np.concatenate((moves, falls, changes)).tolist()} - {len(rows)}
        for start, stop in pairwise([*sorted(starts), len(rows)]):
            for index in np.flatnonzero(moves == start).tolist():
                self._shown[index].moved = moved[index] = True
            self._take_fallen(description.fallen_at(rows[start]))
            fresh = batch.fresh and not rows[start]
            indices = np.flatnonzero(present[start] & moved)
            if len(indices):
                some = slice(start, stop)
                yield self._transforms(MOVED, indices, rows[some], stamps[some], poses[some, indices])
            indices = np.flatnonzero(present[start] & ~moved)
            ids = [self._shown[index].actor.id for index in indices.tolist()]
            if changed or fresh or ids != self._before:
                self._before = ids
                some = slice(start, start + 1)
                yield self._transforms(STILL, indices, rows[some], stamps[some], poses[some, indices])
            yield from self._show_bodies(present[start], int(rows[start]), stamps[start], fresh=fresh)
            if self._written > self._most_bytes:
                self._make_boxes(batch.time[rows[start]].item())
            changed = False
        yield from self._show_lamps(description.lamps[shown], rows, stamps, fresh=batch.fresh and not rows[0])

    def _show_bodies(self, present: NDArray[np.bool_], row: int, stamp: Stamps, *, fresh: bool) -> Iterator[TopicMessages]:
        entities: dict[str, dict[str, bytes]] = {topic: {} for topic in self._bodies}
        for index in np.flatnonzero(present).tolist():
            shown = self._shown[index]
            entities[shown.topic][bodies.frame_of(shown.actor.id)] = shown.body
        for topic, found in entities.items():
            for message in self._bodies[topic].messages(found, row, stamp, fresh=fresh):
                self._written += message.data.size
                yield message

    def _make_boxes(self, time: float) -> None:
        """Show all actors as boxes from the next message on, given the elapsed seconds."""
        detailed = [shown for shown in self._shown if shown.detailed]
        for shown in detailed:
            shown.detailed = False
            shown.set_fall(shown.fall)
        if detailed:
            text = f"from {time:g} s on, all actors are boxes: models have taken {self._most_bytes / 1e6:.0f} MB until then"
            warnings.warn(text, RecapWarning, stacklevel=2)

    def _show_lamps(self, lit: NDArray[np.uint64], rows: Indices, stamps: Stamps, *, fresh: bool) -> Iterator[TopicMessages]:
        """Yield the messages of the lamps, whenever one goes on or off."""
        for start in (0, *(np.flatnonzero((lit[1:] != lit[:-1]).any(axis=1)) + 1).tolist()):
            fresh_now = fresh and not start
            lamps: dict[str, bytes] = {}
            signals: dict[str, bytes] = {}
            for index in np.flatnonzero(lit[start]).tolist():
                shown = self._shown[index]
                found = signals if shown.actor.kind == "traffic_light" else lamps
                found[bodies.lamps_id(shown.actor)] = shown.lit(int(lit[start, index]))
            yield from self._lamps.messages(lamps, int(rows[start]), stamps[start], fresh=fresh_now)
            yield from self._signals.messages(signals, int(rows[start]), stamps[start], fresh=fresh_now)

    def _take_fallen(self, fallen: dict[int, Fall]) -> None:
        """Let walkers fall and get up."""
        for shown in self._shown if self._fallen or fallen else ():
            now = fallen.get(shown.actor.id)
            if now != shown.fall:
                shown.set_fall(now)
        self._fallen = fallen

    def _take_actors(self, description: SceneDescription) -> bool:
        """Set the shown actors; return whether they have changed."""
        lives, looks = description.lives, description.actors
        if looks is self._looks and (lives is self._lives or lives == self._lives):
            return False
        self._lives, self._looks = lives, looks
        known = {shown.actor.id: shown for shown in self._shown}
        models = sum(shown.detailed for shown in self._shown if looks.look_of(shown.actor.id) is not None)
        self._shown = []
        for id, look in zip(looks.ids.tolist(), looks.looks, strict=True):
            actor, shown = lives[id], known.get(id)
            if shown is None or (shown.actor is not actor and shown.actor.spawn != actor.spawn):
                shown = _ShownActor(actor, look, models < _MOST_MODELS and self._written <= self._most_bytes)
                models += shown.detailed
                shown.draw(actor, look)
            elif shown.actor is not actor and shown.actor != actor:
                shown.draw(actor, look)
            self._shown.append(shown)
        return True

    def _find_moves(self, poses: Floats, present: Booleans, moved: Booleans) -> Indices:
        """Return the position of the scene in which each actor moves for the first time; the number of scenes if in none."""
        first = np.array([shown.first for shown in self._shown]).reshape(-1, 6)
        for index in np.flatnonzero(np.isnan(first[:, 0]) & present.any(axis=0)).tolist():
            first[index] = self._shown[index].first = poses[present[:, index].argmax(), index]
        still, moves = np.flatnonzero(~moved), np.full(len(self._shown), len(present))
        with np.errstate(invalid="ignore", over="ignore"):
            away = (np.abs(change(first[still], poses[:, still])) > _MOVED_BY).any(axis=2) & present[:, still]
        moves[still] = np.where(away.any(axis=0), away.argmax(axis=0), len(present))
        return moves

    def _transforms(self, topic: str, indices: Indices, rows: Indices, stamps: Stamps, poses: Floats) -> TopicMessages:
        """Return messages with the transforms of the same actors."""
        transforms = [self._shown[index].transform for index in indices.tolist()]
        return _transform_messages(topic, transforms, rows, stamps, poses)


def _deletions(ids: Sequence[str], stamp: bytes) -> bytes:
    """Return the part of a `SceneUpdate` that deletes entities, given the timestamp."""
    time = MessagePart(stamp).within(SceneEntityDeletion.TIMESTAMP_FIELD_NUMBER)
    deletions = [SceneEntityDeletion(type=SceneEntityDeletion.MATCHING_ID, id=id).SerializeToString() for id in ids]
    field = SceneUpdate.DELETIONS_FIELD_NUMBER
    return b"".join((time + MessagePart(deletion)).within(field).data for deletion in deletions)
