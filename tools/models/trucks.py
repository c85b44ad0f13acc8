"""Trucks: a cab, a chassis, and what it carries."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from carla_recap.scene.materials import Material
from tools.models.cars import SUV, VAN, CarShape, axle, beacons, car, plate
from tools.models.solid import Solid, model

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tools.models.solid import Point

M: Final = Material

CAB: Final = replace(
    SUV,
    name="cab",
    length=2.25,
    width=2.46,
    axles=(1.32,),
    wheel=0.5,
    clearance=0.42,
    deck=((0.0, 1.42), (0.08, 1.52), (2.25, 1.55)),
    cabin=(0.06, 2.24, 0.26, 2.2),
    roof=2.75,
    pillars=(0.62,),
    glazed=0.66,
    narrowing=0.06,
    corner=0.16,
    lamp=(0.3, 0.12),
    tail=False,
)


def _truck(solid: Solid, shape: CarShape, length: float, rear_axles: Sequence[float]) -> None:
    """Add a truck of a length in m: a cab at the front of a chassis, whose rear axles are at distances from its front."""
    cab = Solid()
    car(cab, shape)
    solid.add(cab, ((length - shape.length) / 2, 0, 0))
    front = length / 2
    height = shape.wheel + 0.32
    solid.box((-front + 0.1, -0.42, shape.wheel), (front - shape.length + 0.3, 0.42, height), M.TRIM)
    for distance in rear_axles:
        axle(solid, front - distance, shape.width / 2 - 0.04, shape.wheel, 0.5)
    _tail(solid, -front, shape.wheel + 0.1, shape.width / 2)


def _tail(solid: Solid, x: float, z: float, half: float) -> None:
    """Add the rear bumper with its lamps."""
    solid.box((x, -half + 0.1, z), (x + 0.12, half - 0.1, z + 0.22), M.TRIM)
    left = Solid()
    for start, stop, material in (
        (0.74, 0.88, M.LEFT_INDICATOR),
        (0.60, 0.74, M.TAIL_LIGHT),
        (0.46, 0.60, M.BRAKE_LIGHT),
        (0.36, 0.46, M.REVERSE_LIGHT),
    ):
        y0, y1 = half * start, half * stop
        corners = ((x - 0.01, y1, z + 0.04), (x - 0.01, y0, z + 0.04), (x - 0.01, y0, z + 0.18), (x - 0.01, y1, z + 0.18))
        left.facet(corners, material)
    solid.add_both(left)
    plate(solid, x - 0.012, z + 0.11, -1)


def _body(solid: Solid, low: Point, high: Point) -> None:
    """Add a closed body with a band of paint along its sides, and doors at its rear."""
    solid.box(low, high, M.SECOND_PAINT)
    (rear, _, bottom), (front, half, top) = low, high
    edge, back = half + 0.004, rear - 0.004
    height = top - bottom
    left = Solid()
    for start, stop, material in ((0.0, 0.05, M.TRIM), (0.3, 0.52, M.PAINT)):
        z0, z1 = bottom + start * height, bottom + stop * height
        left.facet(((front, edge, z0), (rear, edge, z0), (rear, edge, z1), (front, edge, z1)), material)
    for y0, y1 in ((0.0, 0.012), (0.34, 0.38), (half - 0.08, half)):
        left.facet(((back, y1, bottom), (back, y0, bottom), (back, y0, top), (back, y1, top)), M.RIM)
    solid.add_both(left)


@model
def box_truck(solid: Solid) -> None:
    """Add a truck with a closed body."""
    shape = replace(CAB, length=1.9, width=2.2, wheel=0.42, roof=2.2, axles=(1.1,), clearance=0.34)
    shape = replace(shape, deck=((0.0, 1.12), (0.08, 1.2), (1.9, 1.24)), cabin=(0.06, 1.88, 0.36, 1.84))
    _truck(solid, shape, 5.6, (4.4,))
    _body(solid, (-2.8, -1.15, 0.78), (0.84, 1.15, 2.62))


@model
def lorry(solid: Solid) -> None:
    """Add a lorry: a high cab, a long body, three axles."""
    _truck(solid, replace(CAB, roof=3.3), 8.2, (5.7, 7.0))
    _body(solid, (-4.1, -1.25, 1.0), (1.75, 1.25, 3.45))
    for side in (-1, 1):
        solid.box((-0.6, side * 1.05 - 0.12, 0.5), (1.0, side * 1.05 + 0.12, 0.95), M.TRIM)


@model
def fire_engine(solid: Solid) -> None:
    """Add a fire engine: a crew cab, lockers with shutters, a ladder and beacons."""
    length, cab = 8.4, 3.2
    shape = replace(CAB, length=cab, axles=(1.4,), roof=2.85, pillars=(0.32, 0.4, 0.7), glazed=0.75, lamp=(0.32, 0.12))
    shape = replace(shape, deck=((0.0, 1.42), (0.08, 1.52), (cab, 1.55)), cabin=(0.06, cab - 0.01, 0.24, cab - 0.05))
    _truck(solid, shape, length, (6.1,))
    low, rear, front = 1.06, -length / 2, length / 2 - cab - 0.06
    solid.box((rear, -1.23, low), (front, 1.23, 2.9), M.PAINT)
    solid.box((rear - 0.004, -1.236, low + 0.02), (front + 0.004, 1.236, low + 0.24), M.YELLOW_BAND)
    for x0, x1 in ((rear + 0.25, rear + 1.2), (-1.5, -0.25), (-0.1, front - 0.2)):
        left = Solid()
        top = 2.55
        left.facet(((x1, 1.242, 1.42), (x0, 1.242, 1.42), (x0, 1.242, top), (x1, 1.242, top)), M.RIM)
        solid.add_both(left)
    solid.facet([(rear - 0.006, y, z) for y, z in ((0.8, 1.42), (-0.8, 1.42), (-0.8, 2.55), (0.8, 2.55))], M.RIM)
    for x0, x1 in ((0.15, front - 0.2), (rear + 0.3, -0.9)):
        solid.box((x0, -1.15, 0.5), (x1, 1.15, low), M.PAINT)
    for y in (-0.35, 0.35):
        solid.box((rear + 0.1, y - 0.05, 3.02), (front + 0.9, y + 0.05, 3.14), M.CHROME)
    for number in range(9):
        x = rear + 0.35 + number * 0.68
        solid.box((x, -0.33, 3.04), (x + 0.06, 0.33, 3.1), M.CHROME)
    for x in (rear + 0.5, front - 0.4):
        solid.box((x, -0.45, 2.88), (x + 0.08, 0.45, 3.03), M.TRIM)
    beacons(solid, length / 2 - 0.75, 2.83, 1.0)


@model
def ambulance(solid: Solid) -> None:
    """Add an ambulance: a van's cab and a high body with stripes."""
    length = 6.3
    shape = replace(VAN, length=2.9, axles=(0.98,), cabin=(1.0, 2.8, 1.6, 2.8), roof=2.05, pillars=(0.72,), glazed=0.75)
    shape = replace(
        shape, deck=((0.0, 0.86), (0.12, 0.98), (0.5, 1.08), (1.0, 1.2), (2.9, 1.24)), wheel=0.38, width=2.0, tail=False
    )
    _truck(solid, shape, length, (4.95,))
    rear, front = -length / 2, length / 2 - 2.6
    solid.box((rear, -1.14, 0.62), (front, 1.14, 2.55), M.PAINT)
    solid.box((rear + 0.02, -1.02, 2.5), (front - 0.05, 1.02, 2.62), M.PAINT)
    solid.box((rear - 0.004, -1.146, 1.2), (front + 0.004, 1.146, 1.42), M.RED_BAND)
    for y in (-0.5, 0.5):
        corners = ((y + 0.32, 1.6), (y - 0.32, 1.6), (y - 0.32, 2.2), (y + 0.32, 2.2))
        solid.facet([(rear - 0.006, across, z) for across, z in corners], M.GLASS)
    for x, y0, y1 in (
        (front - 0.06, -1.0, -0.45),
        (front - 0.06, 0.45, 1.0),
        (rear - 0.01, -1.05, -0.75),
        (rear - 0.01, 0.75, 1.05),
    ):
        solid.box((x, y0, 2.38), (x + 0.07, y1, 2.5), M.BEACON)
    beacons(solid, length / 2 - 1.95, 2.03, 0.6)


@model
def pickup(solid: Solid) -> None:
    """Add a pickup with a bed."""
    shape = replace(
        SUV,
        name="pickup",
        length=5.8,
        width=2.02,
        axles=(1.05, 4.6),
        wheel=0.42,
        clearance=0.36,
        deck=((0.0, 1.0), (0.12, 1.08), (0.4, 1.14), (1.6, 1.24), (5.6, 1.3), (5.8, 1.26)),
        cabin=(1.55, 3.95, 2.2, 3.6),
        roof=1.98,
        pillars=(0.5,),
    )
    car(solid, shape)
    solid.facet([(x, y, 1.325) for x, y in ((-2.75, -0.75), (-1.15, -0.75), (-1.15, 0.75), (-2.75, 0.75))], M.TRIM)
