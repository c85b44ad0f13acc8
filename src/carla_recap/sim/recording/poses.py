"""Transforms of the simulator, in m, as the poses of recordings, in cm, and back.

A pose is six numbers, as in `carla_recap.replay.pose`: x, y, z in cm, then roll, pitch, yaw in degrees, left-handed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from carla_recap.sim.geometry import Location, Rotation, Transform

if TYPE_CHECKING:
    from collections.abc import Iterable

CM_PER_M: Final = 100.0


def pose(transform: Transform) -> tuple[float, float, float, float, float, float]:
    """Return the pose of a transform."""
    location, rotation = transform.location, transform.rotation
    return (
        location.x * CM_PER_M,
        location.y * CM_PER_M,
        location.z * CM_PER_M,
        rotation.roll,
        rotation.pitch,
        rotation.yaw,
    )


def transform(pose: Iterable[float]) -> Transform:
    """Return the transform of a pose."""
    x, y, z, roll, pitch, yaw = map(float, pose)
    return Transform(Location(x / CM_PER_M, y / CM_PER_M, z / CM_PER_M), Rotation(pitch, yaw, roll))
