"""The events and incidents of a recording as lines of text.

Of many actors at once there is a single line, and of a contact of many frames, too.
"""

from __future__ import annotations

import math
from collections import Counter
from contextlib import suppress
from enum import IntEnum
from typing import TYPE_CHECKING, Final, NamedTuple

from carla_recap.errors import RecapError
from carla_recap.model.batch import within
from carla_recap.model.frame import SAME_TIME
from carla_recap.queries.incidents import IncidentOptions, IncidentSearch
from carla_recap.queries.kinds import KINDS, kinds_without_roads
from carla_recap.queries.measures.over_time import SeriesCollector
from carla_recap.scene import style

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from carla_recap.model.actors import ActorLife
    from carla_recap.model.batch import Batch
    from carla_recap.queries.incidents import Incident
    from carla_recap.queries.measures import MeasureSeries
    from carla_recap.replay import Collided, Player, Scene
    from carla_recap.roads.network import RoadNetwork

_MANY: Final = 5  # the number of actors that appear or disappear in a scene from which on they are counted, not named
_PAUSE: Final = 1.0  # s; actors that touch again within this time are still in the same contact


class Level(IntEnum):
    """The importance of a line."""

    DEBUG = 1
    INFO = 2
    WARNING = 3
    ERROR = 4


class Line(NamedTuple):
    """A line of text, its level and subject, and the contact that it reports, if any."""

    level: Level
    subject: str
    text: str
    contact: Collided | None = None


class EventText:
    """Puts the events of a recording into words, scene by scene."""

    def __init__(self) -> None:
        self._actors: dict[int, ActorLife] = {}  # the present ones, and those destroyed in the current scene
        self._contacts: dict[frozenset[int], float] = {}  # the latest time of contact of pairs, in elapsed seconds

    def lines(self, scene: Scene) -> Iterator[Line]:
        """Yield the lines of a scene; scenes have to come in order."""
        if not scene.events and not scene.fresh:
            return
        spawned, destroyed = scene.spawned, scene.destroyed
        self._actors.update((event.actor.id, event.actor) for event in spawned)
        if scene.fresh:
            yield _actor_line(_count([event.actor for event in spawned], "are there"))
        elif len(spawned) >= _MANY:
            yield _actor_line(_count([event.actor for event in spawned], "appear"))
        else:
            yield from (_actor_line(style.sentence(event, self._actors)) for event in spawned)
            yield from (Line(Level.DEBUG, "actors", style.sentence(event, self._actors)) for event in scene.parented)
        yield from self._contact_lines(scene)
        if len(destroyed) >= _MANY:
            gone = [self._actors[event.id] for event in destroyed if event.id in self._actors]
            yield _actor_line(_count(gone, "disappear"))
        else:
            yield from (_actor_line(style.sentence(event, self._actors)) for event in destroyed)
        for event in destroyed:
            if event.id not in scene.actors:
                self._actors.pop(event.id, None)

    def _contact_lines(self, scene: Scene) -> Iterator[Line]:
        self._contacts = {pair: time for pair, time in self._contacts.items() if scene.time - time <= _PAUSE}
        for event in scene.collisions:
            pair = frozenset((event.actor1, event.actor2))
            is_new = pair not in self._contacts
            self._contacts[pair] = event.elapsed
            if is_new:
                level = Level.ERROR if event.hero1 or event.hero2 else Level.WARNING
                yield Line(level, "collisions", style.sentence(event, self._actors), event)


class PlayedIncidents:
    """The incidents in the time that is played, without collisions; none if the recording is damaged elsewhere.

    Near misses are those of the followed actor, if there is one.

    Args:
        player: The player, which has not begun; its frames are what they are found in.
        roads: The roads of the map, if it is known.
    """

    def __init__(self, player: Player, roads: RoadNetwork | None = None) -> None:
        self._start, self._stop = player.start, player.stop + 2 * SAME_TIME
        if player.start <= 0 and player.stop >= player.total:  # all: what an MCAP file lists need not be computed
            self._start, self._stop = -math.inf, math.inf
        self._search: IncidentSearch | None = None
        self._series = None if player.followed is None else SeriesCollector(player.followed)
        kinds = frozenset(KINDS) if roads is not None else kinds_without_roads()
        with suppress(RecapError):
            self._search = IncidentSearch(
                player.reader,
                IncidentOptions(kinds=kinds - {"collision"}, roads=roads, start=self._start, stop=self._stop),
                near=None if player.followed is None else (player.followed,),
                series=self._series,
            )
            player.observe(self._add)

    def found(self) -> Iterable[Incident]:
        """Return the incidents in all that was played."""
        return () if self._search is None else self._search.finish()

    def series(self) -> MeasureSeries | None:
        """Return the measures of the followed actor, after `found`; None without one, or if the recording is damaged."""
        return None if self._search is None or self._series is None else self._series.finish()

    def _add(self, batch: Batch) -> None:
        try:
            for part in within((batch,), self._start - SAME_TIME, self._stop - SAME_TIME):
                if self._search is not None:
                    self._search.add(part)
        except RecapError:
            self._search = None


def incident_lines(found: Iterable[Incident]) -> Iterator[tuple[float, Line]]:
    """Yield the lines of incidents, with their elapsed seconds, but not of collisions, which are among the events."""
    for incident in found:
        if incident.kind != "collision":
            yield incident.start, Line(Level.WARNING, "incidents", incident.text)


def _actor_line(text: str) -> Line:
    return Line(Level.INFO, "actors", text)


def _count(actors: Sequence[ActorLife], verb: str) -> str:
    """Return a sentence that counts actors: `150 actors appear: 60 walkers, 50 vehicles, 40 others`."""
    kinds = Counter(style.style_of(actor).name for actor in actors)
    counts = ", ".join(f"{count} {name}{'s' * (count > 1)}" for name, count in kinds.most_common())
    return f"{len(actors)} actor{'s' * (len(actors) != 1)} {verb}{': ' * bool(counts)}{counts}"
