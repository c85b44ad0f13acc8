"""A recording in a notebook."""

from __future__ import annotations

import math
import re
from html import escape
from xml.etree import ElementTree

import pytest

from carla_recap import create_recording, open_recording
from tests.replay.scripts import pose, spawn, write
from tests.samples import CRASH


def drawing(html: str) -> ElementTree.Element:
    return ElementTree.fromstring(html[html.index("<svg") :])


@pytest.fixture(scope="module")
def shown():
    with open_recording(CRASH) as recording:
        yield recording._repr_html_()


def test_a_recording_is_its_summary_and_a_drawing(shown):
    assert "Map: Brickfield" in shown
    assert "Incidents: 2 collisions, 2 long stops" in shown
    titles = [title.text for title in drawing(shown).iter("{http://www.w3.org/2000/svg}title")]
    assert titles[0] == "12.10 s: hero collides with walker.pedestrian.0004 (44)"
    assert len(titles) == 4


def test_the_hero_has_the_widest_line_and_the_incident_lies_on_it(shown):
    svg = drawing(shown)
    lines = list(svg.iter("{http://www.w3.org/2000/svg}polyline"))
    (hero,) = [line for line in lines if line.get("stroke-width") == "3.0"]
    assert len(lines) > 5
    points = [tuple(map(float, point.split(","))) for point in hero.get("points").split()]
    first = next(svg.iter("{http://www.w3.org/2000/svg}circle"))
    x, y = float(first.get("cx")), float(first.get("cy"))
    assert min(points)[0] < x < max(points)[0]
    assert abs(y - points[0][1]) < 3


def test_all_points_are_inside(shown):
    svg = drawing(shown)
    width, height = float(svg.get("width")), float(svg.get("height"))
    assert max(width / 640, height / 400) == pytest.approx(1, abs=0.01)
    for x, y in re.findall(r"([\d.-]+),([\d.-]+)", shown[shown.index("<svg") :]):
        assert 0 <= float(x) <= width
        assert 0 <= float(y) <= height


def test_an_actor_that_is_listed_in_the_place_of_another_is_not_taken_for_it(tmp_path):
    rows = [{"transforms": [pose(7 if number < 40 else 8, 100.0 * number, 0.0)]} for number in range(80)]
    rows[0]["spawned"] = [spawn(7), spawn(8, "static.prop.mesh")]
    with open_recording(write(tmp_path / "relay.log", rows)) as recording:
        (line,) = drawing(recording._repr_html_()).iter("{http://www.w3.org/2000/svg}polyline")
    assert len(line.get("points").split()) == 40


def test_names_are_escaped_and_a_recording_without_movement_has_no_drawing(tmp_path):
    path = tmp_path / "a<b>.mcap"
    with create_recording(path, map_name="<i>Town\x1b[31m") as recorder:
        for time in (0.0, 0.1):
            recorder.add_frame(time, spawned=[] if time else [spawn(7)], transforms=[(7, 100.0, 0.0, 0.0, 0.0, 0.0, 0.0)])
    with open_recording(path) as recording:
        html = recording._repr_html_()
    assert "a&lt;b&gt;.mcap" in html
    assert "&lt;i&gt;Town" in html
    assert "<svg" not in html
    assert "\x1b" not in html
    assert recording._repr_html_() == escape(repr(recording))


def test_names_in_a_drawing_are_escaped(tmp_path):
    rows = [{"transforms": [pose(id, 100.0 * number, 500.0 * id) for id in (7, 8)]} for number in range(40)]
    rows[0]["spawned"], rows[20]["collisions"] = [spawn(7, "vehicle.<b>\x1b"), spawn(8)], [(0, 7, 8, 0, 0)]
    with open_recording(write(tmp_path / "hit.log", rows)) as recording:
        (title,) = drawing(recording._repr_html_()).iter("{http://www.w3.org/2000/svg}title")
    assert title.text == r"20.00 s: vehicle.<b>\x1b (7) collides with vehicle.audi.tt (8)"


def test_long_paths_are_drawn_once_where_they_repeat(tmp_path):
    angles = [2 * math.pi * number / 40 for number in range(1000)]
    rows = [
        {"transforms": [pose(id, 1000 * id * math.cos(angle), 1000 * id * math.sin(angle)) for id in range(1, 31)]}
        for angle in angles
    ]
    rows[0]["spawned"] = [spawn(id) for id in range(1, 31)]
    with open_recording(write(tmp_path / "circles.log", rows)) as recording:
        html = recording._repr_html_()
    assert len(html) < 400_000
    lines = [line.get("points").split() for line in drawing(html).iter("{http://www.w3.org/2000/svg}polyline")]
    assert 30 * 40 <= sum(map(len, lines)) < 3000  # of 30,000
