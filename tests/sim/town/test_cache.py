"""What is kept of parsed maps."""

from __future__ import annotations

import os
import pickle
import shutil
from hashlib import sha256
from typing import TYPE_CHECKING

import pytest

from carla_recap.sim.town import town
from carla_recap.sim.town.town import load_town
from carla_recap.util import cache

if TYPE_CHECKING:
    from pathlib import Path

BUILT_IN = load_town().opendrive


@pytest.fixture(scope="module")
def parsed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the entry of the built-in map, as it was written when the map was parsed."""
    folder = tmp_path_factory.mktemp("parsed")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(cache.FOLDER, str(folder))
        forget()
        load_town()
        forget()
    return folder


class Parser:
    """Counts what the parser is asked."""

    def __init__(self) -> None:
        self.count = 0
        self._ask = town.parse_in_child

    def __call__(self, module: str, path: Path, content: bytes) -> bytes:
        self.count += 1
        return self._ask(module, path, content)


@pytest.fixture
def parser(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Parser:
    """The parser, with an empty cache."""
    parser = Parser()
    monkeypatch.setattr(town, "parse_in_child", parser)
    monkeypatch.setenv(cache.FOLDER, str(tmp_path / "cache"))
    forget()
    yield parser
    forget()


@pytest.fixture
def filled(parser: Parser, parsed: Path, tmp_path: Path) -> Parser:
    """The parser, with the entry of the built-in map in the cache."""
    shutil.copytree(parsed, tmp_path / "cache")
    return parser


def forget() -> None:
    """Empty the cache in memory."""
    town._towns.clear()


def entry() -> Path:
    folder = cache.cache_folder()
    assert folder is not None
    (path,) = folder.glob("*.town")
    return path


def test_a_map_is_parsed_once(parser: Parser) -> None:
    first = load_town()
    assert load_town() is first
    forget()
    again = load_town()
    assert parser.count == 1
    assert (again.name, again.opendrive) == (first.name, first.opendrive)
    assert [lane.length for lane in again.lanes] == [lane.length for lane in first.lanes]
    assert again.signals == first.signals
    assert again.junctions == first.junctions


def test_the_content_counts_and_not_the_name(parser: Parser, tmp_path: Path) -> None:
    (tmp_path / "One.xodr").write_text(BUILT_IN)
    (tmp_path / "Other.xodr").write_text(BUILT_IN)
    one, other = load_town(tmp_path / "One.xodr"), load_town(tmp_path / "Other.xodr")
    assert (one.name, other.name) == ("One", "Other")
    assert one.lanes is other.lanes
    (tmp_path / "One.xodr").write_text(BUILT_IN + "<!-- changed -->")
    assert load_town(tmp_path / "One.xodr").opendrive.endswith("<!-- changed -->")
    assert parser.count == 2


def test_an_entry_of_another_process_is_used(filled: Parser) -> None:
    assert load_town().spawn_points
    assert filled.count == 0


def test_another_parser_does_not_use_the_entries(filled: Parser, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "_digest", lambda _: b"newer")
    load_town()
    assert filled.count == 1


@pytest.mark.parametrize("damage", ["empty", "cut", "flipped", "pickle", "no town", "a folder"])
def test_damaged_entries_are_ignored_and_rebuilt(filled: Parser, damage: str) -> None:
    path = entry()
    whole = path.read_bytes()
    signed = {"pickle": pickle.dumps({"lines": 1}), "no town": b"PK\x05\x06" + bytes(18)}
    match damage:
        case "empty":
            path.write_bytes(b"")
        case "cut":
            path.write_bytes(whole[: len(whole) // 2])
        case "flipped":
            path.write_bytes(whole[:-100] + bytes((whole[-100] ^ 1,)) + whole[-99:])
        case "a folder":
            path.unlink()
            path.mkdir()
        case _:
            path.write_bytes(b"carla-recap town 1\n" + sha256(signed[damage]).digest() + signed[damage])
    assert load_town().spawn_points
    assert filled.count == 1
    if damage != "a folder":
        assert path.read_bytes() == whole


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="Windows has no file modes")
def test_entries_that_others_can_write_are_ignored(filled: Parser) -> None:
    entry().chmod(0o666)
    load_town()
    assert filled.count == 1


def test_a_folder_that_cannot_be_written_costs_nothing(
    parser: Parser, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv(cache.FOLDER, str(tmp_path / "file" / "folder"))
    assert load_town().lanes
    monkeypatch.setenv(cache.FOLDER, "")
    forget()
    assert load_town().lanes
    assert parser.count == 2


def test_the_cache_is_bounded(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(cache.FOLDER, str(tmp_path))
    monkeypatch.setattr(cache, "_MOST_BYTES", 1000)
    for number in range(5):
        cache.write_entry(f"{number}", bytes(400))
        os.utime(tmp_path / f"{number}.town", (number, number))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["3.town", "4.town"]
    cache.write_entry("large", bytes(600))
    assert cache.read_entry("large") is None
    assert cache.read_entry("4") == bytes(400)


def test_nothing_but_entries_is_left_in_the_folder(parser: Parser) -> None:
    load_town()
    assert list(entry().parent.iterdir()) == [entry()]


@pytest.mark.parametrize("variable", ["XDG_CACHE_HOME", "HOME"])
def test_the_folder_is_the_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, variable: str) -> None:
    monkeypatch.delenv(cache.FOLDER, raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(cache.sys, "platform", "linux")
    monkeypatch.setenv(variable, str(tmp_path))
    parts = ("carla-recap", "towns") if variable == "XDG_CACHE_HOME" else (".cache", "carla-recap", "towns")
    assert cache.cache_folder() == tmp_path.joinpath(*parts)
