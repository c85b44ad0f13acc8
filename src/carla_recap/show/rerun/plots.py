"""Plots of the followed actor: its speed, its acceleration and its controls, and how close others are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.model.frame import SAME_TIME
from carla_recap.scene.follow import CONTROLS
from carla_recap.show.rerun import paths

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.queries.measures import MeasureSeries
    from carla_recap.scene.follow import FollowedSeries
    from carla_recap.scene.style import Color
    from carla_recap.show.rerun.stream import Stream, TimeColumns

    Floats = NDArray[np.float64]

THROTTLE: Final[Color] = (90, 200, 120)
BRAKE: Final[Color] = (240, 90, 80)
STEER: Final[Color] = (130, 170, 255)
GAP: Final[Color] = (235, 235, 240)
HEADWAY: Final[Color] = (110, 200, 235)
FARTHEST: Final = 50.0
"""The distances up to which there are plots, in m."""
LATEST: Final = 5.0
"""The times up to which there are plots, in s."""
SPEED: Final[Color] = (255, 190, 80)
ACCELERATION: Final[Color] = (205, 150, 240)

_KMH: Final = 3.6  # in a m/s


def write_measures(stream: Stream, clock: TimeColumns, series: MeasureSeries) -> None:
    """Write the plots of how close others are to the followed actor, at the scenes in which it is measured.

    Args:
        stream: The stream.
        clock: The times of all scenes.
        series: The measures.
    """
    seconds = np.maximum.accumulate(clock.seconds)
    rows = np.searchsorted(seconds, series.time - SAME_TIME)
    known = np.flatnonzero(rows < len(seconds))
    known = known[np.abs(seconds[rows[known]] - series.time[known]) <= 2 * SAME_TIME]
    times = clock.take(rows[known])
    lines = (
        (paths.GAP, GAP, "gap, m", series.gap, FARTHEST),
        (paths.HEADWAY, HEADWAY, "headway, m", series.distance_headway, FARTHEST),
        (paths.TIME_TO_COLLISION, BRAKE, "time to collision, s", series.time_to_collision, LATEST),
        (paths.TIME_HEADWAY, HEADWAY, "time headway, s", series.time_headway, LATEST),
    )
    for path, color, name, values, most in lines:
        stream.log_static(path, rr.SeriesLines(colors=[color], names=[name], widths=[2.0]))
        shown = values[known]
        shown = np.where(shown <= most, shown, np.nan)
        # A NaN ends a line; those that follow it are left out, but for the first and the last time of the axis.
        is_needed = ~(np.isnan(shown) & np.isnan(np.append(np.nan, shown[:-1])))
        is_needed[:1] = is_needed[-1:] = True
        kept = np.flatnonzero(is_needed)
        stream.columns(path, times.take(kept), rr.Scalars.columns(scalars=shown[kept]))


class PlotWriter:
    """Writes the plots of an actor.

    The controls are written as recorded, and the pedals without their chatter at a standstill besides.

    Args:
        stream: The stream.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        colors = [THROTTLE, BRAKE, STEER]
        stream.log_static(paths.CONTROLS, rr.SeriesLines(colors=colors, names=CONTROLS, widths=[1.5] * len(colors)))
        names = ["throttle, none while the brake is held", "brake, held at a standstill"]
        stream.log_static(paths.PEDALS, rr.SeriesLines(colors=colors[:2], names=names, widths=[2.0] * 2))
        stream.log_static(paths.SPEED, rr.SeriesLines(colors=[SPEED], names=["km/h"], widths=[2.0]))
        stream.log_static(paths.ACCELERATION, rr.SeriesLines(colors=[ACCELERATION], names=["m/s²"], widths=[1.5]))

    def write(self, times: TimeColumns, series: FollowedSeries) -> None:
        """Write the plots of some scenes."""
        present = series.known | np.isfinite(series.speed)  # where the speed is unknown, its line ends
        self._write(paths.SPEED, times, series.speed[:, None] * _KMH, present)
        self._write(paths.ACCELERATION, times, series.acceleration[:, None], np.isfinite(series.acceleration))
        recorded = np.isfinite(series.pedals[:, 0])
        self._write(paths.CONTROLS, times, series.controls, recorded)
        self._write(paths.PEDALS, times, series.pedals, recorded)

    def _write(self, path: str, times: TimeColumns, values: Floats, shown: NDArray[np.bool_]) -> None:
        """Write the lines of a plot, (scenes, lines), in the scenes in which they are shown."""
        rows = np.flatnonzero(shown)
        (column,) = rr.Scalars.columns(scalars=values[rows].ravel())
        self._stream.columns(path, times.take(rows), [column.partition(np.full(len(rows), values.shape[1]))])
