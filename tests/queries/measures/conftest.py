"""Recordings of boxes that move as a test says."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carla_recap.formats import open_reader
from carla_recap.formats.base import Reader
from carla_recap.model.records import Spawn, attributes
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
            spawns = {
                "spawned": [
                    Spawn(
                        mover.id,
                        mover.kind,
                        type_id=mover.type_id,
                        attributes=attributes(**({"role_name": mover.role_name} | mover.other)),
                    )
                    for mover in movers
                ],
                "parented": [(mover.id, mover.parent) for mover in movers if mover.parent is not None],
                "bounding_boxes": [
                    (
                        mover.id,
                        mover.offset[0] * 100,
                        -mover.offset[1] * 100,
                        75.0,
                        mover.size[0] * 50,
                        mover.size[1] * 50,
                        75.0,
                    )
                    for mover in movers
                    if mover.size is not None
                ],
            }
            frame = spawns | frame
        frames.append(frame | events.get(index, {}))
    return write(path, frames, durations=[1 / rate] * (count - 1) + [-1.0])
