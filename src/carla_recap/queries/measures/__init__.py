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
from carla_recap.queries.measures.definitions import MEASURES, SHORT_NAMES, Measure, MeasureRow, MeasureSeries, MeasureValues
from carla_recap.queries.measures.encroachment import Path, post_encroachment_time
from carla_recap.queries.measures.extremes import Measures, MeasureSearch, measures, measures_on_roads
from carla_recap.queries.measures.series import MeasuresOverTime, measures_over_time, time_series

__all__ = [
    "MEASURES",
    "SHORT_NAMES",
    "Boxes",
    "Measure",
    "MeasureRow",
    "MeasureSearch",
    "MeasureSeries",
    "MeasureValues",
    "Measures",
    "MeasuresOverTime",
    "Path",
    "gap",
    "measures",
    "measures_on_roads",
    "measures_over_time",
    "overlaps",
    "post_encroachment_time",
    "required_deceleration",
    "time_headway",
    "time_series",
    "time_to_collision",
]
