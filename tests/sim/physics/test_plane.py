from __future__ import annotations

import ctypes
import gc
from itertools import pairwise

import pytest

from carla_recap.sim.physics.plane import WALKER, Plane

MOST = 10_000  # bytes; a plane's buffers are larger


class MallocInfo(ctypes.Structure):
    """What glibc says of its heap."""

    _fields_ = (("values", ctypes.c_size_t * 10),)


def in_use() -> int:
    """Return the bytes in use, in mappings of their own and in arenas: `hblkhd` and `uordblks`."""
    mallinfo = getattr(ctypes.CDLL(None), "mallinfo2", None)
    if mallinfo is None:
        pytest.skip("glibc 2.33 or later counts what is allocated")
    mallinfo.restype = MallocInfo
    gc.collect()
    info = mallinfo()
    return info.values[4] + info.values[7]


def use_plane() -> None:
    plane = Plane()
    for _ in range(300):
        plane.add_disc(WALKER, 0.3, 75.0)
    plane.step(0.05)


def test_planes_that_are_gone_leave_no_memory() -> None:
    sizes = []
    for _ in range(20):
        use_plane()
        sizes.append(in_use())
    growth = sorted(after - before for before, after in pairwise(sizes))
    assert growth[len(growth) // 2] < MOST
