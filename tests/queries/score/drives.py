"""Recordings of drives in the built-in town, made frame by frame, and the route along its main road.

The road leads to the west, at y = 1.75; the route, from x = 255 to x = 155, is 100 m long.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import numpy as np

from carla_recap.formats import open_reader
from carla_recap.model.frame import Header
from carla_recap.model.records import Spawn, attributes
from carla_recap.queries.score import Route, Score, ScoreOptions, score
from tests.queries.conftest import write

TICK: Final = 0.05
HERO, OTHER = 7, 8
START, END, Y = 255.0, 155.0, 1.75
ROUTE: Final = Route("1", "Brickfield", np.array([(START, Y, 0.0), (END, Y, 0.0)]))

Pose = tuple[float, float, float]


def westward(speeds: Sequence[float], start: float = START, y: float = Y, tick: float = TICK) -> list[Pose]:
    """Return poses (x, y, heading in degrees) of a car that has a speed in each frame."""
    return [(start - way, y, 180.0) for way in (np.cumsum(speeds) * tick).tolist()]


def at_speed(speed: float, metres: float, tick: float = TICK) -> list[float]:
    return [speed] * round(metres / speed / tick)


class Drives:
    """Writes recordings and scores them."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __call__(
        self,
        poses: Sequence[Pose],
        *,
        route: Route | None = ROUTE,
        others: Mapping[int, tuple[Spawn, Sequence[Pose]]] | None = None,
        touches: Iterable[tuple[int, int]] = (),
        lights: Mapping[int, tuple[Spawn, int | Sequence[int]]] | None = None,
        tick: float = TICK,
        **options: Any,
    ) -> Score:
        """Return the score of a drive.

        Each actor has a pose in each frame; `touches` are frames, and whom the hero touches; lights have one state, or one
        for each frame.
        """
        actors = {HERO: (vehicle(HERO, "hero"), poses), **(others or {})}
        lights = lights or {}
        frames: list[dict[str, Any]] = [{} for _ in poses]
        frames[0]["spawned"] = [spawn for spawn, _ in (*actors.values(), *lights.values())]
        for number, frame in enumerate(frames):
            if hits := [(index, HERO, other, True, False) for index, (at, other) in enumerate(touches) if at == number]:
                frame["collisions"] = hits
            frame["transforms"] = [
                (id, 100 * x, -100 * y, 0.0, 0.0, 0.0, -yaw)
                for id, (_, each) in actors.items()
                for x, y, yaw in each[number : number + 1]
            ]
            if lights:
                states = ((id, state if isinstance(state, int) else state[number]) for id, (_, state) in lights.items())
                frame["light_states"] = [(id, False, 0.0, state) for id, state in states]
        write(self.path, frames, header=Header("Brickfield", 1_600_000_000), durations=[tick] * len(frames))
        with closing(open_reader(self.path)) as reader:
            return score(reader, route, ScoreOptions(**options))


def vehicle(id: int, role: str = "", type_id: str = "vehicle.mini.cooper_s", **more: str) -> Spawn:
    return Spawn(id, 1, type_id=type_id, attributes=attributes(role_name=role, **more))
