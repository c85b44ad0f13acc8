"""Small recordings, written as the records of each frame; and scenes in a form that can be compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from carla_recap import ActorKind, Attribute, Spawn, create_recording

if TYPE_CHECKING:
    from pathlib import Path

    from carla_recap.replay import Scene

Script = Mapping[str, Any]  # records by type


def spawn(id: int, type_id: str = "vehicle.audi.tt", x: float = 0, yaw: float = 0, **attributes: str) -> Spawn:
    kinds = {"vehicle": ActorKind.VEHICLE, "walker": ActorKind.WALKER, "traffic": ActorKind.TRAFFIC_LIGHT}
    kind = kinds.get(type_id.partition(".")[0], ActorKind.OTHER)
    return Spawn(id, kind, x, 0, 0, 0, 0, yaw, 0, type_id, [Attribute(3, *pair) for pair in attributes.items()])


def pose(id: int, x: float = 0, y: float = 0, z: float = 0, roll: float = 0, pitch: float = 0, yaw: float = 0) -> Any:
    return (id, x, y, z, roll, pitch, yaw)


def velocity(id: int, x: float) -> Any:
    return (id, x, 0, 0, 0, 0, 0)


def light(id: int, state: int, elapsed: float = 0) -> Any:
    return (id, 0, elapsed, state)


def write(
    path: Path,
    frames: Sequence[Script],
    *,
    tick: float = 1.0,
    times: list[float] | None = None,
    map_name: str = "Town01",
    **options: Any,
) -> Path:
    with create_recording(path, map_name=map_name, date=0, **options) as recorder:
        for place, frame in enumerate(frames):
            recorder.add_frame(times[place] if times else place * tick, **frame)
    return path


def state(scene: Scene) -> dict[str, Any]:
    """Return all of a scene but its events."""
    return {
        "time": scene.time,
        "frame": scene.frame_id,
        "poses": dict(zip(scene.ids.tolist(), scene.poses.tolist(), strict=True)),
        "actors": {
            id: (actor.type_id, actor.spawned_at, actor.parent, actor.attached, actor.bounding_box)
            for id, actor in scene.actors.items()
        },
        "order": list(scene.actors),
        "places": {id: None if (p := scene.pose_of(id)) is None else p.tolist() for id in scene.actors},
        "doors": dict(scene.doors),
        "weather": scene.weather.tolist() if scene.weather is not None else None,
        **{
            name: getattr(scene, name).tolist()
            for name in (
                "light_states",
                "scene_lights",
                "vehicle_controls",
                "walker_controls",
                "vehicle_lights",
                "velocities",
            )
        },
    }


def x_of(scene: Scene | None, id: int = 1) -> float:
    assert scene is not None
    place = scene.pose_of(id)
    assert place is not None
    return float(np.round(place[0], 6))
