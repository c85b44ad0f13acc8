"""Contacts: two actors touching, when, where, and how fast they were just before."""

from __future__ import annotations

import math
from dataclasses import dataclass
from operator import sub
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.motion import MOTION, counts, motion_of
from carla_recap.model.records import CM, UE4

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Frame, Packet
    from carla_recap.model.lives import ActorLife

    Vector = tuple[float, float, float]

TYPES: Final = ("collisions", *MOTION)
"""The record types that contacts are found by."""
SAME_CONTACT: Final = 1.0
"""Records of a pair in adjacent frames, or less than this many seconds apart, belong to one contact."""
AT_FAULT: Final = 0.1
"""The speed in m/s from which on an actor has caused a contact, as in CARLA's criteria."""
UNKNOWN: Final[Vector] = (math.nan, math.nan, math.nan)

_STILL: Final[Vector] = (0.0, 0.0, 0.0)
_AFTERMATH: Final = 0.5  # s after a contact in which it affects the motion

_COLLISIONS: Final = UE4.named("collisions").id

Key = tuple[int, int, int]


class Impact(NamedTuple):
    """Where two actors are when they touch, and how fast they were just before."""

    frame_index: int  # the index of the frame in which they touch, from 0
    id1: int  # the actor with the collision sensor
    id2: int  # the other actor
    # The position of each in this frame, in cm, left-handed; NaN where it is unknown.
    positions: tuple[Vector, Vector] = (UNKNOWN, UNKNOWN)
    # The velocity of each in the frame before, in m/s, left-handed; NaN where it is unknown; see `velocity_before`.
    velocities: tuple[Vector, Vector] = (UNKNOWN, UNKNOWN)

    @classmethod
    def of(cls, key: Key, frame: Frame, before: Frame | None, earlier: Frame | None) -> Impact:
        """Return an impact, by its frame and the two frames before it, as far as there are such frames."""
        _, id1, id2 = key
        positions = _position(frame, id1), _position(frame, id2)
        return cls(*key, positions, (velocity_before(id1, before, earlier), velocity_before(id2, before, earlier)))

    @property
    def key(self) -> Key:
        """The index and the ids."""
        return self[:3]

    def with_fixed(self, first: bool, second: bool) -> Impact:
        """Return it with a velocity of 0 for what never moves, such as a building or a traffic light."""
        one, two = self.velocities
        return self._replace(velocities=(_STILL if first else one, _STILL if second else two))

    @property
    def speeds(self) -> tuple[float, float]:
        """The speed of each actor just before, in m/s; NaN where it is unknown."""
        one, two = self.velocities
        return _length(one), _length(two)

    @property
    def relative_speed(self) -> float:
        """The magnitude of the difference between both velocities, in m/s; NaN where it is unknown."""
        return _length(map(sub, *self.velocities))


@dataclass(slots=True)
class Contact:
    """Two actors touching: collision records of a pair, each in the next frame or less than 1 s after the one before."""

    number: int  # the number of the contact, from 1
    ids: tuple[int, int]  # the actors of the first record, the one with the collision sensor first
    heroes: tuple[bool, bool]  # whether each is the hero
    frame_index: int  # the index of the frame in which it begins, from 0
    start: float  # the time of its first record, in elapsed seconds
    stop: float  # the time of its last record, in elapsed seconds
    # Where the actors are at the start, and how fast they were just before; None if it was not looked up.
    impact: Impact | None = None
    # The lives of the ids at the start, None of one that is unknown; set once all lives are known.
    actors: tuple[ActorLife | None, ...] = ()

    @property
    def key(self) -> Key:
        """The index of its first frame, and the actors."""
        return self.frame_index, *self.ids

    def is_of(self, *lives: ActorLife) -> bool:
        """Return whether actors take part, not others that have their ids before or after."""
        return all(any(actor is life for actor in self.actors) for life in lives)

    def is_caused_by(self, id: int) -> bool:
        """Return whether an actor is at fault, as CARLA's criteria decide: it moved by 0.1 m/s or more just before.

        So an actor that stands, and that another one drives or walks into, has not caused the contact. One whose speed is
        unknown counts as moving.
        """
        if self.impact is None:
            return id in self.ids
        return any(id == each and not speed < AT_FAULT for each, speed in zip(self.ids, self.impact.speeds, strict=True))


def is_same_contact(frames: int, seconds: float) -> bool:
    """Return whether a collision record of a pair belongs to the contact of the one before, some frames and seconds ago."""
    return frames <= 1 or abs(seconds) < SAME_CONTACT


class Contacts:
    """The contacts that collision records belong to; iterable in order of their first records."""

    def __init__(self) -> None:
        self._all: list[Contact] = []
        self._of_pair: dict[frozenset[int], list[Contact]] = {}
        self._latest: dict[frozenset[int], int] = {}  # the index of the latest frame with a record, by pair
        self._spawned: dict[int, int] = {}  # the index of the frame with the latest spawn, by id
        self._of_actor: dict[int, list[Contact]] = {}

    def __iter__(self) -> Iterator[Contact]:
        return iter(self._all)

    def add(self, frame: Frame) -> None:
        """Add the collision records of a frame."""
        for spawn in frame["spawned"]:
            self.spawn(frame, spawn.id)
        for _, id1, id2, hero1, hero2 in frame["collisions"].tolist():
            self.touch(frame, (id1, id2), (bool(hero1), bool(hero2)))

    def spawn(self, frame: Frame, id: int) -> None:
        """Note a new actor of a frame, which has no part in the contacts of one that had its id before."""
        self._spawned[id] = frame.index

    def touch(self, frame: Frame, ids: tuple[int, int], heroes: tuple[bool, bool]) -> Contact:
        """Add a collision record of a frame, and return the contact that it belongs to."""
        pair = frozenset(ids)
        known, latest = self._of_pair.setdefault(pair, []), self._latest.get(pair)
        self._latest[pair] = frame.index
        if latest is not None and latest < max(self._spawned.get(id, 0) for id in pair):
            latest = None
        if latest is not None and is_same_contact(frame.index - latest, frame.elapsed - known[-1].stop):
            known[-1].stop = frame.elapsed
            return known[-1]
        contact = Contact(len(self._all) + 1, ids, heroes, frame.index, frame.elapsed, frame.elapsed)
        self._all.append(contact)
        known.append(contact)
        for id in pair:
            self._of_actor.setdefault(id, []).append(contact)
        return contact

    def of(self, one: ActorLife, other: ActorLife) -> list[Contact]:
        """Return the contacts of two actors."""
        return [each for each in self._of_pair.get(frozenset((one.id, other.id)), ()) if each.is_of(one, other)]

    def affected(self, life: ActorLife, before: float) -> list[tuple[float, float]]:
        """Return the times in which contacts, from some seconds before each on, affect the motion of an actor, in order.

        Contacts that are less than a second apart affect the time between them, too.
        """
        spans: list[tuple[float, float]] = []
        contacts = (contact for contact in self._of_actor.get(life.id, ()) if contact.is_of(life))
        for contact in sorted(contacts, key=lambda contact: contact.start):
            start, stop = contact.start, contact.stop
            if spans and start - spans[-1][1] < SAME_CONTACT:
                start, earlier = spans.pop()
                stop = max(stop, earlier)
            spans.append((start, stop))
        return [(start - before, stop + _AFTERMATH) for start, stop in spans]


class ImpactTracker:
    """Finds the impacts in the frames of a recording, of which contacts and CARLA's collisions have some.

    An impact is a collision record if the frame before has none that is equal, or was more than a second ago.
    """

    def __init__(self) -> None:
        self._recent: list[Frame] = []  # the two latest frames
        self._touching: set[tuple[int, ...]] = set()
        self._elapsed = math.nan
        self._found: list[Impact] = []

    def frame(self, frame: Frame, index: int) -> None:
        """Process a frame; `index` is its position in the recording."""
        if _has_collisions(frame.packets):
            self._collide(frame, index)
        else:
            self._touching = set()
        self._recent = [*self._recent[-1:], frame]

    def batch(self, batch: Batch, index: int) -> None:
        """Process the frames of a batch; `index` is the position of the first one in the recording."""
        if len(batch) == 1 or _has_collisions(column.packet(0) for column in batch.columns):
            for row, frame in enumerate(batch):
                self.frame(frame, index + row)
        else:
            self._touching = set()
            self._recent = [*self._recent, *batch[-2:]][-2:]

    def take(self) -> list[Impact]:
        """Return the impacts that were found since the previous call."""
        found, self._found = self._found, []
        return found

    def _collide(self, frame: Frame, index: int) -> None:
        before, self._touching = self._touching, {tuple(sides) for _, *sides in frame["collisions"].tolist()}
        if not abs(frame.elapsed - self._elapsed) < SAME_CONTACT:
            before = set()
        self._elapsed = frame.elapsed
        keys = dict.fromkeys((index, id1, id2) for id1, id2, *_ in sorted(self._touching - before))
        if keys:
            recent = [None, None, *self._recent]
            self._found += [Impact.of(key, frame, recent[-1], recent[-2]) for key in keys]


def _has_collisions(packets: Iterable[Packet]) -> bool:
    return any(packet.id == _COLLISIONS and len(packet.records) for packet in packets)


def _row(frame: Frame, name: str, id: int) -> NDArray[np.void] | None:
    """Return the last record of an actor in a frame; None if there is none."""
    records = frame[name]
    assert isinstance(records, np.ndarray)
    rows = np.flatnonzero(records["id"] == id)
    return records[rows[-1]] if len(rows) else None


def _vector(row: NDArray[np.void] | None) -> Vector:
    """Return the first three numbers behind the id; NaN if any is NaN, or there is no record."""
    if row is None:
        return UNKNOWN
    x, y, z = (row[name].item() for name in "xyz")
    return UNKNOWN if math.isnan(x) or math.isnan(y) or math.isnan(z) else (x, y, z)


def _position(frame: Frame, id: int) -> Vector:
    return _vector(_row(frame, "transforms", id))


def velocity_before(id: int, frame: Frame | None, earlier: Frame | None) -> Vector:
    """Return the velocity of an actor just before a contact in m/s, left-handed; NaN where it is unknown.

    It is that of `carla_recap.model.motion`, but derived from frames before the contact alone: in that of the contact, the
    actor may have been stopped, or thrown: `frame` is the one before the contact, and `earlier` the one before that.
    """
    if frame is None:
        return UNKNOWN
    recorded = _vector(_row(frame, "velocities", id))
    is_known = counts(np.array(recorded))
    if earlier is None or is_known:
        return recorded if is_known else UNKNOWN
    places = np.array((_position(earlier, id), _position(frame, id))).T * CM
    with np.errstate(all="ignore"):
        both = np.array((_vector(_row(earlier, "velocities", id)), UNKNOWN)).T
        velocities, _ = motion_of(np.array((earlier.elapsed, frame.elapsed)), places, both)
    x, y, z = velocities[:, 1].tolist()
    return UNKNOWN if math.isnan(x) else (x, y, z)


def _length(vector: Iterable[float]) -> float:
    length = math.hypot(*vector)
    return math.nan if math.isnan(length) else length  # the same object, so that rows are equal
