"""Plots of the followed actor: its speed, its acceleration and its controls."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.export.motion import SPAN, HeldPedals, accelerations
from carla_recap.export.rerun import paths
from carla_recap.export.rerun.stream import TimeColumns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.export.rerun.stream import Stream
    from carla_recap.export.style import Color

    Floats = NDArray[np.float64]

CONTROLS: Final = ("throttle", "brake", "steer")
"""The recorded controls that are plotted."""

THROTTLE: Final[Color] = (90, 200, 120)
BRAKE: Final[Color] = (240, 90, 80)
STEER: Final[Color] = (130, 170, 255)
SPEED: Final[Color] = (255, 190, 80)
ACCELERATION: Final[Color] = (205, 150, 240)

_KMH: Final = 3.6  # in a m/s


class PlotWriter:
    """Writes the plots of an actor.

    The controls are written as recorded, and the pedals without their chatter at a standstill besides.

    Args:
        stream: The stream.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._times = TimeColumns.of_points(())  # of the last rows, before which accelerations are known
        self._speeds: Floats = np.zeros(0)
        self._pedals = HeldPedals()
        colors = [THROTTLE, BRAKE, STEER]
        stream.log_static(paths.CONTROLS, rr.SeriesLines(colors=colors, names=CONTROLS, widths=[1.5] * len(colors)))
        names = ["throttle, none while the brake is held", "brake, held at a standstill"]
        stream.log_static(paths.PEDALS, rr.SeriesLines(colors=colors[:2], names=names, widths=[2.0] * 2))
        stream.log_static(paths.SPEED, rr.SeriesLines(colors=[SPEED], names=["km/h"], widths=[2.0]))
        stream.log_static(paths.ACCELERATION, rr.SeriesLines(colors=[ACCELERATION], names=["m/s²"], widths=[1.5]))

    def write_speeds(self, times: TimeColumns, speeds: Floats) -> None:
        """Write the speeds at some times, in m/s, and the accelerations between them."""
        self._stream.columns(paths.SPEED, times, rr.Scalars.columns(scalars=speeds * _KMH))
        held = len(self._speeds)
        times = TimeColumns.joined([self._times, times])
        speeds = np.concatenate((self._speeds, speeds))
        seconds = times.seconds
        first, last, changes = accelerations(seconds, speeds, held)
        self._stream.columns(paths.ACCELERATION, times.take((first + last + 1) // 2), rr.Scalars.columns(scalars=changes))
        kept = slice(int(np.searchsorted(seconds, seconds[-1] - SPAN)) if len(seconds) else 0, None)
        self._times, self._speeds = times.take(kept), speeds[kept]

    def write_controls(self, times: TimeColumns, controls: Floats, speeds: Floats) -> None:
        """Write recorded controls.

        Args:
            times: The times.
            controls: The `CONTROLS` at these, (times, 3).
            speeds: The speeds, in m/s; NaN where they are unknown.
        """
        if not len(controls):
            return
        (column,) = rr.Scalars.columns(scalars=controls.ravel())
        self._stream.columns(paths.CONTROLS, times, [column.partition(np.full(len(controls), controls.shape[1]))])
        shown = self._pedals.shown(times.seconds, controls[:, :2], speeds)
        (column,) = rr.Scalars.columns(scalars=shown.ravel())
        self._stream.columns(paths.PEDALS, times, [column.partition(np.full(len(shown), shown.shape[1]))])
