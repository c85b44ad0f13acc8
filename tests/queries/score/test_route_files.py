"""Route files: those of both versions of the Leaderboard, and hostile ones."""

from __future__ import annotations

import re
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import pytest

from carla_recap.errors import RecapError
from carla_recap.formats import open_reader
from carla_recap.queries.score import Route, read_routes, route_for
from carla_recap.queries.score.route_files import repetition
from tests.samples import CRASH, save


def position(x: object, y: object = 0.0, z: object = 0.0) -> str:
    return f'<position x="{x}" y="{y}" z="{z}"/>'


def route(*positions: str, id: str = "1", town: str = "Brickfield", inside: str = "") -> str:
    return f'<route id="{id}" town="{town}"><waypoints>{"".join(positions)}</waypoints>{inside}</route>'


def routes(*each: str) -> str:
    return f"<routes>{''.join(each)}</routes>"


TWO = (position(255, -1.75), position(155, -1.75))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "routes.xml"


def test_a_route_has_its_positions_in_right_handed_axes(file: Path) -> None:
    scenarios = '<scenarios><scenario name="A_1" type="ControlLoss"><trigger_point x="1" y="2"/></scenario></scenarios>'
    file.write_text(routes(route(*TWO, id="7", inside=scenarios)))
    (found,) = read_routes(file)
    assert (found.id, found.town, found.scenarios, found.path) == ("7", "Brickfield", ("ControlLoss",), str(file))
    assert found.positions.tolist() == [[255.0, 1.75, 0.0], [155.0, 1.75, 0.0]]


def test_routes_of_version_1_have_waypoints(file: Path) -> None:
    waypoints = "".join(f'<waypoint x="{x}" y="2" z="0" pitch="0" roll="0" yaw="90"/>' for x in (1, 2))
    file.write_text(f'<?xml version="1.0"?><routes><route id="0" town="Town01">{waypoints}</route></routes>')
    assert read_routes(file)[0].positions.tolist() == [[1.0, -2.0, 0.0], [2.0, -2.0, 0.0]]


def bomb() -> str:
    names = "abcdefghij"
    each = "".join(f'<!ENTITY {name} "{10 * f"&{before};"}">' for before, name in pairwise(names))
    return f'<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">{each}]><routes>&j;</routes>'


HOSTILE = {
    "not XML": ("nothing", "the XML is invalid: syntax error: line 1, column 0"),
    "another root": ("<OpenDRIVE/>", "the root element is 'OpenDRIVE'"),
    "cut off": ("<routes><route id='1' town='T'>", "the XML is invalid: no element found: line 1, column 31"),
    "a billion laughs": (bomb(), "it declares entities, which no route file does"),
    "an external entity": (
        '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><routes>&a;</routes>',
        "it declares entities, which no route file does",
    ),
    "no id": (routes(route(*TWO, id="")), "a route has no id"),
    "no town": (routes(route(*TWO, town="")), "route '1' has no town"),
    "no positions": (routes(route()), "2 to 2,000 positions of a route, and route '1' has 0"),
    "a word": (routes(route(position(1), position(1, y="north"))), "position 2 of route '1' has a number y of at most"),
    "a huge number": (routes(route(position(1), position(1, z="1e300"))), "1,000,000 m, and it is '1e300'"),
    "deep elements": (
        routes("<route id='1' town='T'>" + "<a>" * 100_001 + "</a>" * 100_001 + "</route>"),
        "at most 100,000 elements in a route, and one has more",
    ),
    "many routes": (routes(*[route(*TWO)] * 10_001), "at most 10,000 routes, and it has more"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused_in_a_line(name: str, file: Path) -> None:
    text, expected = HOSTILE[name]
    file.write_text(text)
    with pytest.raises(RecapError, match=re.escape(expected)) as error:
        read_routes(file)
    assert str(error.value).startswith(f"{file}: ")
    assert str(error.value).isprintable()


def route_of(recording: Path, file: Path | tuple[Path, ...], name: str | None = None) -> Route:
    with closing(open_reader(recording)) as reader:
        return route_for(read_routes(*(file if isinstance(file, tuple) else (file,))), reader, name)


@pytest.mark.parametrize(
    ("given", "recording", "name", "found"),
    [
        ({"3": "Brickfield", "4": "Town01"}, "drive.mcap", None, "3"),  # the only one of the town
        ({"3": "Brickfield", "4": "Town01"}, "drive.mcap", "3", "3"),
        ({"3": "Brickfield", "4": "Town01"}, "drive.mcap", "5", r"there is no route '5'; it has 3, 4"),
        (
            {"3": "Brickfield", "4": "Town01"},
            "drive.mcap",
            "4",
            r"of the map 'Brickfield', and the route of .* is of Town01",
        ),
        ({"3": "Brickfield", "4": "Brickfield"}, "drive.mcap", None, r"has 2 routes for .*; --route-id names one of 3, 4"),
        ({"3": "Brickfield", "4": "Brickfield"}, "RouteScenario_4_rep2.mcap", None, "4"),
        ({"5": "Brickfield"}, "RouteScenario_4_rep2.mcap", None, r"the name says route '4'; .*routes.xml has 5"),
        ({"5": "Brickfield"}, "RouteScenario_4_rep2.mcap", "5", "5"),
    ],
)
def test_the_route_of_a_recording(
    file: Path, tmp_path: Path, given: dict[str, str], recording: str, name: str | None, found: str
) -> None:
    file.write_text(routes(*(route(*TWO, id=id, town=town) for id, town in given.items())))
    save(tmp_path / recording, CRASH.read_bytes())
    if len(found) == 1:
        assert route_of(tmp_path / recording, file, name).id == found
    else:
        with pytest.raises(RecapError, match=found):
            route_of(tmp_path / recording, file, name)
    assert repetition(recording) == (2 if "_rep2" in recording else 0)


def test_of_several_files_that_of_the_town_or_beside_the_recording_counts(file: Path, tmp_path: Path) -> None:
    paths = [file, *(tmp_path / name / "routes.xml" for name in ("other", "again", "far"))]
    for path in paths:
        path.parent.mkdir(exist_ok=True)
        path.write_text(routes(route(*TWO, id="3", town="Town01" if path.parent.name == "far" else "Brickfield")))
    _, other, again, far = paths
    path = save(tmp_path / "drive.mcap", CRASH.read_bytes())
    assert route_of(path, (other, file, far)).path == str(file)
    assert route_of(path, (other, far), "3").path == str(other)
    assert len(read_routes(file, file)) == 1
    with pytest.raises(RecapError, match=re.escape(f"expected one route '3', found 2: in {other}, {again}")):
        route_of(path, (other, again))
