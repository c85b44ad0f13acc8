"""Where actors are between two frames.

CARLA's own replay blends from the frame before to the frame at a time, so it shows everything a frame late. Here the blend
goes from the frame at a time to the next one: what stands in a frame is what is seen at its time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.replay.pose import LOCATION, ROTATION, change, wrap
from carla_recap.replay.rows import NO_IDS, Ids, Selection, array, latest, numbers, places

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.model.frame import Frame

    Floats = NDArray[np.float64]

JUMP: Final = 500.0  # cm; whatever is shorter is no jump
SLACK: Final = 3.0  # a jump is longer than so many times the way that the recorded velocity explains
TOP_SPEED: Final = 10_000.0  # cm/s; what explains the way of an actor whose velocity is not recorded
_CM_PER_M: Final = 100.0
_NEAR: Final = JUMP / 2  # no step of a location along an axis is so long, and no turn so wide, in most frames


class Motion:
    """The poses of all actors from a frame to the next one; what can be kept from frame to frame is kept."""

    def __init__(self) -> None:
        self._selection = Selection()
        self._frame: Frame | None = None
        self._next: Frame | None = None
        self._hidden: Ids = NO_IDS
        self._ids: Ids = NO_IDS
        self._poses: Floats = np.zeros((0, 6))
        self._ahead: tuple[Ids, Floats] | None = None  # ids and poses of the next frame
        self._change: Floats | None = None
        self._wraps = False  # whether an angle passes ±180 degrees on the way

    def at(self, frame: Frame, next: Frame | None, hidden: Ids, part: float) -> tuple[Ids, Floats]:
        """Ids, ascending, and poses; not to be written to.

        Args:
            frame: The frame at or before the moment.
            next: The one behind it, if there is one.
            hidden: Ids to leave out.
            part: How much of the time between the two has gone by, from 0 to 1.
        """
        if frame is not self._frame or hidden is not self._hidden:
            if frame is self._next and hidden is self._hidden and self._ahead:
                self._ids, self._poses = self._ahead
            else:
                self._ids, self._poses = self.read(array(frame["transforms"]), hidden)
            self._frame, self._hidden, self._next = frame, hidden, None
            self._ahead = self._change = None
        if next is None or part <= 0:
            return self._ids, self._poses
        if self._change is None or next is not self._next:
            self._next, self._ahead = next, self.read(array(next["transforms"]), hidden)
            with np.errstate(invalid="ignore", over="ignore"):
                self._change = self._steps(frame, next, *self._ahead)
                angles = np.stack((self._poses, self._poses + self._change))[:, :, ROTATION]
                self._wraps = not np.abs(angles).max(initial=0) <= 180
        poses = self._poses + part * self._change
        if self._wraps:
            with np.errstate(invalid="ignore"):
                poses[:, ROTATION] = wrap(poses[:, ROTATION])
        poses.setflags(write=False)
        return self._ids, poses

    def read(self, records: NDArray[np.void], hidden: Ids) -> tuple[Ids, Floats]:
        """Return the recorded ids, ascending, and the poses; both are read-only.

        Args:
            records: The transforms of a frame, or of frames with the same ids, (frames, records of each).
            hidden: The ids to leave out.
        """
        rows = self._selection.choose(records if records.ndim == 1 else records[0], hidden)
        with np.errstate(invalid="ignore"):  # a signaling NaN
            poses = numbers(records)[..., rows, :].astype(np.float64)
        poses.setflags(write=False)
        return self._selection.ids, poses

    def _steps(self, frame: Frame, next: Frame, ids: Ids, poses: Floats) -> Floats:
        """What leads from each pose to the next one; nothing for an actor that jumps, goes, or is replaced."""
        if ids is self._ids:
            steps = change(self._poses, poses)
            still = np.zeros(len(ids), np.bool_)
        else:
            where, found = places(self._ids, ids)
            steps = change(self._poses, poses[where] if len(poses) else self._poses)
            still = ~found
        # Comparisons are so made that what is not a number counts as a jump.
        if not np.abs(steps).max(initial=0) <= _NEAR:
            ways = np.sqrt((steps[:, LOCATION] ** 2).sum(axis=1))
            far = ~(ways <= JUMP)
            far[far] = ~(ways[far] <= _explained(frame, next, self._ids[far]))
            still |= far | ~np.isfinite(steps).all(axis=1)
        replaced = [actor.id for actor in next["spawned"]] + array(next["destroyed"])["id"].tolist()
        if replaced:
            still |= np.isin(self._ids, replaced)
        if still.any():
            steps[still] = 0
        return steps


def _explained(frame: Frame, next: Frame, ids: Ids) -> Floats:
    """How far, in cm, actors can have come from a frame to the next, given the velocity recorded in either."""
    seconds = next.elapsed - frame.elapsed
    speeds = np.fmax(_speeds(frame, ids), _speeds(next, ids)) * _CM_PER_M
    return np.where(np.isnan(speeds), TOP_SPEED * seconds, np.maximum(JUMP, SLACK * speeds * seconds))


def _speeds(frame: Frame, ids: Ids) -> Floats:
    """Recorded speeds in m/s; NaN where there is none."""
    records = latest(array(frame["velocities"]))
    speeds = np.full(len(ids), np.nan)
    where, found = places(ids, records["id"])
    velocity = numbers(records)[where[found], LOCATION].astype(np.float64)
    speeds[found] = np.sqrt(np.einsum("ij,ij->i", velocity, velocity))
    return speeds
