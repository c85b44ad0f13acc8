"""Generated OpenDRIVE maps: roads of all geometries, with lanes, markings, links, junctions and signals."""

from __future__ import annotations

from collections.abc import Callable
from math import atan2, cos, sin, tau
from typing import Any

from hypothesis import strategies as st

Draw = Callable[[st.SearchStrategy[Any]], Any]

KINDS = ("driving", "driving", "driving", "parking", "shoulder", "sidewalk", "none", "biking", "bidirectional", "median")
CHANGES = ("none", "increase", "decrease", "both", None)


def number(low: float, high: float, digits: int = 3) -> st.SearchStrategy[float]:
    scale = 10**digits
    return st.integers(round(low * scale), round(high * scale)).map(lambda value: value / scale)


def cubic(tag: str, start: str, s: float, a: float, b: float = 0.0, c: float = 0.0, d: float = 0.0) -> str:
    return f'<{tag} {start}="{s}" a="{a}" b="{b}" c="{c}" d="{d}"/>'


@st.composite
def shapes(draw: Draw, length: float) -> tuple[str, tuple[float, float, float]]:
    """A curve, and x, y and direction of its end as seen from its begin; the ends of spirals are not exact."""
    kind = draw(st.sampled_from(("line", "arc", "spiral", "poly3", "paramPoly3", "of share", "of length")))
    if kind == "line":
        return "<line/>", (length, 0.0, 0.0)
    if kind == "arc":
        bend = draw(number(-0.03, 0.03)) or 0.01
        turn = bend * length
        return f'<arc curvature="{bend}"/>', (sin(turn) / bend, (1 - cos(turn)) / bend, turn)
    if kind == "spiral":
        first, last = draw(number(-0.02, 0.02)), draw(number(0.021, 0.03))  # the library divides by their difference
        turn = (first + last) / 2 * length
        return f'<spiral curvStart="{first}" curvEnd="{last}"/>', (length, turn / 2 * length, turn)
    c, d = draw(number(-0.005, 0.005, 5)), draw(number(-0.0001, 0.0001, 6))
    side, turn = c * length**2 + d * length**3, atan2(2 * c * length + 3 * d * length**2, 1.0)
    if kind == "poly3":
        return f'<poly3 a="0" b="0" c="{c}" d="{d}"/>', (length, side, turn)
    reach = 1.0 if kind == "of share" else length
    scale = length / reach
    values = f'aU="0" bU="{scale}" cU="0" dU="0" aV="0" bV="0" cV="{c * scale**2}" dV="{d * scale**3}"'
    span = {"of share": ' pRange="normalized"', "of length": ' pRange="arcLength"'}.get(kind, "")
    return f"<paramPoly3{span} {values}/>", (length, side, turn)


@st.composite
def plans(draw: Draw, index: int) -> tuple[float, str]:
    """The course of a road, far from those of other indices: its length and its records."""
    x, y, heading, station, records = (
        500 * index + draw(number(-99, 99)),
        draw(number(-99, 99)),
        draw(number(-3, 3)),
        0.0,
        [],
    )
    for _ in range(draw(st.integers(1, 3))):
        length = draw(number(5, 40))
        shape, (ahead, left, turn) = draw(shapes(length))
        records.append(f'<geometry s="{station}" x="{x}" y="{y}" hdg="{heading}" length="{length}">{shape}</geometry>')
        x += ahead * cos(heading) - left * sin(heading)
        y += ahead * sin(heading) + left * cos(heading)
        heading, station = (heading + turn) % tau, station + length
    return station, f"<planView>{''.join(records)}</planView>"


@st.composite
def lanes(draw: Draw, id: int, length: float, beyond: tuple[list[int], list[int]]) -> str:
    """A lane that leads to lanes of the neighbouring sections, or nowhere."""
    links = ""
    for end, ids in zip(("predecessor", "successor"), beyond, strict=True):
        linked = draw(st.sampled_from((id, id, id, None, *ids)))
        links += "" if linked is None or linked not in ids else f'<{end} id="{linked}"/>'
    widths = cubic("width", "sOffset", 0.0, draw(number(1, 4)), *(draw(st.sampled_from(((), (0.01, 0.0005, -0.00001))))))
    if draw(st.booleans()):
        widths += cubic("width", "sOffset", round(length / 2, 2), draw(number(1, 4)), draw(number(-0.02, 0.02)))
    return (
        f'<lane id="{id}" type="{draw(st.sampled_from(KINDS))}" level="false"><link>{links}</link>{widths}'
        f"{draw(marks(length))}</lane>"
    )


@st.composite
def marks(draw: Draw, length: float) -> str:
    found = ""
    for start in (0.0, round(length / 3, 2))[: draw(st.integers(0, 2))]:
        change = draw(st.sampled_from(CHANGES))
        change = "" if change is None else f' laneChange="{change}"'
        found += f'<roadMark sOffset="{start}" type="broken" weight="standard" color="white" width="0.15"{change}/>'
    return found


@st.composite
def signals(draw: Draw, id: int, length: float, ids: list[int]) -> str:
    offset = draw(st.sampled_from((-1, 1))) * draw(number(20, 25))  # beside all lanes
    place = f's="{round(draw(number(0, 1)) * length, 2)}" t="{offset}" zOffset="{draw(number(0, 4))}"'
    orientation = draw(st.sampled_from(("+", "-", "none")))
    kind, value = draw(st.sampled_from((("1000001", -1), ("206", -1), ("205", -1), ("274", 30), ("274", 90))))
    valid = ""
    if draw(st.booleans()):
        pair = draw(st.sampled_from(ids)), draw(st.sampled_from(ids))
        valid = f'<validity fromLane="{min(pair)}" toLane="{max(pair)}"/>'
    name = f"{draw(st.sampled_from(('', 'no. ')))}{id}"
    return (
        f'<signal name="s{id}" id="{name}" {place} hOffset="{draw(number(-1, 1))}" orientation="{orientation}" dynamic="no"'
        f' country="OpenDRIVE" type="{kind}" subtype="-1" value="{value}" unit="km/h" height="1" width="1" text=""'
        f' pitch="0" roll="0">{valid}</signal>'
    )


def link(end: str, other: tuple[str, int, str] | None) -> str:
    if other is None:
        return ""
    kind, id, contact = other
    contact = f' contactPoint="{contact}"' if kind == "road" else ""
    return f'<{end} elementType="{kind}" elementId="{id}"{contact}/>'


@st.composite
def numbers_of_lanes(draw: Draw) -> list[int]:
    right, left = draw(st.integers(0, 3)), draw(st.integers(0, 3))
    return [*range(-right, 0), *range(1, left + 1)] or [-1]


@st.composite
def maps(draw: Draw) -> str:
    """A map of roads in a row or a ring, with a junction between the first and the others, or without one."""
    count = draw(st.integers(1, 4))
    ids = draw(st.lists(st.integers(0, 900), min_size=count, max_size=count, unique=True))
    junction = 901 + draw(st.integers(0, 50))
    has_junction = count >= 3 and draw(st.booleans())
    rule = draw(st.sampled_from(("", ' rule="RHT"', ' rule="LHT"', ' rule="LHT"', "mixed")))
    numbers = [[draw(numbers_of_lanes()) for _ in range(draw(st.sampled_from((1, 1, 2, 3))))] for _ in ids]
    roads, connections = [], ""
    for index, id in enumerate(ids):
        before, after = index - 1, (index + 1) % count
        neighbours: list[tuple[str, int, str] | None] = [None, None]
        inside = has_junction and index >= 2
        if has_junction and index < 2:
            neighbours[1 - index] = ("junction", junction, "")
        elif inside:
            ends = draw(st.sampled_from(((0, 1), (1, 0))))
            neighbours = [("road", ids[ends[0]], "end"), ("road", ids[ends[1]], "start")]
            before, after = ends
        else:
            if before >= 0:
                neighbours[0] = ("road", ids[before], "end")
            if after < count:
                neighbours[1] = ("road", ids[after], "start")
        length, plan = draw(plans(index))
        of_sections = numbers[index]
        cuts = [round(length * number / len(of_sections), 2) for number in range(len(of_sections))]
        sections = ""
        for number_, start in enumerate(cuts):
            stop = cuts[number_ + 1] if number_ + 1 < len(cuts) else length
            here = of_sections[number_]
            first = of_sections[number_ - 1] if number_ else numbers[before][-1] if neighbours[0] else []
            last = of_sections[number_ + 1] if number_ + 1 < len(cuts) else numbers[after][0] if neighbours[1] else []
            of_lane = {n: draw(lanes(n, stop - start, (first, last))) for n in here}
            sections += (
                f'<laneSection s="{start}"><left>{"".join(of_lane[n] for n in reversed(here) if n > 0)}</left><center>'
                f'<lane id="0" type="none" level="false">{draw(marks(stop - start))}</lane></center>'
                f"<right>{''.join(of_lane[n] for n in reversed(here) if n < 0)}</right></laneSection>"
            )
        offsets = draw(st.sampled_from(("", cubic("laneOffset", "s", 0.0, 0.5, 0.02, 0.0002, 0.0))))
        heights = draw(st.sampled_from(("", cubic("elevation", "s", 0.0, 3.0, 0.05, 0.0003, -0.00001))))
        placed = "".join(draw(signals(10 * index + n, length, of_sections[0])) for n in range(draw(st.integers(0, 2))))
        own = draw(st.sampled_from(("", ' rule="LHT"'))) if rule == "mixed" else rule
        roads.append(
            f'<road name="r" length="{length}" id="{id}" junction="{junction if inside else -1}"{own}>'
            f"<link>{link('predecessor', neighbours[0])}{link('successor', neighbours[1])}</link>"
            f'<type s="0" type="town"><speed max="50" unit="km/h"/></type>{plan}'
            f"<elevationProfile>{heights}</elevationProfile><lanes>{offsets}{sections}</lanes>"
            f"<objects/><signals>{placed}</signals></road>"
        )
        if inside:
            for end in neighbours:
                if end is not None and draw(st.booleans()):
                    pairs = [(draw(st.sampled_from(numbers[ids.index(end[1])][0])), n) for n in of_sections[0]]
                    joined = "".join(f'<laneLink from="{one}" to="{other}"/>' for one, other in pairs)
                    contact = "start" if end is neighbours[0] else "end"
                    connections += (
                        f'<connection id="{connections.count("</")}" incomingRoad="{end[1]}" connectingRoad="{id}"'
                        f' contactPoint="{contact}">{joined}</connection>'
                    )
    joining = f'<junction id="{junction}" name="j">{connections}</junction>' if has_junction else ""
    header = '<header revMajor="1" revMinor="5" name="" version="1" north="0" south="0" east="0" west="0"/>'
    return f'<?xml version="1.0"?><OpenDRIVE>{header}{"".join(roads)}{joining}</OpenDRIVE>'
