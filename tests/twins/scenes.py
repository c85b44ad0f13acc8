"""What a replay shows at each frame: its records, and what is left of earlier ones, actor by actor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from carla_recap.model.lives import BoundingBox
from carla_recap.model.records import ActorKind

LASTING = {"transforms": (ActorKind.VEHICLE, ActorKind.WALKER), "light_states": (ActorKind.TRAFFIC_LIGHT,)}
"""The kinds of actors whose latest record of a type holds in later frames."""


def scenes(
    frames: Sequence[Mapping[str, Any]], *, tick: float, ignore_hero: bool, ignore_spectator: bool
) -> Iterator[dict[str, Any]]:
    """Yield what `tests.replay.scripts.state` has of each scene, and the events of its frame."""
    actors, hidden, doors, lamps, weather = {}, set(), {}, {}, None
    latest: dict[str, dict[int, Any]] = {name: {} for name in LASTING}

    def forget(id: int) -> None:
        for kept in (actors, doors, *latest.values()):
            kept.pop(id, None)

    for number, frame in enumerate(frames):
        events, new = [], set()
        for spawn in frame["spawned"]:
            forget(spawn.id)
            is_hero, is_spectator = spawn.attribute("role_name") == "hero", spawn.type_id == "spectator"
            if (ignore_hero and is_hero) or (ignore_spectator and is_spectator):
                hidden.add(spawn.id)
                continue
            hidden.discard(spawn.id)
            actors[spawn.id] = {"spawn": spawn, "at": number * tick, "parent": None, "attached": False, "box": None}
            new.add(spawn.id)
            events.append(("Spawned", spawn.id))
        for (id,) in frame["destroyed"]:
            forget(id)
            events += [] if id in hidden else [("Destroyed", id)]
            hidden.add(id)
        for id, parent in frame["parented"]:
            if id in actors:
                actors[id] |= {"parent": parent, "attached": id in new}
            events += [] if id in hidden else [("Parented", id, parent)]
        events += [("Collided", *row[:3], bool(row[3]), bool(row[4])) for row in frame["collisions"]]
        for id, door, is_open in frame["doors"]:
            if id not in hidden:
                moved = set(range(6) if door == 6 else (door,))
                doors[id] = doors.get(id, set()) | moved if is_open else doors.get(id, set()) - moved
        for id, *sizes in frame["bounding_boxes"]:
            if id in actors:
                actors[id]["box"] = BoundingBox.of(sizes) or actors[id]["box"]
        for row in frame["weather"]:
            weather = row
        lamps |= {row[0]: row for row in frame["scene_lights"]}
        shown = {
            name: {row[0]: row for row in frame[name] if row[0] not in hidden}
            for name in ("transforms", "light_states", "vehicle_controls", "velocities", "walker_controls", "vehicle_lights")
        }
        for name, kinds in LASTING.items():
            held = {id: row for id, row in latest[name].items() if id in actors and actors[id]["spawn"].kind in kinds}
            latest[name] = shown[name] = held | shown[name]
        yield {
            "time": number * tick,
            "frame": number + 1,
            "poses": {id: list(row[1:]) for id, row in shown.pop("transforms").items()},
            "actors": {
                id: (each["spawn"].type_id, each["at"], each["parent"], each["attached"], each["box"])
                for id, each in actors.items()
            },
            "order": list(actors),
            "doors": {id: open for id, open in doors.items() if open},
            "weather": weather,
            "scene_lights": [lamps[id] for id in sorted(lamps)],
            **{name: [rows[id] for id in sorted(rows)] for name, rows in shown.items()},
            "events": events,
        }
