"""Stationary intervals, record by record and actor by actor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from carla_recap.formats.base import Reader

Row = tuple[float, float, int, str, tuple[float, ...]]
"""The start, the duration, the id, the blueprint, and the position."""


@dataclass
class Actor:
    type_id: str = ""
    place: list[Any] | None = None
    start: float = 0.0
    duration: float = 0.0


def stationary(reader: Reader, min_time: float, min_distance: float, *, compat: bool) -> list[Row]:
    """Return the intervals as `blocked` sorts them; with `compat`, for ids that are spawned in order."""
    actors: dict[int, Actor] = {}
    rows: list[Row] = []
    newest = -1

    def report(id: int, actor: Actor) -> None:
        if actor.duration >= min_time and (compat or actor.duration > 0):
            place = tuple(map(float, actor.place or (0.0, 0.0, 0.0)))
            rows.append((actor.start, actor.duration, id, actor.type_id, place))

    for frame in reader.frames():
        length = frame.duration if compat else float(np.fmax(frame.duration, 0.0))
        for packet in frame.packets:
            name = packet.type.name if packet.type else ""
            if name == "spawned":
                for spawned in packet.records:
                    if not compat and (replaced := actors.get(spawned.id)):
                        report(spawned.id, replaced)
                    actors[spawned.id] = Actor(spawned.type_id)
                    newest = spawned.id
            elif name == "destroyed":
                for (id,) in packet.records.tolist():  # type: ignore[union-attr]
                    gone = actors.pop(newest if compat else id, None)
                    if gone and not compat:
                        report(id, gone)
            elif name == "transforms":
                latest = {int(record["id"]): record for record in packet.records}
                for record in packet.records if compat else latest.values():
                    id = int(record["id"])
                    actor = actors.setdefault(id, Actor())
                    place = [record[axis] for axis in "xyz"]
                    if actor.place is None and compat:
                        actor.place = [record["x"].dtype.type(0)] * 3
                    lies = any(60 < float(record[axis]) % 360 < 300 for axis in ("pitch", "roll"))
                    stays = actor.place is not None and not (lies and not compat and actor.type_id.startswith("walker."))
                    if stays and actor.place is not None:
                        dx, dy, dz = (new - old for new, old in zip(place, actor.place, strict=True))
                        stays = float(np.sqrt(dx * dx + dy * dy + dz * dz)) < min_distance
                    if stays:
                        if actor.duration == 0:
                            actor.start = frame.elapsed
                        actor.duration += length
                    else:
                        report(id, actor)
                        actor.duration = 0.0
                        actor.place = place
    left = list(actors.items())
    for id, actor in reversed(left) if compat else left:
        report(id, actor)
    return sorted(rows, key=lambda row: -row[1] if compat else (-row[1], row[0], row[2]))
