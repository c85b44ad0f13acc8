"""The folder of the files of many recordings: what can be one, and the names in it; and a disk that is full."""

from __future__ import annotations

from pathlib import Path

import pytest

from carla_recap.errors import RecapError
from carla_recap.fleet.destinations import DestinationFolder
from tests.cli.command import run_on_full_disk
from tests.fleet.campaign import functions
from tests.samples import SAMPLES, names_in


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


@pytest.mark.parametrize(
    ("command", "errors"),
    [
        (
            ("check", SAMPLES / "crash.mcap", "--rules", SAMPLES / "rules.toml", "--jobs", "1", "--clips", "--html"),
            ("{out}/clips/crash.mcap: cannot be written: File too large", "carla-recap: {out}: cannot be written: File too"),
        ),
        (
            ("campaign", f"{functions.__file__}:wait_here", "--duration", "20", "--workers", "1", "--out"),
            (
                "carla-recap: seed=1.mcap: cannot be written: File too",
                "carla-recap: {out}/campaign.json: cannot be written",
            ),
        ),
    ],
)
def test_a_full_disk_is_an_error_that_names_what_was_asked_for_and_leaves_nothing(tmp_path, command, errors):
    out = tmp_path / "new" / "out"
    done = run_on_full_disk(100, *command, out)
    lines = done.stderr.decode().splitlines()
    assert done.returncode == 2
    assert len(lines) == len(errors)
    for line, expected in zip(lines, errors, strict=True):
        assert expected.format(out=out) in line
    assert names_in(tmp_path) == []
