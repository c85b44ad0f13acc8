"""Measures: how close, how hard and how fast vehicles drive, as numbers and as the moments at which these are extreme."""

from __future__ import annotations

from carla_recap.queries.measures.boxes import (
    Boxes,
    gap,
    overlaps,
    required_deceleration,
    time_headway,
    time_to_collision,
)
from carla_recap.queries.measures.extremes import Measures, MeasureSearch, measures
from carla_recap.queries.measures.rows import MeasureRow

__all__ = [
    "Boxes",
    "MeasureRow",
    "MeasureSearch",
    "Measures",
    "gap",
    "measures",
    "overlaps",
    "required_deceleration",
    "time_headway",
    "time_to_collision",
]
