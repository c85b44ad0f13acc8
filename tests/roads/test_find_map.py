from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from carla_recap.roads import find_map

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "maps"
    folder.mkdir()
    for name in ("Town01", "Town10HD", "Town10HD_Opt", "My town"):
        (folder / f"{name}.xodr").touch()
    (folder / "Folder.xodr").mkdir()
    (tmp_path / "Secret.xodr").touch()
    return folder


@pytest.mark.parametrize(
    ("name", "file"),
    [
        ("Town01", "Town01"),
        ("Carla/Maps/Town01", "Town01"),
        ("/Game/Carla/Maps/Town01_Opt", "Town01"),
        (r"Carla\Maps\Town01", "Town01"),
        ("Town10HD_Opt", "Town10HD_Opt"),
        ("Town10HD", "Town10HD"),
        ("My town", "My town"),
        ("Carla/Maps/town01_opt", "Town01"),
    ],
)
def test_the_file_of_a_map(folder, name, file):
    assert find_map(name, folder) == folder / f"{file}.xodr"


@pytest.mark.parametrize(
    "name",
    [
        *("", ".", "..", "/", "../Secret", "..\\Secret", "x/../../Secret", "Town01/", "Town01.xodr", "Town02", "_Opt"),
        *("*", "Town0?", "Folder", "Town01\0", "\udcff\ud800", "town" * 10_000),
    ],
    ids=lambda name: ascii(name)[:20],
)
def test_no_other_file_is_found(folder, name):
    assert find_map(name, folder) is None


def test_the_folder_comes_from_the_environment(folder, monkeypatch):
    monkeypatch.delenv("CARLA_RECAP_MAPS", raising=False)
    assert find_map("Town01") is None
    monkeypatch.setenv("CARLA_RECAP_MAPS", "")
    assert find_map("Town01") is None
    monkeypatch.setenv("CARLA_RECAP_MAPS", str(folder))
    assert find_map("Town01") == folder / "Town01.xodr"
    for other in (folder.parent, folder / "none"):
        assert find_map("Town01", other) is None
