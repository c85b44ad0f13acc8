"""The images of a camera on the incident page, and rendered pictures of incidents, in its files and in a browser."""

from __future__ import annotations

import json
import math
from base64 import b64decode
from dataclasses import replace
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra foxglove is not installed")
pytest.importorskip("PIL", reason="the extra video is not installed")

from PIL import Image

from carla_recap import FormatError, RecapError, RecapWarning, open_recording
from carla_recap.formats.mcap.writer import McapWriter
from carla_recap.show.page import images as module
from carla_recap.show.page import write_report
from carla_recap.show.page.report import PICTURE_SIZE
from tests.cli.command import error
from tests.replay.scripts import spawn
from tests.samples import CROSSING, drive
from tests.sensed import HEADER, camera, filmed
from tests.show.page.conftest import WITHOUT_ROADS, data, record, report
from tests.show.page.pages import Page, emulated

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from selenium.webdriver import Chrome

SECONDS = 6.0
RED, GREEN, BLUE = (200, 0, 0), (0, 200, 0), (0, 0, 200)
COLORS = {1.0: RED, 2.0: GREEN, 3.0: BLUE}
"""The colours of the images of the camera that looks ahead, and when they are taken; 1 s later there is none any more."""


def often(rate: float, seconds: float = SECONDS) -> dict[float, tuple[int, int, int]]:
    """Return colours of images, `rate` of them in a second."""
    return {index / rate: (index % 256, 100, 0) for index in range(round(rate * seconds))}


def shown(page: Path, index: int = 0) -> Any:
    """Return what a page has of the images of a recording."""
    text = page.read_text("utf-8") if page.is_file() else (page / "data" / "images.js").read_text("utf-8")
    start = text.index("var IMAGES=") + len("var IMAGES=")
    return json.JSONDecoder().raw_decode(text, start)[0][index]


def color_of(text: str) -> np.ndarray:
    """Return the mean colour of an image of a page, which is WebP in base64."""
    with Image.open(BytesIO(b64decode(text)), formats=("WEBP",)) as image:
        return np.asarray(image.convert("RGB")).mean(axis=(0, 1))


def test_a_page_has_the_images_of_the_camera_that_looks_ahead(tmp_path: Path) -> None:
    source = filmed(tmp_path / "a.mcap", {"back": (180.0, COLORS), "ahead": (-10.0, COLORS), "left": (-90.0, COLORS)})
    with open_recording(source) as recording:
        written = write_report(recording, tmp_path / "page.html", WITHOUT_ROADS)
    found = shown(tmp_path / "page.html")
    assert (found["camera"], found["times"], written.images) == ("ahead", [1.0, 2.0, 3.0], 3)
    assert found["size"] == [480, 240]
    for text, color in zip(found["images"], COLORS.values(), strict=True):
        assert color_of(text) == pytest.approx(color, abs=6)


@pytest.mark.parametrize("pose", [{"pitch": -90}, {"yaw": 10**400}, {"yaw": "x"}, {"yaw": math.inf}, {"pitch": None}])
def test_a_camera_that_looks_down_or_somewhere_does_not_look_ahead(tmp_path: Path, pose: dict[str, Any]) -> None:
    with McapWriter(tmp_path / "a.mcap", HEADER) as writer:
        for id, where in (("a", pose), ("b", {"yaw": 30})):
            topic = camera(id)
            spec = json.loads(topic.metadata["sensor"]) | where
            writer.add_topic(replace(topic, metadata={"sensor": json.dumps(spec)}))
        for frame in drive(1.0, size=1):
            writer.write(frame)
    with open_recording(tmp_path / "a.mcap") as recording:
        assert module.camera_of(recording, None) == "b"


def test_a_folder_has_the_images_of_the_camera_that_is_asked_for(tmp_path: Path) -> None:
    source = filmed(tmp_path / "a.mcap", {"ahead": (0.0, COLORS), "back": (180.0, {0.5: GREEN, 2.5: BLUE})})
    found = shown(report(source, tmp_path / "page", camera="back"))
    assert (found["camera"], found["times"]) == ("back", [0.5, 2.5])
    assert found["longest"] == 4.0  # s for which an image is shown: longer where they are rare


def test_a_page_has_a_few_images_in_a_second_with_their_own_times(tmp_path: Path) -> None:
    seconds = 3.0
    source = filmed(tmp_path / "a.mcap", {"ahead": (0.0, often(32.0, seconds))})
    found = shown(report(source, tmp_path / "page.html"))
    assert module.RATE * seconds * 0.7 < len(found["times"]) <= module.RATE * seconds + 1
    steps = np.diff(found["times"])
    assert steps.min() > 0.06
    assert steps.max() < 0.16
    for time, text in zip(found["times"], found["images"], strict=True):
        assert time * 32 == pytest.approx(round(time * 32), abs=0.05)
        assert color_of(text) == pytest.approx((round(time * 32) % 256, 100, 0), abs=8)


def test_the_images_of_a_page_have_a_bounded_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    noise = np.random.default_rng(1).integers(0, 256, (320, 640, 3), np.uint8)
    source = filmed(tmp_path / "a.mcap", {"ahead": (0.0, dict.fromkeys(often(5.0), noise))})
    every = shown(report(source, tmp_path / "all.html"))
    size = len(b64decode(every["images"][0]))
    monkeypatch.setattr(module, "BUDGET", 20 * size)
    found = shown(report(source, tmp_path / "page.html"))
    assert len(every["images"]) == 30
    assert 10 <= len(found["images"]) <= 20
    assert found["times"][0] == 0.0
    assert found["times"][-1] > SECONDS - 1
    assert found["longest"] == 1.0


def test_a_camera_that_is_not_there_is_an_error(tmp_path: Path) -> None:
    source = filmed(tmp_path / "a.mcap", {"ahead": (0.0, COLORS), "back": (180.0, COLORS)})
    arguments = "--camera", "front", "--kinds", "collision"
    said = error("report", source, tmp_path / "page.html", *arguments)
    assert said.endswith(f"{source}: has no images of a camera 'front'; it has those of ahead, back")
    with pytest.raises(RecapError, match=r"'carla-recap sense' writes a recording that has some$"):
        report(CROSSING, tmp_path / "page.html", camera="a")
    assert not (tmp_path / "page.html").exists()


def test_images_that_are_damaged_are_left_out_with_a_warning_unless_they_are_asked_for(tmp_path: Path) -> None:
    source = filmed(tmp_path / "a.mcap", {"ahead": (0.0, COLORS)})
    with open_recording(source) as recording:
        (first, *_) = (data for _, data in recording.reader.messages("/sensors/ahead/image"))
        topic = recording.reader.further_topics()["/sensors/ahead/image"].topic
        schema = topic.schema()
    with McapWriter(tmp_path / "b.mcap", HEADER) as writer:
        writer.add_topic(replace(topic, schema=lambda: schema))
        for frame in drive(2.0, size=1):
            writer.write(frame)
        writer.write_message("/sensors/ahead/image", 1.0, first[: len(first) // 2].replace(b"\xff\xd8", b"\0\0"))
    with pytest.warns(RecapWarning, match=r"the page has no images of the camera ahead: .*b\.mcap"):
        report(tmp_path / "b.mcap", tmp_path / "page.html")
    assert shown(tmp_path / "page.html") is None
    with pytest.raises(FormatError, match=r"b\.mcap"):
        report(tmp_path / "b.mcap", tmp_path / "other.html", camera="ahead")
    assert not (tmp_path / "other.html").exists()


# --- rendered pictures of incidents ---


@pytest.fixture
def source(tmp_path: Path) -> Path:
    there = {"transforms": [(1, 0, 0, 0, 0, 0, 0), (2, 900, 0, 0, 0, 0, 0)]}
    first = there | {"spawned": [spawn(1), spawn(2)]}
    return record(tmp_path / "a.log", [first, there | {"collisions": [(1, 1, 2, 0, 0)]}, there])


def rendered(source: Path, page: Path) -> Path:
    pytest.importorskip("moderngl", reason="the extra cameras is not installed")
    try:
        return report(source, page, pictures="rendered")
    except RecapError as error:
        if "driver" not in str(error):
            raise
        pytest.skip(str(error))


def test_a_folder_has_files(source: Path, tmp_path: Path) -> None:
    page = rendered(source, tmp_path / "page")
    with Image.open(page / data(page, "report")["incidents"][0]["picture"]) as picture:
        assert (picture.format, picture.size) == ("JPEG", PICTURE_SIZE)


def test_a_single_file_contains_them(source: Path, tmp_path: Path) -> None:
    page = rendered(source, tmp_path / "page.html")
    head, _, content = data(page, "report")["incidents"][0]["picture"].partition(",")
    assert head == "data:image/jpeg;base64"
    with Image.open(BytesIO(b64decode(content))) as picture:
        assert picture.size == PICTURE_SIZE


# --- in a browser ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def filmed_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("filmed")
    return report(filmed(folder / "a.mcap", {"ahead": (0.0, COLORS)}), folder / "page.html")


def pixel(page: Page, index: int = 0) -> Sequence[int]:
    """Return the colour in the middle of the image of a camera."""
    return page.browser.execute_script(
        "const { canvas } = replay.images.views[arguments[0]];"
        "const own = new OffscreenCanvas(1, 1).getContext('2d', { willReadFrequently: true });"
        "own.drawImage(canvas, canvas.width / 2, canvas.height / 2, 1, 1, 0, 0, 1, 1);"
        "return [...own.getImageData(0, 0, 1, 1).data].slice(0, 3)",
        index,
    )


def is_blank(page: Page) -> bool:
    return page.ask("document.querySelector('.camera').classList.contains('blank')")


def seek(page: Page, time: float) -> None:
    """Move the slider of the time."""
    page.browser.execute_script(
        "const slider = document.getElementById('time'); slider.value = arguments[0];"
        "slider.dispatchEvent(new Event('input'))",
        time,
    )
    page.until(lambda: page.text("now") == f"0:{time:04.1f}")


def looks(page: Page, color: Sequence[int]) -> bool:
    return bool(np.abs(np.subtract(pixel(page), color)).max() < 16)


def test_the_image_is_that_of_the_time_of_the_slider(chromium: Chrome, filmed_page: Path) -> None:
    page = Page(chromium, filmed_page)
    for time, color in [(1.0, RED), (3.2, BLUE), (1.9, RED), (2.0, GREEN), (2.9, GREEN), (4.9, BLUE)]:
        seek(page, time)
        page.until(lambda color=color: looks(page, color))
        assert not is_blank(page)
    for time in (0.5, 5.5):  # before the first image, and long after the last one
        seek(page, time)
        page.until(lambda: is_blank(page))
        assert page.ask("document.querySelector('.absence').hidden") is False
    assert page.ask("document.querySelector('.camera figcaption span').textContent") == "ahead"
    assert page.errors == []


def test_the_images_play(chromium: Chrome, filmed_page: Path) -> None:
    page = Page(chromium, filmed_page, "#t=1.5")
    page.until(lambda: looks(page, RED))
    page.press(" ")
    page.until(lambda: looks(page, GREEN))
    assert page.time > 1.99
    page.until(lambda: looks(page, BLUE))
    assert page.time > 2.99
    assert page.errors == []


def test_the_images_can_be_hidden(chromium: Chrome, filmed_page: Path) -> None:
    page = Page(chromium, filmed_page, "#t=1.5")
    width = "document.getElementById('canvas').getBoundingClientRect().width"
    beside = page.ask(width)
    page.press("i")
    page.until(lambda: page.ask(width) > 1.5 * beside)
    assert page.ask("document.getElementById('cameras').hidden")
    page.click("#images")
    page.until(lambda: page.ask(width) == beside)
    assert page.ask("document.getElementById('images').ariaPressed") == "true"


def test_pages_without_images_have_neither_room_nor_a_button_for_them(chromium: Chrome, crossing_page: Path) -> None:
    page = Page(chromium, crossing_page)
    hidden = "['cameras', 'images'].map(id => document.getElementById(id).hidden)"
    assert page.ask(hidden) == [True, True]
    page.press("i")
    assert page.ask(hidden) == [True, True]
    assert "Camera" not in page.text("shortcuts")
    assert page.errors == []


@pytest.mark.parametrize(
    ("size", "is_beside"), [((1280, 900), True), ((768, 1024), True), ((390, 844), False), ((320, 640), False)]
)
def test_the_image_is_beside_the_map_or_above_it(
    chromium: Chrome, filmed_page: Path, size: tuple[int, int], is_beside: bool
) -> None:
    with emulated(chromium, size=size):
        page = Page(chromium, filmed_page, "#t=1.5")
        page.until(lambda: looks(page, RED))
        box = "(({ left, right, top, bottom }) => [left, right, top, bottom])(arguments[0].getBoundingClientRect())"
        box = box.replace("arguments[0]", "document.querySelector(arguments[0])")
        image, stage, controls = (page.ask(box, name) for name in (".camera canvas", ".stage", ".transport"))
        assert page.ask("document.documentElement.scrollWidth") == size[0]
        assert image[1] - image[0] > 200
        assert image[3] - image[2] > 80
        assert stage[3] - stage[2] > 150
        assert image[1] <= stage[0] + 2 if is_beside else image[3] <= stage[2] + 2
        assert controls[3] <= size[1]
        assert page.errors == []


def test_two_recordings_have_an_image_each(chromium: Chrome, tmp_path: Path) -> None:
    sources = [
        filmed(tmp_path / f"{name}.mcap", {"ahead": (0.0, {1.0: color})}) for name, color in (("a", RED), ("b", BLUE))
    ]
    with open_recording(sources[0]) as one, open_recording(sources[1]) as other:
        written = write_report(one, tmp_path / "page.html", WITHOUT_ROADS, other=other)
    assert written.images == 2
    page = Page(chromium, tmp_path / "page.html", "#t=1.5")
    page.until(lambda: looks(page, RED) and pixel(page, 1)[2] > 180)
    assert page.ask("[...document.querySelectorAll('.camera .letter')].map(each => each.textContent)") == ["A", "B"]
    assert page.errors == []
    bottom = "document.querySelector(arguments[0]).getBoundingClientRect().bottom"
    with emulated(chromium, size=(768, 1024)):
        page = Page(chromium, tmp_path / "page.html", "#t=1.5")
        assert page.ask(bottom, "#cameras figure:last-child") <= page.ask(bottom, ".stage") + 1
