"""Recordings to replay, each as a log and as MCAP."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from carla_recap import Recording, open_recording
from tests.replay.scripts import Script, write

Record = Callable[..., Recording]


@pytest.fixture(params=[".log", ".mcap"])
def suffix(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def record(tmp_path: Path, suffix: str) -> Iterator[Record]:
    """Write a recording, one mapping of records per frame, and open it."""
    opened: list[Recording] = []
    numbers = count()

    def make(*frames: Script, tick: float = 1.0, times: list[float] | None = None, **options: Any) -> Recording:
        path = write(tmp_path / f"{next(numbers)}{suffix}", frames, tick=tick, times=times, **options)
        opened.append(open_recording(path))
        return opened[-1]

    yield make
    for recording in opened:
        recording.close()
