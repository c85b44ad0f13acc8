"""Small recordings, written as the records of each frame; and scenes in a form that can be compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

from carla_recap import ActorKind, Attribute, Spawn, create_recording
from carla_recap.formats import create_writer
from carla_recap.model.frame import Frame, Header, Packet
from carla_recap.model.records import NO_ACTOR
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
    path: Path, frames: Sequence[Script], *, tick: float = 1.0, times: list[float] | None = None, **options: Any
) -> Path:
    """Write a recording of frames, whose options are those of `create_recording`."""
    with create_recording(path, **{"map_name": "Town01", "date": 0, **options}) as recorder:
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


IDS = st.integers(1, 4)
TYPE_IDS = st.sampled_from(["vehicle.audi.tt", "traffic.traffic_light", "walker.pedestrian.0001", "spectator"])
SPAWNS = st.builds(
    lambda id, type_id, hero, x: spawn(id, type_id, x, **({"role_name": "hero"} if hero else {})),
    IDS,
    TYPE_IDS,
    st.booleans(),
    st.integers(0, 9),
)


def matrix_of(quaternion: Sequence[float]) -> Any:
    """Return the rotation of a quaternion x, y, z, w as a matrix."""
    x, y, z, w = quaternion
    return np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )
    )


def few(rows: st.SearchStrategy[object], size: int = 2) -> st.SearchStrategy[list[object]]:
    return st.lists(rows, max_size=size)


FRAMES = st.fixed_dictionaries(
    {
        "spawned": few(SPAWNS),
        "destroyed": few(st.tuples(IDS), 1),
        "parented": few(st.tuples(IDS, IDS), 1),
        "doors": few(st.tuples(IDS, st.integers(0, 6), st.integers(0, 1))),
        "weather": few(st.integers(0, 99).map(lambda value: (value,) + (0,) * 13), 1),
        "transforms": few(st.builds(pose, IDS, st.integers(-300, 300), yaw=st.integers(-180, 180)), 4),
        "light_states": few(st.builds(light, IDS, st.integers(0, 4)), 3),
        "vehicle_controls": few(st.tuples(IDS, *[st.integers(0, 1)] * 5)),
        "velocities": few(st.builds(velocity, IDS, st.integers(0, 9))),
        "bounding_boxes": few(st.tuples(IDS, *[st.integers(0, 9)] * 6), 1),
        "scene_lights": few(st.tuples(IDS, *[st.integers(0, 1)] * 7), 1),
        "collisions": few(st.tuples(IDS, IDS, st.sampled_from([2, NO_ACTOR]), st.integers(0, 1), st.integers(0, 1)), 1),
        "walker_controls": few(st.tuples(IDS, st.integers(0, 9)), 1),
        "vehicle_lights": few(st.tuples(IDS, st.integers(0, 9)), 1),
    }
)


def build(
    path: Path, header: Header, frames: Sequence[Script], *, preamble: bool = False, times: Sequence[float] = ()
) -> Path:
    """Write a recording as only some builds write it, or with any times."""
    with create_writer(path, header) as writer:
        for place, frame in enumerate(frames):
            table = header.table
            packets = [
                Packet(table.named(name).id, table.named(name), None, table.named(name).records(rows))
                for name, rows in frame.items()
            ]
            before = preamble and place == 0
            elapsed = times[place] if times else 0.0 if before else float(place - preamble)
            writer.write(
                Frame(
                    place, 0 if before else place + 1 - preamble, elapsed, 0.0 if before else 1.0, packets, preamble=before
                )
            )
    return path
