"""Recordings of worlds, and their frames."""

from __future__ import annotations

import resource
from contextlib import contextmanager
from typing import TYPE_CHECKING

import carla_recap
from tests.waiting import wait_until

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from carla_recap.model.frame import Frame
    from carla_recap.sim.world import World


def frames(path: Path) -> list[Frame]:
    with carla_recap.open_recording(path) as recording:
        return list(recording.frames())


def record(world: World, path: Path, ticks: int, *, additional_data: bool = False, **options: bool) -> list[Frame]:
    """Record some ticks, by default without another process, and return the frames; for the options see `start`."""
    world.recorder.start(path, additional_data, **{"in_process": True, **options})
    for _ in range(ticks):
        world.tick()
    world.stop_recorder()
    return frames(path)


def writer_pid(world: World) -> int:
    """Return the id of the process that writes."""
    assert world.recorder._writer is not None
    return world.recorder._writer.pid


@contextmanager
def disk_of(world: World, size: int) -> Iterator[None]:
    """Let no file that the world's recorder writes grow beyond a size, in bytes: larger than the bytecode of a module."""
    writer = writer_pid(world)
    resource.prlimit(writer, resource.RLIMIT_FSIZE, (size, size))
    yield


def run_until_it_fails(world: World) -> None:
    def has_failed() -> bool:
        world.tick()
        return not world.recorder.path

    wait_until(has_failed, pause=0.0)
