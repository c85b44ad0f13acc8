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
    """Rectangles that move without turning; each field is an array, or one number for all."""

    x: ArrayLike  # of the centre, in m
    y: ArrayLike
    yaw: ArrayLike  # the heading in radians, counter-clockwise
    length: ArrayLike  # m
    width: ArrayLike
    vx: ArrayLike = 0.0  # m/s
    vy: ArrayLike = 0.0


def _axes(a: Boxes, b: Boxes) -> list[tuple[Floats, Floats, Floats, Floats]]:
    """Return the directions along and across a and b, the centre of b minus that of a along each, and where they overlap.

    The boxes overlap on an axis if the third number, in m, is within the fourth one.
    """
    (al, aw), (bl, bw) = ((np.divide(box.length, 2), np.divide(box.width, 2)) for box in (a, b))
    (a_cos, a_sin), (b_cos, b_sin) = ((np.cos(box.yaw), np.sin(box.yaw)) for box in (a, b))
    x, y, turn = np.subtract(b.x, a.x), np.subtract(b.y, a.y), np.subtract(b.yaw, a.yaw)
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    axes = (
        (a_cos, a_sin, al + cos * bl + sin * bw),
        (-a_sin, a_cos, aw + sin * bl + cos * bw),
        (b_cos, b_sin, bl + cos * al + sin * aw),
        (-b_sin, b_cos, bw + sin * al + cos * aw),
    )
    return [(cos, sin, x * cos + y * sin, reach) for cos, sin, reach in axes]


def overlaps(a: Boxes, b: Boxes) -> Booleans:
    """Return whether boxes overlap or touch."""
    one, two, three, four = (np.abs(distance) <= reach for _, _, distance, reach in _axes(a, b))
    return np.asarray(one & two & three & four)


def gap(a: Boxes, b: Boxes) -> Floats:
    """Return the distance between boxes in m: the least distance of a corner of one to the other, 0 if they overlap."""
    axes, turn = _axes(a, b), np.subtract(b.yaw, a.yaw)
    along_a, across_a, along_b, across_b = (distance for _, _, distance, _ in axes)
    half_a, half_b = ((np.divide(box.length, 2), np.divide(box.width, 2)) for box in (a, b))
    least = np.minimum(
        _corner_distance(along_a, across_a, half_a, half_b, np.cos(turn), np.sin(turn)),
        _corner_distance(-along_b, -across_b, half_b, half_a, np.cos(turn), -np.sin(turn)),
    )
    one, two, three, four = (np.abs(distance) <= reach for _, _, distance, reach in axes)
    return np.asarray(np.where(one & two & three & four, 0.0, least))


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

    With an unknown velocity, boxes that do not overlap never touch.
    The result is exact for boxes that do not turn: on each of their four axes, the times at which they overlap are an
    interval; they touch when all four do. The time to collision is due to Hayward, "Near-miss determination through use of
    a scale of danger" (1972).
    """
    vx, vy = np.subtract(b.vx, a.vx), np.subtract(b.vy, a.vy)
    first, last, inside = np.asarray(-math.inf), np.asarray(math.inf), np.asarray(True)
    for cos, sin, distance, reach in _axes(a, b):
        velocity = vx * cos + vy * sin
        moves = velocity != 0
        speed = np.where(moves, np.abs(velocity), 1.0)
        toward = -np.sign(velocity) * distance  # the distance until the centres are level on this axis
        level = np.abs(distance) <= reach
        inside, always = inside & level, np.where(level, math.inf, -math.inf)
        first = np.maximum(first, np.where(moves, (toward - reach) / speed, -always))
        last = np.minimum(last, np.where(moves, (toward + reach) / speed, always))
    touches = (first <= last) & (last >= 0)
    return np.asarray(np.where(inside, 0.0, np.where(touches, np.maximum(first, 0.0), math.inf)))


def required_deceleration(gap: ArrayLike, speed: ArrayLike, leader_speed: ArrayLike) -> Floats:
    """Return the constant deceleration that a follower needs to avoid its leader, in m/s²; 0 if it is not faster.

    It is the deceleration rate to avoid a crash (DRAC): the squared difference of speeds, in m/s, over twice the gap in m.
    """
    faster, room = np.maximum(np.subtract(speed, leader_speed), 0.0), 2 * np.maximum(gap, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        braking = np.where(room == 0, math.inf, faster * faster / room)
    return np.asarray(np.where(faster > 0, braking, faster))


def time_headway(gap: ArrayLike, speed: ArrayLike) -> Floats:
    """Return the time in s in which a follower covers the gap to its leader, bumper to bumper, in m; inf at rest."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(np.greater(speed, 0), np.divide(gap, speed), math.inf)
