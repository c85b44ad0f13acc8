"""Random traffic, as a recording."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from carla_recap.model.records import Spawn, attributes
from tests.queries.conftest import write
from tests.queries.measures.conftest import Mover, record, straight

LIGHT: Final = 90
"""The id of a traffic light."""


def traffic(path: Path, seed: int) -> Path:
    """Record random traffic: actors that turn, reverse, brake, vanish, jump, get an id again, and hit each other."""
    random = np.random.default_rng(seed)
    rate = float(random.choice([2, 5, 10, 20, 30, 100]))
    frames = int(random.integers(1, 60))
    actors = int(random.integers(1, 9)) if frames < 25 else int(random.integers(1, 5))
    durations = np.full(frames, 1 / rate) if random.random() < 0.6 else random.uniform(0.2, 1.8, frames) / rate
    if random.random() < 0.2:
        durations[int(random.integers(frames))] = 2.5
    time = np.append(0.0, np.cumsum(durations[:-1]))
    span, packets = float(time[-1]), [{"transforms": [], "velocities": []} for _ in range(frames)]
    spawned, boxes = [], []
    for id in range(1, actors + 1):
        in_reverse = np.random.default_rng((seed, id)).random() < 0.15
        is_walker = id > 1 and random.random() < 0.25
        speed, turn = random.uniform(0, 3 if is_walker else 18), random.choice([0, random.normal(0, 0.4)])
        yaw = random.uniform(-math.pi, math.pi)
        meeting = random.uniform(0, max(span, 2))  # it is near the origin then
        braking = random.choice([0, random.uniform(0, 8)])
        here, where = [], random.normal(0, 3, 2)
        fine = np.linspace(0, max(span, 0.1), 400)
        fast = np.maximum(speed - braking * np.maximum(fine - meeting + 1, 0), 0)
        heading = yaw + turn * (fine - meeting)
        steps = np.gradient(fine)
        x, y = np.cumsum(fast * np.cos(heading) * steps), np.cumsum(fast * np.sin(heading) * steps)
        x, y = (values - np.interp(meeting, fine, values) + offset for values, offset in zip((x, y), where, strict=True))
        jump = random.uniform(0, span) if random.random() < 0.1 else math.inf
        absent = sorted(random.uniform(0, span, 2)) if random.random() < 0.2 else (math.inf, math.inf)
        has_velocity, z = random.random() < 0.7, random.choice([0, 0, 0, 0, 6]) * 100.0
        for frame, now in enumerate(time.tolist()):
            if absent[0] <= now <= absent[1]:
                continue
            px, py = (np.interp(now, fine, values) + (60 if now > jump else 0) for values in (x, y))
            angle = float(np.interp(now, fine, heading))
            v = float(np.interp(now, fine, fast))
            facing = math.degrees(angle) + (180 if in_reverse else 0)
            packets[frame]["transforms"].append((id, px * 100, -py * 100, z, 0.0, 0.0, -facing))
            if has_velocity:
                velocity = (id, v * math.cos(angle), -v * math.sin(angle), 0.0, 0.0, 0.0, 0.0)
                packets[frame]["velocities"].append(velocity)
            here.append(frame)
        names = {"role_name": "hero"} if id == 1 else {}
        type_id = "walker.pedestrian.0001" if is_walker else str(random.choice(["vehicle.audi.tt", "vehicle.bh.crossbike"]))
        spawn = Spawn(id, 2 if is_walker else 1, type_id=type_id, attributes=attributes(**names))
        spawned.append(spawn)
        if random.random() < 0.5:
            boxes.append((id, random.normal(0, 20), 0.0, 75.0, *random.uniform(20, 300, 2), 75.0))
        if random.random() < 0.15 and frames > 2:
            again = int(random.integers(1, frames))
            packets[again]["destroyed"] = [*packets[again].get("destroyed", []), (id,)]
            packets[again]["spawned"] = [*packets[again].get("spawned", []), spawn]
    spawned.append(Spawn(LIGHT, 3, type_id="traffic.traffic_light", attributes=[]))
    for frame in range(frames):
        packets[frame]["vehicle_controls"] = [(1, 0.1, frame / frames, 0.0, 0, 1)]
        packets[frame]["light_states"] = [(LIGHT, 0, random.random(), int(random.integers(4)))]
    packets[0] = {"spawned": spawned, "bounding_boxes": boxes, **packets[0]}
    if actors > 1 and random.random() < 0.3:
        pair = random.choice(actors, 2, replace=False) + 1
        begin = int(random.integers(frames))
        for frame in range(begin, min(begin + int(random.integers(1, 4)), frames)):
            packets[frame]["collisions"] = [(0, int(pair[0]), int(pair[1]), 0, 0)]
    return write(path, packets, durations=[*durations[:-1].tolist(), -1.0])


Contact = tuple[int, int]


def crossing(
    path: Path,
    *,
    speed: float = 8.0,
    faster: float = 10.0,
    turn: float = 90.0,
    z: float = 0.0,
    lag: float = 0.5,
    contact: float = -1.0,
    of: Contact = (1, 2),
    kind: int = 1,
) -> Path:
    """Record a car that arrives at the origin after 6 s, where another actor has left, some seconds before."""
    left, start = 6.0 - 3 / speed - 3 / faster - lag, 6.0 * faster
    x, y = -start * math.cos(math.radians(turn)), -start * math.sin(math.radians(turn))
    other = straight(2, -left * speed, 0, speed, z=z, kind=kind, type_id="vehicle.a" if kind == 1 else "walker.a")
    return _met(path, [straight(1, x, y, faster, turn), other], contact, of)


def approach(
    path: Path,
    *,
    closest: float = 0.75,
    beside: float = 0.0,
    z: float = 0.0,
    pause: float = 9.0,
    contact: float = -1.0,
    of: Contact = (1, 2),
) -> Path:
    """Record a car of 12 m/s, which vanishes after 6 s, some seconds before it hits a standing one, and comes again."""

    def x(time: float) -> float:
        return 12.0 * (time if time < 5.99 + pause else time - pause)

    car = Mover(1, x, present=lambda time: time < 6.01 or 5.99 + pause < time < 6.21 + pause)
    return _met(path, [car, straight(2, 4 + 12 * (6 + closest), beside, 0, z=z)], contact, of)


def _met(path: Path, cars: list[Mover], contact: float, of: Contact) -> Path:
    events: dict[int, Any] = {round(contact * 10): {"collisions": [(0, *of, 0, 0)]}} if contact >= 0 else {}
    return record(path, [*cars, straight(3, 0, 300, 0)], 9.5, 10, events)
