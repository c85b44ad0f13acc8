"""Beginnings of contacts: where two actors are when they touch, and how fast they were just before."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.records import CM, UE4

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Frame, Packet

    Vector = tuple[float, float, float]
    Recent = Frame | tuple[Batch, int]  # a frame, or a batch and the row of one

MOTION: Final = ("transforms", "velocities")
"""The record types of positions and velocities."""
TYPES: Final = ("collisions", *MOTION)
"""The record types that contacts are found by."""
SAME_CONTACT: Final = 1.0
"""Records of a pair with a shorter interval between them, in seconds, belong to one contact."""
UNKNOWN: Final[Vector] = (math.nan, math.nan, math.nan)

_GAP: Final = 1.0  # s between two positions that a velocity is derived from, at most
_TOP_SPEED: Final = 100.0  # m/s; what is faster has jumped

_COLLISIONS: Final = UE4.named("collisions").id

Key = tuple[int, int, int]


class ContactStart(NamedTuple):
    """The first frame of a contact.

    Attributes:
        frame_index: The index of the frame, from 0.
        id1: The actor with the collision sensor.
        id2: The other actor.
        position1: The position of the first actor in this frame, in cm, left-handed; NaN where it is unknown.
        position2: That of the other one.
        velocity1: The velocity of the first actor in the frame before, in m/s, left-handed; NaN where it is unknown.
        velocity2: That of the other one.
    """

    frame_index: int
    id1: int
    id2: int
    position1: Vector = UNKNOWN
    position2: Vector = UNKNOWN
    velocity1: Vector = UNKNOWN
    velocity2: Vector = UNKNOWN

    @property
    def key(self) -> Key:
        """The index and the ids."""
        return self[:3]


def contact_start(key: Key, frame: Frame, before: Frame | None, earlier: Frame | None) -> ContactStart:
    """Return the beginning of a contact.

    The velocity of an actor is the one recorded in the frame before; if none is recorded, it is derived from the positions
    in the two frames before, unless they are more than a second apart or the actor jumps.

    Args:
        key: The index of the frame and the ids of the actors.
        frame: The frame.
        before: The frame before it, if there is one.
        earlier: The frame before that one, if there is one.
    """
    _, id1, id2 = key
    positions = _position(frame, id1), _position(frame, id2)
    return ContactStart(*key, *positions, _velocity(id1, before, earlier), _velocity(id2, before, earlier))


class ContactTracker:
    """Finds the beginnings of contacts in the frames of a recording.

    A contact begins with a collision record if the frame before has none that is equal, or was more than a second ago.
    """

    def __init__(self) -> None:
        self._recent: list[Recent] = []  # the two latest frames
        self._touching: set[tuple[int, ...]] = set()
        self._elapsed = math.nan
        self._found: list[ContactStart] = []

    def frame(self, frame: Frame, index: int) -> None:
        """Process a frame; `index` is its position in the recording.

        Raises:
            FormatError: A packet contradicts its layout.
        """
        if _has_collisions(frame.packets):
            self._collide(frame, index)
        else:
            self._touching = set()
        self._recent = [*self._recent[-1:], frame]

    def batch(self, batch: Batch, index: int) -> None:
        """Process the frames of a batch; `index` is the position of the first one in the recording.

        Raises:
            FormatError: A packet contradicts its layout.
        """
        if len(batch) == 1 or _has_collisions(column.packet(0) for column in batch.columns):
            for row, frame in enumerate(batch):
                self.frame(frame, index + row)
        else:
            self._touching = set()
            rows = range(max(len(batch) - 2, 0), len(batch))
            self._recent = [*self._recent, *((batch, row) for row in rows)][-2:]

    def take(self) -> list[ContactStart]:
        """Return the contacts that were found since the previous call."""
        found, self._found = self._found, []
        return found

    def _collide(self, frame: Frame, index: int) -> None:
        before, self._touching = self._touching, {tuple(sides) for _, *sides in frame["collisions"].tolist()}
        if not abs(frame.elapsed - self._elapsed) < SAME_CONTACT:
            before = set()
        self._elapsed = frame.elapsed
        keys = dict.fromkeys((index, id1, id2) for id1, id2, *_ in sorted(self._touching - before))
        if keys:
            recent = [None, None, *map(_frame, self._recent)]
            self._found += [contact_start(key, frame, recent[-1], recent[-2]) for key in keys]


def _frame(recent: Recent) -> Frame:
    if not isinstance(recent, tuple):
        return recent
    batch, row = recent
    return batch.frame(row)


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


def _velocity(id: int, frame: Frame | None, earlier: Frame | None) -> Vector:
    if frame is None:
        return UNKNOWN
    recorded = _row(frame, "velocities", id)
    if recorded is not None:
        return _vector(recorded)
    seconds = frame.elapsed - earlier.elapsed if earlier is not None else 0.0
    if earlier is None or not 0 < seconds <= _GAP:
        return UNKNOWN
    now, then = _position(frame, id), _position(earlier, id)
    x, y, z = ((a - b) * CM / seconds for a, b in zip(now, then, strict=True))
    return (x, y, z) if math.hypot(x, y, z) <= _TOP_SPEED else UNKNOWN
