"""The extreme values of the measures of actors over a recording."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from carla_recap.model.motion import MOTION
from carla_recap.queries import Answer
from carla_recap.queries.measures.definitions import MEASURES, NO_OTHER, MeasureRow, MeasureValues
from carla_recap.queries.measures.drives import BACKGROUND, Drive, background, comfort, efficiency
from carla_recap.queries.measures.encroachment import CrossingSearch
from carla_recap.queries.measures.motion_table import MotionCollector
from carla_recap.queries.measures.pairs import SEEN
from carla_recap.queries.measures.road import TYPES as ROAD_TYPES
from carla_recap.queries.measures.road import RoadSearch
from carla_recap.queries.measures.series import HORIZON, measured_actors, series_of
from carla_recap.queries.recorded_actors import lives_and_contacts
from carla_recap.queries.roads import roads_of, warn_without_roads
from carla_recap.tables.trajectories import RowCollector, Trajectory, portions, trajectories, trajectories_of

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from carla_recap.formats.base import Reader
    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.measures.motion_table import MotionTable
    from carla_recap.queries.measures.series import Subjects
    from carla_recap.roads.network import RoadNetwork


POST_ENCROACHMENT_TIME: Final = 3.0
"""The longest post-encroachment time that is measured, in s."""

_BEFORE_CONTACT: Final = 0.4  # s before a contact in which its effect on the motion begins, since motions are means


class Measures(Answer[MeasureRow]):
    """The extreme values of the measures of actors, by actor in order of appearance."""

    row_type = MeasureRow
    row_units: ClassVar = {"time": "s"}


def measures(
    source: Reader,
    actors: Subjects = None,
    *,
    roads: RoadNetwork | None = None,
    start: float = -math.inf,
    stop: float = math.inf,
) -> Measures:
    """Return the extreme values of the measures of actors; see `Recording.measures`.

    A measure without a value has no row, such as the time to collision of an actor that was never on a collision course.
    """
    return MeasureSearch(source, actors, roads=roads, start=start, stop=stop).find()


def measures_on_roads(source: Reader, actors: Subjects = None, *, road_map: str | None = None) -> Measures:
    """Return the measures of actors, with those of the road if the map is known, else with a warning; see `find_map_of`."""
    roads = roads_of(source, road_map)
    if roads is None:
        warn_without_roads(source)
    return measures(source, actors, roads=roads)


class MeasureSearch:
    """Computes the measures of a recording; see `measures`.

    Attributes:
        values: The values over time after `find`, by measure and key of the actor, of the ids that `over_time` has.
    """

    def __init__(
        self,
        source: Reader,
        actors: Subjects = None,
        *,
        roads: RoadNetwork | None = None,
        start: float = -math.inf,
        stop: float = math.inf,
        over_time: Mapping[str, Collection[int]] | None = None,
        others: Callable[[ActorLife | None], bool] | None = None,
    ) -> None:
        self._source, self._start, self._stop = source, start, stop
        self._is_whole = start == -math.inf and stop == math.inf
        lives, self._contacts = lives_and_contacts(source, stop=stop + _BEFORE_CONTACT)
        self._subjects = {actor.key: actor for actor in measured_actors(source, lives, actors)}
        self._lives, self._crossings = lives, CrossingSearch(POST_ENCROACHMENT_TIME)
        margins = {"before": self._crossings.before, "after": HORIZON + SEEN}
        self._motion = MotionCollector(lives, self._contacts, **margins, start=start, stop=stop)
        self._over_time, self._others = over_time or {}, others
        self._roads = None if roads is None else RoadSearch(source, roads, lives, self._note)
        self._heroes = [actor for actor in self._subjects.values() if actor.is_hero and actor.kind == "vehicle"]
        self._traffic = [life for life in lives if life.role_name == BACKGROUND]
        self._drivers = {life.id for life in (*self._heroes, *self._traffic)} if self._heroes else set()
        self._driven = RowCollector(MOTION, self._drivers)
        self._parts: dict[tuple[str, int, float], list[MeasureValues]] = defaultdict(list)
        self.values: dict[tuple[str, int, float], MeasureValues] = {}
        self._rows: dict[tuple[str, int, float], MeasureRow] = {}

    def find(self) -> Measures:
        """Return the measures."""
        if self._subjects:
            types = MOTION if self._roads is None else ROAD_TYPES
            start, stop = self._motion.span
            for batches in portions(self._source.batches(types, start=start, stop=stop)):
                if self._heroes and self._is_whole:
                    self._driven.add(batches)
                for batch in batches:
                    if self._roads is not None:
                        self._roads.lights.add(batch)
                    for table in self._motion.add(batch):
                        self._measure(table)
        for table in self._motion.finish():
            self._measure(table)
        for each in self._crossings.finish():
            for subject, met in ((each.other, each.one), (each.one, each.other)):
                if self._others is None or self._others(met):
                    values = np.array([each.time]), np.array([each.post_encroachment_time]), np.array([met.id], np.int64)
                    self._note(subject, "post_encroachment_time", MeasureValues(*values), met)
        self._note_driving()
        if self._roads is not None:
            self._roads.finish()
        self.values = {key: MeasureValues.joined(parts) for key, parts in self._parts.items()}
        rows = (self._rows.get((name, *key)) for key in self._subjects for name in MEASURES)
        return Measures(filter(None, rows), self._source, compat=False)

    def _measure(self, table: MotionTable) -> None:
        if self._roads is not None:
            self._roads.evaluate(table)
        is_subject = np.array([actor.key in self._subjects for actor in table.actors], np.bool_)
        rows = np.flatnonzero(is_subject)
        if not len(rows):
            return
        actors = [table.actors[row] for row in rows]
        kept = self._over_time.get("time_to_collision", ())
        known = [self._rows.get(("time_to_collision", *actor.key)) for actor in actors]
        shortest = np.array([row.value if row else math.inf for row in known])
        shortest[[actor.id in kept for actor in actors]] = math.nan
        series = series_of(table, rows, self._others, shortest=shortest)
        for number, actor in enumerate(actors):
            for start, stop in self._contacts.affected(actor, _BEFORE_CONTACT):
                affected = (table.time >= start) & (table.time <= stop)
                series.acceleration[number, affected] = series.jerk[number, affected] = np.nan
        time, present = table.time[table.core], ~np.isnan(table.x[rows, table.core])
        for measure in MEASURES.values():
            if (values := measure.values_of(series)) is not None:
                others = getattr(series, measure.other) if measure.other else np.full(values.shape, NO_OTHER)
                for number, actor in enumerate(actors):
                    found = MeasureValues(time, values[number, table.core], others[number, table.core])
                    self._note(actor, measure.name, found.only(present[number]))
        self._crossings.add(table, is_subject)

    def _note_driving(self) -> None:
        """Note the numbers of Bench2Drive, of heroes that are vehicles."""
        paths = trajectories_of(self._driven.finish(), self._lives.reuses())
        if self._heroes and not self._is_whole:  # the speeds in a part follow from what is before and after it, too
            paths = trajectories(self._source, self._drivers)
        others = background(paths, self._traffic)
        for hero in self._heroes:
            path = paths.get(hero.id, Trajectory.empty(hero.id)).of_life(hero)
            drive = Drive.of(hero, path).during(self._start, self._stop)
            if len(drive) > 1:
                smooth = comfort(drive.time, drive.velocity, drive.yaw)
                for name, value in (
                    ("driving_efficiency", efficiency(drive, drive.driven, drive.driven[-1], others)),
                    ("driving_smoothness", smooth and smooth.smoothness),
                ):
                    if value is not None:
                        self._note(hero, name, MeasureValues.of(drive.time[-1:], np.array([value])))

    def _note(self, actor: ActorLife, name: str, found: MeasureValues, met: ActorLife | None = None) -> None:
        """Note the extreme value of a measure of an actor in some frames, and keep all values if they are asked for.

        `met` is the other actor; None: the one that has its id at that time.
        """
        measure, finite = MEASURES[name], np.isfinite(found.value)
        if actor.id in self._over_time.get(name, ()):
            self._parts[name, *actor.key].append(found._replace(value=np.where(finite, found.value, np.nan)))
        found = found.only(finite)
        if not len(found.value) or actor.key not in self._subjects:
            return
        best = int(found.value.argmin() if measure.extreme == "least" else found.value.argmax())
        value, time, other = (column[best].item() for column in (found.value, found.time, found.other))
        known = self._rows.get((name, *actor.key))
        is_new = value > 0 or not measure.needs_roads if known is None else measure.key(value) < measure.key(known.value)
        if is_new:
            met = met or (None if other == NO_OTHER else self._lives.at(other, time))
            sides = (actor.id, actor.type_id, actor.is_hero, met.id if met else None, met.type_id if met else "")
            self._rows[name, *actor.key] = MeasureRow(name, *sides, value, measure.unit, time)
