"""Rules judged on recordings of actors that drive given ways."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from textwrap import dedent
from typing import Any, Final

import numpy as np
import pytest
from numpy.typing import ArrayLike

from carla_recap import ActorKind, Spawn, Verdict, attributes, check, create_recording, open_recording
from carla_recap.rules.rule_sets import parse_rules
from tests.roads.straight_road import STRAIGHT_ROAD

TICK: Final = 0.1
HERO: Final = 1


Judge = Callable[..., Verdict]


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Returns the recording of some ways, which is written once."""
    folder = tmp_path_factory.mktemp("ways")
    paths: dict[str, Path] = {}

    def path_of(ways: Sequence[ArrayLike], *more: Any) -> Path:
        key = repr(([np.asarray(way).tolist() for way in ways], *more))
        if key not in paths:
            paths[key] = folder / f"{len(paths)}.mcap"
            write(paths[key], ways, *more)
        return paths[key]

    return path_of


@pytest.fixture
def judge(tmp_path: Path, recorded: Callable[..., Path]) -> Judge:
    """Judges a rule, or the last one of a file, on actors that drive ways: the hero, then cars without a role.

    A way has a row of x, y and maybe z in m, right-handed, for each frame of 0.1 s. In the frames of `hits`, the hero
    collides with the actor. Those of the numbers of `walkers` are no cars.
    """

    def judged(
        rules: str, *ways: ArrayLike, hits: Mapping[int, int] | None = None, walkers: Collection[int] = ()
    ) -> Verdict:
        road = tmp_path / "Straight.xodr"
        road.write_text(STRAIGHT_ROAD, "utf-8")
        text = dedent(rules)
        parsed = parse_rules(text if "[rules." in text else f"[rules.it]\n{text}", "rules.toml")
        with open_recording(recorded(ways, hits or {}, walkers)) as recording:
            return check(recording, parsed, road_map=str(road))[-1]

    return judged


def write(path: Path, ways: Sequence[ArrayLike], hits: Mapping[int, int], walkers: Collection[int] = ()) -> None:
    """Write a recording of actors that go ways: the hero first; those of some numbers are walkers, the others cars."""
    poses = [np.asarray(way, np.float64) for way in ways]
    cars = [
        Spawn(
            HERO + number,
            ActorKind.WALKER if number in walkers else ActorKind.VEHICLE,
            type_id="walker.pedestrian.0001" if number in walkers else "vehicle.tesla.model3",
            attributes=attributes(role_name="autopilot" if number else "hero"),
        )
        for number in range(len(poses))
    ]
    with create_recording(path, map_name="Straight") as recorder:
        for frame in range(max(map(len, poses))):
            there = [(HERO + number, way[frame]) for number, way in enumerate(poses) if frame < len(way)]
            more: dict[str, Any] = {"spawned": cars} if not frame else {}
            if frame in hits:
                pair = {"actor1": [HERO], "actor2": [hits[frame]], "hero1": [True], "hero2": [False]}
                more["collisions"] = {"id": [0], **pair}
            transforms = {
                "id": [id for id, _ in there],
                "x": [100 * pose[0] for _, pose in there],
                "y": [-100 * pose[1] for _, pose in there],
                "z": [100 * pose[2] if len(pose) > 2 else 0.0 for _, pose in there],
            }
            recorder.add_frame(frame * TICK, transforms=transforms, **more)


def straight(speed: float, seconds: float, x: float = 0.0, y: float = -1.75) -> np.ndarray:
    """A way along x at a speed in m/s."""
    time = np.arange(round(seconds / TICK) + 1) * TICK
    return np.stack((x + speed * time, np.full(len(time), y)), axis=1)
