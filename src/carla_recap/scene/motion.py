"""Plots of an actor's motion: accelerations out of speeds, and pedals without chatter."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Indices = NDArray[np.intp]

SPAN: Final = 0.3
"""The time over which an acceleration is a mean, in s."""
_LONGEST: Final = 1.0  # s; over a longer step there is no acceleration
_STANDSTILL: Final = 0.1  # m/s
_HELD: Final = 1.0  # s for which a brake counts as held at a standstill


class Accelerations:
    """Accelerations as means over the last 0.3 s, from part to part of a recording."""

    def __init__(self) -> None:
        self._seconds: Floats = np.zeros(0)  # of the last rows, before which accelerations are known
        self._speeds: Floats = np.zeros(0)

    def at(self, seconds: Floats, speeds: Floats) -> Floats:
        """Return the acceleration up to each time in m/s²; NaN where it is unknown.

        Args:
            seconds: The times.
            speeds: The speeds at these, in m/s.
        """
        held = len(self._seconds)
        seconds, speeds = np.concatenate((self._seconds, seconds)), np.concatenate((self._speeds, speeds))
        found = np.full(len(seconds), np.nan)
        _, last, changes = accelerations(seconds, speeds, held)
        found[last] = changes
        kept = slice(int(np.searchsorted(seconds, seconds[-1] - SPAN)) if len(seconds) else 0, None)
        self._seconds, self._speeds = seconds[kept], speeds[kept]
        return found[held:]


def accelerations(seconds: Floats, speeds: Floats, held: int = 0) -> tuple[Indices, Indices, Floats]:
    """Return the mean accelerations over 0.3 s: the positions of the first and the last time, and the values in m/s².

    Args:
        seconds: The times.
        speeds: The speeds at these, in m/s.
        held: The number of the first times for which no acceleration is wanted.
    """
    last = np.arange(max(held, 1), len(seconds))
    first = np.clip(np.searchsorted(seconds, seconds[last] - SPAN), 0, last - 1)
    spans = seconds[last] - seconds[first]
    usable = (spans > 0) & (spans <= _LONGEST)
    first, last, spans = first[usable], last[usable], spans[usable]
    return first, last, (speeds[last] - speeds[first]) / spans


class HeldPedals:
    """Pedals without the chatter at a standstill, from part to part of a recording.

    Pedals at a standstill chatter, as drivers are programmed. What is shown instead is the brake as held for a second after
    each time, and no throttle meanwhile.
    """

    def __init__(self) -> None:
        self._seconds: Floats = np.zeros(0)  # of the last rows, within the time for which a brake is held
        self._brakes: Floats = np.zeros(0)

    def shown(self, seconds: Floats, pedals: Floats, speeds: Floats) -> Floats:
        """Return throttle and brake as they are shown at some times, (times, 2).

        Args:
            seconds: The times, at least one.
            pedals: Throttle and brake as recorded, (times, 2).
            speeds: The speeds, in m/s; NaN where they are unknown.
        """
        throttle, brake = pedals[:, 0], pedals[:, 1]
        held = len(self._brakes)
        all_seconds, brakes = np.concatenate((self._seconds, seconds)), np.concatenate((self._brakes, brake))
        stops = np.arange(held, len(brakes)) + 1
        starts = np.minimum(np.searchsorted(all_seconds, seconds - _HELD), stops - 1)
        ends = np.stack((starts, stops), axis=1).ravel()
        recent = np.maximum.reduceat(np.append(brakes, 0.0), ends)[::2]
        kept = slice(int(starts[-1]), None)
        self._seconds, self._brakes = all_seconds[kept], brakes[kept]
        is_held = (speeds < _STANDSTILL) & (recent > 0)
        return np.stack((np.where(is_held, 0.0, throttle), np.where(is_held, recent, brake)), axis=1)
