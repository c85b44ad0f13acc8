"""Maps that cost time and memory: each is refused in one line, or works, in less than 20 s and 500 MB."""

from __future__ import annotations

import subprocess
import sys
from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from tests.roads.towns import crossing, lane, opendrive, road, section
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

pytest.importorskip("resource", reason="Windows has no limits of resources")

MOST_SECONDS = 20
MOST_MEGABYTES = 500
LOAD = """
import resource, sys
from carla_recap import RecapError
from carla_recap.rendering.town import load_town_mesh
from carla_recap.roads import load_map, load_road_network
from carla_recap.sim.town.rules import Rules
from carla_recap.sim.town.town import load_town

def drive(path):
    Rules(load_town(path))

for load in (load_map, load_road_network, drive, load_town_mesh):
    try:
        load(sys.argv[1])
        print("works")
    except RecapError as error:
        print(error)
used = resource.getrusage(resource.RUSAGE_SELF)
print(used.ru_utime + used.ru_stime, used.ru_maxrss / 1024)
"""


def linked(number: int, count: int) -> str:
    """Return a road of 2 cm in a ring of roads that follow each other, with a light."""
    before, after = ((number + step) % count + 1 for step in (-2, 0))
    links = f'<predecessor elementType="road" elementId="{before}"/><successor elementType="road" elementId="{after}"/>'
    light = '<signal id="1" s="0.01" t="-3" zOffset="0" hOffset="0" orientation="+" type="1000001" value="-1"/>'
    follows = '<link><predecessor id="-1"/><successor id="-1"/></link></lane>'
    one = road(number, x=0.02 * number, length=0.02, sections=section(0, right=lane(-1).replace("</lane>", follows)))
    return one.replace("<planView>", f"<link>{links}</link><planView>").replace(
        "</road>", f"<signals>{light}</signals></road>"
    )


def entities() -> str:
    names = "abcdefghij"
    each = "".join(f'<!ENTITY {name} "{10 * f"&{before};"}">' for before, name in pairwise(names))
    return f'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">{each}]><OpenDRIVE><x>&j;</x></OpenDRIVE>'


MAPS: dict[str, Callable[[], str]] = {
    "a road of 10⁷ m": lambda: opendrive(road(length=1e7)),
    "roads of 10⁷ m together": lambda: opendrive(*(road(number, y=10 * number, length=4e4) for number in range(1, 251))),
    "a road of 40 km": lambda: opendrive(road(length=4e4)),
    "a spiral of curvature 10⁶": lambda: opendrive(road(length=1e3, shape='<spiral curvStart="0" curvEnd="1e6"/>')),
    "a narrow spiral": lambda: opendrive(road(length=1e4, shape='<spiral curvStart="-50" curvEnd="90"/>')),
    "200,000 roads": lambda: opendrive(*(road(number, x=10 * number) for number in range(1, 200_001))),
    "10⁶ sections": lambda: opendrive(road(sections='<laneSection s="0"/>' * 1_000_000)),
    "many sections": lambda: opendrive(
        *(road(n, y=10 * n, sections="".join(section(i / 20, right=lane(-1)) for i in range(2000))) for n in range(1, 6))
    ),
    "10⁶ empty elements": lambda: opendrive(road(), "<a/>" * 1_000_001),
    "deep elements": lambda: opendrive(road(), "<a>" * 300_000 + "</a>" * 300_000),
    "entities": entities,
    "cut": lambda: opendrive(*(road(number) for number in range(1000)))[:-1000],
    "not a number": lambda: opendrive(road(length="nan"), road(2, x="nan"), road(3, sections=section(0, lane(1, "nan")))),
    "negative lengths": lambda: opendrive(road(length=-1e9), road(2).replace('length="100"', 'length="-100"')),
    "a ring of links": lambda: opendrive(*(linked(number, 300) for number in range(1, 301))),
    "many lanes in a junction": lambda: opendrive(*(road(n, y=n / 100, length=50, junction=5) for n in range(1, 1001))),
    "many sidewalks at one place": lambda: opendrive(
        *(road(n, length=3, sections=section(0, lane(1), lane(-1) + lane(-2, 2, "sidewalk"))) for n in range(1, 1501))
    ),
    "many crossings": lambda: opendrive(*(road(n, y=20 * n, inside=crossing(50) * 50) for n in range(1, 11))),
}


@pytest.mark.parametrize("text", MAPS.values(), ids=MAPS)
def test_a_hostile_map_costs_little(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: Callable[[], str]) -> None:
    monkeypatch.setenv("CARLA_RECAP_CACHE", "")
    path = tmp_path / "hostile.xodr"
    path.write_text(text(), "utf-8")
    done = subprocess.run(
        [sys.executable, "-c", LOAD, path], capture_output=True, text=True, timeout=4 * PATIENCE, check=False
    )
    assert done.stderr == ""
    *outcomes, used = done.stdout.splitlines()
    assert len(outcomes) == 4
    assert all(outcome == "works" or outcome.startswith(f"{path}: an OpenDRIVE map was expected") for outcome in outcomes)
    seconds, megabytes = map(float, used.split())
    assert seconds < 4 * MOST_SECONDS
    assert megabytes < MOST_MEGABYTES
