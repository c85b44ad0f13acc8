"""The memory that viewers take: it does not grow with the recording, but for a few numbers of a frame."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from carla_recap import Recording, clip, open_recording
from carla_recap.scene.follow import followed_series
from tests.replay.scripts import spawn, write

pytest.importorskip("foxglove", reason="the extra foxglove-live is not installed")

from carla_recap.show.foxglove.websocket import _PlayedRecording

ACTORS: Final = 40
SHORT, LONG = 3500, 6000  # frames, both above those of a table of near misses
TICK: Final = 0.05  # s
PER_FRAME: Final = 1500  # bytes; the poses of all actors are 1,920


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("memory")
    ids = np.arange(1, ACTORS + 1)
    places = {"id": ids, "y": np.where(ids == 1, 0.0, 900.0)}
    frames: list[dict[str, Any]] = [
        {"transforms": places | {"x": np.where(ids == 1, 50.0 * frame, 1000.0 * ids)}} for frame in range(LONG)
    ]
    frames[0]["spawned"] = [spawn(id, role_name="hero" * (id == 1)) for id in ids.tolist()]
    whole = write(folder / "whole.log", frames, tick=TICK)  # which takes less time than an .mcap
    paths = [folder / f"{count}.mcap" for count in (10, SHORT, LONG)]
    for path in paths:
        clip(whole, path, start=0, duration=(int(path.stem) - 1) * TICK)
    return paths


SHOWN: Final[dict[str, Callable[[Recording], object]]] = {
    "the followed actor": lambda recording: followed_series(recording, 1, {}),
    "view --foxglove": lambda recording: _PlayedRecording(recording, None, 0.0, 0.0, None, None),
}


@pytest.mark.parametrize("name", SHOWN)
def test_memory_does_not_grow_with_the_recording(recordings: list[Path], name: str) -> None:
    peaks = []
    for path in recordings:  # with the first one, modules are imported
        with open_recording(path) as recording:
            tracemalloc.start()
            try:
                SHOWN[name](recording)
                peaks.append(tracemalloc.get_traced_memory()[1])
            finally:
                tracemalloc.stop()
    assert peaks[2] - peaks[1] < PER_FRAME * (LONG - SHORT)
