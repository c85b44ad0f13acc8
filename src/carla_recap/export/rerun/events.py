"""What happens, as a log; and collisions as marks in the world, one for each contact."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.export import style
from carla_recap.export.event_text import Level, Teller
from carla_recap.export.rerun import tree
from carla_recap.export.rerun.stream import Times
from carla_recap.replay import right_handed
from carla_recap.replay.pose import LOCATION

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.export.event_text import Line
    from carla_recap.export.rerun.stream import Moment, Stream
    from carla_recap.replay import Collided, Scene

    Floats = NDArray[np.float64]

_SHOWN: Final = 2_000_000_000  # ns; so long a collision is marked
_ABOVE: Final = 2.5  # m; so high above the ground
_MARK: Final = 0.5  # m
_MOST: Final = 50  # so many contacts are marked at once: those that came last
_HELD: Final = 8192  # so many lines are held back at the most
_LEVELS: Final = {
    Level.DEBUG: rr.TextLogLevel.DEBUG,
    Level.INFO: rr.TextLogLevel.INFO,
    Level.WARNING: rr.TextLogLevel.WARN,
    Level.ERROR: rr.TextLogLevel.ERROR,
}


class Chronicle:
    """Writes the log, and the collisions.

    Args:
        stream: Where to.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._teller = Teller()
        self._told: list[tuple[Moment, Line]] = []
        self._marks: deque[tuple[int, Floats]] = deque(maxlen=_MOST)  # until when, in ns, and where

    def enter(self, scene: Scene, moment: Moment) -> None:
        """Take a scene in."""
        changed = False
        while self._marks and self._marks[0][0] <= moment.elapsed:
            self._marks.popleft()
            changed = True
        for line in self._teller.tell(scene):
            self._told.append((moment, line))
            if line.contact is not None:
                changed |= self._mark(line.contact, scene, moment)
        if changed:
            self._draw(moment)
        if len(self._told) >= _HELD:
            self.flush()

    def flush(self) -> None:
        """Write what is held back."""
        if self._told:
            times = Times.of(moment for moment, _ in self._told)
            texts, levels = zip(*((line.text, _LEVELS[line.level]) for _, line in self._told), strict=True)
            self._stream.columns(tree.EVENTS, times, rr.TextLog.columns(text=texts, level=levels))
        self._told.clear()

    def _mark(self, contact: Collided, scene: Scene, moment: Moment) -> bool:
        """Note where a contact is; says whether that is known."""
        poses = [pose for id in (contact.actor1, contact.actor2) if (pose := scene.pose_of(id)) is not None]
        if poses:
            self._marks.append((moment.elapsed + _SHOWN, right_handed(np.mean(poses, axis=0))[LOCATION]))
        return bool(poses)

    def _draw(self, moment: Moment) -> None:
        """Show the marks: each one is a ball, and above it a point with the label."""
        count = len(self._marks)
        if not count:
            self._stream.clear(tree.COLLISIONS, moment)
            return
        places = np.repeat([place for _, place in self._marks], 2, axis=0)
        places[:, 2] += np.tile((_ABOVE, _ABOVE + 2 * _MARK), count)
        self._stream.log(
            tree.COLLISIONS,
            moment,
            rr.Points3D(
                places,
                colors=[style.COLLISION],
                radii=[_MARK, 0] * count,
                labels=["", "collision"] * count,
                show_labels=True,
            ),
        )
