"""Event cameras (DVS): the pixels whose brightness changes, and when, from two images after each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.server.sensors.feed import flag, number

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.actors.actor import Actor

    Floats = NDArray[np.float32]

_EVENT: Final = np.dtype([("x", "<u2"), ("y", "<u2"), ("time", "<i8"), ("polarity", "?")])
_GREY: Final = np.array([0.114, 0.587, 0.2989], np.float32)  # of blue, green and red
_LEAST_THRESHOLD: Final = 0.01  # as in CARLA
_LEAST_EPSILON: Final = 1e-6
_MOST_EVENTS: Final = 1 << 22  # of an image; later ones are lost
_NS: Final = 1e9  # in a second


class EventDetector:
    """Compares each image of an event camera with the one before, as CARLA does, but without noise.

    The brightness is supposed to change evenly between two images. A pixel has an event whenever its brightness has changed
    by a threshold since its last event.

    Args:
        sensor: The camera.
    """

    def __init__(self, sensor: Actor) -> None:
        self._rising = max(number(sensor, "positive_threshold"), _LEAST_THRESHOLD)
        self._falling = max(number(sensor, "negative_threshold"), _LEAST_THRESHOLD)
        self._is_logarithmic = flag(sensor, "use_log")
        self._epsilon = max(number(sensor, "log_eps"), _LEAST_EPSILON)
        self._last: Floats | None = None
        self._reference = np.empty(0, np.float32)
        self._time = 0.0

    def detect(self, image: NDArray[Any], time: float) -> NDArray[np.void]:
        """Return the events since the image before, in the order of their times.

        Args:
            image: The image, (height, width, 4) of blue, green, red, alpha.
            time: Its time in s.
        """
        brightness = (image[..., :3].astype(np.float32) @ _GREY).ravel()
        if self._is_logarithmic:
            brightness = np.log(self._epsilon + brightness / 255)
        last, before = self._last, self._time
        self._last, self._time = brightness, time
        if last is None or len(last) != len(brightness):
            self._reference = brightness.copy()
            return np.empty(0, _EVENT)
        changed = np.flatnonzero(brightness != last)
        old, new, reference = last[changed], brightness[changed], self._reference[changed]
        rises = new > old
        sign = np.where(rises, 1, -1).astype(np.float32)
        step = np.where(rises, self._rising, self._falling).astype(np.float32)
        most = np.floor(sign * (new - reference) / step).astype(np.int64)  # crossings of thresholds until now
        least = np.maximum(np.floor(sign * (old - reference) / step).astype(np.int64), 0)  # those before
        crossed = np.flatnonzero(most > least)
        self._reference[changed[crossed]] += sign[crossed] * step[crossed] * most[crossed]
        counts = most[crossed] - least[crossed]
        counts = counts[np.cumsum(counts) <= _MOST_EVENTS]
        crossed = crossed[: len(counts)]
        row = np.repeat(crossed, counts)
        number_of = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts) + least[row] + 1
        level = reference[row] + sign[row] * step[row] * number_of
        share = np.clip((level - old[row]) / (new[row] - old[row]), 0.0, 1.0)
        events = np.zeros(len(row), _EVENT)
        events["y"], events["x"] = np.divmod(changed[row], image.shape[1])
        events["time"] = (before + share.astype(np.float64) * (time - before)) * _NS
        events["polarity"] = rises[row]
        return events[np.argsort(events["time"], kind="stable")]
