"""The camera that follows an actor, as in CARLA's replay, but with a level horizon and a calm heading.

Poses are arrays as in `carla_recap.replay.pose`: x, y, z in cm, roll, pitch, yaw in degrees, left-handed.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.replay.pose import LOCATION, YAW, wrap

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from carla_recap.util.arrays import Floats


CHASE_BACK: Final = 1000.0  # cm
CHASE_UP: Final = 500.0  # cm
CHASE_PITCH: Final = -25.0  # degrees
TOP_UP: Final = 4000.0  # cm
TOP_PITCH: Final = -90.0  # degrees
CALM: Final = 0.5  # s; the time constant of the heading


def level(poses: Floats, heading: ArrayLike | None = None) -> Floats:
    """Return poses without roll and pitch: the axes in which a following camera stands still.

    Without a heading (the yaw to look along, in degrees; see `calm_headings`), it is that of the actor.
    """
    levelled = np.zeros_like(poses)
    levelled[..., LOCATION] = poses[..., LOCATION]
    levelled[..., YAW] = poses[..., YAW] if heading is None else heading
    return levelled


def chase(
    poses: Floats,
    heading: ArrayLike | None = None,
    *,
    back: float = CHASE_BACK,
    up: float = CHASE_UP,
    pitch: float = CHASE_PITCH,
) -> Floats:
    """Return the poses of a camera behind and above an actor, looking down at it.

    Distances are in cm, angles in degrees; a heading is as in `level`.
    """
    camera = level(poses, heading)
    yaw = np.radians(camera[..., YAW])
    camera[..., 0] -= back * np.cos(yaw)
    camera[..., 1] -= back * np.sin(yaw)
    camera[..., 2] += up
    camera[..., 4] = pitch
    return camera


def top(poses: Floats, heading: ArrayLike | None = None, *, up: float = TOP_UP) -> Floats:
    """Return the poses of a camera straight above an actor, looking down.

    The height is in cm; the heading, which is upwards in the picture, as in `level`.
    """
    camera = level(poses, heading)
    camera[..., 2] += up
    camera[..., 4] = TOP_PITCH
    return camera


def calm_heading(yaw: float, previous: float | None, delta: float, seconds: float = CALM) -> float:
    """Return the heading of a camera that follows the yaw of an actor with a delay.

    Args:
        yaw: The yaw of the actor, in degrees.
        previous: The last heading; None at the beginning, and after the actor has jumped.
        delta: Seconds since then.
        seconds: The time constant: two thirds of a turn are done after this time.
    """
    if previous is None or not math.isfinite(yaw - previous):
        return yaw
    share = -math.expm1(-max(delta, 0.0) / seconds) if seconds > 0 else 1.0
    return math.remainder(previous + share * math.remainder(yaw - previous, 360), 360)


def calm_headings(times: Floats, yaws: Floats, seconds: float = CALM) -> Floats:
    """Return `calm_heading` at many times, without jumps from 180 to -180 degrees.

    Args:
        times: Times in seconds, ascending.
        yaws: The actor's yaw at these times, in degrees.
        seconds: See `calm_heading`.
    """
    if not len(yaws):
        return np.zeros(0)
    unwrapped = np.concatenate(([0.0], np.cumsum(wrap(np.diff(yaws))))) + yaws[0]
    shares = -np.expm1(-np.fmax(np.diff(times), 0.0) / seconds) if seconds > 0 else np.ones(len(yaws) - 1)
    heading = float(unwrapped[0])
    headings = [heading]
    for target, share in zip(unwrapped[1:].tolist(), shares.tolist(), strict=True):
        heading += share * (target - heading)
        headings.append(heading)
    return np.array(headings)
