"""The log of events, and marks on the ground where actors collide, one for each contact."""

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

_DURATION: Final = 5_000_000_000  # ns; the time for which a contact is marked
_ABOVE: Final = 0.05  # m; of a mark above the ground
_RADIUS: Final = 1.1  # m; of a mark
_CROSS: Final = (0.35, 0.8)  # the ends of the four lines of a mark, as shares of its radius
_WIDTH: Final = 0.1  # m; of the lines of a mark
_CORNERS: Final = 24
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
        locations = [found for id in (contact.actor1, contact.actor2) if (found := _foot(id, batch)) is not None]
        if locations:
            self._marks.append((time.elapsed + _DURATION, np.mean(locations, axis=0)))
        return bool(locations)

    def _draw(self, time: TimePoint) -> None:
        """Show the marks: each one is a ring on the ground with a cross in it, which hide nothing."""
        if not self._marks:
            self._stream.clear(paths.COLLISIONS, time)
            return
        strips = [location + line for _, location in self._marks for line in _LINES]
        self._stream.log(paths.COLLISIONS, time, rr.LineStrips3D(strips, colors=[style.COLLISION], radii=[_WIDTH / 2]))


def _foot(id: int, batch: SceneBatch) -> Floats | None:
    """Return the location of an actor on the ground in m, right-handed; None if it is unknown."""
    pose = batch.pose_of(id, 0)
    if pose is None or not np.isfinite(pose).all():
        return None
    actor = batch.actors.get(id)
    box = None if actor is None else style.box_of(actor)
    bottom = 0.0 if box is None else box.z - box.extent_z
    return np.asarray(right_handed(pose)[LOCATION] + np.array((0, 0, bottom + _ABOVE)))


def _mark() -> list[Floats]:
    """Return the lines of a mark."""
    turns = np.linspace(0, 2 * np.pi, _CORNERS + 1)
    lines = [np.stack((np.cos(turns), np.sin(turns), np.zeros(len(turns))), axis=1)]
    for turn in np.pi * np.array((0.25, 0.75, 1.25, 1.75)):
        lines += [np.array([(share * np.cos(turn), share * np.sin(turn), 0) for share in _CROSS])]
    return [_RADIUS * line for line in lines]


_LINES: Final = _mark()
