"""What happens, line by line: many who come or go at once in one line, and a contact of many frames once."""

from __future__ import annotations

from collections import Counter
from enum import IntEnum
from typing import TYPE_CHECKING, Final, NamedTuple

from carla_recap.export import style

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from carla_recap.replay import Collided, Present, Scene

_MANY: Final = 5  # so many who come or go in a scene are counted, not named
_PAUSE: Final = 1.0  # s; who touch again within so much have not parted


class Level(IntEnum):
    """How much a line matters."""

    DEBUG = 1
    INFO = 2
    WARNING = 3
    ERROR = 4


class Line(NamedTuple):
    """A line: how much it matters, what it is about, what it says, and the contact that it tells of, if any."""

    level: Level
    subject: str
    text: str
    contact: Collided | None = None


class Teller:
    """Tells of the events of a recording, scene by scene."""

    def __init__(self) -> None:
        self._actors: dict[int, Present] = {}  # who is there, or is just going
        self._contacts: dict[frozenset[int], float] = {}  # pairs, and when they touched last

    def tell(self, scene: Scene) -> Iterator[Line]:
        """The lines of a scene, which comes behind those before."""
        if not scene.events and not scene.fresh:
            return
        spawned, destroyed = scene.spawned, scene.destroyed
        self._actors.update((event.actor.id, event.actor) for event in spawned)
        if scene.fresh:
            yield _about_actors(_count([event.actor for event in spawned], "are there"))
        elif len(spawned) >= _MANY:
            yield _about_actors(_count([event.actor for event in spawned], "appear"))
        else:
            yield from (_about_actors(style.sentence(event, self._actors)) for event in spawned)
            yield from (Line(Level.DEBUG, "actors", style.sentence(event, self._actors)) for event in scene.parented)
        yield from self._contacts_of(scene)
        if len(destroyed) >= _MANY:
            gone = [self._actors[event.id] for event in destroyed if event.id in self._actors]
            yield _about_actors(_count(gone, "disappear"))
        else:
            yield from (_about_actors(style.sentence(event, self._actors)) for event in destroyed)
        for event in destroyed:
            if event.id not in scene.actors:
                self._actors.pop(event.id, None)

    def _contacts_of(self, scene: Scene) -> Iterator[Line]:
        self._contacts = {pair: time for pair, time in self._contacts.items() if scene.time - time <= _PAUSE}
        for event in scene.collisions:
            if self._begins(event):
                level = Level.ERROR if event.hero1 or event.hero2 else Level.WARNING
                yield Line(level, "collisions", style.sentence(event, self._actors), event)

    def _begins(self, event: Collided) -> bool:
        """Note a contact; says whether it begins."""
        pair = frozenset((event.actor1, event.actor2))
        begins = pair not in self._contacts
        self._contacts[pair] = event.elapsed
        return begins


def _about_actors(text: str) -> Line:
    return Line(Level.INFO, "actors", text)


def _count(actors: Sequence[Present], verb: str) -> str:
    """Many actors in a sentence: `150 actors appear: 60 walkers, 50 vehicles, 40 others`."""
    kinds = Counter(style.style_of(actor).name for actor in actors)
    counts = ", ".join(f"{count} {name}{'s' * (count > 1)}" for name, count in kinds.most_common())
    return f"{len(actors)} actor{'s' * (len(actors) != 1)} {verb}{': ' * bool(counts)}{counts}"
