"""Rerun's viewer in the page, in a real browser."""

from __future__ import annotations

from pathlib import Path
from threading import Thread

import pytest

from carla_recap import RecapError
from carla_recap.show.page import page_server, samples
from tests.browser import browser
from tests.replay.scripts import write
from tests.samples import CROSSING, names_in
from tests.scene.accidents import accident
from tests.show.page.conftest import data, report
from tests.waiting import wait_until

pytest.importorskip("rerun", reason="the extra rerun is not installed")


def test_the_viewer_shows_the_time_and_the_actor_of_an_incident(tmp_path: Path) -> None:
    page = report(write(tmp_path / "few.log", accident(10), tick=2.0), tmp_path / "page", viewer=True)
    (incident,) = data(page, "report")["incidents"]
    small = "window-size=240,240"  # and few actors, for it is drawn without a GPU
    software = (small, "use-angle=swiftshader", "enable-unsafe-swiftshader", "ignore-gpu-blocklist")
    with browser(*software) as chromium, page_server(page) as server:
        thread = Thread(target=server.serve_forever, args=(0.05,))
        thread.start()
        try:
            chromium.get(f"http://127.0.0.1:{server.server_port}/")
            chromium.execute_script("replay.space.toggle(); replay.open(0, {play: false})")
            chromium.switch_to.frame("space")
            chromium.execute_script("starting.then(viewer => { window.viewer = viewer })")
            before = pytest.approx(incident["start"] - 3)
            wait_until(lambda: chromium.execute_script("return window.viewer && viewer.time") == before)
            assert chromium.execute_script("return viewer.camera") == f"cameras/follow_{incident['actors'][0]}.rbl"
            asked = chromium.execute_script("return performance.getEntriesByType('resource').map(entry => entry.name)")
            assert all(name.startswith("http://127.0.0.1:") for name in asked), asked
        finally:
            server.shutdown()
            thread.join()


def test_a_long_recording_has_no_viewer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(samples, "BUDGET", 5_000)
    with pytest.raises(RecapError, match="too long for the viewer"):
        report(CROSSING, tmp_path / "page", viewer=True)
    assert names_in(tmp_path) == []
