"""Poses as arrays: conversion to metres and right-handed axes, attachment, and interpolation between frames.

A pose is six numbers, along the last axis of an array: x, y, z in cm, then roll, pitch, yaw in degrees, as CARLA has them:
left-handed, x forward, y right, z up. Right-handed poses are in m and have x forward, y left, z up, as in ROS, Rerun and
Foxglove; their rotations are Rz(yaw) · Ry(pitch) · Rx(roll).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from carla_recap.model.motion import FAULTY_SPEED, JUMP, neighbours, possible_step
from carla_recap.model.records import CM
from carla_recap.replay.selection import NO_IDS, Selection, array, find, latest, numbers

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.model.frame import Frame
    from carla_recap.replay.state import ReplayState
    from carla_recap.util.arrays import Booleans, Floats, Ids


F = TypeVar("F", bound=np.floating)

LOCATION: Final = slice(0, 3)
ROTATION: Final = slice(3, 6)
YAW: Final = 5

MIRROR: Final = np.array((1.0, -1.0, 1.0))
"""The factors of coordinates between CARLA's axes and right-handed ones."""

ANGULAR_MIRROR: Final = np.array((-1.0, 1.0, -1.0))
"""The factors of angular velocities between CARLA's axes and right-handed ones: a mirror turns rotations around."""

_NEAR: Final = JUMP / CM / 2  # steps along each axis, in cm, and rotations, in degrees, are shorter in most frames

_TO_RIGHT_HANDED: Final = np.array([CM, -CM, CM, 1, -1, -1])
_VELOCITY_TO_RIGHT_HANDED: Final = np.concatenate((MIRROR, ANGULAR_MIRROR))


def wrap(angles: Floats) -> Floats:
    """Return the same angles within ±180 degrees."""
    wrapped: Floats = angles - 360 * np.rint(angles / 360)
    return wrapped


def change(before: Floats, after: Floats) -> Floats:
    """Return the differences of poses: of locations in cm, and of each angle the shortest rotation in degrees."""
    difference = after - before
    difference[..., ROTATION] = wrap(difference[..., ROTATION])
    return difference


def right_handed(poses: Floats) -> Floats:
    """Return poses in m and degrees, right-handed: y, pitch and yaw change their sign."""
    converted: Floats = poses * _TO_RIGHT_HANDED
    return converted


def left_handed(poses: Floats) -> Floats:
    """Return CARLA's poses, in cm and degrees, of right-handed ones."""
    converted: Floats = poses / _TO_RIGHT_HANDED
    return converted


def right_handed_velocities(velocities: Floats) -> Floats:
    """Return velocities, right-handed.

    Args:
        velocities: Rows of linear x, y, z in m/s and angular x, y, z in degrees/s, as recorded.
    """
    converted: Floats = velocities * _VELOCITY_TO_RIGHT_HANDED
    return converted


def quaternions(poses: NDArray[F]) -> NDArray[F]:
    """Return the rotations of right-handed poses as quaternions x, y, z, w, in the precision of the poses."""
    half = np.ascontiguousarray(np.moveaxis(np.radians(poses[..., ROTATION]) / 2, -1, 0))
    with np.errstate(invalid="ignore"):  # of infinite angles
        (sr, sp, sy), (cr, cp, cy) = np.sin(half), np.cos(half)
    found = np.empty((*poses.shape[:-1], 4), poses.dtype)
    found[..., 0] = sr * cp * cy - cr * sp * sy
    found[..., 1] = cr * sp * cy + sr * cp * sy
    found[..., 2] = cr * cp * sy - sr * sp * cy
    found[..., 3] = cr * cp * cy + sr * sp * sy
    return found


def rotations(poses: Floats) -> Floats:
    """Return the rotations of right-handed poses as matrices: their columns point forward, left and up."""
    angles = np.radians(poses[..., ROTATION])
    with np.errstate(invalid="ignore"):  # of infinite angles
        sines, cosines = np.sin(angles), np.cos(angles)
    sr, sp, sy = (sines[..., axis] for axis in range(3))
    cr, cp, cy = (cosines[..., axis] for axis in range(3))
    found = np.empty((*angles.shape, 3), angles.dtype)
    found[..., 0, 0], found[..., 0, 1], found[..., 0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    found[..., 1, 0], found[..., 1, 1], found[..., 1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    found[..., 2, 0], found[..., 2, 1], found[..., 2, 2] = -sp, cp * sr, cp * cr
    return found


def quaternions_of(matrices: NDArray[np.floating]) -> Floats:
    """Return rotation matrices, (…, 3, 3), as quaternions x, y, z, w of length 1, (…, 4)."""
    (a, b, c), (d, e, f), (g, h, i) = np.moveaxis(np.asarray(matrices, np.float64), (-2, -1), (0, 1))
    products = np.stack(  # four times that of each two of x, y, z, w
        [
            np.stack(row, axis=-1)
            for row in (
                (1 + a - e - i, b + d, c + g, h - f),
                (b + d, 1 - a + e - i, f + h, c - g),
                (c + g, f + h, 1 - a - e + i, d - b),
                (h - f, c - g, d - b, 1 + a + e + i),
            )
        ],
        axis=-2,
    )
    largest = np.diagonal(products, axis1=-2, axis2=-1).argmax(axis=-1)
    found = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    return np.asarray(found / np.sqrt((found**2).sum(axis=-1, keepdims=True)))


def angular_velocities(time: Floats, poses: Floats, joined: Booleans) -> Floats:
    """Return the angular velocities of right-handed poses, (n, 6), as vectors in the world in degrees/s, (n, 3).

    They are derived between the neighbours of each frame, as `carla_recap.model.motion.rates` does; NaN without one.
    """
    axes, (before, after) = rotations(poses), neighbours(joined)
    turn = axes[after] @ np.swapaxes(axes[before], 1, 2)
    sine = np.stack(
        (turn[:, 2, 1] - turn[:, 1, 2], turn[:, 0, 2] - turn[:, 2, 0], turn[:, 1, 0] - turn[:, 0, 1]), axis=1
    )  # twice the sine of the angle, along the axis
    length = np.sqrt((sine**2).sum(axis=1))
    angle = np.arctan2(length, np.trace(turn, axis1=1, axis2=2) - 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        vectors: Floats = np.degrees(sine * np.where(length > 0, angle / length, 0.5)[:, None])
        return vectors / (time[after] - time[before])[:, None]


def attach(parent: Floats, relative: Floats) -> Floats:
    """Return the pose in the world (cm, degrees, left-handed) of an actor that is fixed to a parent.

    The relative pose is in the axes of the parent.
    """
    parent, relative = right_handed(parent), right_handed(relative)
    rotation = rotations(parent)
    location = parent[..., LOCATION] + (rotation @ relative[..., LOCATION, None])[..., 0]
    return _left_handed_of(location, rotation @ rotations(relative))


def detach(parent: Floats, child: Floats) -> Floats:
    """Return the pose of an actor in its parent's axes (cm, degrees, left-handed), as `attach` takes it."""
    parent, child = right_handed(parent), right_handed(child)
    inverse = np.swapaxes(rotations(parent), -1, -2)
    location = (inverse @ (child - parent)[..., LOCATION, None])[..., 0]
    return _left_handed_of(location, inverse @ rotations(child))


def _left_handed_of(location: Floats, matrix: Floats) -> Floats:
    """Return CARLA's pose of a right-handed location and rotation."""
    sine = np.clip(-matrix[..., 2, 0], -1, 1)
    upright = np.abs(sine) > 1 - 1e-12  # pointing up or down: roll and yaw are the same rotation, which is given as yaw
    roll = np.where(upright, 0.0, np.arctan2(matrix[..., 2, 1], matrix[..., 2, 2]))
    yaw = np.where(
        upright,
        np.arctan2(-matrix[..., 0, 1], matrix[..., 1, 1]),
        np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0]),
    )
    angles = np.degrees(np.stack((roll, np.arcsin(sine), yaw), axis=-1))
    return left_handed(np.concatenate((location, angles), axis=-1)) + 0.0


def poses_of(transforms: NDArray[np.void]) -> Floats:
    """Return the poses of records, (…, 6), as recorded; read-only."""
    with np.errstate(invalid="ignore"):  # a signaling NaN
        poses: Floats = numbers(transforms).astype(np.float64)
    poses.setflags(write=False)
    return poses


class Interpolator:
    """Interpolates the poses of all actors between a frame and the next one.

    CARLA's own replay interpolates between the frame at a time and the one before, so it is always a frame late.
    """

    def __init__(self) -> None:
        self._selection = Selection()
        self._frame: Frame | None = None
        self._next: Frame | None = None
        self._ids: Ids = NO_IDS
        self._poses: Floats = np.zeros((0, 6))
        self._change: Floats | None = None
        self._wraps = False  # whether an angle passes ±180 degrees

    def at(self, frame: Frame, next: Frame | None, state: ReplayState, part: float) -> Floats:
        """Return the poses of the actors whose transforms the state has, (ids, 6), read-only.

        Args:
            frame: The frame at or before the moment.
            next: The frame after it, if any.
            state: The state after the frame.
            part: The part of the time between the two that has passed, from 0 to 1.
        """
        latest = state.latest["transforms"]
        if frame is not self._frame or latest.ids is not self._ids:
            self._ids, self._poses = latest.ids, poses_of(latest.records)
            self._frame, self._next = frame, None
        if next is None or part <= 0:
            return self._poses
        if self._change is None or next is not self._next:
            self._next = next
            records = array(next["transforms"])
            rows = self._selection.choose(records, state.hidden)
            with np.errstate(invalid="ignore", over="ignore"):
                self._change = self._steps(frame, next, self._selection.ids, poses_of(records[rows]))
                angles = np.stack((self._poses, self._poses + self._change))[:, :, ROTATION]
                self._wraps = not np.abs(angles).max(initial=0) <= 180
        poses = self._poses + part * self._change
        if self._wraps:
            with np.errstate(invalid="ignore"):
                poses[:, ROTATION] = wrap(poses[:, ROTATION])
        poses.setflags(write=False)
        return poses

    def _steps(self, frame: Frame, next: Frame, ids: Ids, poses: Floats) -> Floats:
        """Return the difference of each pose to the next one; 0 for an actor that jumps, disappears or is replaced.

        A step is a jump by `possible_step`, one of up to 5 m never is: no velocity follows from it.
        """
        if np.array_equal(ids, self._ids):
            steps = change(self._poses, poses)
            still = np.zeros(len(ids), np.bool_)
        else:
            where, found = find(self._ids, ids)
            steps = change(self._poses, poses[where] if len(poses) else self._poses)
            still = ~found
        # NaN fails these comparisons, so that it counts as a jump.
        if not np.abs(steps).max(initial=0) <= _NEAR:
            distances = np.sqrt((steps[:, LOCATION] ** 2).sum(axis=1)) * CM
            far = ~(distances <= JUMP)
            fast = self._ids[far]
            speeds = np.fmax(_speeds(frame, fast), _speeds(next, fast))
            far[far] = ~(distances[far] <= possible_step(next.elapsed - frame.elapsed, speeds))
            still |= far | ~np.isfinite(steps).all(axis=1)
        replaced = [actor.id for actor in next["spawned"]] + array(next["destroyed"])["id"].tolist()
        if replaced:
            still |= np.isin(self._ids, replaced)
        if still.any():
            steps[still] = 0
        return steps


def _speeds(frame: Frame, ids: Ids) -> Floats:
    """Return recorded speeds in m/s; NaN for actors without one."""
    records = latest(array(frame["velocities"]))
    speeds = np.full(len(ids), np.nan)
    where, found = find(ids, records["id"])
    velocity = numbers(records)[where[found], LOCATION].astype(np.float64)
    speeds[found] = np.sqrt(np.einsum("ij,ij->i", velocity, velocity))
    return np.where(speeds < FAULTY_SPEED, speeds, np.nan)
