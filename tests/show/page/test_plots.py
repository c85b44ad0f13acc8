"""The plots: speed, acceleration and the gap ahead of the followed actor."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from tests.replay.scripts import spawn
from tests.show.page.conftest import record, report
from tests.show.page.pages import Page

if TYPE_CHECKING:
    from pathlib import Path

    from selenium.webdriver import Chrome


def series(page: Page, id: int) -> dict[str, Any]:
    """Return the series of an actor, with None where there is no value."""
    found = page.ask(
        f"(({{values, leader}}) => Object.entries({{...values, leader}}).map(([name, all]) => [name, [...all]]))"
        f"(replay.recording.motion.series(replay.tracks.indexOf({id}, 0)))"
    )
    return dict(found)


@pytest.fixture(scope="module")
def followed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A car that accelerates with 2 m/s² towards a truck 50 m ahead, with another car in the next lane."""
    folder = tmp_path_factory.mktemp("plots")
    times = np.arange(80) * 0.05
    frames: list[dict[str, Any]] = [
        {"transforms": [(1, 100 * t * t, 0, 0, 0, 0, 0), (2, 5000, 0, 0, 0, 0, 0), (3, 2000, 350, 0, 0, 0, 0)]}
        for t in times.tolist()
    ]
    frames[0]["spawned"] = [spawn(1, role_name="hero"), spawn(2, "vehicle.truck"), spawn(3)]
    return report(record(folder / "a.mcap", frames), folder / "page.html")


def test_the_card_the_reading_and_the_plot_have_one_speed_at_the_start(chromium: Chrome, tmp_path: Path) -> None:
    frames: list[dict[str, Any]] = [{"transforms": [(1, 10 * n, 0, 0, 0, 0, 0)]} for n in range(20)]
    frames[0]["spawned"] = [spawn(1, role_name="hero")]
    page = Page(chromium, report(record(tmp_path / "a.mcap", frames), tmp_path / "page.html"))
    assert page.time == 0
    assert page.text("speed") == page.ask("document.querySelector('#readings output').textContent") == "7"
    assert series(page, 1)["speed"][0] == pytest.approx(2, abs=0.01)


def test_an_unknown_speed_is_not_shown_as_a_standstill(chromium: Chrome, tmp_path: Path) -> None:
    frame = {"transforms": [(1, 0, 0, 0, 0, 0, 0)], "spawned": [spawn(1, role_name="hero")]}
    page = Page(chromium, report(record(tmp_path / "a.mcap", [frame]), tmp_path / "page.html"))
    assert page.text("speed") == "\N{EN DASH}"


def test_of_an_actor_that_is_not_measured_only_the_speed_is_plotted(chromium: Chrome, followed: Path) -> None:
    page = Page(chromium, followed)
    page.browser.execute_script("replay.follow(3)")
    page.until(lambda: page.text("readings").count("not measured") == 2)
    assert set(series(page, 3)["acceleration"]) == {None}
    assert series(page, 3)["speed"][0] == 0


def test_the_values_at_the_present_time_are_shown(chromium: Chrome, followed: Path) -> None:
    page = Page(chromium, followed)
    page.browser.execute_script("replay.clock.seek(3)")
    page.until(lambda: page.ask("document.querySelectorAll('#readings output')[0].textContent") == "22")
    assert "to truck 2" in page.text("readings")
    page.press("g")
    assert page.ask("[replay.plots.isOpen, document.getElementById('plots').offsetHeight]") == [False, 0]


def test_a_drag_on_the_plots_goes_to_a_time(chromium: Chrome, followed: Path) -> None:
    from selenium.webdriver import ActionChains

    page = Page(chromium, followed)
    canvas = page.browser.find_element("id", "plot")
    width = page.ask("replay.plots.width")
    away = int(width / 2 - canvas.size["width"] / 2)
    ActionChains(page.browser).move_to_element_with_offset(canvas, away, 0).click().perform()
    assert page.time == pytest.approx(page.ask("replay.part.length") / 2, abs=0.05)
    assert page.errors == []
