"""Runs of the simulator that are compared: of the same seed, and of another one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from carla_recap import open_recording
from carla_recap.sim import World
from carla_recap.sim.traffic import populate

if TYPE_CHECKING:
    from pathlib import Path

    from carla_recap import Differences

SECONDS = 5


def run(path: Path, seed: int) -> Path:
    """Record traffic."""
    with World(seed=seed) as world:
        populate(world, vehicles=12, walkers=6)
        world.recorder.start(path, in_process=True)
        world.run(SECONDS)
    return path


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(tmp_path_factory.mktemp("runs") / "first.mcap", 1)


def compare(a: Path, b: Path, **options: float) -> Differences:
    with open_recording(a) as one, open_recording(b) as other:
        return one.diff(other, **options)


def test_the_same_seed_gives_an_equal_run(first: Path, tmp_path: Path) -> None:
    assert compare(first, run(tmp_path / "again.log", 1)).summary == "equal within 0 m"


def test_another_seed_differs_from_the_first_frame_on(first: Path, tmp_path: Path) -> None:
    found = compare(first, run(tmp_path / "other.mcap", 2))
    assert not found.equal
    assert len(found.lights) == 17
    assert found.first is None or found.first.first == 0
    assert found.missing
    assert found.extra
