"""A town with two levels: a road in the form of an eight, which crosses over itself on a bridge 6 m above the ground."""

from __future__ import annotations

import re
from math import pi
from pathlib import Path
from typing import Any

from tests.roads.towns import lane, opendrive, road, section

BRIDGE = 6.0
"""The height of the upper road in m; both roads are straight where they cross, at (0, 0): the lower one along x."""
_RADIUS = 60.0
_BEND = 1.5 * pi * _RADIUS
_UP = f'<elevation s="0" a="0" b="0" c="{3 * BRIDGE / _BEND**2}" d="{-2 * BRIDGE / _BEND**3}"/>'
_DOWN = f'<elevation s="0" a="{BRIDGE}" b="0" c="{-3 * BRIDGE / _BEND**2}" d="{2 * BRIDGE / _BEND**3}"/>'
_ARC = '<arc curvature="{}"/>'


def _lane(id: int, kind: str, width: float) -> str:
    return lane(id, width, kind).replace(">", f'><link><predecessor id="{id}"/><successor id="{id}"/></link>', 1)


_SECTION = section(
    0, _lane(2, "sidewalk", 2.0) + _lane(1, "driving", 3.5), _lane(-1, "driving", 3.5) + _lane(-2, "sidewalk", 2.0)
)


def _road(id: int, *, slope: str = "", **given: Any) -> str:
    ends = ("predecessor", (id - 2) % 4 + 1, "end"), ("successor", id % 4 + 1, "start")
    links = "".join(f'<{name} elementType="road" elementId="{other}" contactPoint="{at}"/>' for name, other, at in ends)
    made = road(id, sections=_SECTION, **given).replace("<planView>", f"<link>{links}</link><planView>")
    return re.sub("<elevation .*?/>", slope, made) if slope else made


def two_levels(folder: Path, far: float = 0.0) -> Path:
    """Write the OpenDRIVE file of the town, with another road so many m from it in both directions, if any."""
    roads = [
        _road(1, x=-_RADIUS, length=2 * _RADIUS),
        _road(2, x=_RADIUS, length=_BEND, shape=_ARC.format(1 / _RADIUS), slope=_UP),
        _road(3, y=_RADIUS, heading=-pi / 2, length=2 * _RADIUS, height=BRIDGE),
        _road(4, y=-_RADIUS, heading=-pi / 2, length=_BEND, shape=_ARC.format(-1 / _RADIUS), slope=_DOWN),
    ]
    if far:
        roads.append(road(5, x=far, y=far, length=2 * _RADIUS, sections=_SECTION))
    path = folder / "TwoLevels.xodr"
    path.write_text(opendrive(*roads))
    return path
