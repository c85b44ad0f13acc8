"""Measures: how close, how hard and how fast vehicles drive, as numbers and as the moments at which these are extreme."""

from __future__ import annotations

from carla_recap.queries.measures.definitions import MEASURES, SHORT_NAMES, Measure, MeasureRow, MeasureSeries, MeasureValues
from carla_recap.queries.measures.extremes import Measures, MeasureSearch, measures, measures_on_roads
from carla_recap.queries.measures.series import MeasuresOverTime, measures_over_time, time_series

__all__ = [
    "MEASURES",
    "SHORT_NAMES",
    "Measure",
    "MeasureRow",
    "MeasureSearch",
    "MeasureSeries",
    "MeasureValues",
    "Measures",
    "MeasuresOverTime",
    "measures",
    "measures_on_roads",
    "measures_over_time",
    "time_series",
]
