"""With `compat`, answers are what CARLA's own query code prints, byte for byte."""

from __future__ import annotations

import gzip
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from carla_recap.errors import NotARecording
from carla_recap.formats import open_reader
from carla_recap.formats.base import Reader
from carla_recap.output.text import text
from carla_recap.queries.blocked import Blocked, blocked
from carla_recap.queries.collisions import Collisions, collisions
from carla_recap.queries.info import Info, info
from tests.samples import CARLA_LOGS, RANDOM_LOGS

FOLDERS = (CARLA_LOGS, RANDOM_LOGS)
NO_RECORDINGS = ("magic_bad", "not_a_log", "zero_bytes")
NAME = re.compile(r"(?P<log>.+?)\.(?P<query>[a-z]+)(_(?P<options>.+))?\.txt(\.gz)?")

# A traffic light's state of 0x80 and above: CARLA prints the raw byte there, we print a `?`.
RAW_STATES = tuple(f"random_{number}.info_all" for number in (2022, 2129, 2161))
RAW_STATE = re.compile(rb"(  Id: \d+ state: )[^\x00-\x7f]( frozen: )")

pytestmark = pytest.mark.skipif(
    not all(folder.is_dir() for folder in FOLDERS),
    reason=f"{' or '.join(map(str, FOLDERS))} is not here: it is data that is not part of the repository",
)


def expectations() -> list[Path]:
    found = [path for folder in FOLDERS for path in (folder / "expected").glob("*.txt*")]
    return sorted(path for path in found if not path.name.startswith(NO_RECORDINGS))


def ask(reader: Reader, query: str, options: str | None) -> Info | Collisions | Blocked:
    if query == "info":
        return info(reader, all=options == "all", compat=True)
    first, second = (options or "").split("_")
    if query == "collisions":
        return collisions(reader, first, second, compat=True)
    return blocked(reader, float(first), float(second), compat=True)


@pytest.mark.parametrize("expected", expectations(), ids=lambda path: path.name)
def test_as_carla(
    expected: Path, suffix: str, converted: Callable[[Path, str], Path], opened: Callable[[Path], Reader]
) -> None:
    name = NAME.fullmatch(expected.name)
    assert name
    reader = opened(converted(expected.parents[1] / f"{name['log']}.log", suffix))
    answer = "".join(text(ask(reader, name["query"], name["options"]))).encode()
    wanted = gzip.decompress(expected.read_bytes()) if expected.suffix == ".gz" else expected.read_bytes()
    if expected.name.startswith(RAW_STATES):
        wanted = RAW_STATE.sub(rb"\1?\2", wanted)
    assert answer.splitlines(keepends=True) == wanted.splitlines(keepends=True)


def test_there_is_something_expected() -> None:
    assert len(expectations()) > 250


@pytest.mark.parametrize("name", NO_RECORDINGS)
def test_no_recording(name: str) -> None:
    with pytest.raises(NotARecording):
        open_reader(CARLA_LOGS / f"{name}.log")
