"""Two recordings in a page: one clock, the same actors followed in both, side by side or over each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from carla_recap import RecapError, open_recording
from carla_recap.show.page import write_report
from tests.replay.scripts import spawn
from tests.samples import names_in
from tests.show.page.conftest import WITHOUT_ROADS, record
from tests.show.page.pages import Page, emulated

if TYPE_CHECKING:
    from pathlib import Path

    from selenium.webdriver import Chrome

STEPS = 120  # of 0.05 s


def driven(path: Path, *, hero: int, brakes_at: float | None, hits: bool, map_name: str = "Town01") -> Path:
    """Write a recording of a hero that drives at 10 m/s to a truck 40 m ahead, and of a walker."""
    truck, walker = hero + 1, hero + 2
    x, speed, frames = 0.0, 10.0, []
    for step in range(STEPS):
        time = step * 0.05
        if brakes_at is not None and time > brakes_at:
            speed = max(0.0, speed - 5 * 0.05)
        if x > 3500 and hits:
            speed = 0.0
        x += speed * 5
        frames.append({"transforms": [(hero, x, 0, 0, 0, 0, 0), (truck, 4000, 0, 0, 0, 0, 0), (walker, 0, 900, 0, 0, 0, 0)]})
        if hits and speed == 0 and not any("collisions" in frame for frame in frames):
            frames[-1]["collisions"] = [(0, hero, truck, 1, 0)]
    frames[0] |= {
        "spawned": [spawn(hero, role_name="hero"), spawn(truck, "vehicle.carlamotors.firetruck"), spawn(walker, "walker.a")]
    }
    return record(path, frames, map_name=map_name)


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("compared")
    crash = driven(folder / "crash.mcap", hero=5, brakes_at=None, hits=True)
    avoided = driven(folder / "avoided.mcap", hero=8, brakes_at=1.0, hits=False, map_name="Carla/Maps/Town01_Opt")
    return compare(crash, avoided, folder / "page.html")


def compare(first: Path, second: Path, page: Path, **options: Any) -> Path:
    with open_recording(first) as one, open_recording(second) as other:
        write_report(one, page, WITHOUT_ROADS, other=other, **options)
    return page


def test_both_maps_show_the_same_actor_at_the_same_time(chromium: Chrome, compared: Path) -> None:
    page = Page(chromium, compared, "#t=3")
    assert page.ask("replay.followed") == [5, 8]
    xs = page.ask("replay.followedPoses().map(pose => pose.x)")
    assert xs[0] > xs[1] + 5
    assert page.ask("replay.active.map(stage => stage.camera.x)") == pytest.approx(xs)
    assert page.ask("[...document.querySelectorAll('.pane')].map(pane => pane.hidden)") == [False, False]
    apart = float(page.text("apart").removesuffix(" m apart"))
    assert apart == pytest.approx(xs[0] - xs[1], abs=0.06)
    assert page.errors == []


def test_the_time_from_which_they_differ_is_shown(chromium: Chrome, compared: Path) -> None:
    page = Page(chromium, compared)
    assert page.ask("replay.recording.report.differences.since") == pytest.approx(1.5, abs=0.2)
    assert page.text("difference").startswith("The paths differ from 1.")
    assert page.ask("document.querySelectorAll('#covered .difference').length") == 1


def test_both_lists_of_incidents_are_shown(chromium: Chrome, compared: Path) -> None:
    page = Page(chromium, compared)
    assert page.ask("document.querySelectorAll('#list .incident').length") == 1
    assert page.ask("document.querySelectorAll('#other-list .incident').length") == 0
    assert "There are no incidents" in page.text("lists")
    page.browser.execute_script("replay.clock.pace = 0.1")  # so that it plays still when it is asked
    page.click(".incident")
    assert page.ask("[replay.followed, replay.clock.playing]") == [[5, 8], True]
    page.until(lambda: page.text("caption-text") == "A: hero collides with vehicle.carlamotors.firetruck (6)")


def test_the_switch_lays_one_over_the_other(chromium: Chrome, compared: Path) -> None:
    page = Page(chromium, compared, "#t=3")
    page.click("#over")
    page.until(lambda: page.ask("replay.stage.ghosts.length") == 1)
    assert page.ask("replay.stage.ghosts.map(one => replay.stage.ghost.tracks.actors[one.actor].id)") == [8]
    assert page.ask("[...document.querySelectorAll('.pane')].map(pane => pane.hidden)") == [False, True]
    assert page.text("pane-name") == "Acrash.mcapBavoided.mcap"
    page.press("c")
    assert [page.text(name) for name in ("pane-name", "other-pane-name")] == ["Acrash.mcap", "Bavoided.mcap"]
    assert page.ask("[...document.querySelectorAll('.pane')].map(pane => pane.hidden)") == [False, False]
    page.until(lambda: page.browser.current_url.endswith("#t=3&follow=5"))
    assert Page(chromium, compared, "#t=3&view=over").ask("replay.mode") == "over"
    assert page.errors == []


def test_both_views_have_the_same_scale_on_a_narrow_screen(chromium: Chrome, compared: Path) -> None:
    with emulated(chromium, size=(390, 800)):
        page = Page(chromium, compared)
        assert page.ask("replay.mode") == "over"
        page.click("#beside")
        scales = page.ask("replay.stages.map(({camera}) => camera.scale)")
        assert scales[0] == scales[1] > 2
        assert page.ask("document.documentElement.scrollWidth") == 390
        assert page.errors == []


def test_moving_one_view_moves_both(chromium: Chrome, compared: Path) -> None:
    from selenium.webdriver import ActionChains

    page = Page(chromium, compared)
    canvas = page.browser.find_element("id", "other-canvas")
    ActionChains(page.browser).move_to_element_with_offset(canvas, -100, 60).click_and_hold().move_by_offset(
        60, 20
    ).release().perform()
    assert page.ask("replay.followed") is None
    cameras = page.ask("replay.stages.map(({camera}) => [camera.x, camera.y, camera.scale])")
    assert cameras[0] == cameras[1]


def test_recordings_of_different_maps_are_refused(tmp_path: Path) -> None:
    one = driven(tmp_path / "a.mcap", hero=1, brakes_at=None, hits=False)
    other = driven(tmp_path / "b.mcap", hero=1, brakes_at=None, hits=False, map_name="Town02")
    with pytest.raises(RecapError, match=r"is of the map Town01, .* of Town02; recordings of one map were expected"):
        compare(one, other, tmp_path / "page.html")
    with pytest.raises(RecapError, match="goes with a folder and one recording"):
        compare(one, one, tmp_path / "page", viewer=True)
    assert names_in(tmp_path) == ["a.mcap", "b.mcap"]


def test_given_differences_say_which_actors_are_the_same(chromium: Chrome, tmp_path: Path) -> None:
    crash = driven(tmp_path / "crash.mcap", hero=5, brakes_at=None, hits=True)
    avoided = driven(tmp_path / "avoided.mcap", hero=8, brakes_at=1.0, hits=False)
    with open_recording(crash) as one, open_recording(avoided) as other:
        found = one.diff(other)
        write_report(one, tmp_path / "page.html", WITHOUT_ROADS, other=other, differences=found)
    page = Page(chromium, tmp_path / "page.html", "#t=3")
    assert page.text("difference") == f"{found.reasons[0].capitalize()}."
    assert page.ask("replay.mode") == "over"
    twins = page.ask(
        "[...replay.recordings[0].twins].map(([own, other]) => "
        "[replay.recordings[0].tracks.actors[own].id, replay.recordings[1].tracks.actors[other].id])"
    )
    assert sorted(twins) == [[5, 8], [6, 9], [7, 10]]
    assert page.ask("replay.actors.entries.map(({recording}) => recording.letter).join('')") == "AAA"  # each is listed once
    assert page.ask("document.querySelectorAll('#covered .difference').length") == 1
    assert page.errors == []
