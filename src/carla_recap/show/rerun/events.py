"""The log of events, and marks on the ground where actors collide."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.scene import style
from carla_recap.scene.captions import EventText, Level, incident_lines
from carla_recap.scene.marks import MARK_RADIUS
from carla_recap.show.rerun import paths
from carla_recap.show.rerun.stream import TimeColumns

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.queries.incidents import Incident
    from carla_recap.scene.captions import Line
    from carla_recap.scene.description import SceneDescription
    from carla_recap.show.rerun.stream import Stream, TimePoint

    Floats = NDArray[np.float64]

_ABOVE: Final = 0.02  # m; of the lines of a mark above its location
_CROSS: Final = (0.35, 0.8)  # the ends of the four lines of a mark, as shares of its radius
_WIDTH: Final = 0.1  # m; of the lines of a mark
_CORNERS: Final = 24
_MAX_LINES: Final = 8192  # the number of lines that are held back
_LEVELS: Final = {
    Level.DEBUG: rr.TextLogLevel.DEBUG,
    Level.INFO: rr.TextLogLevel.INFO,
    Level.WARNING: rr.TextLogLevel.WARN,
    Level.ERROR: rr.TextLogLevel.ERROR,
}


class EventWriter:
    """Writes the log and the collisions.

    Args:
        stream: The stream.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._text = EventText()
        self._lines: list[tuple[TimePoint, Line]] = []
        self._clock: list[TimeColumns] = []  # of all scenes

    def write(self, description: SceneDescription, times: TimeColumns) -> None:
        """Write scenes."""
        self._clock.append(times)
        time = times.point(0)
        self._lines += [(time, line) for line in self._text.lines(description.batch.scene(0))]
        for row, locations in description.marks:
            self._draw(locations, times.point(row))
        if len(self._lines) >= _MAX_LINES:
            self.flush()

    @property
    def clock(self) -> TimeColumns:
        """The times of all scenes so far."""
        return TimeColumns.joined(self._clock) if self._clock else TimeColumns.of_points(())

    def write_incidents(self, found: Iterable[Incident]) -> None:
        """Write the incidents that began during the scenes so far, each at the scene at which it began."""
        clock = self.clock
        if len(clock.frame):
            self._lines += [(clock.point(row), line) for row, line in incident_lines(found, clock.seconds)]

    def flush(self) -> None:
        """Write what is held back."""
        if self._lines:
            times = TimeColumns.of_points(time for time, _ in self._lines)
            texts, levels = zip(*((line.text, _LEVELS[line.level]) for _, line in self._lines), strict=True)
            self._stream.columns(paths.EVENTS, times, rr.TextLog.columns(text=texts, level=levels))
        self._lines.clear()

    def _draw(self, locations: Floats, time: TimePoint) -> None:
        """Show marks: each one is a ring on the ground with a cross in it, which hide nothing."""
        if not len(locations):
            self._stream.clear(paths.COLLISIONS, time)
            return
        strips = [location + line for location in locations for line in _LINES]
        self._stream.log(paths.COLLISIONS, time, rr.LineStrips3D(strips, colors=[style.COLLISION], radii=[_WIDTH / 2]))


def _mark() -> list[Floats]:
    """Return the lines of a mark."""
    turns = np.linspace(0, 2 * np.pi, _CORNERS + 1)
    lines = [np.stack((np.cos(turns), np.sin(turns), np.zeros(len(turns))), axis=1)]
    for turn in np.pi * np.array((0.25, 0.75, 1.25, 1.75)):
        lines += [np.array([(share * np.cos(turn), share * np.sin(turn), 0) for share in _CROSS])]
    return [MARK_RADIUS * line + np.array((0, 0, _ABOVE)) for line in lines]


_LINES: Final = _mark()
