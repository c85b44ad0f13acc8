"""A town with two levels: a road in the form of an eight, which crosses over itself on a bridge 6 m above the ground."""

from __future__ import annotations

import re
from math import pi
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

BRIDGE = 6.0
"""The height of the upper road in m; both roads are straight where they cross, at (0, 0): the lower one along x."""
_RADIUS = 60.0
_BEND = 1.5 * pi * _RADIUS
_UP = f'<elevation s="0" a="0" b="0" c="{3 * BRIDGE / _BEND**2}" d="{-2 * BRIDGE / _BEND**3}"/>'
_DOWN = f'<elevation s="0" a="{BRIDGE}" b="0" c="{-3 * BRIDGE / _BEND**2}" d="{2 * BRIDGE / _BEND**3}"/>'
_ARC = '<arc curvature="{}"/>'


def _level(height: float) -> str:
    return f'<elevation s="0" a="{height}" b="0" c="0" d="0"/>'


def _lane(id: int, kind: str, width: float) -> str:
    return (
        f'<lane id="{id}" type="{kind}" level="false"><link><predecessor id="{id}"/><successor id="{id}"/></link>'
        f'<width sOffset="0" a="{width}" b="0" c="0" d="0"/></lane>'
    )


def _road(id: int, x: float, y: float, heading: float, length: float, shape: str, elevation: str) -> str:
    before, after = (id - 2) % 4 + 1, id % 4 + 1
    left = _lane(2, "sidewalk", 2.0) + _lane(1, "driving", 3.5)
    right = _lane(-1, "driving", 3.5) + _lane(-2, "sidewalk", 2.0)
    return (
        f'<road name="" length="{length}" id="{id}" junction="-1">'
        f'<link><predecessor elementType="road" elementId="{before}" contactPoint="end"/>'
        f'<successor elementType="road" elementId="{after}" contactPoint="start"/></link>'
        f'<planView><geometry s="0" x="{x}" y="{y}" hdg="{heading}" length="{length}">{shape}</geometry></planView>'
        f"<elevationProfile>{elevation}</elevationProfile>"
        f'<lanes><laneSection s="0"><left>{left}</left><center><lane id="0" type="none" level="false"/></center>'
        f"<right>{right}</right></laneSection></lanes></road>"
    )


def two_levels(folder: Path, far: float = 0.0) -> Path:
    """Write the OpenDRIVE file of the town, with another road so many m from it in both directions, if any."""
    roads = (
        _road(1, -_RADIUS, 0, 0, 2 * _RADIUS, "<line/>", _level(0)),
        _road(2, _RADIUS, 0, 0, _BEND, _ARC.format(1 / _RADIUS), _UP),
        _road(3, 0, _RADIUS, -pi / 2, 2 * _RADIUS, "<line/>", _level(BRIDGE)),
        _road(4, 0, -_RADIUS, -pi / 2, _BEND, _ARC.format(-1 / _RADIUS), _DOWN),
    )
    if far:
        road = _road(5, far, far, 0, 2 * _RADIUS, "<line/>", _level(0))
        roads = (*roads, re.sub("<link><predecessor elementType.*?</link>", "<link/>", road))
    path = folder / "TwoLevels.xodr"
    path.write_text(f'<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="4"/>{"".join(roads)}</OpenDRIVE>')
    return path
