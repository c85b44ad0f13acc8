"""The extreme values of the measures of actors over a recording."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np

from carla_recap.model.contacts import Contacts
from carla_recap.model.lives import TYPES as ACTOR_TYPES
from carla_recap.model.lives import ActorLives
from carla_recap.queries import Answer
from carla_recap.queries.measures.definitions import MEASURES, Extreme, MeasureRow, MeasureValues, series_of
from carla_recap.queries.measures.encroachment import STEP, encroachments, path_of, refined
from carla_recap.queries.measures.motion_blocks import TYPES, MotionCollector
from carla_recap.queries.measures.near_misses import paths_meet
from carla_recap.queries.measures.over_time import measured_actors
from carla_recap.queries.measures.pairs import near_pairs
from carla_recap.queries.measures.road import TYPES as ROAD_TYPES
from carla_recap.queries.measures.road import RoadSearch
from carla_recap.queries.measures.series import NO_OTHER, criticality
from carla_recap.queries.roads import roads_of, warn_without_roads

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.queries.measures.definitions import Measure, MeasureSeries
    from carla_recap.queries.measures.motion_blocks import MotionBlock
    from carla_recap.queries.measures.over_time import Subjects
    from carla_recap.queries.measures.series import Criticality
    from carla_recap.roads.network import RoadNetwork
    from carla_recap.util.arrays import Floats


POST_ENCROACHMENT_TIME: Final = 3.0
"""The longest post-encroachment time that is measured, in s."""

SHORT: Final = 3.0
"""The time to collision below which both actors have to meet on the paths that they take, too, in s."""

_BEFORE_CONTACT: Final = 0.4  # s before a contact in which its effect on the motion begins, since motions are means
_LATER: Final = 0.5  # s by which a bent path may take longer
_CHECKS: Final = 64  # of an actor in a block
_SAME_THREAT: Final = 0.25  # s


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
    """Return the extreme values of the measures of actors: how close others came, how hard and how fast they drive.

    A measure without a value has no row, such as the time to collision of an actor that was never on a collision course.

    Args:
        source: The recording.
        actors: The ids of vehicles or walkers, "hero" or "all"; None: the heroes, or if there is none, all vehicles.
        roads: The roads of the map, for the speed over the limit and other measures of the road; None: without these.
        start: The elapsed seconds from which on to measure.
        stop: The elapsed seconds until which to measure.

    Raises:
        RecapError: There is no such vehicle or walker, or no hero.
        FormatError: The file contradicts its format.
    """
    search = MeasureSearch(source, actors, roads=roads, start=start, stop=stop)
    search.read()
    return search.finish()


def measures_on_roads(source: Reader, actors: Subjects = None, *, road_map: str | None = None) -> Measures:
    """Return the measures of actors, with those of the road if the map is known; see `measures`.

    Args:
        source: The recording.
        actors: The actors to measure.
        road_map: The map, or the folder to look in; None: the usual folders.

    Raises:
        RecapError: See `measures`; or the folder does not have the map, or it is damaged.

    Warns:
        RecapWarning: The map is unknown.
    """
    roads = roads_of(source, road_map)
    if roads is None:
        warn_without_roads(source)
    return measures(source, actors, roads=roads)


class MeasureSearch:
    """Computes measures in the batches of a recording, which are read for something else, too.

    Args and errors are those of `measures`. The spawns, the ends and the collisions of all actors are read at once.

    Args:
        source: The recording.
        actors: The actors to measure.
        roads: The roads of the map; None: without measures of the road.
        start: The elapsed seconds from which on to measure.
        stop: The elapsed seconds until which to measure.
        over_time: The ids of the actors of which values over time are kept, by measure.

    Attributes:
        values: These values after `finish`, by measure and actor.
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
    ) -> None:
        self._source, self._start, self._stop = source, start, stop
        lives, self._contacts = ActorLives(), Contacts()
        for frame in source.frames((*ACTOR_TYPES, "collisions"), sparse=True, stop=stop):
            self._contacts.add(frame)
            for packet in frame.packets:
                lives.add(packet, frame.elapsed)
        self._subjects = measured_actors(source, lives, actors)
        self._motion = MotionCollector(lives)
        self._over_time = over_time or {}
        self._roads = None if roads is None else RoadSearch(source, roads, lives, self._over_time)
        self._parts: dict[tuple[str, int], list[MeasureValues]] = defaultdict(list)
        self.values: dict[tuple[str, int], MeasureValues] = {}
        self._extremes: dict[int, dict[str, Extreme]] = {id: {} for id in self._subjects}

    def read(self) -> None:
        """Read the recording.

        Raises:
            FormatError: The file contradicts its format.
        """
        if self._subjects:
            types = TYPES if self._roads is None else (*TYPES, *ROAD_TYPES)
            for batch in self._source.batches(types, start=self._start, stop=self._stop):
                self.add(batch)

    def add(self, batch: Batch) -> None:
        """Process the next frames, which have at least their transforms, velocities and, with roads, states of lights."""
        if self._roads is not None:
            self._roads.add(batch)
        for block in self._motion.add(batch):
            self._measure(block)

    def finish(self) -> Measures:
        """Return the measures."""
        for block in self._motion.finish():
            self._measure(block)
        if self._roads is not None:
            self._roads.finish()
            for id in self._subjects:
                self._extremes[id].update(self._roads.extremes.get(id, {}))
            self._parts.update(self._roads.values)
        for name, ids in self._over_time.items():
            self.values.update({(name, id): MeasureValues.joined(self._parts[name, id]) for id in ids})
        rows = []
        for id, actor in self._subjects.items():
            for name, measure in MEASURES.items():
                extreme = self._extremes[id].get(name)
                if extreme is not None:
                    other, other_type_id = (extreme.other.id, extreme.other.type_id) if extreme.other else (None, "")
                    sides = (id, actor.type_id, actor.is_hero, other, other_type_id)
                    rows.append(MeasureRow(name, *sides, extreme.value, measure.unit, extreme.time))
        return Measures(rows, self._source, compat=False)

    def _measure(self, block: MotionBlock) -> None:
        rows = np.flatnonzero(np.isin(block.ids, list(self._subjects)))
        if not len(rows):
            return
        found = criticality(block, rows)
        self._drop_unconfirmed(block, rows, found, every="time_to_collision" in self._over_time)
        series = series_of(block, rows, found)
        for number, row in enumerate(rows.tolist()):
            for start, stop in self._contacts.affected(int(block.ids[row]), _BEFORE_CONTACT):
                affected = (block.time >= start) & (block.time <= stop)
                series.acceleration[number, affected] = series.jerk[number, affected] = np.nan
        for measure in MEASURES.values():
            if measure.values is not None:
                values = measure.values(series)
                self._note(block, rows, measure, series, values)
                self._keep(block, rows, measure, series, values)
        self._note_crossings(block, rows)

    def _note(
        self, block: MotionBlock, rows: NDArray[np.intp], measure: Measure, series: MeasureSeries, values: Floats
    ) -> None:
        """Note the extreme values of a measure in a block, (subjects, frames)."""
        sign = -1.0 if measure.extreme == "greatest" else 1.0
        ranked = np.where(np.isfinite(values), sign * values, np.inf)[:, block.core]
        best = ranked.argmin(axis=1) if ranked.shape[1] else np.zeros(0, np.intp)
        for number, (row, frame) in enumerate(zip(rows.tolist(), best.tolist(), strict=True)):
            value = float(ranked[number, frame])
            known = self._extremes[int(block.ids[row])]
            if value < math.inf and (measure.name not in known or value < sign * known[measure.name].value):
                frame += block.first
                other = None
                if measure.other:
                    other = block.actors[int(np.flatnonzero(block.ids == getattr(series, measure.other)[number, frame])[0])]
                known[measure.name] = Extreme(sign * value, float(block.time[frame]), other)

    def _keep(
        self, block: MotionBlock, rows: NDArray[np.intp], measure: Measure, series: MeasureSeries, values: Floats
    ) -> None:
        """Keep the values over time of a measure in a block, (subjects, frames)."""
        wanted = self._over_time.get(measure.name, ())
        for number, id in enumerate(block.ids[rows].tolist()):
            if id in wanted:
                frames = np.flatnonzero(np.isfinite(values[number, block.core])) + block.first
                others = getattr(series, measure.other)[number] if measure.other else np.full(len(block.time), NO_OTHER)
                part = MeasureValues(block.time[frames], values[number, frames], others[frames])
                self._parts[measure.name, id].append(part)

    def _drop_unconfirmed(
        self, block: MotionBlock, rows: NDArray[np.intp], found: Criticality, *, every: bool = False
    ) -> None:
        """Drop short times to collision with actors that are not on the path that the subject takes, as in a bend.

        Args:
            block: The block.
            rows: The rows of the subjects.
            found: How critical their situation is.
            every: Whether every value counts, not the least one alone.
        """
        for number, row in enumerate(rows.tolist()):
            times, threats = found.time_to_collision[number], found.threat[number]
            known = self._extremes[int(block.ids[row])].get("time_to_collision")
            limit = SHORT if known is None or every else min(SHORT, known.value)
            open_times = times[block.core].copy()  # of which it is not known whether both meet
            for _ in range(len(open_times) + 1 if every else _CHECKS):
                frame = block.first + int(open_times.argmin())
                if not open_times[frame - block.first] < limit:
                    break
                meet = paths_meet(block, row, int(threats[frame]), frame, SHORT + _LATER)
                if meet and not every:
                    break
                is_same = (threats == threats[frame]) & (np.abs(block.time - block.time[frame]) <= _SAME_THREAT)
                open_times[is_same[block.core]] = np.inf
                if not meet:
                    times[is_same] = np.inf
            else:
                times[times < limit] = np.inf

    def _note_crossings(self, block: MotionBlock, rows: NDArray[np.intp]) -> None:
        """Note the least post-encroachment times in a block."""
        wanted = self._over_time.get("post_encroachment_time", ())
        is_subject = np.zeros(len(block.ids), np.bool_)
        is_subject[rows] = True
        fastest = np.nan_to_num(np.fmax.reduce(block.speed, axis=1))
        reach = np.hypot(block.length, block.width) / 2 + fastest * POST_ENCROACHMENT_TIME
        for start, one, other in near_pairs(block, is_subject, reach):
            found = encroachments(block, start, one, other, POST_ENCROACHMENT_TIME)
            for subjects, others in ((found.first, found.second), (found.second, found.first)):
                order = np.lexsort((found.time, others, subjects))
                order = order[is_subject[subjects[order]]]
                is_least = (np.diff(subjects[order], prepend=-1) != 0) | (np.diff(others[order], prepend=-1) != 0)
                for index in order[is_least].tolist():
                    id = int(block.ids[subjects[index]])
                    known = self._extremes[id]
                    before = known.get("post_encroachment_time")
                    time = float(found.time[index])
                    if before is not None and time - STEP > before.value and id not in wanted:
                        continue
                    left, arrived = int(found.left[index]), int(found.arrived[index])
                    first = path_of(block, int(found.first[index]), left)
                    second = path_of(block, int(found.second[index]), arrived)
                    time = refined(first, second, float(block.time[arrived]), time)
                    if id in wanted:
                        met = block.ids[others[index]]
                        part = MeasureValues(block.time[[arrived]], np.array([time]), np.array([met], np.int64))
                        self._parts["post_encroachment_time", id].append(part)
                    if before is None or time < before.value:
                        extreme = Extreme(time, float(block.time[arrived]), block.actors[int(others[index])])
                        known["post_encroachment_time"] = extreme
