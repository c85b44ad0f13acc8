"""Walkers, and riders of two-wheelers."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple

from carla_recap.scene.materials import Material
from tools.models.solid import Solid, model

if TYPE_CHECKING:
    from tools.models.solid import Point

M: Final = Material


class Clothes(NamedTuple):
    """The materials of a person."""

    skin: Material = M.SKIN
    hair: Material = M.HAIR
    top: Material = M.PAINT
    trousers: Material = M.TROUSERS
    shoes: Material = M.SHOES


_COMPLEXIONS: Final = (
    Clothes(),
    Clothes(M.FAIR_SKIN, M.FAIR_HAIR, trousers=M.JEANS),
    Clothes(M.DARK_SKIN, M.DARK_HAIR, trousers=M.LIGHT_TROUSERS),
)


def walker(solid: Solid, clothes: Clothes, *, long_hair: bool = False, child: bool = False) -> None:
    """Add a person in mid-stride."""
    head = 0.13 if child else 0.105
    hip, shoulder, crown = (0.80, 1.37, 1.8) if child else (0.90, 1.43, 1.8)
    chin = crown - 2 * head * 1.22
    for side, stride in ((1, 1.0), (-1, -1.0)):
        y = 0.09 * side
        knee = (0.05 + 0.10 * stride, y, hip * 0.53)
        foot = (0.16 * stride - 0.03, y, 0.08 if stride > 0 else 0.10)
        solid.bent_limb(((0.0, y, hip), knee, foot), (0.095, 0.074, 0.05), clothes.trousers, sides=5)
        solid.box(
            (foot[0] - 0.09, y - 0.05, foot[2] - 0.08),
            (foot[0] + 0.17, y + 0.05, foot[2] + 0.02),
            clothes.shoes,
            top=(0.7, 0.8),
        )
        elbow = (-0.06 * stride - 0.03, side * 0.225, (hip + shoulder) / 2 - 0.02)
        hand = (elbow[0] + 0.12 - 0.06 * stride, side * 0.215, hip - 0.04)
        upper = (0.0, side * 0.185, shoulder - 0.02)
        solid.bent_limb((upper, elbow, hand), (0.062, 0.05, 0.036), clothes.top, sides=5)
        solid.ball((hand[0] + 0.01, hand[1], hand[2] - 0.045), (0.04, 0.03, 0.065), clothes.skin, sides=5, rings=3)
    _torso(solid, hip, shoulder, clothes)
    solid.limb((0.0, 0.0, shoulder), (0.015, 0.0, chin + 0.05), (0.055, 0.05), clothes.skin, sides=5, caps=False)
    _head(solid, (0.02, 0.0, (crown + chin) / 2), head, clothes, long_hair=long_hair)


def _torso(solid: Solid, hip: float, shoulder: float, clothes: Clothes) -> None:
    rows = (
        (hip - 0.09, 0.105, 0.15),
        (hip + 0.04, 0.11, 0.165),
        (hip + 0.17, 0.095, 0.145),
        (shoulder - 0.15, 0.125, 0.185),
        (shoulder - 0.02, 0.105, 0.195),
        (shoulder + 0.05, 0.06, 0.08),
    )
    outline = (
        (1.0, 0.45),
        (0.45, 1.0),
        (-0.45, 1.0),
        (-1.0, 0.45),
        (-1.0, -0.45),
        (-0.45, -1.0),
        (0.45, -1.0),
        (1.0, -0.45),
    )
    rings = [[(x * depth, y * width, z) for x, y in outline] for z, depth, width in rows]
    solid.loft(rings, lambda i, _: clothes.trousers if i < 1 else clothes.top)


def _head(solid: Solid, center: Point, radius: float, clothes: Clothes, *, long_hair: bool) -> None:
    x, y, z = center
    radii = (radius, radius * 0.86, radius * 1.22)
    solid.ball(center, radii, clothes.skin, sides=7, rings=5)
    back, up, grown = (0.26, 0.16, 1.08) if long_hair else (0.20, 0.34, 1.0)
    solid.ball((x - radius * back, y, z + radius * up), tuple(grown * r for r in radii), clothes.hair, sides=7, rings=4)
    if long_hair:
        low = (x - radius * 0.85, y, z - radius * 1.9)
        solid.limb((x - radius * 0.6, y, z), low, (radius * 0.8, radius * 0.5), clothes.hair, sides=6, flat=1.2)


for _number, _clothes in enumerate(_COMPLEXIONS):
    model(partial(walker, clothes=_clothes), f"man {_number}")
    model(partial(walker, clothes=_clothes, long_hair=True), f"woman {_number}")
    model(partial(walker, clothes=_clothes, child=True), f"child {_number}")
