"""The folder of the files of many recordings: what can be one, and the names in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from carla_recap.errors import RecapError
from carla_recap.fleet.destinations import DestinationFolder
from carla_recap.fleet.sources import SourceFile


@pytest.mark.parametrize("name", ["new", "old", "s3://bucket/runs/"])
def test_a_file_has_the_name_of_its_recording(tmp_path, name):
    (tmp_path / "old").mkdir()
    folder = DestinationFolder(name if "://" in name else str(tmp_path / name), ".mcap")
    assert folder.file_of(SourceFile("runs/a/b.log", name="a/b.log")) == f"{folder.location}/a/b.mcap"
    assert not folder.location.endswith("/")


def test_a_folder_of_a_drive_that_is_missing_is_no_error_yet(monkeypatch):
    monkeypatch.setattr(Path, "exists", lambda _: False)  # as on Windows
    assert DestinationFolder("Z:/runs", ".log").location == "Z:/runs"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("file", "file: is a file; a folder was expected, for the files of many recordings"),
        ("all.mcap", "all.mcap: names a file; a folder was expected"),
        ("x" * 5000, "cannot be written: File name too long"),
        ("http://host/runs", "http://host/runs: a web server takes no files"),
    ],
)
def test_what_cannot_be_a_folder_is_an_error_of_one_short_line(tmp_path, name, message):
    (tmp_path / "file").touch()
    with pytest.raises(RecapError, match=message) as caught:
        DestinationFolder(name if "://" in name else str(tmp_path / name), ".mcap")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
