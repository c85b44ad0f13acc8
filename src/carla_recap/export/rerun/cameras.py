"""Axes that follow an actor, level and calm: a camera stands still in them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carla_recap.export.rerun.stream import Transforms
from carla_recap.replay import calm_headings, level
from carla_recap.replay.motion import JUMP, TOP_SPEED
from carla_recap.replay.pose import LOCATION, YAW

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.export.rerun.stream import Stream, Times

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]


def jumps(seconds: Floats, poses: Floats) -> Flags:
    """Which of some poses is farther from the one before than anybody drives."""
    ways = np.sqrt((np.diff(poses[:, LOCATION], axis=0) ** 2).sum(axis=1))
    return np.concatenate(([False], ways > np.maximum(JUMP, TOP_SPEED * np.diff(seconds))))


class Chase:
    """Writes the axes of an actor's camera, block after block.

    Args:
        stream: Where to.
        path: As which entity.
    """

    def __init__(self, stream: Stream, path: str) -> None:
        self._stream = stream
        self._path = path
        self._seconds = np.zeros(0)  # of the last row
        self._pose = np.zeros((0, 6))  # with the camera's heading as its yaw

    def move(self, times: Times, poses: Floats, there: NDArray[np.intp]) -> None:
        """Go on.

        Args:
            times: When.
            poses: Those of the actor, in cm and degrees, left-handed.
            there: The rows in which it has one.
        """
        held = len(self._pose)
        seconds = np.concatenate((self._seconds, times.seconds[there]))
        path = np.concatenate((self._pose, poses[there]))
        absent = np.concatenate((np.zeros(held, np.bool_), np.diff(there, prepend=-1) > 1))
        starts = np.flatnonzero(jumps(seconds, path) | absent)
        runs = zip(np.split(seconds, starts), np.split(path[:, YAW], starts), strict=True)
        calm = level(path, np.concatenate([calm_headings(*run) for run in runs]))
        stays = len(there) > 0 and there[-1] == len(poses) - 1
        self._seconds, self._pose = (seconds[-1:], calm[-1:]) if stays else (seconds[:0], calm[:0])
        before = calm[:1] if held else np.full((1, 6), np.nan)
        calm = calm[held:]
        news = np.flatnonzero(np.diff(calm, axis=0, prepend=before).any(axis=1))
        if len(news):
            self._stream.transforms(self._path, times.take(there[news]), Transforms.of(calm[news]))
