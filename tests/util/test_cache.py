"""The cache of what is made of maps."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from carla_recap.errors import RecapWarning
from carla_recap.util import cache

DATA = b"a town"


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """The folder of a cache that is empty."""
    monkeypatch.setenv(cache.FOLDER, str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def entry(folder: Path) -> Path:
    """The file of an entry, `one`."""
    cache.write_entry("one", DATA)
    (path,) = folder.iterdir()  # and nothing else is left there
    return path


def test_an_entry_is_read_as_it_was_written(entry: Path) -> None:
    assert cache.read_entry("one") == DATA
    assert cache.read_entry("other") is None
    cache.write_entry("one", b"another town")
    assert cache.read_entry("one") == b"another town"
    assert [*entry.parent.iterdir()] == [entry]
    cache.remove_entry("one")
    assert cache.read_entry("one") is None
    cache.remove_entry("one")


def test_the_key_is_that_of_the_content_and_of_the_code(monkeypatch: pytest.MonkeyPatch) -> None:
    key = cache.content_key(b"map", "roads")
    assert key == cache.content_key(b"map", "roads")
    assert key not in (cache.content_key(b"other", "roads"), cache.content_key(b"map", "roads", "rendering"))
    monkeypatch.setattr(cache, "_digest", lambda _: b"newer")
    assert key != cache.content_key(b"map", "roads")


DAMAGE = {
    "empty": lambda data: b"",
    "cut": lambda data: data[:-1],
    "flipped": lambda data: data[:-1] + b"?",
    "longer": lambda data: data + b"!",
    "another format": lambda data: b"?" + data[1:],
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_damaged_entries_are_ignored_and_written_again(entry: Path, damage: Callable[[bytes], bytes]) -> None:
    whole = entry.read_bytes()
    entry.write_bytes(damage(whole))
    assert cache.read_entry("one") is None
    cache.write_entry("one", DATA)
    assert cache.read_entry("one") == DATA
    assert entry.read_bytes() == whole
    assert [*entry.parent.iterdir()] == [entry]


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="Windows has neither file modes nor users by number")
def test_entries_are_those_of_the_user_alone(entry: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert (entry.parent.stat().st_mode & 0o777, entry.stat().st_mode & 0o777) == (0o700, 0o600)
    for mode, found in ((0o620, None), (0o602, None), (0o666, None), (0o644, DATA)):
        entry.chmod(mode)
        assert cache.read_entry("one") == found
    other = entry.stat().st_uid + 1
    monkeypatch.setattr(os, "getuid", lambda: other)
    assert cache.read_entry("one") is None


def test_a_folder_that_cannot_be_written_costs_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for name in (str(tmp_path / "file" / "folder"), ""):
        monkeypatch.setenv(cache.FOLDER, name)
        cache.write_entry("one", DATA)
        assert cache.read_entry("one") is None
        cache.remove_entry("one")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_the_cache_is_bounded(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.setattr(cache, "_MOST_BYTES", 1000)
    for number in range(5):
        cache.write_entry(f"{number}", bytes(400))
        for path in folder.glob(f"{number}.*"):
            os.utime(path, (number, number))
    assert sorted(path.stem for path in folder.iterdir()) == ["3", "4"]
    assert cache.read_entry("3") == bytes(400)  # from now on, it is the one that was used last
    cache.write_entry("5", bytes(400))
    assert sorted(path.stem for path in folder.iterdir()) == ["3", "5"]
    cache.write_entry("large", bytes(600))
    assert cache.read_entry("large") is None


@pytest.mark.parametrize(
    ("platform", "variable", "parts"),
    [
        ("linux", "XDG_CACHE_HOME", ()),
        ("linux", "HOME", (".cache",)),
        ("darwin", "HOME", ("Library", "Caches")),
        ("win32", "LOCALAPPDATA", ()),
    ],
)
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no HOME")
def test_the_folder_is_the_users(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, platform: str, variable: str, parts: tuple[str, ...]
) -> None:
    for name in (cache.FOLDER, "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setenv(variable, str(tmp_path))
    assert cache.cache_folder() == tmp_path.joinpath(*parts, "carla-recap", "towns")


def test_arrays_are_made_once_unless_making_them_warns(folder: Path) -> None:
    parts = {"points": [np.arange(6.0).reshape(2, 3), np.ones((0, 3))], "none": [], "ids": [np.array(["a", "bc"])]}
    made = []

    def make() -> dict[str, list[np.ndarray]]:
        made.append(len(made))
        if len(made) > 1:
            warnings.warn("of 3 lanes, 2 are drawn", RecapWarning, stacklevel=1)
        return parts

    for what in ("lines", "lines"):
        found = cache.kept(b"map", what, ["roads"], make)
        assert {name: [part.tolist() for part in values] for name, values in found.items()} == {
            name: [part.tolist() for part in values] for name, values in parts.items()
        }
    assert made == [0]
    for _ in range(2):
        with pytest.warns(RecapWarning, match="of 3 lanes"):
            cache.kept(b"map", "surfaces", ["roads"], make)
    assert made == [0, 1, 2]
    (entry,) = folder.iterdir()
    key = entry.stem
    cache.write_entry(key, b"no arrays")
    with pytest.warns(RecapWarning, match="of 3 lanes"):
        cache.kept(b"map", "lines", ["roads"], make)
    assert cache.read_entry(key) is None
