"""The measures of an actor over time."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from carla_recap.model.actors import ActorLives, ActorName, find_actor
from carla_recap.queries.actors import actors
from carla_recap.queries.measures.motion import KINDS, TYPES, MotionCollector
from carla_recap.queries.measures.series import JERK_WINDOW, NOBODY, SPEED_WINDOW, criticality, slope
from carla_recap.queries.measures.table import MEASURES
from carla_recap.tables import Columns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.queries.measures.motion import MotionBlock
    from carla_recap.queries.measures.series import Criticality

    Floats = NDArray[np.float64]
    Ids = NDArray[np.int64]
    Indices = NDArray[np.intp]


@dataclass(frozen=True)
class MeasureSeries(Columns):
    """The measures of an actor over time: arrays of one length, a value for each frame in which it is present.

    Attributes:
        time: Elapsed seconds.
        speed: The speed over the ground in m/s.
        acceleration: In m/s², below 0 when it brakes; NaN where it is unknown.
        jerk: In m/s³; NaN where it is unknown.
        gap: The least gap to another actor in m; inf without one within 100 m.
        nearest: The id of the actor that is this near; -1 without one.
        time_to_collision: The least time to collision in s; inf above 10 s.
        threat: The id of the actor that this is the time to; -1 without one.
        distance_headway: The distance to the leader in m, from bumper to bumper; inf without one.
        time_headway: The same as a time in s; inf at rest.
        required_deceleration: The deceleration to avoid the leader in m/s².
        leader: The id of the leader; -1 without one.
    """

    column_units: ClassVar = {"time": "s", **{name: measure.unit for name, measure in MEASURES.items()}}

    time: Floats
    speed: Floats
    acceleration: Floats
    jerk: Floats
    gap: Floats
    nearest: Ids
    time_to_collision: Floats
    threat: Ids
    distance_headway: Floats
    time_headway: Floats
    required_deceleration: Floats
    leader: Ids

    def __len__(self) -> int:
        return len(self.time)


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
        RecapError: There is no such vehicle or walker.
        FormatError: The file contradicts its format.
    """
    known = actors(source)
    movers = [each for each in known if each.kind in KINDS]

    def find(name: ActorName) -> int:
        return find_actor(source.location, movers, name, "vehicle or walker", "to measure").id

    series = SeriesCollector(find(actor), None if other is None else find(other))
    motion = MotionCollector(ActorLives(known))
    for batch in source.batches(TYPES, start=start, stop=stop):
        for block in motion.add(batch):
            series.add(block)
    for block in motion.finish():
        series.add(block)
    return series.finish()


def series_of(block: MotionBlock, rows: Indices, found: Criticality) -> MeasureSeries:
    """Return the measures of some actors in a block; the arrays have the shape (actors, frames).

    Args:
        block: The block.
        rows: The rows of the actors.
        found: How critical their situation is.
    """
    speed = block.speed[rows]
    acceleration = slope(block.time, speed, SPEED_WINDOW)
    ids = np.append(block.ids, NOBODY).astype(np.int64)
    return MeasureSeries(
        time=np.broadcast_to(block.time, speed.shape),
        speed=speed,
        acceleration=acceleration,
        jerk=slope(block.time, acceleration, JERK_WINDOW),
        gap=found.gap,
        nearest=ids[found.nearest],
        time_to_collision=found.time_to_collision,
        threat=ids[found.threat],
        distance_headway=found.headway,
        time_headway=found.time_headway,
        required_deceleration=found.required_deceleration,
        leader=ids[found.leader],
    )


class SeriesCollector:
    """Collects the measures of an actor over time from blocks of motion.

    Args:
        actor: The id of the actor.
        other: The id of the only other actor that counts; None for all.
    """

    def __init__(self, actor: int, other: int | None = None) -> None:
        self._actor, self._other = actor, other
        self._parts: list[dict[str, NDArray[Any]]] = []

    def add(self, block: MotionBlock) -> None:
        """Add a block."""
        rows = np.flatnonzero(block.ids == self._actor)
        others = np.flatnonzero(block.ids == (self._actor if self._other is None else self._other))
        if not len(rows) or not len(others):
            return
        series = series_of(block, rows, criticality(block, rows, None if self._other is None else int(others[0])))
        present = np.flatnonzero(~np.isnan(block.x[rows[0], block.core])) + block.first
        self._parts.append({name: values[0, present] for name, values in series.columns().items()})

    def finish(self) -> MeasureSeries:
        """Return the measures."""
        columns: dict[str, Any] = {}
        for field in fields(MeasureSeries):
            none = np.zeros(0, np.float64 if field.type == "Floats" else np.int64)
            columns[field.name] = np.concatenate([none, *(part[field.name] for part in self._parts)])
        return MeasureSeries(**columns)
