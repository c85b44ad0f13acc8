"""Collisions: which actors collide, and when."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Final

from carla_recap.errors import RecapError
from carla_recap.model.contacts import Contacts
from carla_recap.model.lives import PresentActors
from carla_recap.model.records import NO_ACTOR
from carla_recap.queries import Answer
from carla_recap.queries.contacts import impacts
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader
    from carla_recap.model.contacts import Impact, Key

LETTERS: Final = {"v": "vehicle", "w": "walker", "t": "traffic light", "o": "other", "h": "hero", "a": "any"}
"""The kinds that a side of a collision can be filtered by."""

_KINDS: Final = "ovwt"  # by ActorKind; signs and sensors count as others
_KINDS_OF_CARLA: Final = "ovwtha"  # CARLA includes the letters for hero and any in its list of kinds
_TYPES: Final = ("spawned", "destroyed", "collisions")

_Actor = tuple[int, str]  # kind and type id
_UNKNOWN: Final[_Actor] = (0, "")


@dataclass(frozen=True, slots=True)
class CollisionRow:
    """A collision as CARLA counts them: a frame in which an actor touches another one, and did not in the frame before.

    Attributes:
        elapsed: Seconds since the recording began.
        frame: CARLA's frame number.
        letter1: The kind of the first actor: `v` vehicle, `w` walker, `t` traffic light, `o` other.
        id1: Its id; 4294967295 for a static object, such as a building.
        type_id1: Its blueprint, such as `vehicle.audi.tt`; empty for an unknown actor.
        hero1: Whether it is the hero.
        letter2: The kind of the second actor.
        id2: Its id.
        type_id2: Its blueprint.
        hero2: Whether it is the hero.
        contact: The number of the contact that it belongs to, from 1; an incident is a whole contact.
        impact_speed: The speed of the first actor in the frame before, in m/s; NaN where it is unknown.
        relative_speed: The magnitude of the difference of both velocities in the frame before, in m/s; NaN where it is
            unknown. A static object and a traffic light stand still.
    """

    elapsed: float
    frame: int
    letter1: str
    id1: int
    type_id1: str
    hero1: bool
    letter2: str
    id2: int
    type_id2: str
    hero2: bool
    contact: int
    impact_speed: float = math.nan
    relative_speed: float = math.nan


class Collisions(Answer[CollisionRow]):
    """The collisions of a recording."""

    row_type = CollisionRow
    row_units: ClassVar = {"elapsed": "s", "impact_speed": "m/s", "relative_speed": "m/s"}

    @property
    def contacts(self) -> int:
        """The number of contacts that the rows belong to."""
        return len({row.contact for row in self})


def collisions(
    source: Reader, type1: str = "a", type2: str = "a", *, compat: bool = False, speeds: bool = True
) -> Collisions:
    """Return the collisions between two kinds of actors, letters of `LETTERS`; see `Recording.collisions`.

    As in CARLA, an ordered pair of actors gives a row in a frame if the frame before has no record of it. So a contact gives
    several rows if both actors have a sensor, or if a frame in it has no record; they have the same number. Speeds are those
    in the last frame before the contact, but with `compat`; an MCAP file lists them, else the frames before are read.
    """
    if not compat:
        check_letters(type1, type2)
    kinds = _KINDS_OF_CARLA if compat else _KINDS
    present = PresentActors[_Actor](compat=compat)
    rows: list[CollisionRow] = []
    keys: list[Key] = []
    contacts = Contacts()
    touching: set[tuple[int, int]] = set()
    index = -2

    def look_up(id: int) -> tuple[str, str]:
        kind, type_id = present.actors.get(id, _UNKNOWN)
        return kinds[kind] if kind < len(kinds) and id != NO_ACTOR else "o", type_id

    for frame in source.frames(_TYPES, sparse=True):
        before = touching if frame.index == index + 1 else set()
        index, touching = frame.index, set()
        for packet in frame.packets:
            assert packet.type is not None
            if packet.type.name == "spawned":
                for spawn in packet.records:
                    present.spawn(spawn.id, (spawn.kind, readable(spawn.type_id)))
                    contacts.spawn(frame, spawn.id)
            elif packet.type.name == "destroyed":
                for (id,) in packet.records.tolist():  # type: ignore[union-attr]
                    present.destroy(id)
            else:
                for _, id1, id2, hero1, hero2 in packet.records.tolist():  # type: ignore[union-attr]
                    contact = contacts.touch(frame, (id1, id2), (bool(hero1), bool(hero2)))
                    letter1, type_id1 = look_up(id1)
                    letter2, type_id2 = look_up(id2)
                    if not (_passes(type1, letter1, hero1) and _passes(type2, letter2, hero2)):
                        continue
                    touching.add((id1, id2))
                    if (id1, id2) not in before:
                        sides = (letter1, id1, type_id1, bool(hero1), letter2, id2, type_id2, bool(hero2))
                        rows.append(CollisionRow(frame.elapsed, frame.id, *sides, contact.number))
                        keys.append((index, id1, id2))
    if speeds and not compat:
        found = impacts(source, {key: row.elapsed for key, row in zip(keys, rows, strict=True)})
        rows = [_with_speeds(row, found[key]) if key in found else row for key, row in zip(keys, rows, strict=True)]
    return Collisions(rows, source, compat=compat)


def _with_speeds(row: CollisionRow, impact: Impact) -> CollisionRow:
    sides = ((row.id1, row.letter1, row.type_id1), (row.id2, row.letter2, row.type_id2))
    impact = impact.with_fixed(*(_is_fixed(*side) for side in sides))
    return replace(row, impact_speed=impact.speeds[0], relative_speed=impact.relative_speed)


def _is_fixed(id: int, letter: str, type_id: str) -> bool:
    """Return whether a side of a collision never moves; before CARLA 0.9.13, the id 0 stands for what is no actor."""
    return id == NO_ACTOR or letter == "t" or (id == 0 and not type_id)


def _passes(wanted: str, letter: str, hero: int) -> bool:
    return wanted in ("a", letter) or (wanted == "h" and hero != 0)


def check_letters(*letters: str) -> None:
    """Raise `RecapError` unless these are kinds of a collision's actors."""
    for wanted in letters:
        if wanted not in LETTERS:
            known = ", ".join(f"{letter} ({meaning})" for letter, meaning in LETTERS.items())
            raise RecapError(f"{wanted!r} is no type of a collision's actor; there are {known}")
