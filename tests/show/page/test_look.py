"""The look of the page: themes, narrow screens, long names, many incidents, print."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pytest

from tests.replay.scripts import spawn
from tests.show.page.conftest import record, report
from tests.show.page.pages import Page, emulated

if TYPE_CHECKING:
    from pathlib import Path

    from selenium.webdriver import Chrome

LONG = "vehicle." + "a_name_without_spaces" * 5
INCIDENTS = 120


@pytest.fixture(scope="module")
def crowded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page with many incidents, and long names."""
    frames: list[dict[str, Any]] = [
        {"transforms": [(id, 1000 * id, step, 0, 0, 0, 0) for id in range(1, 9)]} for step in range(INCIDENTS + 1)
    ]
    frames[0]["spawned"] = [spawn(id, LONG, role_name=LONG) for id in range(1, 9)]
    for step in range(1, INCIDENTS + 1):
        first = step % 7 + 1
        frames[step]["collisions"] = [(step, first, first + 1, 0, 0)]
    folder = tmp_path_factory.mktemp("crowded")
    return report(record(folder / "a.mcap", frames, tick=2), folder / "page.html")


def background(page: Page) -> str:
    return page.ask("getComputedStyle(document.querySelector('.incidents')).backgroundColor")


def corner(page: Page) -> list[int]:
    """Return the colour of the canvas in a corner."""
    return page.ask("[...replay.stage.context.getImageData(2, 2, 1, 1).data].slice(0, 3)")


def test_the_theme_is_that_of_the_system_until_the_switch_is_used(chromium: Chrome, crossing_page: Path) -> None:
    with emulated(chromium, scheme="light"):
        page = Page(chromium, crossing_page)
        assert background(page) == "rgb(255, 255, 255)"
        assert min(corner(page)) > 180
        page.click("#theme")
        assert max(corner(page)) < 80
        assert background(page) != "rgb(255, 255, 255)"
        assert page.ask("document.documentElement.dataset.theme") == "dark"
    with emulated(chromium, scheme="dark"):
        page = Page(chromium, crossing_page)
        assert max(corner(page)) < 80
        page.press("d")
        assert background(page) == "rgb(255, 255, 255)"


@pytest.mark.parametrize("width", [320, 390, 768, 1024])
def test_nothing_is_wider_than_the_screen(chromium: Chrome, crowded: Path, width: int) -> None:
    with emulated(chromium, size=(width, 700)):
        page = Page(chromium, crowded, "#incident=2&t=6")
        assert page.ask("document.documentElement.scrollWidth") == width
        rights = page.ask("[...document.querySelectorAll('.incident *')].map(node => node.getBoundingClientRect().right)")
        assert max(rights) <= width + 1
        assert page.ask("document.getElementById('caption').getBoundingClientRect().right") <= width
        assert page.errors == []


def test_the_longest_kind_of_incident_fits_into_the_list(chromium: Chrome, crossing_page: Path) -> None:
    with emulated(chromium, size=(1280, 900)):
        page = Page(chromium, crossing_page)
        page.browser.execute_script(
            "document.querySelectorAll('.badge span').forEach(name => (name.textContent = KINDS['wrong way'].name))"
        )
        assert page.ask("[replay.incidents.scroller].map(({scrollWidth, clientWidth}) => scrollWidth - clientWidth)") == [0]


def test_names_at_the_edges_are_inside_the_map(chromium: Chrome, tmp_path: Path) -> None:
    places = [(x, y) for x in range(-60, 61, 4) for y in (-30, 0, 30)]
    frame: dict[str, Any] = {
        "spawned": [spawn(id, "walker.pedestrian.0004") for id, _ in enumerate(places, 1)],
        "transforms": [(id, 100 * x, 100 * y, 0, 0, 0, 0) for id, (x, y) in enumerate(places, 1)],
    }
    page = Page(chromium, report(record(tmp_path / "a.mcap", [frame, frame]), tmp_path / "page.html"))
    page.browser.execute_script("replay.follow(null); Object.assign(replay.camera, { x: 0, y: 0, scale: 12 })")
    drawn = page.ask(
        "(() => { const { stage } = replay, texts = [], draw = stage.text;"
        "stage.text = (text, left) => texts.push([left, stage.context.measureText(text).width / 2]);"
        "stage.drawLabels(); stage.text = draw; return texts; })()"
    )
    width = page.ask("replay.camera.width")
    assert len(drawn) > 3
    assert all(half <= left <= width - half for left, half in drawn)


def test_many_marks_do_not_overlap(chromium: Chrome, crowded: Path) -> None:
    page = Page(chromium, crowded)
    boxes = "[...document.querySelectorAll('.mark')].map(mark => mark.getBoundingClientRect())"
    edges = page.ask(f"{boxes}.map(({{left, right}}) => [left, right])")
    assert 5 < len(edges) < 100
    assert all(before[1] < after[0] for before, after in pairwise(edges))
    counts = page.ask("[...document.querySelectorAll('.mark')].map(mark => Number(mark.textContent) || 1)")
    assert sum(counts) == INCIDENTS


def test_a_mark_of_several_opens_one_after_the_other(chromium: Chrome, crowded: Path) -> None:
    page = Page(chromium, crowded)
    assert "incidents; a click plays one after the other" in page.ask("document.querySelectorAll('.mark')[1].title")
    page.click(".mark", 1)
    first = page.ask("replay.incidents.current")
    page.click(".mark", 1)
    assert page.ask("replay.incidents.current") == first + 1


def test_print_is_light_and_has_all_pictures(chromium: Chrome, crossing_page: Path) -> None:
    page = Page(chromium, crossing_page)
    with emulated(chromium, media="print"):
        page.until(lambda: page.ask("theme.name") == "light")
        page.until(lambda: page.pictures == 4)
        assert page.ask("getComputedStyle(document.querySelector('.transport')).display") == "none"
        assert page.ask("getComputedStyle(document.body).overflow") == "visible"
    page.until(lambda: not page.ask("theme.printing"))
