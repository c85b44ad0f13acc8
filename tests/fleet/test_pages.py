from __future__ import annotations

import re
import shutil
from dataclasses import replace

import pytest

from carla_recap.fleet.check import CheckedRecording, check_sources
from carla_recap.fleet.pages import overview, write_pages
from carla_recap.fleet.sources import find_sources
from carla_recap.queries.info import info
from carla_recap.rules.rule_sets import Verdict, load_rules, parse_rules
from tests.samples import SAMPLES, names_in, reading, save
from tests.show.page.conftest import data

RULES = load_rules(SAMPLES / "rules.toml")
NASTY = "</style></p><img src=x onerror=alert(1)>\"'&amp;\x1b"


def checked(name: str, status: str = "pass", message: str = "fine", time: float | None = None) -> CheckedRecording:
    verdicts = [Verdict(rule.name, "pass", "fine") for rule in RULES]
    verdicts[0] = Verdict(RULES[0].name, status, message, time, (41, 44) if time else ())
    return CheckedRecording(name, tuple(verdicts), "Town01", 200, 9.95)


def text(page: str) -> str:
    """Return the text of a page, without its markup."""
    body = page.partition("<body>")[2]
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", body))


@pytest.fixture
def runs(tmp_path):
    for folder in ("a", "b", "c"):
        (tmp_path / folder).mkdir()
        shutil.copy(SAMPLES / ("junction.mcap" if folder == "c" else "crash.mcap"), tmp_path / folder / "run.mcap")
    return tmp_path


def test_each_recording_that_fails_gets_a_page_and_a_clip(runs):
    folder = runs / "out"
    folder.mkdir()
    found = list(check_sources(find_sources([runs]), RULES))
    said = {}
    written = write_pages(found, RULES, folder, said.__setitem__, clips=True, jobs=1)
    assert [(each.page, each.clip) for each in written] == [
        ("pages/run.html", "clips/run.mcap"),
        ("pages/run-2.html", "clips/run-2.mcap"),
        (None, None),
    ]
    assert said == dict.fromkeys((each.recording for each in found[:2]), ())
    assert names_in(folder / "pages") == ["run-2.html", "run.html"]
    opening = data(folder / "pages" / "run.html", "report")["opening"]
    assert (opening["time"], opening["actors"]) == (12.1, [41, 44])
    assert opening["notes"][0].startswith("no-hero-collision: 2 collisions of the hero instead of at most 0")
    with reading(folder / "clips" / "run.mcap") as clip:
        assert clip.extent().duration == pytest.approx(10, abs=0.1)
        assert "vehicle.mercedes.sprinter" in str(list(info(clip)))


def test_a_page_that_cannot_be_made_is_a_warning(tmp_path):
    found = [checked(str(save(tmp_path / "gone.mcap", b"nothing")), "fail", "hits", 1.0)]
    said = {}
    (each,) = write_pages(found, RULES, tmp_path, said.__setitem__, jobs=1)
    assert each.page is None
    assert said == {found[0].recording: each.warnings}
    assert f"Warning: no page: {found[0].recording}" in text((tmp_path / "index.html").read_text("utf-8"))
    assert "Warning: an odd frame" in text(overview([replace(checked("a.mcap"), warnings=("an odd frame",))], RULES))


def test_the_overview_begins_with_what_is_wrong():
    broken = checked("runs/b.mcap", "fail", "2 collisions", 12.1)
    words = text(page := overview([checked("a.mcap"), broken, checked("c.mcap", "error", "no file")], RULES))
    assert words.index("1 failed and 1 not judged of 3 recordings") < words.index("The hero hits nothing")
    assert words.index("c.mcap") < words.index("b.mcap") < words.index("a.mcap")
    assert "no-hero-collision The hero hits nothing 1 failed" in words
    assert "Passed: no-red-light, keeps-its-distance, gentle-braking, no-long-stops, one-hero, complete" in words
    assert "<a " not in page
    page = overview([replace(broken, page="pages/b #.html")], RULES)
    assert 'href="pages/b%20%23.html#t=9.10&amp;follow=41"' in page


def test_what_had_nothing_to_judge_is_said_of_each_recording():
    idle = Verdict(RULES[1].name, "pass", "nothing to judge: it has no tram", applies=False)
    found = [checked("a.mcap"), checked("b.mcap", "fail", "2 collisions", 12.1)]
    found = [replace(each, verdicts=(each.verdicts[0], idle, *each.verdicts[2:])) for each in found]
    words = text(overview(found, RULES))
    assert words.count(f"{idle.rule}: nothing to judge: it has no tram") == 2
    assert "The hero runs no red light all passed nothing to judge in 2" in words
    assert "Passed: keeps-its-distance, " in words


def test_names_of_recordings_and_rules_cannot_break_the_page(chromium, tmp_path):
    rules = parse_rules(f"[rules.a]\ndescription = '''{NASTY.replace(chr(27), '')}'''\nmap = 'x'", NASTY)
    each = CheckedRecording(NASTY, (Verdict(NASTY, "fail", NASTY, 1.0, (1,), (NASTY, NASTY)),), NASTY, page=NASTY)
    (tmp_path / "index.html").write_text(overview([each, each], rules), "utf-8")
    chromium.get((tmp_path / "index.html").as_uri())
    assert chromium.execute_script("return document.images.length") == 0
    assert chromium.execute_script("return document.querySelector('.card .rule').textContent").startswith("</style>")
    width = chromium.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
    assert width[0] <= width[1]
    assert chromium.execute_script("return getComputedStyle(document.querySelector('.card')).borderLeftWidth") == "4px"
    assert chromium.get_log("browser") == []
