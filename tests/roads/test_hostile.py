"""Maps that cost time and memory: each is refused in one line, or works, in less than 10 s and 500 MB."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.roads.towns import crossing, lane, opendrive, road, section
from tests.waiting import PATIENCE, time_limit

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

if not Path("/proc/self/status").exists():
    pytest.skip("only Linux says how much memory a process had", allow_module_level=True)

MOST_SECONDS = 10
MOST_MEGABYTES = 500
LOADER = """
import json, os, resource, sys
from pathlib import Path
from carla_recap import RecapError
from carla_recap.server.snapshots import LightsAhead
from carla_recap.town.mesh import load_town_mesh
from carla_recap.roads import load_map, load_road_network
from carla_recap.sim.town.loading import load_town

def load_rules(path):
    town = load_town(path)
    LightsAhead(town)

def outcome(name, path):
    try:
        globals()[name](path)
        return "works"
    except RecapError as error:
        return str(error)

for line in sys.stdin:
    path, *names = json.loads(line)
    if os.fork():
        _, status = os.wait()
        assert not status, f"the process of {path} ended with {status}"
        continue
    found = [outcome(name, path) for name in names]
    used = resource.getrusage(resource.RUSAGE_SELF)
    most = Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]
    print(json.dumps([found, used.ru_utime + used.ru_stime, int(most) / 1024]), flush=True)
    os._exit(0)
"""


@pytest.fixture(scope="module")
def loader() -> Iterator[subprocess.Popen[str]]:
    """Return a process that has the modules, and forks one for each map, of which the costs are examined."""
    with subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", LOADER],  # of a fork in spite of numpy's threads, and of limits
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"CARLA_RECAP_CACHE": "", "OPENBLAS_NUM_THREADS": "1"},
    ) as process:
        yield process
        _, errors = process.communicate(timeout=PATIENCE)
    assert errors == ""


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


MANY_LANES = [
    road(
        n, x=n % 70 * 100, y=n // 70 * 40, length=90, sections=section(0, lane(2) + lane(1), lane(-1) + lane(-2) + lane(-3))
    )
    for n in range(1, 4101)
]


def tag(attributes: int) -> str:
    return "<a " + " ".join(f'b{number}=""' for number in range(attributes)) + "/>"


def many_arcs() -> str:
    arc = '<geometry s="{0}" x="{0}" y="0" hdg="0" length="2"><arc curvature="{1}"/></geometry>'
    arcs = "".join(arc.format(2 * number, 0.1 * (-1) ** number) for number in range(20_000))
    whole = road(length=40_000)
    start, end = whole.index("<geometry"), whole.index("</planView>")
    return opendrive(whole[:start] + arcs + whole[end:])


def many_spirals() -> str:
    return opendrive(*(road(n, length=200, shape='<spiral curvStart="-0.1" curvEnd="0.2"/>') for n in range(1, 2001)))


def entities() -> str:
    names = "abcdefghij"
    each = "".join(f'<!ENTITY {name} "{10 * f"&{before};"}">' for before, name in pairwise(names))
    return f'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">{each}]><OpenDRIVE><x>&j;</x></OpenDRIVE>'


REFUSED: dict[str, tuple[str, Callable[[], str]]] = {
    "a road of 10⁷ m": ("road '1': roads of at most 40 km, and one is 10,000 km long", lambda: opendrive(road(length=1e7))),
    "roads of 10⁷ m together": (
        "at most 4,000,000 m of lanes, and it has 4,080,000 and more",
        lambda: opendrive(*(road(number, y=10 * number, length=4e4) for number in range(1, 251))),
    ),
    "many roads": (
        "at most 16,000 roads, and it has 16,001 and more",
        lambda: opendrive(*(road(number, x=10 * number) for number in range(1, 20_001))),
    ),
    "a road of many sections": (
        "at most 200,000 elements in a road or junction, and one has more",
        lambda: opendrive(road(sections='<laneSection s="0"/>' * 200_000)),
    ),
    "many sections": (
        "at most 20,000 sections of lanes, and it has 22,000 and more",
        lambda: opendrive(
            *(
                road(n, y=10 * n, sections="".join(section(i / 20, right=lane(-1)) for i in range(2000)))
                for n in range(1, 12)
            )
        ),
    ),
    "many empty elements": ("at most 4,000,000 elements, and it has more", lambda: opendrive(road(), "<a/>" * 4_000_000)),
    "a tag without an end": (
        "tags of at most 1 MB, and one is longer",
        lambda: opendrive(road(), f'<a b="{"x" * 10_000_000}"/>'),
    ),
    "many attributes": (
        "at most 100 attributes of an element, and a 'a' has 50,000",
        lambda: opendrive(road(), tag(50_000)),
    ),
    "many names": (
        "at most 10,000 names of elements and attributes, and it has more",
        lambda: opendrive(road(), "".join(f"<a{n}/>" for n in range(20_000))),
    ),
    "a road of many attributes": (
        "at most 16 MB of a road or junction, and one has more",
        lambda: opendrive(road(inside=tag(100) * 50_000)),
    ),
    "lanes far beside the road": (
        "road '1': laneOffset: expected what a road has",
        lambda: opendrive(
            road(length=1e3, sections='<laneOffset s="0" a="10" b="10" c="-10" d="10"/>' + section(0, lane(1), lane(-1)))
        ),
    ),
    "a curve that leads away": (
        "road '1': paramPoly3: expected a curve that a road has",
        lambda: opendrive(road(length=1e3, shape='<paramPoly3 pRange="normalized" bU="1e5" cU="1e5" bV="1e5" dV="-1e5"/>')),
    ),
    "a curve around a point": (
        "road '1': arc: expected a curve that a road has",
        lambda: opendrive(road(length=3.9e4, shape='<arc curvature="99"/>')),
    ),
    "a slope to the sky": (
        "road '1': elevation: expected what a road has",
        lambda: opendrive(road(length=3e4).replace('b="0" c="0" d="0"', 'b="1e3" c="1e3" d="1e3"', 1)),
    ),
    "entities": ("it declares entities, which no map does", entities),
    "many lanes in a junction": (
        "at most 500 lanes in a junction such as '5', and it has 502 and more",
        lambda: opendrive(*(road(n, y=n / 100, length=50, junction=5) for n in range(1, 300))),
    ),
}
"""Maps that the reader refuses, or which have no lane: it is the same for all that is made of a map."""

MAPS: dict[str, tuple[tuple[str, ...], Callable[[], str]]] = {
    "a road of 40 km": (("load_rules", "load_town_mesh"), lambda: opendrive(road(length=4e4))),
    "a narrow spiral": (
        ("load_map", "load_rules", "load_road_network", "load_town_mesh"),
        lambda: opendrive(road(length=1e3, shape='<spiral curvStart="-0.05" curvEnd="0.09"/>')),
    ),
    "many lanes": (("load_road_network",), lambda: opendrive(*MANY_LANES[:2000])),
    "many lanes in a town": (("load_rules", "load_town_mesh"), lambda: opendrive(*MANY_LANES)),
    "many spirals at one place": (("load_road_network",), many_spirals),
    "spirals above each other": (("load_town_mesh",), many_spirals),
    "a road of many arcs": (("load_road_network",), many_arcs),
    "a ring of links": (
        ("load_road_network", "load_rules"),
        lambda: opendrive(*(linked(number, 200) for number in range(1, 201))),
    ),
    "many sidewalks at one place": (
        ("load_rules", "load_town_mesh"),
        lambda: opendrive(
            *(road(n, length=3, sections=section(0, lane(1), lane(-1) + lane(-2, 2, "sidewalk"))) for n in range(1, 401))
        ),
    ),
    "many crossings": (
        ("load_rules", "load_town_mesh"),
        lambda: opendrive(*(road(n, y=20 * n, inside=crossing(50) * 50) for n in range(1, 11))),
    ),
}


@pytest.mark.parametrize(("reason", "text"), REFUSED.values(), ids=REFUSED)
def test_a_hostile_map_is_refused_at_little_cost(
    loader: subprocess.Popen[str], tmp_path: Path, reason: str, text: Callable[[], str]
) -> None:
    (outcome,) = outcomes(loader, tmp_path / "hostile.xodr", text(), "load_road_network")
    assert outcome != "works"
    assert reason in outcome


@pytest.mark.parametrize(("loaders", "text"), MAPS.values(), ids=MAPS)
def test_a_hostile_map_costs_little(
    loader: subprocess.Popen[str], tmp_path: Path, loaders: tuple[str, ...], text: Callable[[], str]
) -> None:
    assert len(outcomes(loader, tmp_path / "hostile.xodr", text(), *loaders)) == len(loaders)


def outcomes(loader: subprocess.Popen[str], path: Path, text: str, *functions: str) -> list[str]:
    """Return what is said of a map by each function that loads it."""
    path.write_text(text, "utf-8")
    assert loader.stdin is not None
    assert loader.stdout is not None
    assert loader.stderr is not None
    print(json.dumps([str(path), *functions]), file=loader.stdin, flush=True)
    with time_limit():
        answer = loader.stdout.readline()
    assert answer, loader.stderr.read()
    found, seconds, megabytes = json.loads(answer)
    assert all(outcome == "works" or outcome.startswith(f"{path}: an OpenDRIVE map was expected") for outcome in found)
    assert seconds < MOST_SECONDS
    assert megabytes < MOST_MEGABYTES
    return list(map(str, found))
