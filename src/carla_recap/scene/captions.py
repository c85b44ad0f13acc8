"""The events and incidents of a recording as lines of text.

Of many actors at once there is a single line, and of a contact of many frames, too.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from contextlib import suppress
from dataclasses import replace
from enum import IntEnum
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.batch import FramePart
from carla_recap.model.contacts import is_same_contact
from carla_recap.model.frame import SAME_TIME
from carla_recap.queries.incidents import IncidentOptions, IncidentSearch, incidents, with_roads
from carla_recap.queries.kinds import KINDS, kinds_named, kinds_without_roads
from carla_recap.queries.measures.series import SeriesCollector
from carla_recap.queries.roads import roads_of
from carla_recap.scene import style

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.incidents import Incident
    from carla_recap.queries.measures import MeasureSeries
    from carla_recap.replay import Collided, Player, Scene
    from carla_recap.roads.network import RoadNetwork

_MANY: Final = 5  # the number of actors that appear or disappear in a scene from which on they are counted, not named
_AROUND: Final = 5.0  # s around what is shown in which incidents are looked for
_MAKES: Final = {"bh": "", "bmw": "BMW", "carlamotors": "", "t2": "T2", "tt": "TT", "c3": "C3", "a2": "A2", "zx125": "ZX125"}


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
        self._touching: dict[frozenset[int], tuple[int, float]] = {}  # the latest frame and elapsed seconds of pairs

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
        index, new = scene.batch.frames.index + scene.row, {event.actor.id for event in scene.spawned}
        for pair, (frame, time) in list(self._touching.items()):
            if scene.fresh or not pair.isdisjoint(new) or not is_same_contact(index - frame, scene.time - time):
                del self._touching[pair]
        for event in scene.collisions:
            pair = frozenset((event.actor1, event.actor2))
            is_new = pair not in self._touching
            self._touching[pair] = index, scene.time
            if is_new:
                level = Level.ERROR if event.hero1 or event.hero2 else Level.WARNING
                yield Line(level, "collisions", style.sentence(event, self._actors), event)


def shown_options(source: Reader, options: IncidentOptions | None = None) -> IncidentOptions:
    """Return which incidents are shown: those that are asked for, or else all kinds.

    Raises:
        RecapError: There is no such kind, or all kinds that are asked for need roads, and the map is unknown or damaged.

    Warns:
        RecapWarning: The map is unknown, and kinds that are asked for need roads.
    """
    return with_all_kinds(source) if options is None else with_roads(source, options)


def with_all_kinds(source: Reader, options: IncidentOptions | None = None) -> IncidentOptions:
    """Return options for all kinds, or where the map is unknown or damaged, for those that need no roads."""
    options = options or IncidentOptions()
    roads = options.roads
    if roads is None:
        with suppress(RecapError):
            roads = roads_of(source, options.road_map)
    return replace(options, kinds=frozenset(KINDS) if roads is not None else kinds_without_roads(), roads=roads)


def incidents_around(
    source: Reader, options: IncidentOptions, followed: int | None, start: float, stop: float
) -> list[Incident]:
    """Return the incidents of a recording, of kinds that need every frame only those around a part of it.

    Near misses are those of the followed actor, if there is one. The part is between two moments, in elapsed seconds; for
    the options, see `shown_options`.
    """
    kinds = kinds_named(options.kinds)
    listed = kinds & kinds_named(None)
    found = list(incidents(source, replace(options, kinds=listed))) if listed else []
    if kinds - listed:
        part = replace(options, kinds=kinds - listed, start=start - _AROUND, stop=stop + _AROUND)
        search = IncidentSearch(source, part, near=None if followed is None else (followed,))
        search.read()
        found += search.finish()
    return sorted(found, key=lambda incident: (incident.start, incident.kind))


class PlayedIncidents:
    """The incidents in the time that is played; none if the recording is damaged elsewhere.

    Near misses are those of the followed actor, if there is one.

    Args:
        player: The player, which has not begun; its frames are what they are found in.
        roads: The roads of the map, if it is known.
        options: Which incidents are shown; None: all kinds.
    """

    def __init__(self, player: Player, roads: RoadNetwork | None = None, options: IncidentOptions | None = None) -> None:
        self._start, self._stop = player.start, player.stop + 2 * SAME_TIME
        if player.start <= 0 and player.stop >= player.total:  # all: what an MCAP file lists need not be computed
            self._start, self._stop = -math.inf, math.inf
        self._part = FramePart(self._start - SAME_TIME, self._stop - SAME_TIME)
        self._search: IncidentSearch | None = None
        self._series = None if player.followed is None else SeriesCollector(player.followed)
        if options is None:
            shown = IncidentOptions(kinds=frozenset(KINDS) if roads is not None else kinds_without_roads(), roads=roads)
        else:
            shown = with_roads(player.reader, replace(options, roads=options.roads or roads))
        self._kinds = kinds_named(shown.kinds)
        searched = self._kinds | (set() if self._series is None else {"near miss"})  # with which the measures are found
        with suppress(RecapError):
            self._search = IncidentSearch(
                player.reader,
                replace(shown, kinds=searched, start=self._start, stop=self._stop),
                near=None if player.followed is None else (player.followed,),
                series=self._series,
            )
            player.observe(self._add)

    def found(self) -> list[Incident]:
        """Return the incidents in all that was played."""
        found = () if self._search is None else self._search.finish()
        return [incident for incident in found if incident.kind in self._kinds]

    def series(self) -> MeasureSeries | None:
        """Return the measures of the followed actor, after `found`; None without one, or if the recording is damaged."""
        return None if self._search is None or self._series is None else next(iter(self._series.finish().values()))

    def _add(self, batch: Batch) -> None:
        try:
            if self._search is not None and len(found := self._part.of(batch)):
                self._search.add(found)
        except RecapError:
            self._search = None


def incident_lines(found: Iterable[Incident], elapsed: NDArray[np.float64]) -> Iterator[tuple[int, Line]]:
    """Yield the lines of incidents, but not of collisions, which are among the events, each with its scene.

    Those that began before the first scene are left out; `elapsed` are the moments of all scenes, at least one.
    """
    seconds = np.maximum.accumulate(elapsed)
    for incident in found:
        row = int(np.searchsorted(seconds, incident.start - SAME_TIME))
        is_shown = row < len(seconds) and (row > 0 or seconds[0] <= incident.start + SAME_TIME)
        if is_shown and incident.kind != "collision":
            yield row, Line(Level.WARNING, "incidents", incident.text)


def caption_of(incident: Incident) -> str:
    """Return the text of an incident as a caption, with readable names: `Audi A2 (5) runs a red light`."""
    text = re.sub(r"\b(?:vehicle|walker|static)\.[\w.]+", lambda match: readable_name(match[0]), incident.text)
    return text[:1].upper() + text[1:]


def readable_name(type_id: str) -> str:
    """Return a name of a blueprint that reads well: `vehicle.audi.a2` is `Audi A2`."""
    kind, *words = re.split(r"[._]", type_id)
    named = " ".join(filter(None, (_MAKES.get(word, word.title()) for word in words)))
    return named.lower() if kind == "walker" else named or type_id


def _actor_line(text: str) -> Line:
    return Line(Level.INFO, "actors", text)


def _count(actors: Sequence[ActorLife], verb: str) -> str:
    """Return a sentence that counts actors: `150 actors appear: 60 walkers, 50 vehicles, 40 others`."""
    kinds = Counter(style.style_of(actor).name for actor in actors)
    counts = ", ".join(f"{count} {name}{'s' * (count > 1)}" for name, count in kinds.most_common())
    return f"{len(actors)} actor{'s' * (len(actors) != 1)} {verb}{': ' * bool(counts)}{counts}"
