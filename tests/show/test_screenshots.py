"""Pictures taken by the viewer, and the end of its process."""

from __future__ import annotations

import io

import pytest

pytest.importorskip("rerun", reason="the extra `rerun` is not installed")

from PIL import Image

from carla_recap.errors import RecapError
from carla_recap.show.rerun import viewer
from tests.screenshots import ScreenshotTaker
from tests.waiting import time_limit


def test_the_whole_window_shows_the_blueprint_of_the_recording(crossing_rrd):
    with ScreenshotTaker(crossing_rrd, (800, 600)) as screenshots:
        picture, views = screenshots.take(24.6), screenshots.state.views
    image = Image.open(io.BytesIO(picture)).convert("RGB")
    assert image.size == (800, 600)
    assert len(image.getcolors(1 << 24)) > 100
    assert {"3D", "2D", "TimeSeries", "TextLog"} <= {view.view_class for view in views}
    assert not [report for view in views for report in view.reports]


def test_without_a_graphics_driver_the_error_says_what_to_install(crossing_rrd, temporary, monkeypatch):
    monkeypatch.setenv("VK_ICD_FILENAMES", "/nonexistent")
    monkeypatch.setenv("VK_DRIVER_FILES", "/nonexistent")
    with time_limit(), pytest.raises(RecapError, match=r"^the Rerun viewer found no graphics .* mesa-vulkan-drivers$"):
        ScreenshotTaker(crossing_rrd).__enter__()


def test_a_file_that_the_viewer_cannot_load_is_an_error(tmp_path, temporary, monkeypatch, crossing_rrd):
    def port_when_it_has_failed(self, announced):
        self.wait_for("message", lambda: "failed to read RRD metadata" in self._output())
        monkeypatch.setattr(viewer, "TIMEOUT", 2.0)
        return port(self, announced)

    port = viewer.RerunViewer.port
    monkeypatch.setattr(viewer, "TIMEOUT", 120.0)
    monkeypatch.setattr(viewer.RerunViewer, "port", port_when_it_has_failed)
    (tmp_path / "no.rrd").write_bytes(b"This is no recording.")  # one that is cut may be whole as far as it goes
    with time_limit(), pytest.raises(RecapError, match="no recording within 2 s: failed to read RRD metadata"):
        ScreenshotTaker(tmp_path / "no.rrd").__enter__()
