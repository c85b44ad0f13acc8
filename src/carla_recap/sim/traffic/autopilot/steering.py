"""How to steer along a way: the control law of Stanley (Hoffmann and others, 2007), with the middle of the vehicle on it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

PREVIEW: Final = 0.12  # s: so much later the front wheels are where they are turned to by now
_GAIN: Final = 1.5  # 1/s: how fast the front axle comes back to the way
_SOFTENING: Final = 1.0  # m/s: keeps the steering calm at low speed
_WIDEST: Final = 0.8  # m: the most that the front axle swings out, so that the rear does not cut the curve
_LONG: Final = 3.1  # m: the wheelbase from which on a vehicle is a long one
_HARDEST: Final = 3.0  # m/s² to the side, to come back to the way


def steer(speed: Floats, wheelbase: Floats, half_length: Floats, beside: Floats, turn: Floats, bend: Floats) -> Floats:
    """The angle of the front wheels, in radians, positive to the right.

    In a curve, the middle of a car runs on the way. A long vehicle takes as much room on one side of it as on the other.

    Args:
        speed: In m/s.
        wheelbase: In m.
        half_length: Half the length of the vehicle in m.
        beside: How far to the right of the way the front axle is, in m.
        turn: The direction of the way, relative to that of the vehicle, in radians.
        bend: The curvature of the way in 1/m, positive to the right.
    """
    # If the rear axle runs at a radius of r, a point at a distance of d ahead of it runs at about r + d² / 2r.
    axle, middle, bumper = wheelbase**2 / 2, wheelbase**2 / 8, (wheelbase / 2 + half_length) ** 2 / 2
    swing = -bend * (axle - np.where(wheelbase < _LONG, middle, bumper / 2))
    swing = np.clip(swing, -_WIDEST, _WIDEST)
    back = np.arctan2(_GAIN * (beside - swing), np.abs(speed) + _SOFTENING)
    most = np.arctan(_HARDEST * wheelbase / np.maximum(speed * speed, 1.0))
    angle: Floats = wrap(turn) - np.clip(back, -most, most)
    return angle


def wrap(angle: Floats) -> Floats:
    """Angles in radians, within ±π."""
    wrapped: Floats = (angle + np.pi) % (2 * np.pi) - np.pi
    return wrapped
