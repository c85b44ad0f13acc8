from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.queries.score.drives import Drives

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(params=[".log", ".mcap"])
def drives(tmp_path: Path, request: pytest.FixtureRequest) -> Drives:
    return Drives(tmp_path / f"drive{request.param}")
