"""Recordings of boxes that move as a test says."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carla_recap.formats import open_reader
from carla_recap.formats.base import Reader
from carla_recap.model.lives import ActorLife
from carla_recap.model.records import Spawn, attributes
from carla_recap.queries.measures.motion_table import MotionTable
from tests.queries.conftest import write

Drive = Callable[..., Reader]

RATE = 20.0


@dataclass
class Mover:
    """An actor with a path: x and y in m, right-handed, and the heading in degrees, as functions of the time in s."""

    id: int
    x: Callable[[float], float] = lambda _: 0.0
    y: Callable[[float], float] = lambda _: 0.0
    yaw: Callable[[float], float] = lambda _: 0.0
    size: tuple[float, float] | None = (4.0, 2.0)
    offset: tuple[float, float] = (0.0, 0.0)
    type_id: str = "vehicle.audi.tt"
    kind: int = 1
    role_name: str = ""
    parent: int | None = None
    present: Callable[[float], bool] = lambda _: True
    has_velocity: bool = True
    z: float = 0.0
    other: dict[str, str] = field(default_factory=dict)


def straight(id: int, x: float, y: float, speed: float, yaw: float = 0.0, **given: Any) -> Mover:
    """Return an actor that keeps its velocity."""
    cos, sin = math.cos(math.radians(yaw)), math.sin(math.radians(yaw))
    return Mover(id, lambda t: x + speed * cos * t, lambda t: y + speed * sin * t, lambda _: yaw, **given)


@pytest.fixture
def drive(tmp_path: Path) -> Iterator[Drive]:
    """Record actors that move, and open the recording: `drive([Mover(1), ...], seconds=5)`."""
    readers: list[Reader] = []

    def drive(
        movers: list[Mover],
        seconds: float = 5.0,
        rate: float = RATE,
        events: dict[int, dict[str, Any]] | None = None,
        suffix: str = ".mcap",
    ) -> Reader:
        path = tmp_path / f"{len(readers)}{suffix}"
        readers.append(open_reader(record(path, movers, seconds, rate, events or {})))
        return readers[-1]

    yield drive
    for reader in readers:
        reader.close()


def motion_table(
    time: np.ndarray, x: Any, y: Any = 0.0, z: Any = 0.0, yaw: Any = 0.0, vx: Any = 0.0, vy: Any = 0.0, **changed: Any
) -> MotionTable:
    """Return a table of boxes of 4 m by 2 m: numbers of all actors and frames, (actors, frames), or the same for some."""
    shape = len(x), len(time)
    rows = [np.broadcast_to(np.asarray(values, float), shape).copy() for values in (x, y, z, yaw, vx, vy)]
    count = len(x)
    lives = tuple(ActorLife(id, "", "vehicle", "", 0.0, spawn=Spawn(id)) for id in range(1, count + 1))
    sizes = np.full(count, 4.0), np.full(count, 2.0), np.full(count, 1.5), np.zeros((count, 3))
    return replace(MotionTable(0, len(time), time, lives, *rows, *sizes), **changed)


def record(path: Path, movers: list[Mover], seconds: float, rate: float, events: dict[int, dict[str, Any]]) -> Path:
    count = round(seconds * rate) + 1
    frames: list[dict[str, Any]] = []
    step = 1e-4
    for index in range(count):
        time = index / rate
        present = [mover for mover in movers if mover.present(time)]
        poses, velocities = [], []
        for mover in present:
            x, y, yaw = mover.x(time), mover.y(time), mover.yaw(time)
            poses.append((mover.id, x * 100, -y * 100, mover.z * 100, 0.0, 0.0, -yaw))
            if mover.has_velocity:
                vx = (mover.x(time + step) - mover.x(time - step)) / (2 * step)
                vy = (mover.y(time + step) - mover.y(time - step)) / (2 * step)
                velocities.append((mover.id, vx, -vy, 0.0, 0.0, 0.0, 0.0))
        frame: dict[str, Any] = {"transforms": np.array(poses).reshape(-1, 7).tolist()}
        frame["transforms"] = [(int(row[0]), *row[1:]) for row in frame["transforms"]]
        if velocities:
            frame["velocities"] = velocities
        if index == 0:
            attached = [(mover.id, mover.parent) for mover in movers if mover.parent is not None]
            boxes = [_box(mover) for mover in movers if mover.size is not None]
            frame = {"spawned": list(map(_spawn, movers)), "parented": attached, "bounding_boxes": boxes} | frame
        frames.append(frame | events.get(index, {}))
    return write(path, frames, durations=[1 / rate] * (count - 1) + [-1.0])


def _spawn(mover: Mover) -> Spawn:
    given = attributes(**({"role_name": mover.role_name} | mover.other))
    return Spawn(mover.id, mover.kind, type_id=mover.type_id, attributes=given)


def _box(mover: Mover) -> tuple[float, ...]:
    (x, y), (length, width) = mover.offset, mover.size or (0.0, 0.0)
    return mover.id, 100 * x, -100 * y, 75.0, 50 * length, 50 * width, 75.0
