"""The measures of an actor over time."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import fields, make_dataclass
from itertools import chain
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.contacts import Contacts
from carla_recap.model.lives import HERO, ROAD_USERS, ActorLives, ActorName, find_actor
from carla_recap.queries.measures.definitions import MeasureSeries
from carla_recap.queries.measures.motion_table import TYPES, MotionCollector
from carla_recap.queries.measures.series import MARGIN, NO_OTHER, series_of
from carla_recap.queries.recorded_actors import actors as recorded_actors

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.measures.motion_table import MotionTable


Subjects = Collection[int] | Literal["hero", "all"] | None
"""The actors to measure: their ids, the heroes, all vehicles and walkers; None: the heroes, without one all vehicles."""

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
    """Return the measures of actors over time.

    Args:
        source: The recording.
        actors: The actors to measure; see `measures`.
        pair: Two actors instead, each measured as if the other were the only one.

    Raises:
        RecapError: There is no such vehicle or walker, or no hero, or both of a pair are one actor.
        FormatError: The file contradicts its format.
    """
    lives = recorded_actors(source)
    if pair is None:
        collectors = [SeriesCollector(id) for id in measured_actors(source, ActorLives(lives), actors)]
    else:
        first, second = _find_pair(source, lives, *pair)
        collectors = [SeriesCollector(first, second), SeriesCollector(second, first)]
    _collect(source, lives, collectors)
    return MeasuresOverTime({each.actor: each.finish() for each in collectors}, source)


def time_series(
    source: Reader, actor: ActorName, other: ActorName | None = None, *, start: float = -math.inf, stop: float = math.inf
) -> MeasureSeries:
    """Return the measures of an actor over time.

    Args:
        source: The recording.
        actor: The id of the vehicle or walker, or "hero".
        other: The same of the only other actor that counts; None for all.
        start: The elapsed seconds from which on to measure.
        stop: The elapsed seconds until which to measure.

    Raises:
        RecapError: There is no such vehicle or walker, or both are one actor.
        FormatError: The file contradicts its format.
    """
    lives = recorded_actors(source)
    ids = (_find(source, lives, actor), None) if other is None else _find_pair(source, lives, actor, other)
    series = SeriesCollector(*ids)
    _collect(source, lives, [series], start, stop)
    return series.finish()


def measured_actors(source: Reader, recorded: ActorLives, wanted: Subjects) -> dict[int, ActorLife]:
    """Return the actors to measure by id; of those that had one id, the first.

    Raises:
        RecapError: There is no such vehicle or walker, or no hero.
    """
    movers: dict[int, ActorLife] = {}
    for actor in recorded:
        if actor.kind in ROAD_USERS:
            movers.setdefault(actor.id, actor)
    heroes = {id: actor for id, actor in movers.items() if actor.is_hero}
    if wanted is None:
        return heroes or {id: actor for id, actor in movers.items() if actor.kind == "vehicle"}
    if wanted == "all":
        return movers
    if wanted == HERO:
        find_actor(source.location, movers.values(), HERO, "vehicle or walker", "to measure")
        return heroes
    if isinstance(wanted, str):
        raise RecapError(f"actors to measure must be ids, 'hero' or 'all', not {wanted!r}")
    for id in wanted:
        find_actor(source.location, movers.values(), id, "vehicle or walker", "to measure")
    return {id: movers[id] for id in wanted}


def _find(source: Reader, lives: Iterable[ActorLife], name: ActorName) -> int:
    movers = [each for each in lives if each.kind in ROAD_USERS]
    return find_actor(source.location, movers, name, "vehicle or walker", "to measure").id


def _find_pair(source: Reader, lives: Iterable[ActorLife], name: ActorName, other: ActorName) -> tuple[int, int]:
    first, second = _find(source, lives, name), _find(source, lives, other)
    if first == second:
        raise RecapError(f"{source.location}: {name} and {other} are one actor; two different ones were expected")
    return first, second


def _collect(
    source: Reader,
    lives: Iterable[ActorLife],
    collectors: Sequence[SeriesCollector],
    start: float = -math.inf,
    stop: float = math.inf,
) -> None:
    """Add the motion of a recording to collectors."""
    contacts = Contacts()
    for frame in source.frames(("collisions",), sparse=True):
        contacts.add(frame)
    motion = MotionCollector(lives, contacts, before=MARGIN, after=MARGIN)
    tables = chain.from_iterable(map(motion.add, source.batches(TYPES, start=start, stop=stop)))
    for table in chain(tables, motion.finish()):
        for series in collectors:
            series.add(table)


class SeriesCollector:
    """Collects the measures of an actor over time from tables of motion.

    Attributes:
        actor: The id of the actor.

    Args:
        actor: The id of the actor.
        other: The id of the only other actor that counts; None for all.
    """

    def __init__(self, actor: int, other: int | None = None) -> None:
        self.actor, self._other = actor, other
        self._parts: list[dict[str, NDArray[Any]]] = []

    def add(self, table: MotionTable) -> None:
        """Add a table."""
        rows = np.flatnonzero(table.ids == self.actor)
        if not len(rows) or self._other not in (None, *table.ids.tolist()):
            return
        found = series_of(table, rows, self._other).columns()
        for number, row in enumerate(rows.tolist()):
            present = np.flatnonzero(~np.isnan(table.x[row, table.core])) + table.first
            self._parts.append({name: values[number, present] for name, values in found.items()})

    def finish(self) -> MeasureSeries:
        """Return the measures."""
        columns: dict[str, Any] = {}
        for field in fields(MeasureSeries):
            none = np.zeros(0, np.float64 if field.type == "Floats" else np.int64)
            columns[field.name] = np.concatenate([none, *(part[field.name] for part in self._parts)])
        return MeasureSeries(**columns)
