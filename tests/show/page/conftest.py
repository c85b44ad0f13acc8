"""Pages, and a browser."""

from __future__ import annotations

import base64
import json
import shutil
import struct
import zlib
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from carla_recap import ActorKind, Attribute, Spawn, create_recording, open_recording
from carla_recap.queries.incidents import IncidentOptions
from carla_recap.queries.kinds import kinds_without_roads
from carla_recap.show.page import write_report
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from selenium.webdriver import Chrome

CROSSING = Path(__file__).parents[3] / "samples" / "crossing.log"
NASTY = "</script><img src=x onerror=\"document.title='broken'\">\u2028\u2029\x01\"'&amp;"
"""Text that breaks a page that does not escape it."""

WITHOUT_ROADS = IncidentOptions(kinds=kinds_without_roads())
"""What pages list of maps that are unknown, without a warning."""


@pytest.fixture(scope="session")
def crossing_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the sample."""
    folder = tmp_path_factory.mktemp("pages") / "crossing"
    with open_recording(CROSSING) as recording:
        write_report(recording, folder, WITHOUT_ROADS)
    return folder


def data(page: Path, name: str, index: int = 0) -> Any:
    """Return the data in a page, a folder or a file: `report` and `recording` of one of its recordings, or the `ground`."""
    variable, key = {"report": ("REPORTS", index), "recording": ("RECORDINGS", index), "ground": ("GROUND", None)}[name]
    files = [page] if page.is_file() else sorted((page / "data").iterdir())
    text = "".join(file.read_text("utf-8") for file in files)
    value = json.JSONDecoder().raw_decode(text, text.index(f"var {variable}=") + len(variable) + 5)[0]
    value = value if key is None else value[key]
    return unpack(value) if isinstance(value, str) else value


def unpack(text: str) -> Any:
    """Return the value in a packed text, as the page's scripts read it."""
    content = zlib.decompress(base64.b64decode(text))
    (length,) = struct.unpack_from("<I", content)

    def revive(value: dict[str, Any]) -> Any:
        return numbers(content[4 + length :], *value["column"]) if "column" in value else value

    return json.loads(content[4 : 4 + length], object_hook=revive)


def numbers(content: bytes, offset: int, count: int, planes: int, unit: float, order: int) -> Any:
    """Return the numbers of a packed column."""
    raw = np.frombuffer(content, np.uint8, planes * count, offset).reshape(planes, count).astype(np.uint32)
    zigzag = (raw << (8 * np.arange(planes, dtype=np.uint32))[:, None]).sum(axis=0, dtype=np.uint32)
    values = (zigzag >> 1).astype(np.int32) ^ -(zigzag & 1).astype(np.int32)
    for _ in range(order):
        values = np.cumsum(values, dtype=np.int32)
    return values * unit


def spawn(id: int, type_id: str = "vehicle.audi.tt", **attributes: str) -> Spawn:
    kinds = {"vehicle": ActorKind.VEHICLE, "walker": ActorKind.WALKER, "traffic": ActorKind.TRAFFIC_LIGHT}
    kind = kinds.get(type_id.partition(".")[0], ActorKind.OTHER)
    pairs = [Attribute(3, *pair) for pair in attributes.items()]
    return Spawn(id, kind, 0, 0, 0, 0, 0, 0, 0, type_id, pairs)


def record(
    path: Path, frames: Sequence[Mapping[str, Any]], *, tick: float = 0.05, map_name: str = "Town01", **options: Any
) -> Path:
    """Write a recording, one mapping of records per frame."""
    with create_recording(path, map_name=map_name, date=0, **options) as recorder:
        for index, frame in enumerate(frames):
            recorder.add_frame(index * tick, **frame)
    return path


def report(source: Path, folder: Path, **options: Any) -> Path:
    """Write the page of a recording."""
    with open_recording(source) as recording:
        write_report(recording, folder, WITHOUT_ROADS, **options)
    return folder


@contextmanager
def browser(*arguments: str) -> Iterator[Chrome]:
    """Yield a browser without a window; skips the test if it is not installed."""
    binary, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not binary or not driver:
        pytest.skip("chromium or chromedriver is not installed")
    webdriver = pytest.importorskip("selenium.webdriver")
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for argument in ("headless=new", "no-sandbox", "disable-background-networking", "window-size=1440,900", *arguments):
        options.add_argument(f"--{argument}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    chrome = webdriver.Chrome(options=options, service=Service(driver))
    chrome.set_script_timeout(PATIENCE)
    chrome.set_page_load_timeout(PATIENCE)
    try:
        yield chrome
    finally:
        chrome.quit()


@pytest.fixture(scope="session")
def chromium() -> Iterator[Chrome]:
    """A browser for all tests."""
    with browser("disable-gpu") as chrome:
        yield chrome
