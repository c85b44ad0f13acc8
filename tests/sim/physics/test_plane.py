from __future__ import annotations

import gc
import resource
from multiprocessing import get_context
from pathlib import Path

from carla_recap.sim.physics.plane import WALKER, Plane

LEAST = 1 << 20  # bytes that may come and go


def resident() -> int:
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def use_planes(count: int) -> None:
    for _ in range(count):
        plane = Plane()
        for _ in range(300):
            plane.add_disc(WALKER, 0.3, 75.0)
        plane.step(0.05)


def growth() -> int:
    use_planes(100)
    before = resident()
    use_planes(100)
    return resident() - before


def test_planes_that_are_gone_leave_no_memory() -> None:
    with get_context("spawn").Pool(1) as pool:  # where nothing else takes memory
        assert pool.apply(growth) < LEAST
