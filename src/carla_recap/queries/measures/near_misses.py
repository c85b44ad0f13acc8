"""Near misses: encounters of two actors that nearly end in a collision.

An encounter is one if the time to collision falls to 1.5 s or less; or if a vehicle arrives at most 1 s after the other
actor has left, where their paths cross.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.queries.measures.encroachment import ENCOUNTER, CrossingSearch, Encounter, encounters
from carla_recap.queries.measures.motion_table import MotionCollector
from carla_recap.queries.measures.pairs import BEND_TIME, SEEN, PairFrames, near_pairs, on_collision_course

if TYPE_CHECKING:
    from carla_recap.model.batch import Batch
    from carla_recap.model.contacts import Contacts
    from carla_recap.model.lives import ActorLives
    from carla_recap.queries.measures.motion_table import MotionTable
    from carla_recap.queries.measures.series import SeriesCollector
    from carla_recap.util.arrays import Booleans


TIME_TO_COLLISION: Final = 1.5
"""The greatest time to collision of a near miss, in s."""
POST_ENCROACHMENT_TIME: Final = 1.0
"""The greatest post-encroachment time of a near miss, in s."""
LONGEST: Final = 60.0
"""The longest such times that can be asked for, in s: what is compared, and the memory for it, grow with them."""
REQUIRED_DECELERATION: Final = 0.0
"""The least deceleration that a near miss by its time to collision requires, in m/s²."""

_CROSSING_SPEED: Final = 3.0  # m/s of a vehicle that arrives where another actor was
UNTIL_CONTACT: Final = 3.0
"""The time after an encounter in s; if the pair collides by then, it is a collision."""
_AFTER_CONTACT: Final = 5.0  # s after a contact in which the pair has no near miss


class NearMissDetector:
    """Finds near misses in the frames of a recording; for the thresholds, see `IncidentOptions`.

    Near misses that end in a collision are none, and what was hit has none for some time. One of `ids` takes part, unless it
    is None. `series` gets the motion, too. They are looked for from one time on and before another one, in elapsed seconds.

    Attributes:
        span: The times from which on and before which it needs frames.
    """

    def __init__(
        self,
        actors: ActorLives,
        contacts: Contacts,
        ids: frozenset[int] | None = None,
        *,
        series: SeriesCollector | None = None,
        time_to_collision: float = TIME_TO_COLLISION,
        post_encroachment_time: float = POST_ENCROACHMENT_TIME,
        required_deceleration: float = REQUIRED_DECELERATION,
        start: float = -math.inf,
        stop: float = math.inf,
    ) -> None:
        self._contacts, self._ids, self._series = contacts, ids, series
        self._longest, self._deceleration = time_to_collision, required_deceleration
        self._crossings = CrossingSearch(post_encroachment_time, least_speed=_CROSSING_SPEED, only_vehicles=True)
        before, after = max(self._crossings.before, BEND_TIME), max(time_to_collision + SEEN, ENCOUNTER)
        self._motion = MotionCollector(actors, contacts, before=before, after=after, start=start, stop=stop)
        self.span = self._motion.span
        self._approaches: dict[frozenset[tuple[int, float]], list[Encounter]] = defaultdict(list)

    def batch(self, batch: Batch) -> None:
        """Process the frames of a batch, which have at least their transforms and velocities."""
        for table in self._motion.add(batch):
            self._add(table)

    def finish(self) -> list[Encounter]:
        """Return the near misses in all frames, by start."""
        for table in self._motion.finish():
            self._add(table)
        critical: dict[frozenset[tuple[int, float]], list[Encounter]] = defaultdict(list)
        for pair, approaches in self._approaches.items():
            critical[pair] += [miss for miss in _joined(approaches) if miss.required_deceleration >= self._deceleration]
        for miss in self._crossings.finish():
            critical[miss.pair].append(miss)
        found = [
            each
            for misses in critical.values()
            for each in _joined(sorted(misses, key=lambda miss: miss.start))
            if not self._collides(each)
        ]
        return sorted(found, key=lambda miss: (miss.start, miss.one.key, miss.other.key))

    def _collides(self, miss: Encounter) -> bool:
        """Return whether an encounter ends in a collision, or follows one."""
        contacts = self._contacts.of(miss.one, miss.other)
        return any(each.start - UNTIL_CONTACT <= miss.stop and miss.start <= each.stop + _AFTER_CONTACT for each in contacts)

    def _add(self, table: MotionTable) -> None:
        if self._series is not None:
            self._series.add(table)
        subjects = np.ones(len(table.ids), np.bool_) if self._ids is None else np.isin(table.ids, list(self._ids))
        if subjects.any() and len(table.ids) > 1:
            self._add_approaches(table, subjects)
            self._crossings.add(table, subjects)

    def _add_approaches(self, table: MotionTable, subjects: Booleans) -> None:
        """Add the encounters of pairs on a collision course."""
        near = near_pairs(table, subjects, table.radius + table.fastest * self._longest)
        found = [each.colliding(self._longest) for each in near]
        if not found:
            return
        pairs, times = PairFrames.joined([each for each, _ in found]), np.concatenate([seconds for _, seconds in found])
        counts = np.flatnonzero(on_collision_course(pairs, times))
        pairs, times = pairs.take(counts), times[counts]
        speeds = pairs.approach()
        for rows in encounters(pairs.one, pairs.other, table.time[pairs.frame]):
            best = rows[times[rows].argmin()]
            one, other, frame = int(pairs.one[best]), int(pairs.other[best]), int(pairs.frame[best])
            if table.speed[other, frame] > table.speed[one, frame]:
                one, other = other, one
            room = 2 * times[rows]
            braking = np.divide(speeds[rows], room, out=np.where(speeds[rows] > 0, np.inf, 0.0), where=room > 0)
            miss = Encounter(
                table.actors[one],
                table.actors[other],
                float(table.time[pairs.frame[rows[0]]]),
                float(table.time[pairs.frame[rows[-1]]]),
                float(table.time[frame]),
                float(times[best]),
                float(braking.max()),
                math.inf,
                float(table.speed[one, frame]),
                table.location(one, frame),
            )
            self._approaches[miss.pair].append(miss)


def _joined(critical: list[Encounter]) -> list[Encounter]:
    """Return one near miss for each encounter of a pair, of its critical times, which are in order."""
    found: list[Encounter] = []
    for miss in critical:
        if found and miss.start - found[-1].stop <= ENCOUNTER:
            found[-1] = _as_one(found[-1], miss)
        else:
            found.append(miss)
    return found


def _as_one(one: Encounter, other: Encounter) -> Encounter:
    """Return two critical times of a pair as one, with what is most critical; of crossings, the most critical one."""
    if one.time_to_collision == other.time_to_collision == math.inf:
        return min(one, other, key=lambda miss: miss.post_encroachment_time)
    worst = min(one, other, key=lambda miss: (miss.time_to_collision, miss.post_encroachment_time))
    return replace(
        worst,
        start=min(one.start, other.start),
        stop=max(one.stop, other.stop),
        required_deceleration=max(one.required_deceleration, other.required_deceleration),
        post_encroachment_time=min(one.post_encroachment_time, other.post_encroachment_time),
    )
