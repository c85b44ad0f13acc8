"""What the tests of the viewer share: whether it can draw here, and what it leaves behind."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from carla_recap.errors import RecapError

SAMPLE = Path(__file__).parents[2] / "samples" / "crossing.log"


@pytest.fixture(scope="session")
def crossing_rrd(tmp_path_factory):
    """Six seconds of the crossing, around the collision of the hero; skips the test where the viewer cannot draw."""
    pytest.importorskip("rerun", reason="the extra `rerun` is not installed")
    from carla_recap import open_recording
    from carla_recap.export.headless import Photographer
    from carla_recap.export.rerun import export_rerun

    path = tmp_path_factory.mktemp("rerun") / "crossing.rrd"
    with open_recording(SAMPLE) as recording:
        export_rerun(recording, path, start=20, duration=6)
    try:
        with Photographer(path):
            pass
    except RecapError as error:
        pytest.skip(str(error))
    return path


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """An empty folder for temporary files, where the test is to leave none."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", None)
    yield folder
    assert list(folder.iterdir()) == []
