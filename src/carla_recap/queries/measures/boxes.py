"""How close oriented boxes are, and how soon they touch: measures of two moving rectangles, on plain arrays.

Axes are right-handed and seen from above; all arrays are broadcast against each other. The definitions are those of
Westhofen et al., "Criticality Metrics for Automated Driving" (2022).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from carla_recap.util.arrays import Booleans, Floats


_CORNERS: Final = ((1, 1), (1, -1), (-1, -1), (-1, 1))


class Boxes(NamedTuple):
    """Rectangles that move without turning; each field is an array, or one number for all.

    Attributes:
        x, y: The centre, in m.
        yaw: The heading in radians, counter-clockwise.
        length, width: The size in m.
        vx, vy: The velocity in m/s.
    """

    x: ArrayLike
    y: ArrayLike
    yaw: ArrayLike
    length: ArrayLike
    width: ArrayLike
    vx: ArrayLike = 0.0
    vy: ArrayLike = 0.0


class _Relative:
    """One box as seen from another: distances, velocities and the sizes along the axes of both.

    Args:
        a: The box that is the origin.
        b: The other box.
    """

    def __init__(self, a: Boxes, b: Boxes) -> None:
        ax, ay, a_yaw, a_length, a_width, avx, avy = (np.asarray(values, np.float64) for values in a)
        bx, by, b_yaw, b_length, b_width, bvx, bvy = (np.asarray(values, np.float64) for values in b)
        self.half_a = a_length / 2, a_width / 2
        self.half_b = b_length / 2, b_width / 2
        self.cos, self.sin = np.cos(b_yaw - a_yaw), np.sin(b_yaw - a_yaw)
        self._a, self._b = (np.cos(a_yaw), np.sin(a_yaw)), (np.cos(b_yaw), np.sin(b_yaw))
        self._distance, self._velocity = (bx - ax, by - ay), (bvx - avx, bvy - avy)

    def distance(self) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Return the centre of b minus that of a, along and across a, and along and across b, in m."""
        return _along(self._distance, self._a), _along(self._distance, self._b)

    def velocity(self) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Return the velocity of b minus that of a, in m/s; see `distance`."""
        return _along(self._velocity, self._a), _along(self._velocity, self._b)

    def reach(self) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Return the distances along each of the four axes below which the boxes overlap on this axis."""
        cos, sin = np.abs(self.cos), np.abs(self.sin)
        (al, aw), (bl, bw) = self.half_a, self.half_b
        return (al + cos * bl + sin * bw, aw + sin * bl + cos * bw), (bl + cos * al + sin * aw, bw + sin * al + cos * aw)


def _along(vector: tuple[Floats, Floats], axis: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Return the components of a vector along an axis, and across it to the left."""
    (x, y), (cos, sin) = vector, axis
    return x * cos + y * sin, y * cos - x * sin


def overlaps(a: Boxes, b: Boxes) -> Booleans:
    """Return whether boxes overlap or touch."""
    relative = _Relative(a, b)
    return _overlaps(relative)


def _overlaps(relative: _Relative) -> Booleans:
    (d1, d2), (d3, d4) = relative.distance()
    (r1, r2), (r3, r4) = relative.reach()
    found: Booleans = (np.abs(d1) <= r1) & (np.abs(d2) <= r2) & (np.abs(d3) <= r3) & (np.abs(d4) <= r4)
    return found


def gap(a: Boxes, b: Boxes) -> Floats:
    """Return the distance between boxes in m: the least distance of a corner of one to the other, 0 if they overlap."""
    relative = _Relative(a, b)
    (along_a, across_a), (along_b, across_b) = relative.distance()
    least = np.minimum(
        _corner_distance(along_a, across_a, relative.half_a, relative.half_b, relative.cos, relative.sin),
        _corner_distance(-along_b, -across_b, relative.half_b, relative.half_a, relative.cos, -relative.sin),
    )
    return np.asarray(np.where(_overlaps(relative), 0.0, least))


def _corner_distance(
    along: Floats, across: Floats, half: tuple[Floats, Floats], other: tuple[Floats, Floats], cos: Floats, sin: Floats
) -> Floats:
    """Return the least distance of the corners of another box to a box, in whose axes the other's centre is given."""
    least = np.asarray(math.inf)
    for sign_length, sign_width in _CORNERS:
        length, width = sign_length * other[0], sign_width * other[1]
        beside = np.maximum(np.abs(along + cos * length - sin * width) - half[0], 0.0)
        beyond = np.maximum(np.abs(across + sin * length + cos * width) - half[1], 0.0)
        least = np.minimum(least, beside * beside + beyond * beyond)
    return np.asarray(np.sqrt(least))


def time_to_collision(a: Boxes, b: Boxes) -> Floats:
    """Return the time until boxes touch if both keep their velocity, in s: 0 if they overlap, inf if they never touch.

    The result is exact for boxes that do not turn: on each of their four axes, the times at which they overlap are an
    interval; they touch when all four do. The time to collision is due to Hayward, "Near-miss determination through use of
    a scale of danger" (1972).
    """
    relative = _Relative(a, b)
    first, last = np.asarray(-math.inf), np.asarray(math.inf)
    for distances, velocities, reaches in zip(relative.distance(), relative.velocity(), relative.reach(), strict=True):
        for distance, velocity, reach in zip(distances, velocities, reaches, strict=True):
            moves = velocity != 0
            speed = np.where(moves, np.abs(velocity), 1.0)
            toward = -np.sign(velocity) * distance  # the distance until the centres are level on this axis
            always = np.where(np.abs(distance) <= reach, math.inf, -math.inf)
            first = np.maximum(first, np.where(moves, (toward - reach) / speed, -always))
            last = np.minimum(last, np.where(moves, (toward + reach) / speed, always))
    touches = (first <= last) & (last >= 0)
    return np.asarray(np.where(touches, np.maximum(first, 0.0), math.inf))


def required_deceleration(gap: ArrayLike, speed: ArrayLike, leader_speed: ArrayLike) -> Floats:
    """Return the constant deceleration that a follower needs to avoid its leader, in m/s²; 0 if it is not faster.

    It is the deceleration rate to avoid a crash (DRAC): the squared difference of speeds over twice the gap.

    Args:
        gap: The gap to the leader in m.
        speed: The speed of the follower in m/s.
        leader_speed: The speed of the leader in m/s.
    """
    gap, speed, leader_speed = (np.asarray(values, np.float64) for values in (gap, speed, leader_speed))
    faster = np.maximum(speed - leader_speed, 0.0)
    room = 2 * np.where(gap > 0, gap, np.where(np.isnan(gap), math.nan, 0.0))
    squared, room = np.broadcast_arrays(faster * faster, room)
    braking = np.divide(squared, room, out=np.full(room.shape, math.inf), where=room != 0)
    return np.asarray(np.where(faster > 0, braking, faster))


def time_headway(gap: ArrayLike, speed: ArrayLike) -> Floats:
    """Return the time in which a follower covers the gap to its leader, in s; inf at rest.

    Args:
        gap: The gap to the leader, from bumper to bumper, in m.
        speed: The speed of the follower in m/s.
    """
    gap, speed = np.broadcast_arrays(np.asarray(gap, np.float64), np.asarray(speed, np.float64))
    return np.asarray(np.divide(gap, speed, out=np.full(gap.shape, math.inf), where=speed > 0))
