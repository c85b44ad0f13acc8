"""What collisions leave behind: walkers that lie on the ground, and marks on the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.records import NO_ACTOR
from carla_recap.replay.events import Collided
from carla_recap.replay.player import Player
from carla_recap.replay.pose import LOCATION, ROTATION, right_handed, rotations
from carla_recap.replay.selection import find
from carla_recap.scene.appearance import Look, look_of_present

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.recording import Recording
    from carla_recap.replay import SceneBatch

    Floats = NDArray[np.float64]

MARKED: Final = 5.0
"""The time in s for which a collision is marked after the last contact."""

MARK_RADIUS: Final = 1.1
"""The radius of a mark in m."""

MOST_MARKS: Final = 50
"""The number of marks at a time, the latest ones."""

_MARK_HEIGHT: Final = 0.03  # m above the ground
_KNOCKED: Final = 1.5  # m/s: from this speed on, a vehicle knocks a walker down
_UPRIGHT: Final = 45.0  # degrees; the recorded pose of one that leans more is shown as it is
_WALKING: Final = 20.0  # cm/s; one that walks again has got up

_MOST_RECALLED: Final = 50  # collisions
_LEAD: Final = 0.3  # s before a collision that are read, for the velocities
_SLACK: Final = 1e-6  # s


class Fall(NamedTuple):
    """How a walker lies whose recorded pose is upright, in the walker's own right-handed axes.

    Attributes:
        rotation: The rotation of the body: a matrix, row by row.
        offset: The middle of the body, in m.
    """

    rotation: tuple[float, ...]
    offset: tuple[float, float, float]

    @property
    def matrix(self) -> Floats:
        """The rotation as a matrix, (3, 3)."""
        return np.array(self.rotation).reshape(3, 3)


class FallChange(NamedTuple):
    """A walker that falls or gets up.

    Attributes:
        row: The position of the scene in its batch.
        id: The walker.
        fall: How it lies from then on; None if it stands.
    """

    row: int
    id: int
    fall: Fall | None


class FallenWalkers:
    """The walkers that vehicles have knocked down, until they walk again.

    Attributes:
        falls: How they lie after the latest batch, by their ids.
    """

    def __init__(self) -> None:
        self.falls: dict[int, Fall] = {}
        self._before: SceneBatch | None = None

    def changes(self, batch: SceneBatch, *, keep: bool = False) -> list[FallChange]:
        """Return the falls and risings in the scenes of a batch; each batch has to be given, in order.

        Args:
            batch: The scenes.
            keep: Whether walkers keep lying in a batch that does not follow the one before.
        """
        found: list[FallChange] = []
        if not keep and _is_new(batch, self._before):
            found += [FallChange(0, id, None) for id in self.falls]
            self.falls.clear()
        for event in batch.events:
            if isinstance(event, Collided) and (fallen := self._fall(event, batch)) is not None:
                self.falls[fallen[0]] = fallen[1]
                found.append(FallChange(0, *fallen))
        for id in list(self.falls):
            row = _rises(id, batch)
            if row is not None:
                del self.falls[id]
                found.append(FallChange(row, id, None))
        self._before = batch
        return found

    def _fall(self, contact: Collided, batch: SceneBatch) -> tuple[int, Fall] | None:
        """Return the walker that a contact knocks down, and how it lies; None if there is none."""
        pair = contact.actor1, contact.actor2
        kinds = [batch.actors[id].kind if id in batch.actors else None for id in pair]
        if kinds.count("walker") != 1:
            return None
        walker, other = pair if kinds[0] == "walker" else pair[::-1]
        pose, look = batch.pose_of(walker, 0), look_of_present(batch.actors[walker])
        if walker in self.falls or pose is None or look is None or not np.isfinite(pose).all() or _leans(pose):
            return None
        if other == NO_ACTOR or batch.pose_of(other, 0) is None:
            return None
        velocity = self._velocity(other, batch) - self._velocity(walker, batch)
        speed = float(np.hypot(*velocity))
        return (walker, _lying(pose, look, velocity / speed)) if speed > _KNOCKED else None

    def _velocity(self, id: int, batch: SceneBatch) -> Floats:
        """Return the velocity over the ground in m/s, right-handed: as recorded, else that of the last step."""
        rows = batch.records("velocities")[0]
        index, known = find(np.array([id], np.uint32), rows["id"])
        if known[0]:
            recorded = np.array((rows["x"][index[0]], -rows["y"][index[0]]), np.float64)
            if np.isfinite(recorded).all():
                return recorded
        before, pose = self._before, batch.pose_of(id, 0)
        if before is None or pose is None or batch.fresh:
            return np.zeros(2)
        last, seconds = before.pose_of(id, len(before) - 1), float(batch.time[0] - before.time[-1])
        if last is None or not seconds > 0:
            return np.zeros(2)
        step = np.asarray(right_handed(pose - last)[LOCATION][:2] / seconds)
        return step if np.isfinite(step).all() else np.zeros(2)


def _lying(pose: Floats, look: Look, direction: Floats) -> Fall:
    """Return how a walker lies that was hit in a direction: on its back, or on its face if it was hit from behind."""
    upright = rotations(right_handed(pose))
    up = np.array((*direction, 0.0))
    forward = np.array((0.0, 0.0, 1.0 if upright[:, 0] @ up <= 0 else -1.0))
    lying = np.column_stack((forward, np.cross(up, forward), up))
    down = np.array((0.0, 0.0, look.half_extents[0] - look.half_extents[2]))
    x, y, z = (look.center + upright.T @ down).round(4).tolist()
    return Fall(tuple((upright.T @ lying).round(6).ravel().tolist()), (x, y, z))


def _rises(id: int, batch: SceneBatch) -> int | None:
    """Return the first row in which a fallen walker walks, leans as recorded, or is gone; None if it keeps lying."""
    if id not in batch.actors:
        return 0
    ends = np.zeros(len(batch), np.bool_)
    controls = batch.records("walker_controls")
    index, known = find(np.array([id], np.uint32), controls["id"][0])
    if known[0]:
        ends |= controls["speed"][:, index[0]] > _WALKING
    poses = batch.pose_of(id)
    if poses is not None:
        ends |= _leans(poses)
    rows = np.flatnonzero(ends)
    return int(rows[0]) if len(rows) else None


def _leans(poses: Floats) -> NDArray[np.bool_]:
    """Return whether poses are far from upright."""
    return np.asarray(np.abs(poses[..., ROTATION][..., :2]).max(axis=-1) > _UPRIGHT)


@dataclass
class _Mark:
    """A mark: its location in m, right-handed, and the elapsed seconds until which it is shown."""

    location: Floats
    until: float


class CollisionMarks:
    """The marks where actors have collided: from the first contact of two actors until some seconds after the last one."""

    def __init__(self) -> None:
        self._marks: dict[tuple[int, int], _Mark] = {}  # by the two actors
        self._before: SceneBatch | None = None

    @property
    def locations(self) -> Floats:
        """Where the marks are after the latest batch, (marks, 3) in m, right-handed, a little above the ground."""
        return np.array([self._marks[pair].location for pair in self._shown()], np.float64).reshape(-1, 3)

    def changes(self, batch: SceneBatch, *, keep: bool = False) -> list[tuple[int, Floats]]:
        """Return the rows at which marks appear or disappear, and `locations` from then on.

        Args:
            batch: The scenes; each batch has to be given, in order.
            keep: Whether marks are kept in a batch that does not follow the one before.
        """
        shown = self._shown()
        if not keep and _is_new(batch, self._before):
            self._marks.clear()
        self._before = batch
        self._remove(float(batch.time[0]))
        for event in batch.events:
            if isinstance(event, Collided):
                self._mark(event, batch)
        found = [(0, self.locations)] if self._shown() != shown else []
        while self._marks:
            rows = np.flatnonzero(batch.time >= min(mark.until for mark in self._marks.values()))
            if not len(rows):
                break
            shown = self._shown()
            self._remove(float(batch.time[rows[0]]))
            if self._shown() != shown:
                found.append((int(rows[0]), self.locations))
        return found

    def _shown(self) -> list[tuple[int, int]]:
        """Return the pairs of actors whose marks are shown: the latest ones."""
        return list(self._marks)[-MOST_MARKS:]

    def _remove(self, time: float) -> None:
        """Remove the marks that are over."""
        self._marks = {pair: mark for pair, mark in self._marks.items() if not mark.until <= time}

    def _mark(self, contact: Collided, batch: SceneBatch) -> None:
        """Mark a contact: below the walker, if one was hit, else in the middle of both actors."""
        pair = min(contact.actor1, contact.actor2), max(contact.actor1, contact.actor2)
        until = float(batch.time[0]) + MARKED - _SLACK
        if pair in self._marks:
            self._marks[pair].until = until
            return
        feet = {id: foot for id in pair if id != NO_ACTOR and (foot := _foot(id, batch)) is not None}
        walkers = [foot for id, foot in feet.items() if id in batch.actors and batch.actors[id].kind == "walker"]
        if not feet:
            return
        location = np.mean(walkers or list(feet.values()), axis=0)
        location[2] += _MARK_HEIGHT
        self._marks[pair] = _Mark(location, until)


def collision_scenes(recording: Recording, time: float) -> Iterator[SceneBatch]:
    """Yield the scenes around those collisions before a moment of which something may be left, in order.

    Args:
        recording: The recording.
        time: The moment, in elapsed seconds.
    """
    rows = [row for row in recording.collisions() if row.elapsed <= time]
    lasting = [row for row in rows if "w" in (row.letter1, row.letter2) or row.elapsed > time - MARKED]
    for row in lasting[-_MOST_RECALLED:]:
        for scene in Player(recording, start=max(row.elapsed - _LEAD, 0.0), duration=2 * _LEAD).scenes():
            if scene.time > row.elapsed + _SLACK:
                break
            yield scene.batch[scene.row : scene.row + 1]


def _is_new(batch: SceneBatch, before: SceneBatch | None) -> bool:
    """Return whether a batch does not follow the one before: it is the first one, one after a seek, or an earlier one."""
    return batch.fresh or (before is not None and bool(batch.time[0] < before.time[-1]))


def _foot(id: int, batch: SceneBatch) -> Floats | None:
    """Return the location of an actor on the ground in m, right-handed; None if it is unknown."""
    pose = batch.pose_of(id, 0)
    if pose is None or not np.isfinite(pose).all():
        return None
    actor = batch.actors.get(id)
    look = None if actor is None else look_of_present(actor)
    bottom = 0.0 if look is None else look.center[2] - look.half_extents[2]
    return np.asarray(right_handed(pose)[LOCATION] + np.array((0.0, 0.0, bottom)))
