"""Props: cones, barriers, bins, plants, furniture and the like, each of a family as one model."""

from __future__ import annotations

import itertools
from math import cos, pi, sin
from typing import TYPE_CHECKING, Final

from carla_recap.scene.materials import Material
from tools.models.solid import MaterialOf, Solid, model

if TYPE_CHECKING:
    from collections.abc import Sequence

M: Final = Material


def _turned(solid: Solid, profile: Sequence[tuple[float, float]], material: MaterialOf, *, sides: int = 10) -> None:
    """Add a body of revolution about the vertical axis: radius and height, from below."""
    angles = [2 * pi * (i + 0.5) / sides for i in range(sides)]
    solid.loft([[(cos(a) * radius, sin(a) * radius, z) for a in angles] for radius, z in profile], material)


@model
def cone(solid: Solid) -> None:
    """Add a traffic cone."""
    solid.box((-0.2, -0.2, 0), (0.2, 0.2, 0.04), M.WARNING_ORANGE)
    bands = (M.WARNING_ORANGE, M.SECOND_PAINT, M.WARNING_ORANGE, M.SECOND_PAINT, M.WARNING_ORANGE)
    profile = ((0.15, 0.04), (0.122, 0.2), (0.096, 0.34), (0.072, 0.48), (0.05, 0.6), (0.028, 0.72))
    _turned(solid, profile, lambda i, _: bands[min(max(i, 0), 4)])


@model
def barrier(solid: Solid) -> None:
    """Add a barrier across the road, with stripes."""
    for y in (-0.5, 0.5):
        solid.box((-0.2, y - 0.04, 0), (0.2, y + 0.04, 0.06), M.TRIM)
        solid.box((-0.03, y - 0.03, 0.06), (0.03, y + 0.03, 1.0), M.SECOND_PAINT)
    for z in (0.45, 0.78):
        for i in range(6):
            y = -0.6 + i * 0.2
            solid.box((-0.05, y, z), (0.05, y + 0.2, z + 0.2), M.PAINT if i % 2 == 0 else M.SECOND_PAINT)


@model
def chain_barrier(solid: Solid) -> None:
    """Add posts with a chain between them."""
    for y in (-0.66, 0.66):
        solid.limb((0, y, 0), (0, y, 0.86), (0.05, 0.05), M.PAINT, sides=8)
        solid.limb((0, y, 0.5), (0, y, 0.66), (0.052, 0.052), M.SECOND_PAINT, sides=8)
        solid.box((-0.11, y - 0.11, 0), (0.11, y + 0.11, 0.04), M.TRIM)
    points = [(0.0, y, 0.8 - 0.22 * (1 - (y / 0.66) ** 2)) for y in (-0.66, -0.4, 0.0, 0.4, 0.66)]
    for start, stop in itertools.pairwise(points):
        solid.limb(start, stop, (0.02, 0.02), M.CHROME, sides=4)


@model
def cardboard_box(solid: Solid) -> None:
    """Add a cardboard box with tape."""
    solid.box((-0.5, -0.5, 0), (0.5, 0.5, 1), M.PAINT)
    solid.facet(((-0.5, -0.07, 1.002), (0.5, -0.07, 1.002), (0.5, 0.07, 1.002), (-0.5, 0.07, 1.002)), M.WOOD)


@model
def barrel(solid: Solid) -> None:
    """Add a barrel with hoops."""
    profile = (
        (0.29, 0),
        (0.3, 0.05),
        (0.29, 0.07),
        (0.3, 0.3),
        (0.31, 0.33),
        (0.3, 0.36),
        (0.3, 0.6),
        (0.31, 0.63),
        (0.3, 0.66),
        (0.29, 0.9),
    )
    _turned(solid, profile, M.PAINT, sides=12)


@model
def bin_(solid: Solid) -> None:
    """Add a bin with a lid."""
    solid.box((-0.24, -0.24, 0), (0.24, 0.24, 0.85), M.PAINT, top=(1.14, 1.14))
    solid.box((-0.3, -0.3, 0.85), (0.3, 0.3, 0.93), M.TRIM)
    solid.box((-0.27, -0.27, 0.93), (0.27, 0.27, 1.0), M.PAINT, top=(0.6, 0.8))


@model
def bag(solid: Solid) -> None:
    """Add a bag that is tied at the top."""
    _turned(solid, ((0.22, 0), (0.3, 0.12), (0.29, 0.3), (0.18, 0.5), (0.05, 0.58), (0.09, 0.66)), M.PAINT, sides=8)


@model
def bench(solid: Solid) -> None:
    """Add a bench; its front is in the direction of x."""
    for y in (-0.6, 0.6):
        solid.box((-0.25, y - 0.03, 0), (-0.2, y + 0.03, 0.9), M.TRIM)
        solid.box((0.18, y - 0.03, 0), (0.23, y + 0.03, 0.44), M.TRIM)
        solid.box((-0.22, y - 0.03, 0.38), (0.22, y + 0.03, 0.44), M.TRIM)
    for x in (-0.18, -0.02, 0.14):
        solid.box((x - 0.06, -0.77, 0.44), (x + 0.07, 0.77, 0.48), M.PAINT)
    for z in (0.6, 0.78):
        solid.box((-0.2, -0.77, z), (-0.16, 0.77, z + 0.12), M.PAINT)


@model
def table(solid: Solid) -> None:
    """Add a table."""
    _turned(solid, ((0.6, 0.72), (0.62, 0.74), (0.6, 0.77)), M.PAINT, sides=12)
    solid.limb((0, 0, 0.02), (0, 0, 0.73), (0.05, 0.04), M.TRIM)
    solid.box((-0.3, -0.3, 0), (0.3, 0.3, 0.04), M.TRIM)


@model
def chair(solid: Solid) -> None:
    """Add a chair; its front is in the direction of x."""
    for x in (-0.2, 0.2):
        for y in (-0.2, 0.2):
            solid.limb((x * 1.15, y * 1.15, 0), (x, y, 0.44), (0.02, 0.025), M.PAINT, sides=4)
    solid.box((-0.24, -0.24, 0.43), (0.24, 0.24, 0.47), M.PAINT)
    solid.box((-0.26, -0.24, 0.47), (-0.22, 0.24, 0.92), M.PAINT, top=(1.0, 0.85))
    for y in (-0.25, 0.25):
        solid.box((-0.24, y - 0.025, 0.64), (0.18, y + 0.025, 0.68), M.PAINT)


@model
def case(solid: Solid) -> None:
    """Add a travelling case with a handle."""
    solid.box((-0.14, -0.24, 0.04), (0.14, 0.24, 0.72), M.PAINT, top=(0.9, 0.94))
    for y in (-0.12, 0.12):
        solid.limb((-0.08, y, 0.7), (-0.08, y, 1.0), (0.012, 0.012), M.CHROME, sides=4)
    solid.limb((-0.08, -0.13, 1.0), (-0.08, 0.13, 1.0), (0.02, 0.02), M.TRIM, sides=4)
    for y in (-0.18, 0.18):
        solid.box((-0.13, y - 0.03, 0), (0.13, y + 0.03, 0.05), M.TYRE)


@model
def plant(solid: Solid) -> None:
    """Add a plant in a pot."""
    _turned(solid, ((0.16, 0), (0.22, 0.26), (0.2, 0.28)), M.PAINT, sides=8)
    for x, y, z, radius in (
        (0.0, 0.0, 0.42, 0.19),
        (0.12, 0.07, 0.36, 0.13),
        (-0.1, 0.1, 0.38, 0.13),
        (0.0, -0.13, 0.36, 0.13),
    ):
        solid.ball((x, y, z), (radius, radius, radius), M.FOLIAGE, sides=7, rings=4)


@model
def tree(solid: Solid) -> None:
    """Add a tree with leaves."""
    solid.limb((0, 0, 0), (0.1, 0, 2.6), (0.24, 0.16), M.WOOD, sides=7)
    for x, y, z, radius in (
        (0.1, 0, 4.1, 1.7),
        (1.0, 0.4, 3.4, 1.2),
        (-0.9, 0.5, 3.5, 1.25),
        (0.1, -1.0, 3.4, 1.2),
        (0.0, 0.9, 3.3, 1.1),
    ):
        solid.ball((x, y, z), (radius, radius, radius * 0.85), M.FOLIAGE, sides=8, rings=5)


@model
def conifer(solid: Solid) -> None:
    """Add a slender conifer."""
    solid.limb((0, 0, 0), (0, 0, 1.2), (0.16, 0.14), M.WOOD)
    _turned(solid, ((0.7, 0.8), (1.0, 2.0), (0.95, 4.0), (0.6, 6.4), (0.05, 8.2)), M.FOLIAGE, sides=9)


@model
def palm(solid: Solid) -> None:
    """Add a palm."""
    solid.limb((0, 0, 0), (0.3, 0, 6.4), (0.24, 0.18, 0.14), M.WOOD, sides=7)
    for i in range(9):
        angle = 2 * pi * i / 9
        forward, across = (cos(angle), sin(angle)), (-sin(angle), cos(angle))
        rows = [(0.1, 6.4, 0.1), (1.1, 6.9, 0.32), (2.1, 6.5, 0.26), (2.8, 5.6, 0.03)]
        for (d0, z0, w0), (d1, z1, w1) in itertools.pairwise(rows):
            corners = [
                (0.3 + forward[0] * d + across[0] * w, forward[1] * d + across[1] * w, z)
                for d, z, w in ((d0, z0, -w0), (d1, z1, -w1), (d1, z1, w1), (d0, z0, w0))
            ]
            solid.facet(corners, M.FOLIAGE)
            solid.facet(corners[::-1], M.FOLIAGE)


@model
def board(solid: Solid) -> None:
    """Add an upright board on two feet; it faces x."""
    for y in (-0.5, 0.5):
        solid.box((-0.05, y - 0.04, 0), (0.05, y + 0.04, 2.0), M.TRIM)
    solid.box((-0.06, -0.65, 0.75), (0.06, 0.65, 2.2), M.PAINT)
    for x in (-0.064, 0.064):
        corners = [(x, y, z) for y, z in ((-0.58, 0.82), (0.58, 0.82), (0.58, 2.13), (-0.58, 2.13))]
        solid.facet(corners if x > 0 else corners[::-1], M.SECOND_PAINT)


@model
def warning_board(solid: Solid) -> None:
    """Add a triangle of warning on a stand, which faces x."""
    for y in (-0.45, 0.45):
        solid.box((-0.4, y - 0.05, 0), (0.4, y + 0.05, 0.07), M.TRIM)
        solid.box((-0.05, y - 0.04, 0.07), (0.05, y + 0.04, 0.8), M.TRIM)
    for share, x, material in ((1.0, 0.05, M.RED_BAND), (0.72, 0.056, M.SECOND_PAINT)):
        points = [(0.62 * share * y, 1.2 + up * 0.62 * share) for y, up in ((-1.0, -0.6), (1.0, -0.6), (0.0, 1.1))]
        solid.loft([[(-x, y, z) for y, z in points], [(x, y, z) for y, z in points]], material)
    solid.box((-0.06, -0.05, 1.1), (0.06, 0.05, 1.42), M.TRIM)
    solid.box((-0.06, -0.05, 0.95), (0.06, 0.05, 1.04), M.TRIM)


@model
def shelter(solid: Solid) -> None:
    """Add a shelter with a roof, open to x."""
    for x, y in ((-0.8, -1.8), (-0.8, 1.8), (0.7, -1.8), (0.7, 1.8)):
        solid.box((x - 0.05, y - 0.05, 0), (x + 0.05, y + 0.05, 2.5), M.PAINT)
    solid.box((-0.9, -1.9, 2.5), (0.95, 1.9, 2.65), M.PAINT)
    solid.box((-0.82, -1.75, 0.3), (-0.78, 1.75, 2.3), M.GLASS)
    solid.box((-0.7, -1.2, 0.4), (-0.3, 1.2, 0.46), M.WOOD)


@model
def debris(solid: Solid) -> None:
    """Add a low heap."""
    for x, y, length, width, height in (
        (0.0, 0.0, 0.50, 0.42, 0.13),
        (0.46, 0.24, 0.26, 0.18, 0.08),
        (-0.46, -0.2, 0.28, 0.2, 0.09),
        (0.22, -0.38, 0.2, 0.14, 0.07),
        (-0.26, 0.38, 0.22, 0.15, 0.08),
        (0.62, -0.22, 0.1, 0.1, 0.05),
        (-0.62, 0.22, 0.1, 0.1, 0.05),
    ):
        outline = [(cos(2 * pi * i / 7), sin(2 * pi * i / 7)) for i in range(7)]
        rings = [
            [(x + a * length * s, y + b * width * s, z) for a, b in outline]
            for s, z in ((1.0, 0.0), (0.8, height * 0.6), (0.3, height))
        ]
        solid.loft(rings, M.PAINT)


@model
def fountain(solid: Solid) -> None:
    """Add a fountain with two basins."""
    _turned(
        solid,
        (
            (1.0, 0),
            (1.05, 0.35),
            (0.9, 0.36),
            (0.88, 0.26),
            (0.14, 0.26),
            (0.1, 0.8),
            (0.45, 0.95),
            (0.42, 1.0),
            (0.06, 1.0),
            (0.05, 1.3),
        ),
        M.PAINT,
        sides=14,
    )


@model
def cabinet(solid: Solid) -> None:
    """Add a cabinet or a vending machine, which faces x."""
    solid.box((-0.42, -0.5, 0.06), (0.42, 0.5, 2.0), M.PAINT)
    solid.box((-0.4, -0.48, 0), (0.4, 0.48, 0.06), M.TRIM)
    solid.facet([(0.424, y, z) for y, z in ((-0.42, 0.7), (0.2, 0.7), (0.2, 1.85), (-0.42, 1.85))], M.GLASS)
    solid.facet([(0.424, y, z) for y, z in ((-0.42, 0.22), (0.2, 0.22), (0.2, 0.5), (-0.42, 0.5))], M.TRIM)
    solid.facet([(0.424, y, z) for y, z in ((0.27, 1.0), (0.42, 1.0), (0.42, 1.6), (0.27, 1.6))], M.SECOND_PAINT)


@model
def figure(solid: Solid) -> None:
    """Add a garden gnome."""
    _turned(solid, ((0.14, 0), (0.17, 0.2), (0.1, 0.42)), M.PAINT, sides=8)
    solid.ball((0, 0, 0.5), (0.1, 0.1, 0.11), M.SKIN, sides=8, rings=4)
    _turned(solid, ((0.12, 0.54), (0.0, 0.88)), M.RED_BAND, sides=8)
