"""The rendered pictures of incidents."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING, Any

import pytest

from carla_recap import RecapError
from carla_recap.show.page import report as module
from tests.replay.scripts import pose, spawn
from tests.show.page.conftest import data, record, report

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from carla_recap.model.frame import Frame

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


def test_contacts_are_read_once_for_all_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from carla_recap.formats.base import Reader

    read: list[float] = []
    frames = Reader.frames

    def counted(reader: Reader, types: Any = None, **options: Any) -> Iterator[Frame]:
        for frame in frames(reader, types, **options):
            if types == ("collisions",):
                read.append(frame.elapsed)
            yield frame

    there = [pose(1, 0), pose(2, 900, z=93)]
    script: list[dict[str, Any]] = [{"transforms": there} for _ in range(20)]
    script[0]["spawned"] = [spawn(1), spawn(2, "walker.pedestrian.0001")]
    for number in (5, 10, 15):
        script[number]["collisions"] = [(number, 1, 2, 0, 0)]
    source = record(tmp_path / "a.mcap", script, tick=2)
    monkeypatch.setattr(Reader, "frames", counted)
    rendered(source, tmp_path / "page")
    assert read == [10.0, 10.0, 20.0]  # the first one to choose who is followed; the last contact is after all beginnings


def test_a_single_file_contains_them(source: Path, tmp_path: Path) -> None:
    page = rendered(source, tmp_path / "page.html")
    head, _, content = data(page, "report")["incidents"][0]["picture"].partition(",")
    assert head == "data:image/jpeg;base64"
    with image.open(io.BytesIO(base64.b64decode(content))) as picture:
        assert picture.size == module.PICTURE_SIZE
