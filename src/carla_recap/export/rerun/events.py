"""What happens, as a log; and collisions as markers in the world, one for each contact."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.export import look
from carla_recap.export.rerun import tree
from carla_recap.export.telling import Level, Teller
from carla_recap.replay import right_handed
from carla_recap.replay.pose import LOCATION

if TYPE_CHECKING:
    from carla_recap.export.rerun.stream import Moment, Stream
    from carla_recap.replay import Collided, Scene

_SHOWN: Final = 2_000_000_000  # ns; so long a collision is marked
_ABOVE: Final = 2.5  # m; so high above the ground
_MARK: Final = 0.5  # m
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
        self._marks: list[tuple[int, str]] = []  # what is to disappear, and when, in ns
        self._count = 0

    def enter(self, scene: Scene, moment: Moment) -> None:
        """Take a scene in."""
        if self._marks:
            self._wipe(moment)
        for line in self._teller.tell(scene):
            self._stream.log(tree.EVENTS, moment, rr.TextLog(line.text, level=_LEVELS[line.level]))
            if line.contact is not None:
                self._mark(line.contact, scene, moment)

    def close(self) -> None:
        """Nothing is held back."""

    def _mark(self, contact: Collided, scene: Scene, moment: Moment) -> None:
        poses = [pose for id in (contact.actor1, contact.actor2) if (pose := scene.pose_of(id)) is not None]
        if not poses:
            return
        place = right_handed(np.mean(poses, axis=0))[LOCATION]
        path = f"{tree.COLLISIONS}/{self._count}"
        self._count += 1
        self._marks.append((moment.elapsed + _SHOWN, path))
        self._stream.log(
            path,
            moment,
            rr.Points3D(
                [place + np.array((0, 0, _ABOVE)), place + np.array((0, 0, _ABOVE + 2 * _MARK))],
                colors=[look.COLLISION],
                radii=[_MARK, 0],
                labels=["", "collision"],
                show_labels=True,
            ),
        )

    def _wipe(self, moment: Moment) -> None:
        due = [path for time, path in self._marks if time <= moment.elapsed]
        for path in due:
            self._stream.clear(path, moment)
        del self._marks[: len(due)]
