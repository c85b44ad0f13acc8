"""A car that hits a walker."""

from __future__ import annotations

from tests.replay.scripts import pose, spawn

CAR, WALKER = 1, 2
HIT = 2  # the frame of the collision


def accident(count=20, speed=10.0, walker=WALKER, kind="walker.pedestrian.0001"):
    """Return frames of a car that hits a walker in the third one, and stops."""
    step = 10 * speed  # cm
    frames = [{"transforms": [pose(CAR, min(n - HIT, 0) * step), pose(walker, 200, z=93)]} for n in range(count)]
    frames[0]["spawned"] = [spawn(CAR), spawn(walker, kind)]
    frames[HIT]["collisions"] = [(0, CAR, walker, False, False)]
    return frames
