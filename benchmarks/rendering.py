"""Images by the software renderer: a town with 100 vehicles and 50 walkers, seen from eight of the vehicles."""

from __future__ import annotations

import random
import time
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from benchmarks.measuring import TOWN, Line, Subject, at_least, fastest, line

if TYPE_CHECKING:
    from collections.abc import Iterator

VEHICLES: Final = 100
WALKERS: Final = 50
VIEWS: Final = 8
ROUNDS: Final = 4
TYPES: Final = ("vehicle.tesla.model3", "vehicle.audi.tt", "vehicle.nissan.patrol", "vehicle.mercedes.sprinter")


def cameras(_: Subject) -> Iterator[Line]:
    from carla_recap.rendering.camera import ImageKind
    from carla_recap.rendering.renderer import Renderer

    four = (ImageKind.RGB, ImageKind.SEMANTIC, ImageKind.INSTANCE, ImageKind.DEPTH)
    town, actors, poses = crowded_town()
    with Renderer(town.tiles) as renderer:
        for what, width, height, kinds, goal in (
            ("RGB", 800, 600, four[:1], 30),
            ("RGB, semantic, instance, depth", 800, 600, four, 18),
            ("RGB", 320, 240, four[:1], 60),
        ):

            def draw_all() -> None:
                for camera in seen:  # noqa: B023
                    renderer.draw(camera, actors, kinds)  # noqa: B023

            seen = [camera_behind(pose, width, height) for pose in poses[:VIEWS]]
            draw_all()
            rate = at_least(VIEWS / fastest(draw_all, ROUNDS), "{:.0f} a second", goal)
            cpu = fastest(draw_all, ROUNDS, time.process_time) / VIEWS
            yield line(f"{width} x {height}: {what}", rate, f"{cpu * 1e3:.0f} ms of CPU")


def crowded_town() -> tuple[Any, Any, Any]:
    """Return the mesh of a town, actors in it, and CARLA's poses of these."""
    from carla_recap.replay.pose import right_handed
    from carla_recap.roads.drawing import load_map
    from carla_recap.roads.find import find_map
    from carla_recap.scene.actor_instances import instances
    from carla_recap.scene.appearance import look_of
    from carla_recap.scene.description import LookColumns
    from carla_recap.town.mesh import load_town_mesh

    path = TOWN if TOWN.exists() else find_map("Brickfield")
    assert path is not None
    lines, chance = load_map(path).centre_lines, random.Random(1)
    poses, looks = [], []
    for number in range(VEHICLES + WALKERS):
        way = chance.choice(lines)
        index = chance.randrange(len(way) - 1)
        x, y, z = way[index]
        ahead = way[index + 1] - way[index]
        poses.append((100 * x, -100 * y, 100 * z, 0, 0, -np.degrees(np.arctan2(ahead[1], ahead[0]))))
        kind = chance.choice(TYPES) if number < VEHICLES else f"walker.pedestrian.{chance.randint(1, 40):04d}"
        color = ",".join(str(chance.randrange(256)) for _ in range(3))
        looks.append(look_of(kind, 1 if number < VEHICLES else 2, {"color": color}, None))
    table = np.array(poses)
    actors = LookColumns(np.arange(1, len(looks) + 1, dtype=np.uint32), looks)
    return load_town_mesh(path), instances(actors, right_handed(table)), table


def camera_behind(pose: Any, width: int, height: int) -> Any:
    """Return a chase camera."""
    from carla_recap.rendering.camera import Camera
    from carla_recap.replay.pose import attach, right_handed, rotations

    behind = right_handed(attach(pose, np.array((-600.0, 0, 300, 0, -8, 0))))
    return Camera(width, height, 90.0, behind[:3], rotations(behind))


ROWS: Final = (cameras,)
