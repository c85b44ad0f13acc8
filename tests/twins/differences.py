"""The differences of the paths and traffic lights of two recordings, frame by frame and actor by actor."""

from __future__ import annotations

import math
from typing import Any

from carla_recap.formats.base import Reader
from carla_recap.model.lives import ActorLife, ActorLives
from carla_recap.queries.recorded_actors import actors

SAME_TIME = 1e-6
JUMP, TOP_SPEED = 5.0, 100.0  # m, m/s

Pose = tuple[float, float, float, float]


class Drive:
    """The frames of a recording: times, and of each actor by its role the pose and the state in each frame."""

    def __init__(self, reader: Reader) -> None:
        self.lives = {life.role_name: life for life in actors(reader)}
        lives = ActorLives(actors(reader))
        self.elapsed: list[float] = []
        self.durations: list[float] = []
        self.clock: list[float] = []
        self.poses: list[dict[str, Pose]] = []
        self.states: list[dict[str, int]] = []
        for frame in reader.frames():
            self.elapsed.append(frame.elapsed)
            self.durations.append(frame.duration)
            self.clock.append(max(frame.elapsed, *self.clock[-1:]) if self.clock else frame.elapsed)
            roles = {id: life.role_name for id in lives.ids() if (life := lives.at(id, frame.elapsed))}
            self.poses.append(
                {roles[row["id"]]: tuple(map(float, row[["x", "y", "z", "yaw"]].item())) for row in frame["transforms"]}
            )
            self.states.append({roles[row["id"]]: int(row["state"]) for row in frame["light_states"]})


def around(a: Drive, number: int, b: Drive) -> tuple[int, int] | None:
    """Return the frames of b before and after a frame of a; the same twice, if it has the same time."""
    time = a.clock[number]
    rank = sum(earlier == time for earlier in a.clock[:number])
    same = [n for n, other in enumerate(b.clock) if other == time]
    if same:
        return (same[min(rank, len(same) - 1)],) * 2
    before = max((n for n, other in enumerate(b.clock) if other < time), default=None)
    after = min((n for n, other in enumerate(b.clock) if other > time), default=None)
    if after is not None and b.clock[after] - time <= SAME_TIME:
        return after, after
    if before is not None and time - b.clock[before] <= SAME_TIME:
        return before, before
    return None if before is None or after is None else (before, after)


def turned(degrees: float) -> float:
    return (degrees + 180) % 360 - 180 if math.isfinite(degrees) else math.nan


def pose_at(name: str, time: float, frames: tuple[int, int], b: Drive) -> Pose | None:
    """Return the pose of an actor of b at a time of a; None if it is not known."""
    before, after = frames
    first, second = b.poses[before].get(name), b.poses[after].get(name)
    if first is None or second is None:
        return None
    if before == after:
        return first
    seconds = b.clock[after] - b.clock[before]
    metres = math.sqrt(sum((q - p) ** 2 for p, q in zip(first[:3], second[:3], strict=True))) / 100
    if metres > max(TOP_SPEED * seconds, JUMP):
        return None
    share = (time - b.clock[before]) / seconds
    x, y, z = (p + share * (q - p) for p, q in zip(first[:3], second[:3], strict=True))
    return x, y, z, first[3] + share * turned(second[3] - first[3])


def paths(name: str, a: Drive, b: Drive, tolerance: float) -> dict[str, Any]:
    """Return the difference of the paths of an actor, as fields of `ActorDifference`."""
    times, distances, heading = [], [], 0.0
    for number, poses in enumerate(a.poses):
        frames = around(a, number, b)
        if name not in poses or frames is None or (theirs := pose_at(name, a.clock[number], frames, b)) is None:
            continue
        steps = [0.0 if p == q or (p != p and q != q) else p - q for p, q in zip(poses[name], theirs, strict=True)]
        distance = math.hypot(*steps[:3]) / 100
        times.append(a.elapsed[number])
        distances.append(distance if math.isfinite(distance) else math.inf)
        turn = abs(turned(steps[3]))
        heading = max(heading, turn if turn > 1e-9 else 0.0)
    finite = [distance for distance in distances if distance < math.inf]
    beyond = [n for n, distance in enumerate(distances) if distance > tolerance]
    largest = max(distances, default=math.nan)
    return {
        "frames": len(distances),
        "first": times[beyond[0]] if beyond else None,
        "first_distance": distances[beyond[0]] if beyond else None,
        "mean": sum(finite) / len(finite) if finite else math.nan,
        "rms": math.sqrt(sum(distance**2 for distance in finite) / len(finite)) if finite else math.nan,
        "max": largest,
        "max_at": times[distances.index(largest)] if distances else math.nan,
        "final": distances[-1] if distances else math.nan,
        "heading": heading,
    }


def light(name: str, a: Drive, b: Drive) -> dict[str, Any]:
    """Return for how long the states of a traffic light differ, as fields of `LightDifference`."""
    first, seconds = None, 0.0
    for number, states in enumerate(a.states):
        frames = around(a, number, b)
        if name not in states or frames is None or name not in b.states[frames[0]]:
            continue
        if states[name] not in [b.states[n][name] for n in frames if name in b.states[n]]:
            first = a.elapsed[number] if first is None else first
            seconds += max(a.durations[number], 0.0)
    return {"first": first, "seconds": seconds}


def life_differs(a: ActorLife, b: ActorLife, ends: tuple[float, float], allowed: float) -> bool:
    """Return whether an actor appears or disappears at other times."""
    stays = a.destroyed_at is None, b.destroyed_at is None
    stop_a, stop_b = (
        end if life.destroyed_at is None else life.destroyed_at for end, life in zip(ends, (a, b), strict=True)
    )
    late = abs(a.spawned_at - b.spawned_at) > allowed + SAME_TIME
    if all(stays):
        return late
    return late or abs(stop_a - stop_b) > allowed + SAME_TIME or (stays[0] != stays[1] and allowed == 0)


def actor_differs(name: str, a: Drive, b: Drive, tolerance: float, time_tolerance: float) -> bool:
    """Return whether anything about an actor is beyond the tolerances."""
    found = paths(name, a, b, tolerance)
    in_a, in_b = (sum(name in poses for poses in drive.poses) for drive in (a, b))
    same_times = len(a.elapsed) == len(b.elapsed) and all(
        abs(p - q) <= SAME_TIME for p, q in zip(a.elapsed, b.elapsed, strict=True)
    )
    exact = tolerance == 0 and same_times
    poses_differ = not in_a == in_b == found["frames"] if exact else (in_a > 0) != (in_b > 0)
    return (
        found["first"] is not None
        or (tolerance == 0 and found["heading"] > 0)
        or poses_differ
        or life_differs(a.lives[name], b.lives[name], (a.elapsed[-1], b.elapsed[-1]), time_tolerance)
    )
