"""The followed actor becomes see-through while it hides another one from the camera behind it.

Unlike `export.video.transparency`, which compares projected boxes in one picture of any camera, this computes the lines of
sight of a fixed camera in whole blocks of frames at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.replay import right_handed
from carla_recap.replay.pose import LOCATION, YAW
from carla_recap.show.rerun import paths
from carla_recap.show.rerun.eyes import chase_eye
from carla_recap.show.rerun.stream import TimeColumns

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from carla_recap.scene.appearance import Look
    from carla_recap.show.rerun.poses import PoseBlock
    from carla_recap.show.rerun.stream import Stream, TimePoint

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]

_REACH: Final = 30.0  # m; what is farther ahead need not be seen
_STEP: Final = 0.2  # s between the moments that are looked at
_HELD: Final = 1.0  # s for which it stays see-through
_OPACITY: Final = 0.45
_LOW: Final = 0.5  # the height of the part of an actor that has to be visible, as a share of its box


class SeeThroughWriter:
    """Writes how opaque the followed actor is.

    Args:
        stream: The stream.
        id: The followed actor.
        looks: The looks of actors by id; those that are not among these are not looked for.
    """

    def __init__(self, stream: Stream, id: int, looks: Mapping[int, Look]) -> None:
        self._stream = stream
        self._id = id
        self._looks = looks
        self._hidden_at = -np.inf  # s; when it last hid anything
        self._is_faded = False

    def write(self, block: PoseBlock) -> None:
        """Write the opacity in a block of frames."""
        own = np.flatnonzero(block.ids == self._id)
        look = self._looks.get(self._id)
        if not len(own) or look is None:
            return
        seconds = block.times.seconds
        rows = _every(seconds, _STEP)
        rows = rows[block.present[rows, own[0]]]
        others = np.array([id in self._looks and id != self._id for id in block.ids.tolist()], np.bool_)
        if not len(rows):
            return
        hidden = self._hides(look, block, rows, own[0], np.flatnonzero(others))
        changes: list[tuple[TimePoint, bool]] = []
        for row, hides in zip(rows.tolist(), hidden.tolist(), strict=True):
            if hides:
                self._hidden_at = seconds[row]
            faded = bool(seconds[row] - self._hidden_at < _HELD)
            if faded != self._is_faded:
                self._is_faded = faded
                changes.append((block.times.point(row), faded))
        if changes:
            times = TimeColumns.of_points(time for time, _ in changes)
            alphas = [(255, 255, 255, round(255 * _OPACITY) if faded else 255) for _, faded in changes]
            column = rr.Mesh3D.columns(albedo_factor=np.array(alphas, np.uint8))
            self._stream.columns(paths.actor(self._id), times, column)

    def _hides(self, look: Look, block: PoseBlock, rows: NDArray[np.intp], own: int, others: NDArray[np.intp]) -> Flags:
        """Return whether the actor hides any other one in some rows of a block."""
        hidden = np.zeros(len(rows), np.bool_)
        if not len(others):
            return hidden
        poses = right_handed(block.poses[np.ix_(rows, others)])
        here = right_handed(block.poses[rows, own])
        heights = [
            self._looks[id].center[2] - (1 - _LOW) * self._looks[id].half_extents[2] for id in block.ids[others].tolist()
        ]
        away = poses[..., LOCATION] - here[:, None, LOCATION]
        away[..., 2] += heights
        near = block.present[np.ix_(rows, others)] & (np.abs(away) < _REACH).all(axis=2)
        at, which = np.nonzero(near)
        if not len(at):
            return hidden
        away, yaw = away[at, which], np.radians(here[at, YAW])
        cos, sin = np.cos(yaw), np.sin(yaw)
        target = np.stack((away[:, 0] * cos + away[:, 1] * sin, away[:, 1] * cos - away[:, 0] * sin, away[:, 2]), axis=1)
        half, center = np.array(look.half_extents), np.array(look.center)
        eye = np.array(chase_eye(look.half_extents))
        along = target - eye
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.stack(((center - half - eye) / along, (center + half - eye) / along))
        enters, leaves = np.fmin(*ends).max(axis=1), np.fmax(*ends).min(axis=1)
        ahead = target[:, 0] > center[0] + half[0]
        hidden[at[ahead & (enters < leaves) & (leaves > 0) & (enters < 1)]] = True
        return hidden


def _every(seconds: Floats, step: float) -> NDArray[np.intp]:
    """Return the first row of each step of time; row 0 belongs to the block before."""
    steps = np.floor(seconds / step + 1e-6)
    return np.asarray(np.flatnonzero(steps[1:] != steps[:-1]) + 1)
