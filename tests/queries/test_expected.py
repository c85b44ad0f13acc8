"""With `compat`, answers are what CARLA's own query code prints, byte for byte."""

from __future__ import annotations

import gzip
import re
from typing import TYPE_CHECKING

import pytest

from carla_recap.errors import NotARecording
from carla_recap.formats import open_reader
from carla_recap.queries import Blocked, Collisions, Info, blocked, collisions, info
from carla_recap.queries.report import text
from tests.samples import CARLA_LOGS

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from carla_recap.formats.base import Reader

EXPECTED = CARLA_LOGS / "expected"
NO_RECORDINGS = ("magic_bad", "not_a_log", "zero_bytes")
NAME = re.compile(r"(?P<log>.+?)\.(?P<query>[a-z]+)(_(?P<options>.+))?\.txt(\.gz)?")

pytestmark = pytest.mark.skipif(
    not EXPECTED.is_dir(), reason=f"{EXPECTED} is not here: it is data that is not part of the repository"
)


def expectations() -> list[Path]:
    return sorted(path for path in EXPECTED.glob("*.txt*") if not path.name.startswith(NO_RECORDINGS))


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
    reader = opened(converted(CARLA_LOGS / f"{name['log']}.log", suffix))
    answer = "".join(text(ask(reader, name["query"], name["options"]))).encode()
    wanted = gzip.decompress(expected.read_bytes()) if expected.suffix == ".gz" else expected.read_bytes()
    assert answer.splitlines(keepends=True) == wanted.splitlines(keepends=True)


def test_there_is_something_expected() -> None:
    assert len(expectations()) > 100


@pytest.mark.parametrize("name", NO_RECORDINGS)
def test_no_recording(name: str) -> None:
    with pytest.raises(NotARecording):
        open_reader(CARLA_LOGS / f"{name}.log")
