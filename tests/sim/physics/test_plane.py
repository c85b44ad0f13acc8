from __future__ import annotations

import gc
import resource
from itertools import pairwise
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
    sizes = []
    for _ in range(3):
        use_planes(100)
        sizes.append(resident())
    return min(later - earlier for earlier, later in pairwise(sizes))  # a leak grows each time


def test_planes_that_are_gone_leave_no_memory() -> None:
    with get_context("spawn").Pool(1) as pool:  # where nothing else takes memory
        assert pool.apply(growth) < LEAST
