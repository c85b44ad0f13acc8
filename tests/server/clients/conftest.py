"""One server for everything that real clients do, with the built-in town under the name of one of CARLA's."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from carla_recap.roads.find import find_map
from carla_recap.server import running

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture(scope="package")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings")


@pytest.fixture(scope="package")
def port(recordings: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    maps = tmp_path_factory.mktemp("maps")
    built_in = find_map("Brickfield")
    assert built_in is not None
    (maps / "Town10HD.xodr").write_bytes(built_in.read_bytes())
    with running(maps=maps, recordings=recordings) as port:
        yield port
