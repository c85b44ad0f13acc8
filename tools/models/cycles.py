"""Motorcycles, scooters and bicycles with their riders."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from carla_recap.scene.materials import Material
from tools.models.solid import Solid, model

if TYPE_CHECKING:
    from tools.models.solid import Point

M: Final = Material


class RiderJoints(NamedTuple):
    """Where the joints of a rider are, in m: of those that there are two of, those of the left side."""

    hip: Point
    knee: Point
    foot: Point
    shoulder: Point
    elbow: Point
    hand: Point
    head: Point


def _rider(solid: Solid, pose: RiderJoints) -> None:
    left = Solid()
    left.bent_limb((pose.hip, pose.knee, pose.foot), (0.10, 0.078, 0.05), M.RIDER_TROUSERS, sides=5)
    x, y, z = pose.foot
    left.box((x - 0.09, y - 0.05, z - 0.06), (x + 0.16, y + 0.05, z + 0.03), M.RIDER_TROUSERS, top=(0.7, 0.8))
    left.bent_limb((pose.shoulder, pose.elbow, pose.hand), (0.066, 0.052, 0.04), M.RIDER_CLOTHES, sides=5)
    left.ball(pose.hand, (0.055, 0.045, 0.045), M.RIDER_SKIN, sides=5, rings=3)
    solid.add_both(left)
    hip, shoulder = pose.hip, pose.shoulder
    middle = ((hip[0] + shoulder[0]) / 2 - 0.03, 0.0, (hip[2] + shoulder[2]) / 2)
    lean = 0.05
    rings = []
    for x, z, depth, width in (
        (hip[0] - 0.01, hip[2] - 0.08, 0.12, 0.16),
        (hip[0], hip[2] + 0.06, 0.125, 0.17),
        (middle[0], middle[2], 0.115, 0.165),
        (shoulder[0] - lean * 0.3, shoulder[2] - 0.03, 0.115, 0.20),
        (shoulder[0], shoulder[2] + 0.06, 0.06, 0.09),
    ):
        outline = ((1, 0.4), (0.4, 1), (-0.4, 1), (-1, 0.4), (-1, -0.4), (-0.4, -1), (0.4, -1), (1, -0.4))
        rings.append([(x + forward * depth, across * width, z) for forward, across in outline])
    solid.loft(rings, lambda i, _: M.RIDER_TROUSERS if i < 1 else M.RIDER_CLOTHES)
    x, y, z = pose.head
    solid.limb((shoulder[0], 0, shoulder[2] + 0.02), (x, 0, z - 0.06), (0.055, 0.05), M.RIDER_SKIN, sides=5, caps=False)

    def face(i: int, j: int) -> Material:
        return M.RIDER_SKIN if i in (1, 2) and j in (0, 7) else M.RIDER_HELMET if i >= 2 else M.RIDER_SKIN

    solid.ball((x, y, z), (0.125, 0.105, 0.14), face, sides=8, rings=6)


def _wheel(solid: Solid, x: float, radius: float, width: float, *, spokes: Material | None) -> None:
    """Add a wheel in the middle plane; without spokes, one can see through it."""
    inner = radius * (0.68 if spokes is not None else 0.88)
    tyre = [(inner, -width / 2), (radius, -width / 4), (radius, width / 4), (inner, width / 2)]
    if spokes is None:
        ring = [*tyre, tyre[0]]
        solid.tube(ring, (x, 0, radius), lambda i, _: M.RIM if i == 3 else M.TYRE, sides=14, caps=False)
        solid.limb((x, -0.05, radius), (x, 0.05, radius), (0.035, 0.035), M.CHROME, sides=5)
        return

    def material(i: int, j: int) -> Material:
        return M.TYRE if 0 < i < 4 else spokes if j % 2 == 0 else M.TRIM

    disc = [(0.0, -width * 0.3), *tyre, (0.0, width * 0.3)]
    solid.tube(disc, (x, 0, radius), material, sides=12, caps=False)


@model
def motorcycle(solid: Solid) -> None:
    """Add a motorcycle with its rider."""
    with solid.steered(0.72, 0.0):
        _wheel(solid, 0.72, 0.31, 0.12, spokes=M.RIM)
        for y in (-0.09, 0.09):
            solid.limb((0.72, y, 0.31), (0.47, y, 0.88), (0.028, 0.032), M.CHROME, sides=5)
        solid.box((0.6, -0.07, 0.62), (0.86, 0.07, 0.66), M.PAINT)
    _wheel(solid, -0.70, 0.31, 0.16, spokes=M.RIM)
    rings = [
        [(x, y * width, z + up * height) for y, up in ((1, 0), (0.6, 1), (-0.6, 1), (-1, 0), (-0.6, -1), (0.6, -1))]
        for x, z, width, height in (
            (-0.98, 0.84, 0.04, 0.03),
            (-0.62, 0.76, 0.12, 0.07),
            (-0.16, 0.70, 0.15, 0.09),
            (0.04, 0.82, 0.17, 0.15),
            (0.36, 0.86, 0.16, 0.14),
            (0.52, 0.84, 0.13, 0.14),
            (0.66, 0.82, 0.07, 0.08),
        )
    ]
    solid.loft(rings, lambda i, j: M.TRIM if i in (1, 2) and j in (0, 1, 2) else M.PAINT)
    solid.box((-0.28, -0.14, 0.26), (0.36, 0.14, 0.66), M.TRIM, top=(0.8, 0.8))
    solid.box((-0.72, -0.05, 0.30), (-0.2, 0.05, 0.42), M.CHROME)
    solid.limb((0.2, -0.16, 0.30), (-0.85, -0.19, 0.42), (0.035, 0.06), M.CHROME, sides=6)
    solid.ball((0.68, 0, 0.86), (0.06, 0.10, 0.09), M.HEADLIGHT, sides=8, rings=4)
    solid.box((0.5, -0.13, 0.96), (0.62, 0.13, 1.14), M.GLASS, top=(0.3, 0.7))
    solid.limb((0.44, -0.36, 1.0), (0.44, 0.36, 1.0), (0.02, 0.02), M.TRIM, sides=5)
    _bike_lamps(solid, 0.64, -1.0, 0.84)
    _mirrors(solid, 0.46, 1.0)
    pose = RiderJoints(
        (-0.28, 0.1, 0.86),
        (0.12, 0.2, 0.62),
        (-0.18, 0.2, 0.32),
        (-0.02, 0.19, 1.32),
        (0.16, 0.30, 1.08),
        (0.42, 0.30, 1.02),
        (0.10, 0, 1.54),
    )
    _rider(solid, pose)


@model
def scooter(solid: Solid) -> None:
    """Add a scooter with its rider."""
    with solid.steered(0.62, 0.0):
        _wheel(solid, 0.62, 0.23, 0.10, spokes=M.RIM)
        solid.limb((0.62, 0, 0.23), (0.42, 0, 0.98), (0.045, 0.05), M.PAINT, sides=6)
        solid.box((0.5, -0.07, 0.42), (0.78, 0.07, 0.5), M.PAINT, top=(0.8, 0.8))
    _wheel(solid, -0.6, 0.23, 0.10, spokes=M.RIM)
    shield = [
        [(x, y * width, z) for x, y in ((0.47 + lean, 1), (0.44 + lean, 1), (0.44 + lean, -1), (0.47 + lean, -1))]
        for z, lean, width in ((0.28, 0.03, 0.16), (0.55, 0.04, 0.21), (0.92, -0.04, 0.14))
    ]
    solid.loft(shield, M.PAINT)
    solid.box((-0.1, -0.16, 0.22), (0.48, 0.16, 0.29), M.TRIM)
    body = [
        [
            (x, y * width, z)
            for x, y in (
                (front, 0.7),
                (0.5 * (front + back), 1),
                (back, 0.4),
                (back, -0.4),
                (0.5 * (front + back), -1),
                (front, -0.7),
            )
        ]
        for z, front, back, width in ((0.24, -0.08, -0.5, 0.14), (0.48, -0.1, -0.86, 0.20), (0.70, -0.08, -0.84, 0.15))
    ]
    solid.loft(body, M.PAINT)
    solid.box((-0.76, -0.14, 0.69), (-0.04, 0.14, 0.79), M.TRIM, top=(0.9, 0.8))
    solid.limb((0.40, -0.33, 1.0), (0.40, 0.33, 1.0), (0.022, 0.022), M.TRIM, sides=5)
    solid.ball((0.46, 0, 0.98), (0.08, 0.09, 0.09), lambda i, j: M.HEADLIGHT if j in (0, 7) else M.PAINT, sides=8, rings=4)
    _bike_lamps(solid, 0.5, -0.87, 0.56)
    _mirrors(solid, 0.40, 1.0)
    pose = RiderJoints(
        (-0.36, 0.1, 0.86),
        (0.08, 0.16, 0.74),
        (0.16, 0.13, 0.34),
        (-0.26, 0.19, 1.34),
        (0.0, 0.27, 1.10),
        (0.36, 0.28, 1.04),
        (-0.20, 0, 1.56),
    )
    _rider(solid, pose)


def _bike_lamps(solid: Solid, front: float, rear: float, z: float) -> None:
    left = Solid()
    for x, y in ((front, 0.17), (rear + 0.06, 0.13)):
        left.ball((x, y, z), (0.035, 0.035, 0.03), M.LEFT_INDICATOR, sides=5, rings=3)
        left.limb((x, 0.02, z), (x, y, z), (0.012, 0.012), M.TRIM, sides=4)
    solid.add_both(left)
    solid.box((rear - 0.02, -0.07, z - 0.035), (rear + 0.04, 0.07, z), M.TAIL_LIGHT)
    solid.box((rear - 0.02, -0.07, z), (rear + 0.04, 0.07, z + 0.035), M.BRAKE_LIGHT)


def _mirrors(solid: Solid, x: float, z: float) -> None:
    left = Solid()
    left.limb((x, 0.24, z), (x + 0.02, 0.32, z + 0.15), (0.01, 0.01), M.TRIM, sides=4)
    left.box((x, 0.27, z + 0.13), (x + 0.03, 0.39, z + 0.21), M.TRIM)
    solid.add_both(left)


@model
def bicycle(solid: Solid) -> None:
    """Add a bicycle with its rider."""
    front, rear, radius = 0.52, -0.52, 0.34
    with solid.steered(front, 0.0):
        _wheel(solid, front, radius, 0.05, spokes=None)
        for y in (-0.045, 0.045):
            solid.limb((front, y, radius), (0.40, y * 0.6, 0.72), (0.013, 0.016), M.PAINT, sides=4)
        solid.limb((0.40, 0, 0.70), (0.35, 0, 1.0), (0.02, 0.02), M.PAINT, sides=5)
        solid.limb((0.36, -0.28, 1.02), (0.36, 0.28, 1.02), (0.016, 0.016), M.TRIM, sides=4)
    _wheel(solid, rear, radius, 0.05, spokes=None)
    seat, crank = (-0.22, 0.0, 0.86), (-0.08, 0.0, 0.28)
    tubes = [((0.37, 0, 0.84), seat), ((0.39, 0, 0.72), crank), (seat, crank)]
    for start, stop in tubes:
        solid.limb(start, stop, (0.02, 0.02), M.PAINT, sides=5)
    for y in (-0.05, 0.05):
        solid.limb((rear, y, radius), (crank[0], y * 0.5, crank[2]), (0.012, 0.012), M.PAINT, sides=4)
        solid.limb((rear, y, radius), (seat[0], 0, seat[2] - 0.06), (0.012, 0.012), M.PAINT, sides=4)
    solid.box((-0.36, -0.07, 0.90), (-0.10, 0.07, 0.95), M.TRIM, top=(0.9, 0.7))
    solid.limb((crank[0], -0.07, crank[2]), (crank[0], -0.055, crank[2]), (0.09, 0.09), M.CHROME, sides=8)
    solid.box((0.37, -0.03, 0.86), (0.42, 0.03, 0.92), M.HEADLIGHT)
    solid.box((rear - 0.1, -0.025, 0.72), (rear - 0.07, 0.025, 0.78), M.TAIL_LIGHT)
    solid.limb((rear, 0, radius * 2), (rear - 0.085, 0, 0.75), (0.01, 0.01), M.TRIM, sides=4)
    pose = RiderJoints(
        (-0.22, 0.08, 0.98),
        (0.14, 0.11, 0.74),
        (-0.02, 0.12, 0.30),
        (0.02, 0.18, 1.40),
        (0.18, 0.27, 1.18),
        (0.36, 0.25, 1.05),
        (0.10, 0, 1.60),
    )
    _rider(solid, pose)
