"""The measures of actors over time."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import fields, make_dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.lives import HERO, ROAD_USERS, ActorLife, ActorName, find_actor
from carla_recap.model.motion import MOTION, slope
from carla_recap.queries.measures.boxes import gap, required_deceleration, time_headway
from carla_recap.queries.measures.definitions import NO_OTHER, MeasureSeries
from carla_recap.queries.measures.motion_table import MotionCollector
from carla_recap.queries.measures.pairs import PairFrames, ahead, near_pairs, on_collision_course
from carla_recap.queries.recorded_actors import lives_and_contacts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from carla_recap.formats.base import Reader
    from carla_recap.model.contacts import Contacts
    from carla_recap.model.lives import ActorLives
    from carla_recap.queries.measures.motion_table import MotionTable
    from carla_recap.util.arrays import Floats, Indices


RANGE: Final = 100.0
"""The distance of centres up to which others count for gaps and headways, in m."""
HORIZON: Final = 10.0
"""The longest time to collision that is computed, in s."""
SPEED_WINDOW: Final = 0.125
"""The time before and after a moment, of which the speeds count for its acceleration, in s."""
JERK_WINDOW: Final = 0.25
"""The time before and after a moment, of which the accelerations count for its jerk, in s."""

MARGIN: Final = 2.0
"""The time around a frame that the measures of an actor alone depend on, in s."""


def series_of(
    table: MotionTable,
    subjects: Indices,
    others: Callable[[ActorLife], bool] | None = None,
    *,
    shortest: Floats | None = None,
) -> MeasureSeries:
    """Return the measures of the actors in some rows, in the frames of a table, (subjects, frames); margins have no values.

    With `others`, those actors alone count of which it is true. With `shortest`, those times to collision alone count of
    actors that also meet on the paths that they take, see `on_collision_course`, and of each actor those up to its least
    known one in s; NaN: all.
    """
    shape = len(subjects), len(table.time)
    position = np.full(len(table.ids), -1)
    position[subjects] = np.arange(len(subjects))
    counts = np.array([others is None or others(actor) for actor in table.actors], np.bool_)
    gaps, times, headways = _Least(shape), _Least(shape), _Least(shape)
    for pairs in near_pairs(table, position >= 0, np.maximum(RANGE / 2, table.radius + table.fastest * HORIZON)):
        if others is not None:
            pairs = pairs.take(counts[pairs.one] | counts[pairs.other])
        near = pairs.take(pairs.distance <= RANGE)
        for each in (near, near.turned()):
            each = each.take((position[each.one] >= 0) & counts[each.other])
            _add_gaps(gaps, position[each.one], each)
            following, distance = ahead(each)
            headways.add(position[following.one], following, distance)
        pairs, seconds = pairs.colliding(HORIZON)
        if shortest is not None:
            least = np.minimum(shortest, times.value.min(axis=1, initial=np.inf))
            limits = np.append(np.where(np.isnan(shortest), np.inf, least), -np.inf)
            kept = np.flatnonzero(seconds <= np.maximum(limits[position[pairs.one]], limits[position[pairs.other]]))
            kept = kept[on_collision_course(pairs.take(kept), seconds[kept])]
            pairs, seconds = pairs.take(kept), seconds[kept]
        for each in (pairs, pairs.turned()):
            known = (position[each.one] >= 0) & counts[each.other]
            times.add(position[each.one[known]], each.take(known), seconds[known])
    for one, second, frames in table.touching:
        for row, met in ((one, second), (second, one)):
            if position[row] >= 0 and counts[met]:
                there = table.frames_of(row, frames)
                for least in (gaps, times):
                    least.touch(position[row], there, met)
    speed, yaw, frame = table.speed[subjects], table.yaw[subjects], np.arange(shape[1])
    forwards = np.maximum(table.along[subjects], 0.0)  # a follower approaches its leader
    leader, acceleration = headways.other, slope(table.time, speed, SPEED_WINDOW)
    along = np.cos(yaw) * table.vx[leader, frame] + np.sin(yaw) * table.vy[leader, frame]
    deceleration = required_deceleration(headways.value, forwards, np.where(leader >= 0, along, 0.0))
    ids = np.append(table.ids, NO_OTHER)
    return MeasureSeries(
        time=np.broadcast_to(table.time, speed.shape),
        speed=speed,
        acceleration=acceleration,
        jerk=slope(table.time, acceleration, JERK_WINDOW),
        gap=gaps.value,
        nearest=ids[gaps.other],
        time_to_collision=times.value,
        threat=ids[times.other],
        distance_headway=headways.value,
        time_headway=time_headway(headways.value, forwards),
        required_deceleration=np.where(leader >= 0, deceleration, 0.0),
        leader=ids[leader],
    )


class _Least:
    """The least value of each subject in each frame, and the row of the other actor, of several alike the first one."""

    def __init__(self, shape: tuple[int, int]) -> None:
        self.value = np.full(shape, np.inf)
        self.other = np.full(shape, NO_OTHER)

    def add(self, row: Indices, pairs: PairFrames, values: Floats) -> None:
        """Add values of pairs, whose first actors are the subjects in some rows."""
        kept = np.flatnonzero(values < np.inf)
        key, value, other = row[kept] * self.value.shape[1] + pairs.frame[kept], self.value.ravel(), self.other.ravel()
        before = value[key]
        np.minimum.at(value, key, values[kept])
        other[key[value[key] < before]] = np.iinfo(other.dtype).max
        is_least = values[kept] == value[key]
        np.minimum.at(other, key[is_least], pairs.other[kept[is_least]])

    def touch(self, row: int, frames: Indices, other: int) -> None:
        """Add a contact of a subject in a row, in some frames: 0."""
        others = np.where(self.value[row, frames] > 0, other, np.minimum(self.other[row, frames], other))
        self.value[row, frames], self.other[row, frames] = 0.0, others


def _add_gaps(gaps: _Least, row: Indices, pairs: PairFrames) -> None:
    """Add the gaps of the pairs that may have the least one of a subject in a frame."""
    most = np.full(gaps.value.size, np.inf)
    key = row * gaps.value.shape[1] + pairs.frame
    radius = np.minimum(pairs.table.length, pairs.table.width) / 2  # of a circle within each box
    np.minimum.at(most, key, np.maximum(pairs.distance - radius[pairs.one] - radius[pairs.other], 0.0))
    kept = pairs.distance - pairs.around() <= np.minimum(most, gaps.value.ravel())[key]
    pairs = pairs.take(kept)
    gaps.add(row[kept], pairs, gap(*pairs.boxes()))


Subjects = int | Collection[int] | Literal["hero", "all"] | None
"""The actors to measure: an id or ids, the heroes, all vehicles and walkers; None: the heroes, without one all vehicles."""

MeasureMoment: Final = make_dataclass(
    "MeasureMoment",
    [
        ("time", float),
        ("actor", int),
        *((each.name, float if each.type == "Floats" else int | None) for each in fields(MeasureSeries)[1:]),
    ],
    frozen=True,
    slots=True,
    namespace={"__module__": __name__},
)
"""The measures of an actor at a moment: the columns of `MeasureSeries`; ids are None instead of -1."""


class MeasuresOverTime:
    """The measures of actors over time: a row for each actor and moment, by actor, then time.

    Attributes:
        series: The measures by the id of the actor.
        header: The header of the recording.
        extent: The extent of the recording.
    """

    row_type = MeasureMoment
    compat = False

    def __init__(self, series: Mapping[int, MeasureSeries], source: Reader) -> None:
        self.series = series
        self.header = source.header
        self.extent = source.extent()

    def __len__(self) -> int:
        return sum(map(len, self.series.values()))

    def __iter__(self) -> Iterator[Any]:
        for actor, series in self.series.items():
            time, *columns = (column.tolist() for column in series.columns().values())
            for moment, *values in zip(time, *columns, strict=True):
                known = (None if type(value) is int and value == NO_OTHER else value for value in values)
                yield MeasureMoment(moment, actor, *known)


def measures_over_time(
    source: Reader, actors: Subjects = None, *, pair: tuple[ActorName, ActorName] | None = None
) -> MeasuresOverTime:
    """Return the measures of actors over time, or of a pair of them, each as if the other were the only one."""
    lives, contacts = lives_and_contacts(source)
    if pair is None:
        collectors = [SeriesCollector(*measured_actors(source, lives, actors))]
    else:
        first, second = _find_pair(source, lives, *pair)
        collectors = [SeriesCollector(*first, others=second), SeriesCollector(*second, others=first)]
    return MeasuresOverTime(_collected(source, lives, contacts, collectors), source)


def time_series(
    source: Reader, actor: ActorName, other: ActorName | None = None, *, start: float = -math.inf, stop: float = math.inf
) -> MeasureSeries:
    """Return the measures of an actor over time; see `Recording.time_series`."""
    lives, contacts = lives_and_contacts(source)
    first, *met = [_find(source, lives, actor)] if other is None else _find_pair(source, lives, actor, other)
    collectors = [SeriesCollector(*first, others=met[0] if met else None)]
    return _collected(source, lives, contacts, collectors, start, stop)[first[0].id]


def _collected(
    source: Reader,
    lives: ActorLives,
    contacts: Contacts,
    collectors: Sequence[SeriesCollector],
    start: float = -math.inf,
    stop: float = math.inf,
) -> dict[int, MeasureSeries]:
    """Return what collectors have of a recording, by the id of the actor."""
    for table in _tables(source, lives, contacts, start, stop):
        for each in collectors:
            each.add(table)
    return {id: series for each in collectors for id, series in each.finish().items()}


def measures_in_parts(source: Reader, actors: Collection[int]) -> Iterator[Mapping[int, MeasureSeries]]:
    """Yield the measures of actors by id, part by part of a recording that may be too long for all of them in memory."""
    lives, contacts = lives_and_contacts(source)
    subjects = measured_actors(source, lives, actors)
    for table in _tables(source, lives, contacts):
        collector = SeriesCollector(*subjects)
        collector.add(table)
        yield collector.finish()


def _tables(
    source: Reader, lives: ActorLives, contacts: Contacts, start: float = -math.inf, stop: float = math.inf
) -> Iterator[MotionTable]:
    motion = MotionCollector(lives, contacts, before=MARGIN, after=MARGIN, start=start, stop=stop)
    yield from chain.from_iterable(map(motion.add, source.batches(MOTION, start=motion.span[0], stop=motion.span[1])))
    yield from motion.finish()


def measured_actors(source: Reader, recorded: ActorLives, wanted: Subjects) -> list[ActorLife]:
    """Return the actors to measure; an id stands for all that had it."""
    movers = [actor for actor in recorded if actor.kind in ROAD_USERS]
    heroes = [actor for actor in movers if actor.is_hero]
    if wanted is None:
        return heroes or [actor for actor in movers if actor.kind == "vehicle"]
    if wanted == "all":
        return movers
    if wanted == HERO:
        _find(source, movers, HERO)
        return heroes
    if isinstance(wanted, str):
        raise RecapError(f"actors to measure must be ids, 'hero' or 'all', not {wanted!r}")
    names = dict.fromkeys(wanted if isinstance(wanted, Collection) else (wanted,))
    return [actor for name in names for actor in _find(source, movers, name)]


def _find(source: Reader, lives: Iterable[ActorLife], name: ActorName) -> list[ActorLife]:
    """Return the hero, or all actors that had an id."""
    movers = [each for each in lives if each.kind in ROAD_USERS]
    found = find_actor(source.location, movers, name, "vehicle or walker", "to measure")
    return [found] if name == HERO else [each for each in movers if each.id == found.id]


def _find_pair(source: Reader, lives: Iterable[ActorLife], name: ActorName, other: ActorName) -> list[list[ActorLife]]:
    first, second = _find(source, lives, name), _find(source, lives, other)
    if first[0].id == second[0].id:
        raise RecapError(f"{source.location}: {name} and {other} are one actor; expected two")
    if not any(each.kind == "vehicle" for each in (*first, *second)):
        raise RecapError(f"{source.location}: expected a vehicle and another actor, found two walkers, {name} and {other}")
    return [first, second]


class SeriesCollector:
    """Collects the measures of actors over time from tables of motion, in relation to all others, or to some alone.

    An id stands for all actors that had it.
    """

    def __init__(self, *actors: int | ActorLife, others: Collection[ActorLife] | None = None) -> None:
        self._wanted = {actor.key if isinstance(actor, ActorLife) else actor for actor in actors}
        self._counts = None if others is None else lambda actor: any(actor is other for other in others)
        ids = (actor.id if isinstance(actor, ActorLife) else actor for actor in actors)
        self._parts: dict[int, list[MeasureSeries]] = {id: [_NONE] for id in ids}

    def add(self, table: MotionTable) -> None:
        """Add a table."""
        rows = np.flatnonzero([not self._wanted.isdisjoint((actor.id, actor.key)) for actor in table.actors])
        if not len(rows):
            return
        found = series_of(table, rows, self._counts).columns().values()
        for number, row in enumerate(rows.tolist()):
            present = np.flatnonzero(~np.isnan(table.x[row, table.core])) + table.first
            self._parts[int(table.ids[row])].append(MeasureSeries(*(values[number, present] for values in found)))

    def finish(self) -> dict[int, MeasureSeries]:
        """Return the measures by the id of the actor."""
        return {
            id: MeasureSeries(*map(np.concatenate, zip(*(part.columns().values() for part in parts), strict=True)))
            for id, parts in self._parts.items()
        }


_NONE: Final = MeasureSeries(*(np.zeros(0, float if each.type == "Floats" else int) for each in fields(MeasureSeries)))
