"""The page as one file: it opens from the disk, without a network, and shows what the folder shows."""

from __future__ import annotations

import re
import shutil
import subprocess
from typing import TYPE_CHECKING

import numpy as np
import pytest

from carla_recap import IncidentOptions, open_recording, write_report
from carla_recap.show.page.script import Packer
from tests.replay.scripts import spawn
from tests.samples import CROSSING, ROOT, names_in
from tests.show.page.conftest import data, record, report, unpack
from tests.show.page.pages import Page
from tests.waiting import wait_until

if TYPE_CHECKING:
    from pathlib import Path

    from selenium.webdriver import Chrome


VIEWER = ROOT / "viewer"


@pytest.fixture(scope="module")
def single(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of the sample as one file."""
    folder = tmp_path_factory.mktemp("single")
    page = report(CROSSING, folder / "page.html")
    assert names_in(folder) == ["page.html"]
    return page


def test_it_opens_without_a_network_and_asks_for_no_other_file(chromium: Chrome, single: Path) -> None:
    chromium.execute_cdp_cmd("Network.enable", {})
    offline = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
    chromium.execute_cdp_cmd("Network.emulateNetworkConditions", offline)
    try:
        page = Page(chromium, single)
        assert page.ask("document.querySelectorAll('.incident').length") == 4
        page.click(".incident", 1)
        page.until(lambda: page.ask("replay.stage.shown.length") > 5)
        page.until(lambda: page.pictures == 4)
        asked = page.ask("performance.getEntriesByType('resource').map(entry => entry.name)")
        assert [name for name in asked if not name.startswith("data:")] == []
        assert page.errors == []
    finally:
        chromium.execute_cdp_cmd("Network.emulateNetworkConditions", offline | {"offline": False})


def test_its_policy_permits_only_its_own_scripts(chromium: Chrome, single: Path) -> None:
    page = Page(chromium, single)
    page.browser.execute_script(
        "document.body.append(Object.assign(document.createElement('script'), {textContent: 'window.strange = 1'}))"
    )
    assert page.ask("window.strange") is None
    assert "Content Security Policy" in page.errors[0]["message"]


def test_a_notebook_shows_it_in_a_frame(chromium: Chrome, tmp_path: Path) -> None:
    with open_recording(CROSSING) as recording:
        written = write_report(recording, tmp_path / "page.html", IncidentOptions())
        folder = write_report(recording, tmp_path / "folder", IncidentOptions())
    (tmp_path / "cell.html").write_text(written._repr_html_(), "utf-8")
    chromium.get((tmp_path / "cell.html").as_uri())
    chromium.switch_to.frame(0)
    wait_until(lambda: chromium.execute_script("return document.querySelectorAll('.incident').length") == 4)
    assert folder._repr_html_() == f"<p>{tmp_path / 'folder' / 'index.html'}</p>"


def test_a_minute_of_traffic_is_less_than_one_and_a_half_megabytes(tmp_path: Path) -> None:
    ids = np.arange(1, 101)
    random = np.random.default_rng(0)
    speeds, phases = random.uniform(0.02, 0.1, 100), random.uniform(0, 6, 100)
    frames = []
    for step in range(1200):
        turn = phases + speeds * (step * 0.05 + np.sin(step / 90 + phases))
        where = {"x": 9000 * np.cos(turn), "y": 9000 * np.sin(2 * turn), "yaw": np.degrees(turn) % 360}
        frames.append({"transforms": {"id": ids, **where}})
    frames[0]["spawned"] = [spawn(id) for id in ids.tolist()]
    with open_recording(record(tmp_path / "a.mcap", frames)) as recording:
        write_report(recording, tmp_path / "page.html", IncidentOptions(kinds=["collision"]))
    assert (tmp_path / "page.html").stat().st_size < 1_500_000


def test_the_data_are_those_of_the_folder(crossing_page: Path, single: Path) -> None:
    assert data(single, "report") == data(crossing_page, "report")
    assert data(single, "recording")["x"].tolist() == data(crossing_page, "recording")["x"].tolist()
    assert not re.search(r'(src|href)="(?!data:|#)', single.read_text("utf-8"))


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize(
    "values", [[], [0], [-1.5, 1e6, -1e6, 0.004], [3e9, -3e9, 0], np.cumsum(np.arange(300)), [4294967295, 0, 4294967295]]
)
def test_columns_keep_their_values(values: list[float], order: int) -> None:
    packer = Packer()
    found = unpack(packer.pack({"before": packer.column([1, 2, 3]), "it": packer.column(values, 0.002, order=order)}))
    assert found["before"].tolist() == [1, 2, 3]
    largest = max(np.abs(values), default=0)
    assert found["it"] == pytest.approx(np.array(values, float), abs=max(0.0011, largest / 2**30))


def test_the_bundle_is_what_the_modules_make(tmp_path: Path) -> None:
    if shutil.which("npm") is None or not (VIEWER / "node_modules").is_dir():
        pytest.skip("viewer/node_modules is missing: 'make test' installs it where npm is")
    command = ["npm", "--prefix", VIEWER, "run", "bundle", "--", f"--outfile={tmp_path / 'page.js'}"]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    assert (tmp_path / "page.js").read_text() == (VIEWER / "page" / "page.js").read_text(), "run 'make bundle'"
