"""The points from which cameras see the actor that they follow, in its level axes, in m."""

from __future__ import annotations

from typing import Final

from carla_recap.model.records import CM
from carla_recap.replay import camera

Triple = tuple[float, float, float]

LOOK_DOWN: Final = -17.0
"""The pitch of the camera behind an actor, in degrees."""

_CAR: Final = (2.4, 0.8)  # m; half the length and the height of a car, for which the distances are right


def chase_eye(half_extents: Triple | None) -> Triple:
    """Return where the camera behind an actor is: farther away from one that is larger than a car.

    Args:
        half_extents: Half the size of the actor's box; None if it is unknown.
    """
    back, up = camera.CHASE_BACK * CM, camera.CHASE_UP * CM
    if half_extents is not None:
        back += max(0.0, half_extents[0] - _CAR[0]) * 1.6
        up += max(0.0, 2 * half_extents[2] - 2 * _CAR[1]) * 1.1
    return -back, 0.0, up
