"""The summary of a recording: who is in it, how far the hero drives, and how often something goes wrong."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from carla_recap.model.lives import ROAD_USERS, ActorLives, heroes_of
from carla_recap.model.motion import MOTION
from carla_recap.queries import Answer
from carla_recap.queries.incidents import IncidentOptions, IncidentSearch
from carla_recap.queries.kinds import KINDS
from carla_recap.queries.recorded_actors import actors
from carla_recap.queries.sensors import sensors
from carla_recap.tables.trajectories import RowCollector, portions, trajectories_of
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.incidents import Incident
    from carla_recap.tables.trajectories import Trajectories


@dataclass(frozen=True, slots=True)
class HeroSummary:
    """How the hero moves.

    Attributes:
        id: Its actor id.
        type_id: Its blueprint.
        time: The time between its first and its last pose, in s.
        distance: The distance that it covers, in m; jumps do not count.
        top_speed: Its greatest speed, in m/s; NaN if none is known.
    """

    id: int
    type_id: str
    time: float
    distance: float
    top_speed: float


@dataclass(frozen=True, slots=True)
class RecordingSummary:
    """What a recording contains.

    Attributes:
        map: The name of the map.
        frames: The number of frames.
        duration: The elapsed time of the last frame, in s.
        actors: The number of actors by kind, vehicles and walkers first.
        hero: The first hero that has poses; None if there is none.
        incidents: The number of incidents by kind, of the kinds that occur.
        sensors: The types of the sensors whose data it has, by id.
    """

    map: str
    frames: int
    duration: float
    actors: dict[str, int]
    hero: HeroSummary | None
    incidents: dict[str, int]
    sensors: dict[str, str]


class Summaries(Answer[RecordingSummary]):
    """The summary of a recording, as the only row.

    Attributes:
        others: The number of actors of the kind `other` by blueprint, the most frequent first.
    """

    row_type = RecordingSummary
    row_units: ClassVar = {"duration": "s"}
    others: Mapping[str, int] = MappingProxyType({})


def summary(source: Reader, options: IncidentOptions | None = None) -> Summaries:
    """Return the summary of a recording, with incidents of all kinds unless options say which; see `Recording.summary`."""
    search = SummarySearch(source, options or IncidentOptions(kinds="all"))
    search.read()
    return search.finish()


class SummarySearch:
    """Reads the motion of a recording once, for its summary, its incidents, and for what else asks for it.

    If the options are about a part of the recording, incidents are looked for in a read of their own.
    """

    def __init__(self, source: Reader, options: IncidentOptions) -> None:
        self._source, self._search, self._is_whole = source, IncidentSearch(source, options), options.is_whole
        self.actors = list(self._search.actors if options.stop == math.inf else actors(source))  # all
        self.incidents: Sequence[Incident] = ()  # after the read
        self._heroes = heroes_of(self.actors)
        self._rows = RowCollector(MOTION, {hero.id for hero in self._heroes})

    def read(self, also: Callable[[Batch], object] | None = None) -> None:
        """Read the recording as far as it matters; call a function with the transforms in each batch, too."""
        types = {*(self._search.types if self._is_whole else ()), *(MOTION if self._heroes or also else ())}
        for batches in portions(self._source.batches(types)) if types else ():
            for batch in batches:
                if self._is_whole:
                    self._search.add(batch)
                if also:
                    also(batch)
            self._rows.add(batches)
        if not self._is_whole:
            self._search.read()
        self.incidents = self._search.finish()

    def finish(self) -> Summaries:
        """Return the summary."""
        source, found = self._source, Counter(incident.kind for incident in self.incidents)
        kinds, lives = Counter(life.kind for life in self.actors), ActorLives(self.actors)
        paths = trajectories_of(self._rows.finish(), lives.reuses())
        heroes = (_hero(paths, life) for life in self._heroes)
        extent = source.extent()
        row = RecordingSummary(
            readable(source.header.map_name),
            extent.frames,
            extent.duration,
            {kind: count for kind in (*ROAD_USERS, *kinds) if (count := kinds.get(kind))},
            next((hero for hero in heroes if hero is not None), None),
            {kind: found[kind] for kind in KINDS if found[kind]},
            {sensor.id: sensor.type for sensor in sensors(source)},
        )
        summaries = Summaries([row], source, compat=False)
        summaries.others = dict(Counter(life.type_id for life in self.actors if life.kind == "other").most_common())
        return summaries


def _hero(paths: Trajectories, life: ActorLife) -> HeroSummary | None:
    """Return how a hero moves; None if it has no pose."""
    path = paths.get(life.id)
    if path is None:
        return None
    path = path.of_life(life)
    if not len(path):
        return None
    steps, speed = path.steps, path.speed
    distance, top_speed = np.nansum(steps).item(), np.fmax.reduce(speed, initial=math.nan).item()
    return HeroSummary(life.id, life.type_id, (path.time[-1] - path.time[0]).item(), distance, top_speed)
