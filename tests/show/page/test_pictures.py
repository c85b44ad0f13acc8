"""The rendered pictures of incidents."""

from __future__ import annotations

import base64
import io
from pathlib import Path

import pytest

from carla_recap import RecapError
from carla_recap.show.page import report as module
from tests.replay.scripts import spawn
from tests.show.page.conftest import data, record, report

image = pytest.importorskip("PIL.Image", reason="the extra cameras is not installed")
pytest.importorskip("moderngl", reason="the extra cameras is not installed")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    there = {"transforms": [(1, 0, 0, 0, 0, 0, 0), (2, 900, 0, 0, 0, 0, 0)]}
    first = there | {"spawned": [spawn(1), spawn(2)]}
    return record(tmp_path / "a.log", [first, there | {"collisions": [(1, 1, 2, 0, 0)]}, there])


def rendered(source: Path, page: Path) -> Path:
    try:
        return report(source, page, pictures="rendered")
    except RecapError as error:
        if "driver" not in str(error):
            raise
        pytest.skip(str(error))


def test_a_folder_has_files(source: Path, tmp_path: Path) -> None:
    page = rendered(source, tmp_path / "page")
    with image.open(page / data(page, "report")["incidents"][0]["picture"]) as picture:
        assert (picture.format, picture.size) == ("JPEG", module.PICTURE_SIZE)


def test_a_single_file_contains_them(source: Path, tmp_path: Path) -> None:
    page = rendered(source, tmp_path / "page.html")
    head, _, content = data(page, "report")["incidents"][0]["picture"].partition(",")
    assert head == "data:image/jpeg;base64"
    with image.open(io.BytesIO(base64.b64decode(content))) as picture:
        assert picture.size == module.PICTURE_SIZE
