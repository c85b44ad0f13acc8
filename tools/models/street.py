"""What stands in streets: traffic lights, signs, and marks of collisions."""

from __future__ import annotations

from itertools import pairwise
from math import cos, pi, sin
from typing import Final

from carla_recap.scene.materials import Material
from tools.models.solid import Solid, model

M: Final = Material

ROOT: Final = 0.5
"""How far poles reach below the origin of their actor, in m, so that none floats above the ground."""
_LAMP: Final = 0.125  # m, the radius


@model
def traffic_light(solid: Solid) -> None:
    """Add a traffic light on a post. It faces -y: the traffic that it stops drives along y."""
    solid.limb((0, 0, -ROOT), (0, 0, 3.62), (0.065, 0.055), M.POLE, sides=8)
    solid.box((-0.11, -0.11, 0.0), (0.11, 0.11, 0.32), M.POLE, top=(0.8, 0.8))
    solid.box((-0.24, -0.145, 2.48), (0.24, -0.125, 3.72), M.LIGHT_HOUSING)
    solid.box((-0.17, -0.33, 2.54), (0.17, -0.12, 3.66), M.LIGHT_HOUSING)
    for z in (2.75, 3.45):
        solid.box((-0.03, -0.13, z - 0.03), (0.03, 0.0, z + 0.03), M.POLE)
    for z, lamp in ((3.45, M.RED_LAMP), (3.10, M.YELLOW_LAMP), (2.75, M.GREEN_LAMP)):
        circle = [(cos(2 * pi * i / 12), sin(2 * pi * i / 12)) for i in range(12)]
        solid.facet([(x * _LAMP, -0.336, z + up * _LAMP) for x, up in circle], lamp)
        hood = _LAMP + 0.02
        for (x0, up0), (x1, up1) in pairwise(circle[:7]):
            near = ((x0 * hood, -0.33, z + up0 * hood), (x1 * hood, -0.33, z + up1 * hood))
            far = ((x1 * hood, -0.52, z + up1 * hood), (x0 * hood, -0.52, z + up0 * hood))
            solid.facet((*near, *far), M.LIGHT_HOUSING)
            solid.facet((*near, *far)[::-1], M.LIGHT_HOUSING)


@model
def collision_mark(solid: Solid) -> None:
    """Add a ring on the ground."""
    count = 24
    for i in range(count):
        angles = (2 * pi * i / count, 2 * pi * (i + 1) / count)
        (x0, y0), (x1, y1) = ((cos(angle), sin(angle)) for angle in angles)
        for inner, outer in ((0.84, 1.0), (0.0, 0.3)):
            solid.facet(
                [(x * r, y * r, 0.0) for x, y, r in ((x0, y0, inner), (x0, y0, outer), (x1, y1, outer), (x1, y1, inner))],
                M.COLLISION_MARK,
            )


@model
def box(solid: Solid) -> None:
    """Add a box."""
    solid.box((-0.5, -0.5, 0), (0.5, 0.5, 1), M.PAINT)
