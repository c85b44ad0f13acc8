"""Traffic signs, and the positions of traffic lights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.rendering.glyphs import glyphs
from carla_recap.roads.opendrive import LIGHT, SPEED_LIMIT, STOP, YIELD
from carla_recap.scene.materials import Material

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from carla_recap.rendering.building import MeshBuilder
    from carla_recap.rendering.heights import TriangleGrid
    from carla_recap.roads.opendrive import Road

    Floats = NDArray[np.float64]

_MOST: Final = 20_000
_MIDDLE: Final = 2.4  # m from the ground to the middle of a plate
_RADIUS: Final = 0.38  # m
_POLE: Final = 0.04  # m
_LAYER: Final = 0.006  # m from one layer of a plate to the next
_APART: Final = 0.5  # m between two signs


@dataclass(frozen=True, eq=False)
class LightPost:
    """The position of a traffic light of a map.

    Attributes:
        id: The OpenDRIVE id of the signal.
        location: The foot of the pole, in m, (3,).
        heading: The direction that the light faces, towards the drivers, in radians.
    """

    id: str
    location: Floats
    heading: float


@dataclass(frozen=True, eq=False)
class _Sign:
    kind: str
    text: str
    location: Floats
    heading: float


def light_posts(roads: Sequence[Road], ground: TriangleGrid) -> list[LightPost]:
    """Return the traffic lights of roads, on the ground."""
    lights: dict[str, LightPost] = {}
    for road in roads:
        for signal in road.signals:
            if signal.kind == LIGHT and signal.id not in lights and len(lights) < _MOST:
                point, heading = road.at(signal.station, signal.offset)
                if np.isfinite(point).all():
                    location = _grounded(point, ground)
                    lights[signal.id] = LightPost(signal.id, location, heading + signal.heading + np.pi)
    return list(lights.values())


def add_signs(builder: MeshBuilder, roads: Sequence[Road], ground: TriangleGrid, driving: TriangleGrid) -> None:
    """Add speed limits, yield and stop signs with their poles, but not those on lanes for cars.

    Args:
        builder: Collects the triangles.
        roads: The roads.
        ground: All surfaces.
        driving: The lanes for cars.
    """
    known: set[tuple[int, ...]] = set()
    for sign in _signs(roads):
        key = tuple(np.rint(sign.location / _APART).astype(np.int64).tolist())
        if key in known or len(known) >= _MOST or np.isfinite(driving.highest(sign.location[None])[0]):
            continue
        known.add(key)
        foot = _grounded(sign.location, ground)
        _add_pole(builder, foot)
        for layer, (shape, material) in enumerate(_plate(sign)):
            _add_plate(builder, foot, sign.heading, shape, material, layer)


def _signs(roads: Sequence[Road]) -> Iterator[_Sign]:
    for road in roads:
        for signal in road.signals:
            if signal.kind in (SPEED_LIMIT, STOP, YIELD):
                point, heading = road.at(signal.station, signal.offset)
                text = f"{signal.value:.0f}" if 0 < signal.value < 1000 else ""
                yield _Sign(signal.kind, text, point, heading + signal.heading + np.pi)
        for thing in road.objects:
            if thing.speed_limit is not None:
                point, heading = road.at(thing.station, thing.offset)
                yield _Sign(SPEED_LIMIT, f"{thing.speed_limit:.0f}", point, heading + thing.heading + np.pi)


def _grounded(point: Floats, ground: TriangleGrid) -> Floats:
    height = ground.highest(point[None])[0]
    return np.array((point[0], point[1], height if np.isfinite(height) else point[2]))


def _plate(sign: _Sign) -> Iterator[tuple[Floats, Material]]:
    """Yield the layers of a plate from the back: polygons upwards and to the left, as seen by drivers."""
    if sign.kind == SPEED_LIMIT:
        yield _regular(18, _RADIUS), Material.SIGN_RED
        yield _regular(18, 0.78 * _RADIUS), Material.SIGN_WHITE
        width = (0.34 if len(sign.text) < 3 else 0.46) * (1 if len(sign.text) > 1 else 0.4)
        letters, material = glyphs(sign.text, width, 0.3), Material.SIGN_BLACK
    elif sign.kind == STOP:
        yield _regular(8, _RADIUS * 1.05, np.pi / 8), Material.SIGN_WHITE
        yield _regular(8, _RADIUS * 0.98, np.pi / 8), Material.SIGN_RED
        letters, material = glyphs("STOP", 0.54, 0.22), Material.SIGN_WHITE
    else:
        yield _regular(3, _RADIUS * 1.25, np.pi), Material.SIGN_RED
        yield _regular(3, _RADIUS * 0.75, np.pi), Material.SIGN_WHITE
        return
    for letter in letters:
        yield letter, material


def _regular(count: int, radius: float, turn: float = 0.0) -> Floats:
    angles = turn + np.arange(count) * 2 * np.pi / count
    return radius * np.stack((np.cos(angles), np.sin(angles)), axis=1)


def _add_plate(builder: MeshBuilder, foot: Floats, heading: float, shape: Floats, material: Material, layer: int) -> None:
    forward = np.array((np.cos(heading), np.sin(heading), 0.0))  # towards the drivers
    left = np.array((np.sin(heading), -np.cos(heading), 0.0))  # as they see it
    up = np.array((0.0, 0.0, 1.0))
    level = min(layer, 2)
    middle = foot + _MIDDLE * up + (_POLE + (1 + level) * _LAYER) * forward
    corners = middle + shape[:, :1] * up + shape[:, 1:] * left
    builder.add_polygon(corners, forward, material)
    if layer == 0:
        builder.add_polygon(corners[::-1] - _LAYER * forward, -forward, Material.SIGN_BACK)


def _add_pole(builder: MeshBuilder, foot: Floats) -> None:
    angles = np.arange(7) * np.pi / 3
    around = np.stack((np.cos(angles), np.sin(angles), np.zeros(7)), axis=1)
    bottom = foot + _POLE * around - (0.0, 0.0, 0.3)
    top = foot + _POLE * around + (0.0, 0.0, _MIDDLE + 0.3)
    builder.add_strip(top, bottom, around, Material.POLE, np.ones(6, np.bool_))
    builder.add_polygon(top[:6], np.array((0.0, 0.0, 1.0)), Material.POLE)
