"""Poses as arrays: blending, putting one upon another, and the way to metres and right-handed axes.

A pose is six numbers, along the last axis of an array: x, y, z in cm, then roll, pitch, yaw in degrees, as CARLA has them:
left-handed, x forward, y right, z up. What is called right-handed here is in m and has x forward, y left, z up, as ROS,
Rerun and Foxglove do; rotations there are Rz(yaw) · Ry(pitch) · Rx(roll).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from carla_recap.model.records import CM

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

F = TypeVar("F", bound=np.floating)

LOCATION: Final = slice(0, 3)
ROTATION: Final = slice(3, 6)
YAW: Final = 5

_TO_RIGHT_HANDED: Final = np.array([CM, -CM, CM, 1, -1, -1])
_VELOCITY_TO_RIGHT_HANDED: Final = np.array([1.0, -1, 1, 1, -1, -1])


def wrap(angles: Floats) -> Floats:
    """The same angles within ±180 degrees."""
    wrapped: Floats = angles - 360 * np.rint(angles / 360)
    return wrapped


def change(before: Floats, after: Floats) -> Floats:
    """What leads from some poses to others: a way in cm, and about each axis by itself the shortest turn in degrees."""
    difference = after - before
    difference[..., ROTATION] = wrap(difference[..., ROTATION])
    return difference


def right_handed(poses: Floats) -> Floats:
    """Poses in m and degrees, right-handed: y, pitch and yaw change their sign."""
    converted: Floats = poses * _TO_RIGHT_HANDED
    return converted


def left_handed(poses: Floats) -> Floats:
    """CARLA's poses, in cm and degrees, of right-handed ones."""
    converted: Floats = poses / _TO_RIGHT_HANDED
    return converted


def right_handed_velocities(velocities: Floats) -> Floats:
    """Velocities, right-handed.

    Args:
        velocities: Rows of linear x, y, z in m/s and angular x, y, z in degrees/s, as recorded.
    """
    converted: Floats = velocities * _VELOCITY_TO_RIGHT_HANDED
    return converted


def quaternions(poses: NDArray[F]) -> NDArray[F]:
    """The rotations of right-handed poses as quaternions x, y, z, w, in the precision of the poses."""
    half = np.radians(poses[..., ROTATION]) / 2
    (sr, sp, sy), (cr, cp, cy) = np.moveaxis(np.sin(half), -1, 0), np.moveaxis(np.cos(half), -1, 0)
    return np.stack(
        (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ),
        axis=-1,
    )


def rotations(poses: Floats) -> Floats:
    """The rotations of right-handed poses as matrices: their columns point forward, left and up."""
    angles = np.radians(poses[..., ROTATION])
    (sr, sp, sy), (cr, cp, cy) = np.moveaxis(np.sin(angles), -1, 0), np.moveaxis(np.cos(angles), -1, 0)
    rows = (
        np.stack((cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr), axis=-1),
        np.stack((sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr), axis=-1),
        np.stack((-sp, cp * sr, cp * cr), axis=-1),
    )
    return np.stack(rows, axis=-2)


def attach(parent: Floats, relative: Floats) -> Floats:
    """Where an actor is in the world (cm, degrees, left-handed) that is fixed to a parent.

    Args:
        parent: The parent's pose in the world.
        relative: The actor's pose in the parent's axes.
    """
    parent, relative = right_handed(parent), right_handed(relative)
    turn = rotations(parent)
    location = parent[..., LOCATION] + (turn @ relative[..., LOCATION, None])[..., 0]
    return _left_handed_of(location, turn @ rotations(relative))


def detach(parent: Floats, child: Floats) -> Floats:
    """The pose of an actor in its parent's axes (cm, degrees, left-handed): what `attach` takes.

    Args:
        parent: The parent's pose in the world.
        child: The actor's pose in the world.
    """
    parent, child = right_handed(parent), right_handed(child)
    back = np.swapaxes(rotations(parent), -1, -2)
    location = (back @ (child - parent)[..., LOCATION, None])[..., 0]
    return _left_handed_of(location, back @ rotations(child))


def _left_handed_of(location: Floats, matrix: Floats) -> Floats:
    """CARLA's pose of a right-handed location and rotation."""
    sine = np.clip(-matrix[..., 2, 0], -1, 1)
    upright = np.abs(sine) > 1 - 1e-12  # nose up or down: roll and yaw are one, and called yaw
    roll = np.where(upright, 0.0, np.arctan2(matrix[..., 2, 1], matrix[..., 2, 2]))
    yaw = np.where(
        upright,
        np.arctan2(-matrix[..., 0, 1], matrix[..., 1, 1]),
        np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0]),
    )
    angles = np.degrees(np.stack((roll, np.arcsin(sine), yaw), axis=-1))
    return left_handed(np.concatenate((location, angles), axis=-1)) + 0.0
