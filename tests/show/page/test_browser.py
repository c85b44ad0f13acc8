"""The page in a real browser."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from carla_recap import open_recording
from carla_recap.replay import Player, right_handed
from carla_recap.show.page import Opening
from tests.replay.scripts import spawn, write
from tests.samples import CROSSING, names_in
from tests.scene.accidents import accident
from tests.show.page.conftest import NASTY, data, record, report
from tests.show.page.pages import Page

if TYPE_CHECKING:
    from pathlib import Path

    from selenium.webdriver import Chrome


@pytest.fixture
def crossing(chromium: Chrome, crossing_page: Path) -> Page:
    return Page(chromium, crossing_page)


def test_the_list_contains_the_incidents(crossing: Page, crossing_page: Path) -> None:
    rows = crossing.ask(
        "[...document.querySelectorAll('.incident')].map(row => [row.dataset.kind, row.querySelector('.text').textContent])"
    )
    assert rows == [[one["kind"], one["text"]] for one in data(crossing_page, "report")["incidents"]]
    breaks = "[...document.querySelectorAll('.incident .text wbr')].map(each => each.previousSibling.textContent)"
    assert {part[-1] for part in crossing.ask(breaks)} == {"."}  # names break behind dots
    assert crossing.text("map") == "Crossing"
    assert "crossing.log" in crossing.text("origin")
    crossing.until(lambda: crossing.pictures == len(rows))
    assert crossing.errors == []


def test_a_click_plays_through_an_incident_and_follows_its_first_actor(crossing: Page, crossing_page: Path) -> None:
    crossing.browser.execute_script("replay.clock.pace = 0.01")  # so that it plays still whenever it is asked
    for index, incident in enumerate(data(crossing_page, "report")["incidents"]):
        crossing.click(".incident", index)
        assert crossing.ask("replay.clock.playing")
        assert incident["start"] - 3 <= crossing.time < incident["start"]
        assert crossing.ask("replay.camera.followed") == incident["actors"][0]
        assert crossing.ask("document.querySelectorAll('[aria-current]').length") == 1
        assert crossing.text("caption-text") in ("", incident["text"]) or index == 0
    goal = min(incident["stop"], incident["start"] + 6) + 3
    crossing.browser.execute_script("replay.clock.pace = 20")
    crossing.until(lambda: not crossing.ask("replay.clock.playing"))
    assert crossing.time == pytest.approx(goal)
    assert crossing.errors == []


def test_all_actors_have_the_poses_of_the_player(crossing: Page) -> None:
    with open_recording(CROSSING) as recording:
        player = Player(recording)
        for moment in (0.0, 3.33, 12.05, 20.9, 27.03, 41.77, 53.0):
            scene = player.at(moment)
            crossing.browser.execute_script("replay.clock.seek(arguments[0])", moment)
            for id, pose in zip(scene.ids.tolist(), right_handed(scene.poses), strict=True):
                shown = crossing.ask("replay.recording.poseOf(arguments[0], replay.clock.time)", id)
                assert [shown["x"], shown["y"]] == pytest.approx(pose[:2], abs=0.02), (moment, id)
                assert abs((np.degrees(shown["yaw"]) - pose[5] + 180) % 360 - 180) < 0.3
        assert crossing.ask("replay.recording.poseOf(104, replay.clock.time)") is not None
        crossing.browser.execute_script("replay.clock.seek(29)")
        assert crossing.ask(
            "[replay.recording.poseOf(104, replay.clock.time), replay.recording.poseOf(103, replay.clock.time)]"
        ) == [None, None]


def test_everything_works_with_the_keyboard(crossing: Page) -> None:
    from selenium.webdriver.common.keys import Keys

    crossing.press("n")
    assert crossing.ask("replay.clock.playing")
    crossing.press(" ")
    first = crossing.time
    assert first > 10
    crossing.press(Keys.ARROW_RIGHT)
    assert crossing.time == pytest.approx(first + 1)
    crossing.press(" ")
    assert crossing.ask("replay.clock.playing")
    crossing.press(" ", ">")
    assert crossing.ask("[replay.clock.playing, replay.clock.pace]") == [False, 2]
    crossing.press(Keys.ESCAPE)
    assert crossing.ask("replay.camera.followed") is None
    crossing.ask("document.querySelectorAll('.incident')[0].focus()")
    crossing.press(Keys.ARROW_DOWN, Keys.ENTER)
    assert crossing.ask("replay.incidents.current") == 1
    scale = crossing.ask("replay.camera.scale")
    crossing.press("+", "h", "?")
    assert crossing.ask("replay.camera.scale") > scale
    assert crossing.ask("[replay.camera.turns, document.getElementById('help').open]") == [True, True]
    assert crossing.errors == []


TIME, CURRENT = "replay.clock.time", "document.querySelector('[aria-current]')?.dataset.kind"


@pytest.mark.parametrize(
    ("script", "keys", "expression", "expected"),
    [
        ("replay.clock.seek(10)", "..", TIME, 10.2),
        ("replay.clock.seek(10)", ",", TIME, 9.9),
        ("replay.clock.seek(10)", "<<<<<", "replay.clock.pace", 0.1),
        ("replay.clock.seek(10)", ">>>>>>>>", "replay.clock.pace", 16),
        ("replay.clock.seek(53)", "p", CURRENT, "collision"),  # the latest one, as none is chosen
        ("document.querySelector('.filter[data-kind=collision]').click()", "nnn", CURRENT, "hard braking"),
        ("document.getElementById('time').focus()", "\ue010", TIME, 53),  # End: the last sample
        ("", "a\ue00c", "document.activeElement.id", "incidents-tab"),  # Escape leads from the search to the incidents
    ],
)
def test_keys(crossing: Page, script: str, keys: str, expression: str, expected: Any) -> None:
    crossing.browser.execute_script(script)
    crossing.press(*keys)
    assert crossing.ask(expression) == (pytest.approx(expected) if isinstance(expected, float) else expected)


@pytest.mark.parametrize("button", ["#trails", ".incident", "#pace"])
def test_space_plays_and_pauses_after_a_click_on_anything(crossing: Page, button: str) -> None:
    from selenium.webdriver.common.by import By

    element = crossing.browser.find_element(By.CSS_SELECTOR, button)
    if button == "#pace":
        crossing.browser.execute_script("arguments[0].focus(); arguments[0].dispatchEvent(new Event('change'))", element)
    else:
        element.click()
    crossing.browser.execute_script("replay.clock.seek(2); replay.clock.pause()")
    state = "[document.getElementById('trails').ariaPressed, replay.incidents.current, replay.clock.pace]"
    before = crossing.ask(state)
    crossing.press(" ")
    assert crossing.ask("replay.clock.playing")
    crossing.press(" ")
    assert not crossing.ask("replay.clock.playing")
    assert crossing.ask(state) == before


def test_marks_are_reached_and_pressed_by_the_keyboard_and_keep_the_focus(crossing: Page) -> None:
    from selenium.webdriver.common.keys import Keys

    crossing.browser.execute_script("document.getElementById('time').focus()")
    crossing.press(Keys.TAB, Keys.TAB)
    focused = "document.activeElement.dataset.incident"
    assert crossing.ask(focused) == "1"
    crossing.browser.execute_script("replay.part.zoom(2, 20)")  # the marks are made anew
    assert crossing.ask(focused) == "1"
    crossing.press(Keys.ENTER)
    assert crossing.ask("[replay.incidents.current, replay.clock.playing]") == [1, True]


def test_an_actor_is_found_and_followed_without_a_mouse(crossing: Page) -> None:
    from selenium.webdriver.common.keys import Keys

    shown = "[...document.querySelectorAll('#actor-list .actor')].map(one => one.querySelector('span').textContent)"
    crossing.press("a")
    everyone = crossing.ask(shown)
    assert "hero" in everyone[0]
    assert len(everyone) == 14  # all but the sensors and the spectator
    crossing.press(*"walker")
    assert len(crossing.ask(shown)) == 2
    crossing.press(Keys.ARROW_DOWN, Keys.ARROW_DOWN, Keys.ENTER)
    followed = crossing.ask("replay.followedActor().label")
    assert followed == crossing.ask(shown)[1]
    crossing.until(lambda: crossing.ask("document.querySelector('.actor[aria-current] span')?.textContent") == followed)
    assert crossing.ask("replay.focus(replay.stage)") is not None  # it is there at the time that is shown
    crossing.press("a")
    crossing.press(*"nobody")
    assert "No actor is found" in crossing.text("actors-note")
    crossing.press(Keys.ESCAPE, Keys.ESCAPE)
    assert crossing.ask("[replay.actors.isOpen, replay.actors.shown.length]") == [False, 14]
    assert crossing.errors == []


def test_the_timeline_and_the_plots_zoom_together(crossing: Page) -> None:
    part = "[replay.part.start, replay.part.stop]"
    crossing.browser.execute_script("replay.clock.seek(20)")
    crossing.press("z", "z")
    assert crossing.ask(part) == pytest.approx([15, 15 + 53 / 4])
    assert crossing.ask("[Number(time.min), Number(time.max), overview.hidden]") == [*crossing.ask(part), False]
    crossing.browser.execute_script(
        "const { left, width } = plot.getBoundingClientRect();"
        "plot.dispatchEvent(new WheelEvent('wheel', { deltaY: -400, clientX: left, cancelable: true }))"
    )
    start, stop = crossing.ask(part)
    assert start == pytest.approx(15)
    assert stop < 25
    crossing.browser.execute_script("replay.clock.seek(40)")
    crossing.until(lambda: crossing.ask("replay.part.start < 40 && replay.part.stop > 40"))
    crossing.press("x", "x", "x", "x")
    assert crossing.ask("[replay.part.isWhole, overview.hidden]") == [True, True]
    assert crossing.errors == []


def test_a_link_to_the_moment_is_copied(crossing: Page) -> None:
    crossing.browser.execute_script(
        "replay.clock.seek(12.5); navigator.clipboard.writeText = async (text) => { window.copied = text; }"
    )
    crossing.press("y")
    crossing.until(lambda: crossing.ask("document.getElementById('status').className") == "toast")
    assert crossing.ask("window.copied").endswith("/index.html#t=12.5&follow=100")
    assert "copied" in crossing.text("status")


def test_a_picture_of_the_view_is_saved(crossing: Page, tmp_path: Path) -> None:
    from PIL import Image

    crossing.browser.execute_cdp_cmd("Browser.setDownloadBehavior", {"behavior": "allow", "downloadPath": str(tmp_path)})
    crossing.browser.execute_script("replay.clock.seek(12.5)")
    crossing.press("s")
    crossing.until(lambda: names_in(tmp_path) == ["crossing-12.50s.png"])
    with Image.open(tmp_path / "crossing-12.50s.png") as image:
        width, height = crossing.ask("[replay.stage.canvas.width, replay.stage.canvas.height]")
        assert (image.format, image.width) == ("PNG", width)
        assert height < image.height < height + 50  # with a line that says what it is
        place = crossing.ask("[...replay.stage.context.getImageData(100, 100, 1, 1).data].slice(0, 3)")
        assert list(image.convert("RGB").getpixel((100, 100))) == place
    assert crossing.errors == []


def test_a_walker_lies_in_the_direction_of_its_fall(chromium: Chrome, tmp_path: Path) -> None:
    page = Page(chromium, report(write(tmp_path / "fall.log", accident(40), tick=0.1), tmp_path / "page"))
    headings = [page.ask("replay.tracks.lying(replay.tracks.indexOf(2, 0), arguments[0])", time) for time in (0.1, 2.0)]
    assert headings[0] is None
    assert headings[1] == pytest.approx(0, abs=0.05)


def test_a_click_on_an_actor_follows_it_and_the_wheel_zooms(crossing: Page) -> None:
    from selenium.webdriver import ActionChains

    crossing.browser.execute_script("replay.clock.seek(22); replay.fit()")
    crossing.until(lambda: not crossing.ask("replay.stale"))
    left, top = crossing.ask(
        "(one => [one.left, one.top])(replay.stage.shown.find(one => replay.tracks.actors[one.actor].id === 102))"
    )
    canvas = crossing.browser.find_element("id", "canvas")
    middle = [canvas.size["width"] / 2, canvas.size["height"] / 2]
    ActionChains(crossing.browser).move_to_element_with_offset(
        canvas, int(left - middle[0]), int(top - middle[1])
    ).click().perform()
    assert crossing.ask("replay.camera.followed") == 102
    scale = crossing.ask("replay.camera.scale")
    crossing.browser.execute_script(
        "document.getElementById('canvas').dispatchEvent(new WheelEvent('wheel', {deltaY: -200, cancelable: true}))"
    )
    assert crossing.ask("replay.camera.scale") > scale
    ActionChains(crossing.browser).move_to_element(canvas).click_and_hold().move_by_offset(80, 30).release().perform()
    assert crossing.ask("replay.camera.followed") is None


def test_a_link_leads_to_a_time(chromium: Chrome, crossing_page: Path) -> None:
    page = Page(chromium, crossing_page, "#t=12.3&follow=101")
    assert page.time == pytest.approx(12.3)
    assert page.ask("replay.camera.followed") == 101
    page.browser.execute_script("replay.clock.seek(14)")
    page.until(lambda: page.browser.current_url.endswith("#t=14&follow=101"))
    assert Page(chromium, crossing_page, "#t=nonsense&follow=1e99&incident=99").time == 0
    assert page.errors == []


def test_a_link_to_an_incident_plays_through_it_with_its_text(chromium: Chrome, crossing_page: Path) -> None:
    incident = data(crossing_page, "report")["incidents"][1]
    page = Page(chromium, crossing_page, "#incident=2")
    assert page.ask("replay.incidents.current") == 1
    page.until(lambda: page.time > incident["start"] - 3)
    assert page.time < min(incident["stop"], incident["start"] + 6) + 3.01
    page.until(lambda: page.text("caption-text") == incident["text"])
    page.browser.execute_script("replay.clock.pause()")
    page.until(lambda: "#incident=2&t=" in page.browser.current_url)
    again = Page(chromium, crossing_page, "#incident=4&t=24&follow=101")
    assert again.ask("[replay.incidents.current, replay.clock.playing, replay.clock.time]") == [3, False, 24]
    assert "in 0.6 s" in again.text("caption")


@pytest.mark.parametrize("name", ["page", "page.html"])  # in the latter, a text could end the script that it is in
def test_hostile_texts_are_shown_as_texts(chromium: Chrome, tmp_path: Path, name: str) -> None:
    there = {"transforms": [(1, 0, 0, 0, 0, 0, 0), (2**32 - 2, 100, float("nan"), 0, 0, 0, 0), (3, 3e38, -3e38, 0, 0, 0, 0)]}
    actors = [spawn(1, f"vehicle.{NASTY}", role_name=NASTY), spawn(2**32 - 2, NASTY), spawn(3, "")]
    hits = [(1, 2**32 - 2, 1, 0, 0), (2, 3, 7, 0, 0)]
    frames = [there | {"spawned": actors}, there | {"collisions": hits}, there]
    source = record(tmp_path / "a.log", frames, map_name=NASTY)
    page = Page(chromium, report(source, tmp_path / name))
    for index in range(page.ask("document.querySelectorAll('.incident').length")):
        page.click(".incident", index)
    page.press("f", "h", "l")
    assert page.ask("document.querySelector('.incident .text').textContent").count("onerror") >= 1
    assert page.ask("document.querySelectorAll('img[src=x], .incident script').length") == 0
    assert page.browser.title != "broken"
    assert page.errors == []


def test_a_recording_of_one_frame_without_actors(chromium: Chrome, tmp_path: Path) -> None:
    page = Page(chromium, report(record(tmp_path / "a.log", [{}]), tmp_path / "page"))
    assert page.ask("document.getElementById('play').disabled")
    assert "There are no incidents" in page.text("nothing")
    page.press(" ", "f", "n", "+")
    assert page.errors == []


def test_it_opens_at_an_incident_and_names_the_broken_rules(chromium: Chrome, crossing_page: Path, tmp_path: Path) -> None:
    incident = data(crossing_page, "report")["incidents"][0]
    opening = Opening(incident["start"], tuple(incident["actors"]), tuple(f"rule {number}" for number in range(6)))
    page = Page(chromium, report(CROSSING, tmp_path / "page.html", opening=opening))
    assert page.time == pytest.approx(incident["start"] - 3)
    assert page.ask("[replay.incidents.current, replay.camera.followed]") == [0, incident["actors"][0]]
    assert page.ask("[...document.querySelectorAll('#notes li')].map(note => note.textContent)") == [
        *("rule 0", "rule 1", "rule 2", "rule 3", "and 2 more")
    ]
    assert page.ask("location.hash") == ""
    assert Page(chromium, tmp_path / "page.html", "#t=20").time == 20
    assert page.errors == []
    report(CROSSING, tmp_path / "other.html", opening=Opening(20.0, (incident["actors"][0],)))  # without an incident
    page = Page(chromium, tmp_path / "other.html")
    assert (page.time, page.ask("replay.incidents.current")) == (17, -1)
    assert page.ask("document.getElementById('notes').hidden")
