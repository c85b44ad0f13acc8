"""Collisions: which actors collide, and when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final

from carla_recap.errors import RecapError
from carla_recap.model.actors import PresentActors
from carla_recap.model.records import NO_ACTOR
from carla_recap.queries import Answer
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from carla_recap.formats.base import Reader

LETTERS: Final = {"v": "vehicle", "w": "walker", "t": "traffic light", "o": "other", "h": "hero", "a": "any"}
"""The kinds that a side of a collision can be filtered by."""

_KINDS: Final = "ovwt"  # by ActorKind; signs and sensors count as others
_KINDS_OF_CARLA: Final = "ovwtha"  # CARLA includes the letters for hero and any in its list of kinds
_TYPES: Final = ("spawned", "destroyed", "collisions")

_Actor = tuple[int, str]  # kind and type id
_UNKNOWN: Final[_Actor] = (0, "")


@dataclass(frozen=True, slots=True)
class CollisionRow:
    """The beginning of a collision; the frames in which it continues give no further rows.

    Attributes:
        elapsed: Seconds since the recording began.
        frame: CARLA's frame number.
        letter1: The kind of the first actor: `v` vehicle, `w` walker, `t` traffic light, `o` other.
        id1: Its id; 4294967295 for an object that is no actor, such as a building.
        type_id1: Its blueprint, such as `vehicle.audi.tt`; empty for an unknown actor.
        hero1: Whether it is the hero.
        letter2: The kind of the second actor.
        id2: Its id.
        type_id2: Its blueprint.
        hero2: Whether it is the hero.
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


class Collisions(Answer[CollisionRow]):
    """The collisions of a recording."""

    row_type = CollisionRow
    row_units: ClassVar = {"elapsed": "s"}


def collisions(source: Reader, type1: str = "a", type2: str = "a", *, compat: bool = False) -> Collisions:
    """Return the collisions between two kinds of actors.

    Each ordered pair of actors gives a row in the first frame of its contact. The first actor is the one with the collision
    sensor.

    Args:
        source: The recording.
        type1: The kind of the first actor: a letter of `LETTERS`.
        type2: The kind of the second actor.
        compat: Whether to reproduce the mistakes of CARLA 0.9.16.

    Raises:
        RecapError: There is no such letter.
        FormatError: The file contradicts its format.
    """
    if not compat:
        check_letters(type1, type2)
    kinds = _KINDS_OF_CARLA if compat else _KINDS
    present = PresentActors[_Actor](compat=compat)
    rows: list[CollisionRow] = []
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
            elif packet.type.name == "destroyed":
                for (id,) in packet.records.tolist():  # type: ignore[union-attr]
                    present.destroy(id)
            else:
                for _, id1, id2, hero1, hero2 in packet.records.tolist():  # type: ignore[union-attr]
                    letter1, type_id1 = look_up(id1)
                    letter2, type_id2 = look_up(id2)
                    if not (_passes(type1, letter1, hero1) and _passes(type2, letter2, hero2)):
                        continue
                    touching.add((id1, id2))
                    if (id1, id2) not in before:
                        sides = (letter1, id1, type_id1, bool(hero1), letter2, id2, type_id2, bool(hero2))
                        rows.append(CollisionRow(frame.elapsed, frame.id, *sides))
    return Collisions(rows, source, compat=compat)


def _passes(wanted: str, letter: str, hero: int) -> bool:
    return wanted in ("a", letter) or (wanted == "h" and hero != 0)


def check_letters(*letters: str) -> None:
    """Raise `RecapError` unless these are kinds of a collision's actors."""
    for wanted in letters:
        if wanted not in LETTERS:
            known = ", ".join(f"{letter} ({meaning})" for letter, meaning in LETTERS.items())
            raise RecapError(f"{wanted!r} is no type of a collision's actor; there are {known}")
