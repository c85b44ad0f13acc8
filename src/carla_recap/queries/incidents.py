"""Incidents: collisions, actors that do not move for long, hard braking, near misses, and broken rules of the road."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

from carla_recap.model.batch import FramePart
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.lives import HERO, find_actor
from carla_recap.queries import Answer
from carla_recap.queries.detectors import Incident, IncidentOptions, Search
from carla_recap.queries.kinds import KINDS, kinds_named, kinds_without_roads
from carla_recap.queries.measures.near_misses import UNTIL_CONTACT
from carla_recap.queries.recorded_actors import lives_and_contacts
from carla_recap.queries.roads import roads_of, warn_without_roads

if TYPE_CHECKING:
    from collections.abc import Collection

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.queries.measures.series import SeriesCollector

__all__ = ["Incident", "IncidentOptions", "IncidentSearch", "Incidents", "incidents", "unrecorded_contacts", "with_roads"]


class Incidents(Answer[Incident]):
    """The incidents of a recording, in order of time."""

    row_type = Incident
    row_units: ClassVar = {"start": "s", "stop": "s", "x": "m", "y": "m", "z": "m", "time": "s"}


def incidents(source: Reader, options: IncidentOptions | None = None) -> Incidents:
    """Return the incidents of a recording, sorted by start, then kind; see `Recording.incidents`.

    A contact of two actors is one collision, in however many frames it is recorded. A deceleration that begins right after a
    contact is part of it and no hard braking, and an encounter that ends in a collision is no near miss. For collisions
    alone, only the events of an MCAP file and the frames of collisions are read.
    """
    search = IncidentSearch(source, options)
    search.read()
    return search.finish()


def unrecorded_contacts(source: Reader, options: IncidentOptions | None = None) -> int:
    """Return the number of contacts of two actors without a collision record: near misses with a time to collision of 0."""
    wanted = replace(options or IncidentOptions(), kinds=("near miss",), time_to_collision=0.0, post_encroachment_time=0.0)
    return sum(each.measure == "time_to_collision" for each in incidents(source, wanted))


def with_roads(source: Reader, options: IncidentOptions) -> IncidentOptions:
    """Return options with the roads that their kinds need, looked up by the map of a recording; else without these kinds.

    An unknown map is a warning, or an error if all kinds need roads.
    """
    kinds = kinds_named(options.kinds)
    others = kinds & kinds_without_roads()
    if kinds == others or options.roads is not None:
        return options
    roads = roads_of(source, options.road_map, needed=not others)
    if roads is None:
        warn_without_roads(source)
    return replace(options, kinds=others if roads is None else kinds, roads=roads)


class IncidentSearch:
    """Finds the incidents of a recording in its batches, which are read for something else, too.

    The spawns, the ends and the collisions of all actors are read at once; for `near` and `series`, see `Search`.
    """

    def __init__(
        self,
        source: Reader,
        options: IncidentOptions | None = None,
        *,
        near: Collection[int] | None = None,
        series: SeriesCollector | None = None,
    ) -> None:
        options = with_roads(source, options or IncidentOptions())
        self._source, self._options = source, options
        self._kinds = kinds_named(options.kinds)
        actors, contacts = lives_and_contacts(source, stop=options.stop + UNTIL_CONTACT + SAME_TIME)
        self.actors = actors  # until the end of the part that is looked at, and a little later
        self._actor = None if options.actor is None else find_actor(source.location, actors, options.actor)
        search = Search(source=source, options=options, actors=actors, contacts=contacts, near=near, series=series)
        makers = dict.fromkeys(kind.detector for name, kind in KINDS.items() if name in self._kinds)
        self._detectors = [make(search) for make in makers]

    @property
    def types(self) -> set[str]:
        """The record types of which batches are to be added; none if all is known without them."""
        needed = {name for detector in self._detectors for name in detector.types}
        return needed | {name for detector in self._detectors for name in detector.also} if needed else needed

    def read(self) -> None:
        """Read the recording as far as it matters."""
        if types := self.types:
            spans = [detector.span or (self._options.start, self._options.stop) for detector in self._detectors]
            start, stop = min(start for start, _ in spans), max(stop for _, stop in spans)
            parts = [FramePart(start - SAME_TIME, stop - SAME_TIME) for start, stop in spans]
            for batch in self._source.batches(types, start=start, stop=stop):
                for detector, part in zip(self._detectors, parts, strict=True):
                    if len(found := part.of(batch)):
                        detector.add(found)

    def add(self, batch: Batch) -> None:
        """Process frames, with at least transforms, velocities, spawns and destructions, and for roads states of lights."""
        for detector in self._detectors:
            detector.add(batch)

    def finish(self) -> Incidents:
        """Return the incidents."""
        start, stop = self._options.start, self._options.stop
        found = [
            incident
            for detector in self._detectors
            for incident in detector.finish()
            if incident.kind in self._kinds
            and not (incident.start > stop or incident.stop < start)
            and self._takes_part(incident)
        ]
        return Incidents(sorted(found, key=lambda incident: (incident.start, incident.kind)), self._source, compat=False)

    def _takes_part(self, incident: Incident) -> bool:
        """Return whether the actor that is asked for takes part: the hero, or any that had an id."""
        actor = self._actor
        if actor is None or actor.id not in incident.actors:
            return actor is None
        return self._options.actor != HERO or self.actors.at(actor.id, incident.start + SAME_TIME) is actor
