"""A lively log: 20,000 frames of 100 actors that come, go, collide and stop, so that few frames in a row are alike."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from benchmarks.hour import CARS, RATE, TICK, closed_curve, stop_and_go, stored
from carla_recap.formats.carla_log import LogWriter
from carla_recap.model.frame import LAST_FRAME_DURATION, Frame, Header, Packet
from carla_recap.model.records import UE4, ActorKind, Spawn, attributes

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

FRAMES: Final = 20_000
EVENT: Final = 60  # frames from one event to the next, on average: an actor comes or goes, or two collide
COLLISIONS: Final = 0.4  # the share of events
COLLISION_LENGTH: Final = 5  # frames, at most
ACTORS: Final = 100
CARS_ONLY, WALKERS_ONLY = slice(60), slice(60, ACTORS)
STATE: Final = {"transforms": slice(ACTORS), "vehicle_controls": CARS_ONLY, "walker_controls": WALKERS_ONLY}
TYPES: Final = [
    UE4.named(name) for name in ("spawned", "destroyed", "parented", "collisions", *STATE, "platform_time", "frame_end")
]


def frames(count: int = FRAMES, seed: int = 1) -> Iterator[Frame]:
    """Yield the frames; the same count and seed give the same frames."""
    rng = np.random.default_rng(seed)
    state = _state(rng, count)
    ids, present = np.arange(1, ACTORS + 1), np.ones(ACTORS, bool)
    happens = set(rng.choice(np.arange(1, count), (count - 1) // EVENT, replace=False).tolist())
    contact, left, number = np.empty(0, int), 0, 0
    for index in range(count):
        come = np.arange(0 if index else ACTORS)
        events: dict[str, list[Any]] = {"platform_time": [(index * TICK,)]}
        if index in happens and rng.random() < COLLISIONS:
            contact = rng.choice(np.flatnonzero(present), 2, replace=False)
            left = rng.integers(1, COLLISION_LENGTH, endpoint=True)
        elif index in happens:
            slot, left = int(rng.integers(1, ACTORS)), 0  # the hero stays
            if present[slot]:
                events["destroyed"] = [(ids[slot],)]
            else:
                ids[slot] = ids.max() + 1
                come = np.array([slot])
            present[slot] = not present[slot]
        if left:
            events["collisions"] = [(number, *ids[contact], *(contact == 0))]
            left, number = left - 1, number + 1
        events["spawned"] = [
            _spawn(slot, ids[slot].item(), state["transforms"][index, slot].item()) for slot in come.tolist()
        ]
        for name, slots in STATE.items():
            state[name]["id"][index] = ids[slots]
        packets = [
            Packet(type.id, type, None, state[type.name][index, present[STATE[type.name]]])
            if type.name in STATE
            else Packet(type.id, type, None, type.records(events.get(type.name, [])))
            for type in TYPES
        ]
        yield Frame(index, index + 1, index * TICK, TICK if index + 1 < count else LAST_FRAME_DURATION, packets)


def _state(rng: np.random.Generator, count: int) -> dict[str, NDArray[np.void]]:
    """Return the records of all frames and actors, whether present or not; their ids are zero."""
    sizes = {name: len(range(ACTORS)[slots]) for name, slots in STATE.items()}
    state = {name: np.zeros((count, size), UE4.named(name).dtype) for name, size in sizes.items()}
    for slot in range(ACTORS):
        car = slot < CARS_ONLY.stop
        speed = stop_and_go(rng, count, (500, 1400) if car else (90, 180), (1, 5), (0.5, 3), ramp=RATE)
        pose = state["transforms"][:, slot]
        pose["x"], pose["y"], heading = closed_curve(rng, np.cumsum(speed * TICK), rng.uniform(2_000, 10_000))
        pose["yaw"] = np.degrees(heading)
        if car:
            control = state["vehicle_controls"][:, slot]
            control["throttle"], control["brake"] = np.where(speed > 0, rng.uniform(0.2, 0.4, count), 0), speed == 0
        else:
            state["walker_controls"]["speed"][:, slot - WALKERS_ONLY.start] = speed
    return state


def _spawn(slot: int, id: int, transform: tuple[float, ...]) -> Spawn:
    _, *pose = transform
    if slot < CARS_ONLY.stop:
        role = attributes(role_name="autopilot" if slot else "hero", number_of_wheels=4)
        return Spawn(id, ActorKind.VEHICLE, *pose, 26, f"vehicle.{CARS[slot % len(CARS)]}", role)
    return Spawn(id, ActorKind.WALKER, *pose, 5, f"walker.pedestrian.{1 + slot % 29:04}", attributes(speed=1.4))


def make(path: Path, count: int = FRAMES) -> None:
    """Write the log."""
    with LogWriter(path, Header("Town05", 1_700_000_000)) as log:
        for frame in frames(count):
            log.write(frame)


def cached(count: int = FRAMES) -> Path:
    """Return the log, which is made again if this module has changed."""
    return stored(f"lively-{count}", partial(make, count=count), Path(__file__))
