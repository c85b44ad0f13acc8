"""The measures of an actor over time."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from carla_recap.model.actors import ROAD_USERS, ActorLives, ActorName, find_actor
from carla_recap.queries.actors import actors
from carla_recap.queries.measures.motion import TYPES, MotionCollector
from carla_recap.queries.measures.series import criticality
from carla_recap.queries.measures.table import MeasureSeries, series_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.queries.measures.motion import MotionBlock


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
    movers = [each for each in known if each.kind in ROAD_USERS]

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
