"""Maps for tests: CARLA's own, and small ones written by hand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

TOWNS = Path(__file__).parents[3] / "shared" / "data" / "maps"
BUILT_IN = Path(__file__).parents[2] / "src" / "carla_recap" / "sim" / "towns"
PATHS = sorted((*BUILT_IN.glob("*.xodr"), *TOWNS.glob("*.xodr")))


def town(name: str) -> Path:
    """Return a map of CARLA; skips the test if it is missing."""
    path = TOWNS / f"{name}.xodr"
    if not path.exists():
        pytest.skip(f"{path} is not here: it is data that is not part of the repository")
    return path


def lane(id: int, width: float | str = 3.5, kind: str = "driving") -> str:
    return f'<lane id="{id}" type="{kind}" level="false"><width sOffset="0" a="{width}" b="0" c="0" d="0"/></lane>'


def section(s: float, left: str = "", right: str = "") -> str:
    centre = '<center><lane id="0" type="none" level="false"/></center>'
    return f'<laneSection s="{s}"><left>{left}</left>{centre}<right>{right}</right></laneSection>'


def road(
    id: int = 1,
    *,
    x: float | str = 0,
    y: float = 0,
    heading: float = 0,
    length: float | str = 100,
    shape: str = "<line/>",
    height: float = 0,
    slope: float = 0,
    sections: str = section(0, lane(1), lane(-1)),
    inside: str = "",
    junction: int = -1,
) -> str:
    return (
        f'<road name="" length="{length}" id="{id}" junction="{junction}"><planView>'
        f'<geometry s="0" x="{x}" y="{y}" hdg="{heading}" length="{length}">{shape}</geometry></planView>'
        f'<elevationProfile><elevation s="0" a="{height}" b="{slope}" c="0" d="0"/></elevationProfile>'
        f"<lanes>{sections}</lanes>{inside}</road>"
    )


def opendrive(*roads: str) -> str:
    return f'<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="4"/>{"".join(roads)}</OpenDRIVE>'


def stop_sign(station: float, first: int, last: int) -> str:
    return (
        f'<signals><signal name="" id="7" s="{station}" t="0" zOffset="0" hOffset="0" orientation="+" dynamic="no"'
        f' country="" type="206" subtype="-1" value="-1"><validity fromLane="{first}" toLane="{last}"/></signal></signals>'
    )


def crossing(station: float) -> str:
    corners = ((-4, -2), (4, -2), (4, 2), (-4, 2), (-4, -2))
    outline = "".join(f'<cornerLocal u="{u}" v="{v}" z="0"/>' for u, v in corners)
    return (
        f'<objects><object id="8" name="Crosswalk" s="{station}" t="0" zOffset="0" hdg="1.5707963" roll="0" pitch="0"'
        f' orientation="+" type="crosswalk" width="4" length="8"><outline>{outline}</outline></object></objects>'
    )


def crossing_by_road(station: float) -> str:
    corners = ((-2, -4), (2, -4), (2, 4), (-2, 4))
    outline = "".join(
        f'<cornerRoad s="{station + s}" t="{t}" dz="0" height="0" id="{n}"/>' for n, (s, t) in enumerate(corners)
    )
    return re.sub(r"<outline>.*</outline>", f"<outline>{outline}</outline>", crossing(station))


def painted_stop(station: float, t: float, length: float) -> str:
    return (
        f'<objects><object id="9" name="StopLine" s="{station}" t="{t}" zOffset="0" hdg="1.5707963267948966" roll="0"'
        f' pitch="0" orientation="+" type="-1" width="0" length="{length}"/></objects>'
    )


def mirrored(text: str) -> str:
    """Return a map of lines and arcs as seen in a mirror along the x axis: what keeps right there, keeps left."""
    turned = re.sub(r'\b(y|hdg|t|v|hOffset|curvature)="(-?[^"]*)"', lambda found: _negated(*found.groups()), text)
    turned = re.sub(r'(<lane |<predecessor |<successor )(id)="(-?\d+)"', lambda m: m[1] + _negated(*m.groups()[1:]), turned)
    turned = re.sub(r'(<(?:validity|laneLink) )(\w+)="(-?\d+)" (\w+)="(-?\d+)"', _negated_pair, turned)
    turned = re.sub(r"<(/?)(left|right)>", lambda found: f"<{found[1]}{_OPPOSITE[found[2]]}>", turned)
    return re.sub(r"<road ", '<road rule="LHT" ', turned)


_OPPOSITE = {"left": "right", "right": "left"}


def _negated(name: str, value: str) -> str:
    return f'{name}="{value[1:] if value.startswith("-") else f"-{value}"}"'


def _negated_pair(found: re.Match[str]) -> str:
    return f"{found[1]}{_negated(found[2], found[3])} {_negated(found[4], found[5])}"
