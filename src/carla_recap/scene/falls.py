"""Walkers that vehicles have knocked down: they lie on the ground, although their recorded poses are upright."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.contacts import velocity_before
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.records import NO_ACTOR
from carla_recap.replay.events import Collided, Spawned
from carla_recap.replay.player import Player
from carla_recap.replay.pose import ROTATION, right_handed, rotations
from carla_recap.replay.selection import array
from carla_recap.scene.appearance import Look, look_of_present

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.replay import SceneBatch
    from carla_recap.util.arrays import Floats


_KNOCKED: Final = 1.5  # m/s: from this speed on, a vehicle knocks a walker down
UPRIGHT: Final = 45.0
"""The angle in degrees up to which a recorded pose is upright; that of a walker that leans more is shown as it is."""

_WALKING: Final = 20.0  # cm/s; one that walks again has got up
_FALLING: Final = 0.6  # s from the hit until a walker lies
_LEAD: Final = 2.0  # s before a hit that are read, for the velocities in the two frames before it
_SLACK: Final = 1e-3  # s
_LOOK_BACK: Final = 10.0  # s before a moment in which walkers that have got up are looked for first
_WIDER: Final = 4.0  # the factor by which it grows
_MOST_HITS: Final = 50  # of a walker that are looked at


class Fall(NamedTuple):
    """How a walker leans or lies whose recorded pose is upright, in the walker's own right-handed axes."""

    rotation: tuple[float, ...]  # the rotation of the body: a matrix, row by row
    offset: tuple[float, float, float]  # the middle of the body, in m

    @property
    def matrix(self) -> Floats:
        """The rotation as a matrix, (3, 3)."""
        return np.array(self.rotation).reshape(3, 3)


class _Hit(NamedTuple):
    """What knocks a walker down."""

    time: float  # when, in elapsed seconds
    look: Look  # the look of the walker
    upright: Floats  # the rotation of its pose then, (3, 3)
    turn: Floats  # the rotation from there to how it lies, in the walker's own axes: the axis times the angle in rad


class _Tip(NamedTuple):
    """A walker whose recorded pose lies from a hit on: the elapsed seconds of the hit, its look, and its rotation before."""

    time: float
    look: Look
    upright: Floats


class FallChange(NamedTuple):
    """A walker that falls, in several steps, or gets up."""

    row: int  # the position of the scene in its batch
    id: int  # the walker
    fall: Fall | None  # how it leans or lies from then on; None if it stands


class FallenWalkers:
    """The walkers that vehicles have knocked down, until they walk again.

    Attributes:
        falls: How they lean or lie after the latest batch, by their ids.
    """

    def __init__(self) -> None:
        self.falls: dict[int, Fall] = {}
        self._hits: dict[int, _Hit | None] = {}  # what knocked them down; None of those that lie
        self._tips: dict[int, _Tip] = {}  # those that are recorded as lying at once, while they fall
        self._before: SceneBatch | None = None
        self._recent: dict[int, tuple[Batch, int]] = {}  # the two latest frames by index, each a row of a batch

    def changes(self, batch: SceneBatch, *, keep: bool = False) -> list[FallChange]:
        """Return the falls and risings in the scenes of a batch; each batch has to be given, in order.

        With `keep`, walkers keep lying in a batch that does not follow the one before.
        """
        found: list[FallChange] = []
        if is_new(batch, self._before):
            self._recent.clear()
            if not keep:
                found += [FallChange(0, id, None) for id in self.falls]
                self.falls.clear()
                self._hits.clear()
                self._tips.clear()
        for event in batch.events:
            if isinstance(event, Spawned) and not batch.fresh:
                self._hits.pop(event.actor.id, None)
                self._tips.pop(event.actor.id, None)
                if self.falls.pop(event.actor.id, None) is not None:
                    found.append(FallChange(0, event.actor.id, None))
            elif isinstance(event, Collided) and (knocked := self._hit(event, batch)) is not None:
                self._hits[knocked[0]] = knocked[1]
            elif isinstance(event, Collided):
                self._tips |= self._tipped(event, batch)
        for id, tip in list(self._tips.items()):
            found += self._tip(id, tip, batch)
        for id, hit in list(self._hits.items()):
            up = np.flatnonzero(_up(id, batch.frames)) if id in batch.actors else [0]
            rises = int(up[0]) if len(up) else None
            if hit is not None:
                found += self._fall(id, hit, batch.time[:rises])
            if rises is not None:
                del self._hits[id]
                if self.falls.pop(id, None) is not None:
                    found.append(FallChange(rises, id, None))
        self._before, frames = batch, batch.frames
        recent = self._recent | {frames.index + row: (frames, row) for row in range(max(len(frames) - 2, 0), len(frames))}
        self._recent = dict(sorted(recent.items())[-2:])
        return found

    def recall(self, reader: Reader, batch: SceneBatch, contacts: RecordedContacts) -> None:
        """Learn which walkers lie that were knocked down before the next batch."""
        for id, times in _unrisen(reader, _walkers_hit(contacts, batch), float(batch.time[0])).items():
            for hit in times[:_MOST_HITS]:
                seen, start = FallenWalkers(), max(hit - _LEAD, 0.0)
                for around in Player(reader, start=start, duration=hit - start + _SLACK).batches():
                    seen.changes(around, keep=True)
                if id in seen._hits:
                    self._hits[id] = seen._hits[id]
                    break

    def shift(self, seconds: float) -> None:
        """Let elapsed times begin later, as those of a clip do."""
        self._hits = {id: None if hit is None else hit._replace(time=hit.time - seconds) for id, hit in self._hits.items()}
        self._tips = {id: tip._replace(time=tip.time - seconds) for id, tip in self._tips.items()}

    def _fall(self, id: int, hit: _Hit, times: Floats) -> Iterator[FallChange]:
        """Yield how a walker leans in the scenes of some times, until it lies."""
        for row in np.flatnonzero(times > hit.time).tolist():
            share = min((float(times[row]) - hit.time) / _FALLING, 1.0)
            self.falls[id] = _leaning(hit, share**2)
            yield FallChange(row, id, self.falls[id])
            if share == 1:
                self._hits[id] = None
                return

    def _tip(self, id: int, tip: _Tip, batch: SceneBatch) -> Iterator[FallChange]:
        """Yield how a walker leans that is recorded as lying, until it lies as recorded."""
        for row, time in enumerate(batch.time.tolist()):
            pose, share = batch.pose_of(id, row), (time - tip.time) / _FALLING
            if share < 1 and pose is not None and _is_lying(pose):
                self.falls[id] = _tipping(tip, rotations(right_handed(pose)), max(share, 0.0) ** 2)
                yield FallChange(row, id, self.falls[id])
                continue
            del self._tips[id]
            if self.falls.pop(id, None) is not None:
                yield FallChange(row, id, None)
            return

    def _tipped(self, contact: Collided, batch: SceneBatch) -> dict[int, _Tip]:
        """Return the walkers of a contact that are recorded as upright just before it, and as lying from it on."""
        found: dict[int, _Tip] = {}
        for id in (contact.actor1, contact.actor2):
            pose = batch.pose_of(id, 0)
            before = None if self._before is None or batch.fresh else self._before.pose_of(id, len(self._before) - 1)
            if pose is None or before is None or id not in batch.actors or batch.actors[id].kind != "walker":
                continue
            look = look_of_present(batch.actors[id])
            if look is not None and _is_lying(pose) and np.isfinite(before).all() and not _is_lying(before):
                found[id] = _Tip(contact.elapsed, look, rotations(right_handed(before)))
        return found

    def _hit(self, contact: Collided, batch: SceneBatch) -> tuple[int, _Hit] | None:
        """Return the walker that a contact knocks down, and how; None if there is none."""
        pair = contact.actor1, contact.actor2
        kinds = [batch.actors[id].kind if id in batch.actors else None for id in pair]
        if kinds.count("walker") != 1:
            return None
        walker, other = pair if kinds[0] == "walker" else pair[::-1]
        pose, look = batch.pose_of(walker, 0), look_of_present(batch.actors[walker])
        if walker in self._hits or pose is None or look is None or not np.isfinite(pose).all():
            return None
        if _leans(*pose[ROTATION][:2]):
            return None
        if other == NO_ACTOR or batch.pose_of(other, 0) is None:
            return None
        velocity = self._velocity(other, batch) - self._velocity(walker, batch)
        speed = float(np.hypot(*velocity))
        if not speed > _KNOCKED:
            return None
        upright = rotations(right_handed(pose))
        return walker, _Hit(contact.elapsed, look, upright, _turn(upright.T @ _lying(upright, velocity / speed)))

    def _velocity(self, id: int, batch: SceneBatch) -> Floats:
        """Return the velocity over the ground just before a hit in m/s, right-handed; 0 where it is unknown.

        It is that of `velocity_before`, as the relative speeds of contacts are; in a first frame, it is the recorded one.
        """
        frames = [frames.frame(row) for index, (frames, row) in self._recent.items() if index < batch.frames.index]
        earlier, before = [None, None, *frames][-2:]
        x, y, _ = velocity_before(id, before or batch.frames.frame(0), earlier)
        return np.asarray(np.nan_to_num((x, -y)))


class RecordedContacts:
    """The contacts of a recording, each part of which is read once, for many moments in order."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader
        self._read = -math.inf  # the elapsed seconds before which they have been read
        self._contacts: list[tuple[float, int, int]] = []

    def before(self, time: float) -> Iterator[tuple[float, int, int]]:
        """Return the contacts before a time: elapsed seconds and the ids of both actors."""
        if time > self._read:
            for frame in self._reader.frames(("collisions",), sparse=True, start=self._read, stop=time):
                rows = array(frame["collisions"]).tolist()
                self._contacts += [(frame.elapsed, actor1, actor2) for _, actor1, actor2, *_ in rows]
            self._read = time
        return (contact for contact in self._contacts if contact[0] < time - SAME_TIME)


def _walkers_hit(contacts: RecordedContacts, batch: SceneBatch) -> dict[int, list[float]]:
    """Return when, in elapsed seconds, the walkers of a batch were hit before it by something else than a walker."""
    spawned = {id: actor.spawned_at for id, actor in batch.actors.items() if actor.kind == "walker"}
    found: dict[int, list[float]] = {}
    if not spawned:
        return found
    for elapsed, actor1, actor2 in contacts.before(float(batch.time[0])):
        walkers = [id for id in (actor1, actor2) if elapsed >= spawned.get(id, np.inf)]
        if len(walkers) == 1 and NO_ACTOR not in (actor1, actor2):
            found.setdefault(walkers[0], []).append(elapsed)
    return found


def _unrisen(reader: Reader, hits: dict[int, list[float]], time: float) -> dict[int, list[float]]:
    """Return those hits since which, until a moment, the walker has not got up.

    It is looked for from the moment backwards, in longer and longer steps: most walkers walk in the seconds before it.
    """
    stop, span = time, _LOOK_BACK
    while hits and stop >= (earliest := min(times[0] for times in hits.values())):
        start = max(stop - span, earliest - _SLACK)
        risen: dict[int, float] = {}
        for batch in reader.batches(("walker_controls", "transforms"), start=start, stop=stop + _SLACK):
            for id in hits:
                if len(rows := np.flatnonzero(_up(id, batch))):
                    risen[id] = float(batch.elapsed[rows[-1]])
        left = {id: [hit for hit in times if hit > risen.get(id, -np.inf)] for id, times in hits.items()}
        hits = {id: times for id, times in left.items() if times}
        stop, span = start, span * _WIDER
    return hits


def _lying(upright: Floats, direction: Floats) -> Floats:
    """Return the rotation of a walker that was hit in a direction: on its back, or on its face if it was hit from behind."""
    up = np.array((*direction, 0.0))
    forward = np.array((0.0, 0.0, 1.0 if upright[:, 0] @ up <= 0 else -1.0))
    return np.column_stack((forward, np.cross(up, forward), up))


def _turn(matrix: Floats) -> Floats:
    """Return the axis of a rotation times its angle in rad, which is not 0 or pi."""
    axis = np.array((matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]))
    length = np.linalg.norm(axis)  # twice the sine of the angle
    return np.asarray(axis / length * np.arctan2(length, np.trace(matrix) - 1))


def _leaning(hit: _Hit, share: float) -> Fall:
    """Return how a walker leans that has fallen by a share from 0 to 1; it touches the ground."""
    rotation = _turned(hit.turn, share)
    return _standing(hit.look, hit.upright, rotation)


def _tipping(tip: _Tip, recorded: Floats, share: float) -> Fall:
    """Return how a walker leans that has fallen by a share from 0 to 1 from upright to its recorded rotation."""
    leaning = tip.upright @ _turned(_turn(tip.upright.T @ recorded), share)
    return _standing(tip.look, recorded, recorded.T @ leaning)


def _turned(turn: Floats, share: float) -> Floats:
    """Return the matrix of a share of a turn, whose axis times its angle in rad is given."""
    angle = float(np.linalg.norm(turn))
    x, y, z = turn / angle
    across = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    return np.asarray(np.eye(3) + np.sin(share * angle) * across + (1 - np.cos(share * angle)) * across @ across)


def _standing(look: Look, recorded: Floats, rotation: Floats) -> Fall:
    """Return a body that is turned in its own axes, as high above the ground as one at its recorded rotation."""
    half_extents = np.array(look.half_extents)
    height = (np.abs((recorded @ rotation)[2]) - np.abs(recorded[2])) @ half_extents
    x, y, z = (look.center + recorded.T @ (0.0, 0.0, height)).round(4).tolist()
    return Fall(tuple(rotation.round(6).ravel().tolist()), (x, y, z))


def _up(id: int, frames: Batch) -> NDArray[np.bool_]:
    """Return whether a walker cannot lie, as it walks, or leans as recorded, (frames,)."""
    controls, transforms = frames.records("walker_controls"), frames.records("transforms")
    walks = (controls["id"] == id) & (controls["speed"] > _WALKING)
    leans = (transforms["id"] == id) & _leans(transforms["roll"], transforms["pitch"])
    return np.asarray(walks.any(axis=1) | leans.any(axis=1))


def _is_lying(pose: Floats) -> bool:
    return bool(np.isfinite(pose).all() and _leans(*pose[ROTATION][:2]))


def _leans(roll: NDArray[np.floating], pitch: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return whether poses are far from upright, given two of their angles in degrees."""
    with np.errstate(invalid="ignore"):  # a signaling NaN
        return np.asarray(np.maximum(np.abs(roll), np.abs(pitch)) > UPRIGHT)


def is_new(batch: SceneBatch, before: SceneBatch | None) -> bool:
    """Return whether a batch does not follow the one before: it is the first one, one after a seek, or an earlier one."""
    return batch.fresh or (before is not None and bool(batch.time[0] < before.time[-1]))
