"""A small OpenDRIVE map: a straight road through a junction, with a light on one side and a stop sign on the other.

Road 1 leads from x = 0 to x = 100, road 2 from x = 120 to x = 220, and road 3 between them is in junction 9. They have a
lane in each direction, 3.5 m wide; roads 1 and 2 have a shoulder of 1 m on the right side. The light 11 closes the lane to
the east at x = 100, and the stop sign 12 that to the west at x = 120. The limit is 50 km/h, but 30 km/h on the lane to the
west of road 2, and 72 km/h on that to the east of road 1 from x = 50 on, by a sign.
"""

from __future__ import annotations

from typing import Final


def _lane(number: int, kind: str, width: float, inside: str = "") -> str:
    return f'<lane id="{number}" type="{kind}"><width sOffset="0" a="{width}" b="0" c="0" d="0"/>{inside}</lane>'


def _road(number: int, x: float, length: float, links: str, signals: str = "", junction: int = -1, slow: str = "") -> str:
    shoulder = _lane(-2, "shoulder", 1.0) if junction == -1 else ""
    kind = '<type s="0" type="town"><speed max="50" unit="km/h"/></type>' if junction == -1 else ""
    return f"""<road id="{number}" length="{length}" junction="{junction}"><link>{links}</link>{kind}
    <planView><geometry s="0" x="{x}" y="0" hdg="0" length="{length}"><line/></geometry></planView>
    <lanes><laneSection s="0"><left>{_lane(1, "driving", 3.5, slow)}</left><center>{_lane(0, "none", 0)}</center>
    <right>{_lane(-1, "driving", 3.5)}{shoulder}</right></laneSection></lanes><signals>{signals}</signals></road>"""


def _signal(number: int, kind: int, s: float, t: float, lane: int, value: str = "") -> str:
    orientation = "+" if lane < 0 else "-"
    return f"""<signal id="{number}" s="{s}" t="{t}" type="{kind}" orientation="{orientation}" zOffset="0" {value}>
    <validity fromLane="{lane}" toLane="{lane}"/></signal>"""


LIGHT_POSITION: Final = (99.0, -4.5)

STRAIGHT_ROAD: Final = (
    '<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="4" name="Straight"/>'
    + _road(
        1,
        0,
        100,
        '<successor elementType="junction" elementId="9"/>',
        _signal(11, 1000001, 99, -4.5, -1) + _signal(13, 274, 50, -4.5, -1, 'value="72" unit="km/h"'),
    )
    + _road(
        2,
        120,
        100,
        '<predecessor elementType="junction" elementId="9"/>',
        _signal(12, 206, 1, 4.5, 1),
        slow='<speed sOffset="0" max="30" unit="km/h"/>',
    )
    + _road(3, 100, 20, '<predecessor elementType="road" elementId="1"/>', junction=9)
    + '<junction id="9" name="J"/></OpenDRIVE>'
)
