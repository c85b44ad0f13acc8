"""Passenger cars: a body between cross-sections, a cabin of glass, wheels, lamps and mirrors."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import partial
from math import sqrt
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.scene.materials import Material
from tools.models.solid import Solid, model

if TYPE_CHECKING:
    from tools.models.solid import Floats

M: Final = Material
Profile = tuple[tuple[float, float], ...]
"""Distances behind the front end in m, and the value at each."""


@dataclass(frozen=True)
class CarShape:
    """The measures of a car in m; along its length, they are distances behind the front end.

    Attributes:
        name: The name of the model.
        length: The length of the body.
        width: The width of the body without mirrors.
        axles: The front and the rear axle.
        wheel: The radius of the wheels.
        clearance: The height of the sills.
        deck: The height of the bonnet, of the belt line, and of the tail.
        cabin: The cabin: front and rear at the belt line, front and rear of the roof.
        roof: The height of the roof.
        waist: How far above the sills the doors are widest, as a share of their height.
        narrowing: How much narrower the roof is than the belt line, on each side.
        pillars: The pillars between the side windows, as shares of the cabin's length.
        corner: How round the front and the rear are in plan: the length of the corners.
        paint: The material of the body.
        roof_paint: The material of the roof.
        lamp: The height of the head lamps and of the tail lamps.
        glazed: The share of the cabin's length that has side windows; of 0.9, the rear has one, too.
        doors: The material of the doors.
        tail: Whether it has tail lamps; the cab of a truck has none.
        sill: The height of the dark sills, of the rims of the wheel arches, and of the bottom of the bumpers.
    """

    name: str
    length: float
    width: float
    axles: tuple[float, ...]
    wheel: float
    clearance: float
    deck: Profile
    cabin: tuple[float, float, float, float]
    roof: float
    waist: float = 0.62
    narrowing: float = 0.2
    pillars: tuple[float, ...] = (0.47,)
    corner: float = 0.34
    paint: Material = M.PAINT
    roof_paint: Material = M.PAINT
    lamp: tuple[float, float] = (0.16, 0.17)
    glazed: float = 0.9
    doors: Material = M.PAINT
    tail: bool = True
    sill: float = 0.07


def car(solid: Solid, shape: CarShape) -> None:
    """Add a car."""
    _body(solid, shape)
    _cabin(solid, shape)
    y = shape.width / 2 - 0.015
    for number, distance in enumerate(shape.axles):
        axle(solid, shape.length / 2 - distance, y, shape.wheel, 0.12 * shape.width, steered=number == 0)
    _details(solid, shape)


def _at(profile: Profile, distance: float) -> float:
    distances, values = zip(*profile, strict=True)
    return float(np.interp(distance, distances, values))


def _stations(shape: CarShape) -> list[float]:
    """Return where the cross-sections are, from the rear to the front."""
    radius, corner = shape.wheel + 0.05, shape.corner
    arches = [axle + radius * share for axle in shape.axles for share in (-1, -0.97, -0.55, 0.55, 0.97, 1)]
    ends = [0.0, corner * 0.35, corner, shape.length - corner, shape.length - corner * 0.35, shape.length]
    first, last = ends[2], ends[3]
    return sorted({*ends, *(distance for distance in arches if first < distance < last)}, reverse=True)


def _arch(shape: CarShape, distance: float) -> float:
    """Return the height of the wheel arches at a distance; that of the sills elsewhere."""
    radius = shape.wheel + 0.05
    for axle in shape.axles:
        if abs(distance - axle) < radius * 0.999:
            return max(shape.clearance, shape.wheel + sqrt(max(radius**2 - (distance - axle) ** 2, 0.0)))
    return shape.clearance


def _body(solid: Solid, shape: CarShape) -> None:
    corner, length = shape.corner, shape.length
    plan: Profile = (
        (0.0, 0.70),
        (corner * 0.35, 0.86),
        (corner, 0.965),
        (3 * corner, 1.0),
        (length - 3 * corner, 1.0),
        (length - corner, 0.965),
        (length - corner * 0.35, 0.88),
        (length, 0.76),
    )
    rise: Profile = ((0.0, 0.07), (corner, 0.0), (length - corner, 0.02), (length, 0.10))
    front, rear = shape.lamp
    rings = []
    stations = _stations(shape)
    for station in stations:
        half = shape.width / 2 * _at(plan, station)
        deck = _at(shape.deck, station)
        low = _arch(shape, station) + _at(rise, station)
        shoulder = deck - _at(((0.0, 0.05), (corner, 0.07), (length - corner, 0.05), (length, 0.04)), station)
        band = _at(((0.0, front), (corner, front), (2 * corner, 0.22), (length - 2 * corner, 0.22), (length, rear)), station)
        middle = max(min(shoulder - band, shape.clearance + shape.waist * (deck - shape.clearance)), low + 0.015)
        shoulder = max(shoulder, middle + 0.02)
        inset = 0.13 if station not in (0.0, length) else 0.06
        sill = low + min(shape.sill, 0.4 * (middle - low))
        sides = (
            (half * 0.965, low),
            (half * 0.98, sill),
            (half, middle),
            (half * 0.975, shoulder),
            (half - inset, max(deck, shoulder + 0.01)),
        )
        x = length / 2 - station
        rings.append([(x, y, z) for y, z in sides] + [(x, -y, z) for y, z in reversed(sides)])
    distances = np.array(stations)

    def material(i: int, j: int) -> Material:
        if j in (0, 8, 9):
            return M.TRIM  # the sills, the rims of the wheel arches, and the underside
        nearest, farthest = sorted((distances[i], distances[i + 1]))
        if j in (1, 7) and nearest > shape.axles[0] and farthest < shape.axles[-1] and farthest - nearest > 0.8:
            return shape.doors
        if j in (2, 6):
            if farthest <= corner * 0.36:
                return M.HEADLIGHT
            if farthest <= corner * 1.01:
                return M.LEFT_INDICATOR if j == 2 else M.RIGHT_INDICATOR
            if nearest >= length - corner * 0.36 and shape.tail:
                return M.TAIL_LIGHT
        return shape.paint

    solid.loft(rings, material, caps=False)
    _end(solid, np.array(rings[-1]), shape, front=True)
    _end(solid, np.array(rings[0]), shape, front=False)


def _end(solid: Solid, ring: Floats, shape: CarShape, *, front: bool) -> None:
    """Add the front or the rear between the corners: bumper, grille and lamps in rows and columns."""
    rows = [(ring[j], ring[9 - j]) for j in range(5)]
    columns = (0.0, 0.26, 0.74, 1.0)  # from left to right
    paint = shape.paint
    if front:
        dark = (M.TRIM, M.TRIM, M.TRIM)
        table = (dark, (paint, paint, paint), (M.HEADLIGHT, M.TRIM, M.HEADLIGHT), (paint, paint, paint))
    else:
        lamps = (M.BRAKE_LIGHT, paint, M.BRAKE_LIGHT) if shape.tail else (paint, paint, paint)
        table = ((M.TRIM, M.TRIM, M.TRIM), (paint, paint, paint), lamps, (paint, paint, paint))
    for (low_left, low_right), (high_left, high_right), materials in zip(rows, rows[1:], table, strict=False):
        for start, stop, material in zip(columns, columns[1:], materials, strict=False):
            corners = [low_left + (low_right - low_left) * share for share in (start, stop)]
            corners += [high_left + (high_right - high_left) * share for share in (stop, start)]
            solid.facet(corners[::-1] if front else corners, material)


def _cabin(solid: Solid, shape: CarShape) -> None:
    front, rear, roof_front, roof_rear = (shape.length / 2 - distance for distance in shape.cabin)
    base = min(_at(shape.deck, shape.cabin[0]), _at(shape.deck, shape.cabin[1])) - 0.03
    half = shape.width / 2 - 0.12
    top = half - shape.narrowing
    edge = shape.roof - 0.07
    bow = 0.10
    share = (0.0, 0.045, *(pillar + side for pillar in shape.pillars for side in (-0.018, 0.018)), 0.90, 1.0)

    def ring(x0: float, x1: float, y: float, z: float, bow: float) -> list[tuple[float, float, float]]:
        left = [(x0 + (x1 - x0) * s, y - 0.05 * (abs(2 * s - 1) ** 3), z) for s in share]
        right = [(x, -y, z) for x, y, z in reversed(left)]
        return [*left, (x1 - bow * 0.6, 0.0, z), *right, (x0 + bow, 0.0, z)]

    lean = (edge - base) / max(shape.roof - base, 1e-6)
    rings = [
        ring(front, rear, half, base, bow),
        ring(
            front + (roof_front - front) * lean,
            rear + (roof_rear - rear) * lean,
            half - (half - top) * lean * 0.9,
            edge,
            bow,
        ),
        ring(roof_front - 0.12, roof_rear + 0.10, top - 0.08, shape.roof, bow * 0.8),
    ]
    columns = len(share)

    def material(i: int, j: int) -> Material:
        if i >= 1:
            return shape.roof_paint
        column = j if j < columns else 2 * columns - 1 - j  # of the left side; the same counted from the front on the right
        if j in (columns - 1, columns):
            return M.GLASS if shape.glazed >= 0.9 else shape.roof_paint
        if j == 2 * columns + 1 or j == 2 * columns:
            return M.GLASS
        if column == 0 or share[column + 1] > shape.glazed + 1e-6:
            return shape.roof_paint
        return M.TRIM if column % 2 == 0 else M.GLASS

    body = solid.loft(rings, material, caps=False)
    solid.facet(rings[-1], shape.roof_paint, body=body)


def wheel(solid: Solid, x: float, y: float, radius: float, width: float, *, sides: int = 10, rim: Material = M.RIM) -> None:
    """Add a wheel of the left side, with spokes, given its axle (x) and its outer side (y)."""
    profile = ((radius, -width), (radius, -width * 0.12), (radius * 0.68, 0.0), (0.0, -0.02))

    def material(i: int, j: int) -> Material:
        return M.TYRE if i < 2 else rim if j % 2 == 0 else M.TRIM

    solid.tube(profile, (x, y, radius), material, sides=sides)


def axle(
    solid: Solid, x: float, y: float, radius: float, width: float, *, steered: bool = False, rim: Material = M.RIM
) -> None:
    """Add the wheels of an axle at x, given the outer side of the left wheel (y)."""
    left = Solid()
    with left.steered(x, y - width / 2) if steered else nullcontext():
        wheel(left, x, y, radius, width, rim=rim)
    solid.add_both(left)


def _details(solid: Solid, shape: CarShape) -> None:
    """Add mirrors, door handles, number plates and the lamps that are not on the corners."""
    half, front, rear = shape.width / 2, shape.length / 2, -shape.length / 2
    belt = _at(shape.deck, shape.cabin[0])
    left = Solid()
    x = front - shape.cabin[0] - 0.28
    left.box((x - 0.07, half - 0.12, belt - 0.01), (x + 0.07, half + 0.06, belt + 0.12), M.TRIM, top=(0.8, 0.95))
    cabin = shape.cabin[1] - shape.cabin[0]
    for pillar in shape.pillars:
        if pillar < shape.glazed and len(shape.pillars) < 4:
            x = front - shape.cabin[0] - cabin * (pillar - 0.03)
            y = half + 0.004
            left.facet(
                ((x, y, belt - 0.16), (x + 0.17, y, belt - 0.16), (x + 0.17, y, belt - 0.12), (x, y, belt - 0.12))[::-1],
                M.TRIM,
            )
    z = _at(shape.deck, shape.length) - 0.075 - shape.lamp[1]
    back = rear - 0.006
    plate(solid, front + 0.008, shape.clearance + 0.14, 1)
    if not shape.tail:
        solid.add_both(left)
        return
    for start, stop, material in ((0.44, 0.72, M.LEFT_INDICATOR), (0.26, 0.44, M.REVERSE_LIGHT)):
        y0, y1 = half * start, half * stop
        left.facet(((back, y1, z - 0.06), (back, y0, z - 0.06), (back, y0, z), (back, y1, z)), material)
    solid.add_both(left)
    plate(solid, rear - 0.008, z - 0.12, -1)
    if shape.glazed < 0.9:
        _rear_windows(solid, shape)
    x = front - shape.cabin[3]
    solid.box((x - 0.05, -0.16, shape.roof - 0.06), (x + 0.06, 0.16, shape.roof - 0.03), M.BRAKE_LIGHT)


def _rear_windows(solid: Solid, shape: CarShape) -> None:
    """Add windows to the rear doors of a van, whose rear is a plane between the belt line and the roof."""
    belt, edge = _at(shape.deck, shape.cabin[1]), shape.roof - 0.07
    left = Solid()
    corners = []
    for y, share in ((0.62, 0.38), (0.06, 0.38), (0.06, 0.85), (0.62, 0.85)):
        distance = shape.cabin[1] + (shape.cabin[3] - shape.cabin[1]) * share * (edge - belt) / (shape.roof - belt)
        corners.append((shape.length / 2 - distance - 0.07, y * shape.width / 2, belt + (edge - belt) * share))
    left.facet(corners, M.GLASS)
    solid.add_both(left)


def plate(solid: Solid, x: float, z: float, direction: int) -> None:
    """Add a number plate that faces forward (1) or backward (-1)."""
    corners = [(x, y, z + up) for y, up in ((-0.26, -0.055), (0.26, -0.055), (0.26, 0.055), (-0.26, 0.055))]
    solid.facet(corners[::direction], M.SECOND_PAINT)


SEDAN: Final = CarShape(
    "sedan",
    length=4.85,
    width=1.86,
    axles=(0.93, 3.78),
    wheel=0.335,
    clearance=0.2,
    deck=((0.0, 0.66), (0.12, 0.72), (0.4, 0.79), (1.45, 0.95), (3.9, 1.0), (4.5, 1.02), (4.85, 0.95)),
    cabin=(1.42, 4.28, 2.22, 3.52),
    roof=1.46,
)
HATCHBACK: Final = replace(
    SEDAN,
    name="hatchback",
    length=4.0,
    width=1.76,
    axles=(0.8, 3.33),
    wheel=0.31,
    deck=((0.0, 0.68), (0.12, 0.74), (0.4, 0.81), (1.1, 0.95), (3.7, 1.0), (4.0, 0.94)),
    cabin=(1.02, 3.96, 1.8, 3.5),
    roof=1.5,
    pillars=(0.44, 0.74),
)
COUPE: Final = replace(
    SEDAN,
    name="coupe",
    length=4.7,
    width=1.9,
    axles=(0.95, 3.7),
    deck=((0.0, 0.6), (0.12, 0.67), (0.4, 0.75), (1.6, 0.9), (4.0, 0.97), (4.45, 1.0), (4.7, 0.94)),
    cabin=(1.62, 4.3, 2.42, 3.2),
    roof=1.34,
    clearance=0.16,
    pillars=(0.55,),
    narrowing=0.24,
)
SUV: Final = replace(
    SEDAN,
    name="suv",
    length=4.75,
    width=1.94,
    axles=(0.9, 3.72),
    wheel=0.375,
    clearance=0.28,
    deck=((0.0, 0.86), (0.12, 0.93), (0.4, 1.0), (1.3, 1.12), (4.5, 1.16), (4.75, 1.08)),
    cabin=(1.22, 4.72, 1.86, 4.4),
    roof=1.78,
    pillars=(0.36, 0.7),
    narrowing=0.16,
    corner=0.3,
    lamp=(0.17, 0.26),
    sill=0.1,
)


OFF_ROADER: Final = replace(
    SUV,
    name="off-roader",
    length=4.0,
    width=1.84,
    axles=(0.72, 3.14),
    wheel=0.41,
    clearance=0.42,
    deck=((0.0, 0.98), (0.12, 1.08), (1.4, 1.16), (3.9, 1.2), (4.0, 1.16)),
    cabin=(1.42, 3.96, 1.66, 3.9),
    roof=1.86,
    pillars=(0.42,),
    narrowing=0.07,
    corner=0.14,
    roof_paint=M.TRIM,
)
MICROCAR: Final = replace(
    HATCHBACK,
    name="microcar",
    length=2.4,
    width=1.45,
    axles=(0.5, 1.95),
    wheel=0.27,
    deck=((0.0, 0.74), (0.3, 0.86), (0.6, 0.92), (2.1, 0.95), (2.4, 0.88)),
    cabin=(0.22, 2.1, 0.7, 1.7),
    roof=1.48,
    pillars=(0.62,),
    corner=0.45,
)
VAN: Final = replace(
    SUV,
    name="van",
    length=5.9,
    width=1.98,
    axles=(1.0, 4.6),
    wheel=0.36,
    clearance=0.26,
    deck=((0.0, 0.9), (0.12, 1.0), (0.4, 1.12), (0.95, 1.3), (5.7, 1.34), (5.9, 1.3)),
    cabin=(0.9, 5.88, 1.62, 5.8),
    roof=2.5,
    pillars=(0.3,),
    glazed=0.33,
    narrowing=0.1,
    corner=0.26,
    lamp=(0.2, 0.4),
)
MINIBUS: Final = replace(
    SUV,
    name="minibus",
    length=4.45,
    width=1.74,
    axles=(0.95, 3.35),
    wheel=0.33,
    clearance=0.28,
    deck=((0.0, 1.02), (0.1, 1.1), (0.4, 1.14), (4.2, 1.16), (4.45, 1.1)),
    cabin=(0.1, 4.4, 0.42, 4.2),
    roof=1.98,
    pillars=(0.3, 0.54, 0.76),
    narrowing=0.13,
    corner=0.3,
    roof_paint=M.SECOND_PAINT,
    lamp=(0.22, 0.3),
)
BUS: Final = replace(
    SUV,
    name="bus",
    length=10.3,
    width=2.5,
    axles=(2.2, 7.6),
    wheel=0.48,
    clearance=0.32,
    deck=((0.0, 1.22), (0.1, 1.28), (10.2, 1.28), (10.3, 1.22)),
    cabin=(0.06, 10.24, 0.22, 10.16),
    roof=3.1,
    pillars=(0.09, 0.22, 0.36, 0.50, 0.64, 0.78),
    narrowing=0.1,
    corner=0.28,
    lamp=(0.2, 0.3),
)


@model
def police_car(solid: Solid) -> None:
    """Add a police car: a sedan with light doors and a bar of beacons."""
    shape = replace(SEDAN, name="police car", doors=M.SECOND_PAINT)
    car(solid, shape)
    beacons(solid, 0.05, shape.roof - 0.02, 0.55)


@model
def taxi(solid: Solid) -> None:
    """Add a taxi: a sedan with a sign on its roof."""
    car(solid, replace(SEDAN, name="taxi"))
    solid.box((-0.12, -0.3, SEDAN.roof - 0.02), (0.12, 0.3, SEDAN.roof + 0.14), M.SECOND_PAINT, top=(0.6, 0.9))


def beacons(solid: Solid, x: float, z: float, half: float) -> None:
    """Add a bar of beacons across a roof."""
    solid.box((x - 0.13, -half, z), (x + 0.13, half, z + 0.05), M.TRIM)
    for y in (-half * 0.62, half * 0.62):
        solid.box((x - 0.11, y - half * 0.36, z + 0.05), (x + 0.11, y + half * 0.36, z + 0.15), M.BEACON, top=(0.7, 0.9))


for _shape in (SEDAN, HATCHBACK, COUPE, SUV, OFF_ROADER, MICROCAR, VAN, MINIBUS, BUS):
    model(partial(car, shape=_shape), _shape.name)
