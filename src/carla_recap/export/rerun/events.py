"""The log of events, and marks in the world where actors collide, one for each contact."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.export import style
from carla_recap.export.event_text import EventText, Level, incident_lines
from carla_recap.export.rerun import paths
from carla_recap.export.rerun.stream import TimeColumns
from carla_recap.model.frame import SAME_TIME
from carla_recap.replay import right_handed
from carla_recap.replay.pose import LOCATION

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from carla_recap.export.event_text import Line
    from carla_recap.export.rerun.stream import Stream, TimePoint
    from carla_recap.queries.incidents import Incident
    from carla_recap.replay import Collided, SceneBatch

    Floats = NDArray[np.float64]

_DURATION: Final = 2_000_000_000  # ns; the time for which a contact is marked
_HEIGHT: Final = 2.5  # m; of a mark above the ground
_RADIUS: Final = 0.5  # m; of a mark
_MAX_MARKS: Final = 50  # the number of latest contacts that are marked at a time
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
        self._marks: deque[tuple[int, Floats]] = deque(maxlen=_MAX_MARKS)  # the end in ns, and the location

    def write(self, batch: SceneBatch, times: TimeColumns) -> None:
        """Write scenes."""
        self._clock.append(times)
        time = times.point(0)
        changed = self._remove_marks(time)
        for line in self._text.lines(batch.scene(0)):
            self._lines.append((time, line))
            if line.contact is not None:
                changed |= self._add_mark(line.contact, batch, time)
        if changed:
            self._draw(time)
        while self._marks and self._marks[0][0] <= times.elapsed[-1]:
            time = times.point(int(np.searchsorted(times.elapsed, self._marks[0][0])))
            self._remove_marks(time)
            self._draw(time)
        if len(self._lines) >= _MAX_LINES:
            self.flush()

    def write_incidents(self, found: Iterable[Incident]) -> None:
        """Write the incidents that began during the scenes so far, each at the scene at which it began."""
        clock = TimeColumns.joined(self._clock) if self._clock else TimeColumns.of_points(())
        seconds = np.maximum.accumulate(clock.seconds)
        for start, line in incident_lines(found):
            row = int(np.searchsorted(seconds, start - SAME_TIME))
            if row < len(seconds) and (row or seconds[0] <= start + SAME_TIME):
                self._lines.append((clock.point(row), line))

    def flush(self) -> None:
        """Write what is held back."""
        if self._lines:
            times = TimeColumns.of_points(time for time, _ in self._lines)
            texts, levels = zip(*((line.text, _LEVELS[line.level]) for _, line in self._lines), strict=True)
            self._stream.columns(paths.EVENTS, times, rr.TextLog.columns(text=texts, level=levels))
        self._lines.clear()

    def _remove_marks(self, time: TimePoint) -> bool:
        """Remove the marks that end at or before a time, and return whether there are any."""
        count = len(self._marks)
        while self._marks and self._marks[0][0] <= time.elapsed:
            self._marks.popleft()
        return len(self._marks) < count

    def _add_mark(self, contact: Collided, batch: SceneBatch, time: TimePoint) -> bool:
        """Add the mark of a contact, and return whether its location is known."""
        poses = [pose for id in (contact.actor1, contact.actor2) if (pose := batch.pose_of(id, 0)) is not None]
        if poses:
            self._marks.append((time.elapsed + _DURATION, right_handed(np.mean(poses, axis=0))[LOCATION]))
        return bool(poses)

    def _draw(self, time: TimePoint) -> None:
        """Show the marks: each one is a ball, and above it a point with the label."""
        count = len(self._marks)
        if not count:
            self._stream.clear(paths.COLLISIONS, time)
            return
        locations = np.repeat([location for _, location in self._marks], 2, axis=0)
        locations[:, 2] += np.tile((_HEIGHT, _HEIGHT + 2 * _RADIUS), count)
        self._stream.log(
            paths.COLLISIONS,
            time,
            rr.Points3D(
                locations,
                colors=[style.COLLISION],
                radii=[_RADIUS, 0] * count,
                labels=["", "collision"] * count,
                show_labels=True,
            ),
        )
