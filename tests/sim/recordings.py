"""Recordings of worlds, and their frames."""

from __future__ import annotations

from typing import TYPE_CHECKING

import carla_recap

if TYPE_CHECKING:
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
