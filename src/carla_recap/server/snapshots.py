"""Snapshots of a world as CARLA streams them: a header, and 119 bytes for each actor."""

from __future__ import annotations

import struct
import time
from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.server.protocol.releases import WORLD
from carla_recap.sim.actors.lights import Sign, TrafficLight
from carla_recap.sim.actors.moving import MovingActor
from carla_recap.sim.episode import transforms
from carla_recap.sim.signals import GREEN
from carla_recap.sim.town.junctions import SignalKind

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from carla_recap.server.protocol.releases import Release
    from carla_recap.sim.episode import Actor
    from carla_recap.sim.geometry import Transform
    from carla_recap.sim.physics.moving_bodies import MovingBodies
    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.sim.town.loading import Town
    from carla_recap.sim.world import World
    from carla_recap.util.arrays import Floats, Integers

_NUMBER: Final = struct.Struct("<Q")
# sensor type, frame, elapsed seconds, transform
_SENSOR_HEADER: Final = struct.Struct("<QQd6f")
# episode, platform time, delta, map origin, flags
_EPISODE_HEADER: Final = struct.Struct("<Qdf3iI")
_FLAGS: Final = _SENSOR_HEADER.size + struct.calcsize("<Qdf3i")
_MAP_CHANGED: Final = 1
_ACTIVE: Final = 1
_SIZE: Final = 119
_BASE: Final = [("id", "<u4"), ("activity", "u1"), ("numbers", "<(15,)f4")]
_KM_PER_H: Final = 3.6
_REACH: Final = 12.0  # m before a stop line where a vehicle is at its light: enough to stop comfortably at 40 km/h
NO_LIGHT: Final = -1
_FAR: Final = 3.0  # m: once a vehicle has moved as far, all are assigned to lanes anew before the next snapshot


def _dtype(*fields: tuple[str, str]) -> np.dtype[np.void]:
    """Return the layout of a kind of actor: the fields of all actors, its own fields, and padding."""
    used = [*_BASE, *fields]
    return np.dtype([*used, ("padding", f"V{_SIZE - np.dtype(used).itemsize}")])


VEHICLE: Final = _dtype(
    ("throttle", "<f4"),
    ("steer", "<f4"),
    ("brake", "<f4"),
    ("hand_brake", "?"),
    ("reverse", "?"),
    ("manual", "?"),
    ("gear", "<i4"),
    ("speed_limit", "<f4"),
    ("shown", "u1"),
    ("at_light", "?"),
    ("light", "<u4"),
    ("failure", "u1"),
)
WALKER: Final = _dtype(("direction", "<(3,)f4"), ("speed", "<f4"), ("jump", "?"))
LIGHT: Final = _dtype(
    ("opendrive_id", "S32"),
    ("green_time", "<f4"),
    ("yellow_time", "<f4"),
    ("red_time", "<f4"),
    ("elapsed", "<f4"),
    ("pole", "<u4"),
    ("frozen", "?"),
    ("state", "u1"),
)
SIGN: Final = _dtype(("opendrive_id", "S32"))
OTHER: Final = _dtype()

_CONTROLS: Final = ("throttle", "steer", "brake", "hand_brake", "reverse", "manual", "gear")
_TIMES: Final = ("green_time", "yellow_time", "red_time", "elapsed", "frozen")


def sensor_header(kind: int, frame: int, seconds: float, transform: Transform) -> bytes:
    """Return the header of a sensor's frame at some s of the episode; `Release.data` has the number of its kind of data."""
    return _SENSOR_HEADER.pack(kind, frame, seconds, *_pose(transform))


def with_map_changed(snapshot: bytes) -> bytes:
    """Return a snapshot with the flag that makes a client ask for the map anew."""
    return snapshot[:_FLAGS] + bytes((_MAP_CHANGED,)) + snapshot[_FLAGS + 1 :]


def for_release(snapshot: bytes, release: Release) -> bytes:
    """Return a snapshot with the number of its type in a release."""
    number = release.number(WORLD) or 0
    return _NUMBER.pack(number) + snapshot[_NUMBER.size :]


class SnapshotEncoder:
    """Encodes the snapshots of an episode; see `for_release`."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._lights_ahead = LightsAhead(world.town)
        self._light_ids = np.append(world.signals.id, 0)  # row NO_LIGHT is the last
        self._ids: object = None
        self._arrays: list[NDArray[np.void]] = []
        self._others: list[Actor] = []
        self._tracker = LaneTracker(world.town, world.vehicles)
        self._light = np.empty(0, np.int64)
        self._start = time.monotonic()

    def encode(self, episode: int, frame: int) -> bytes:
        """Return a snapshot of the world."""
        world = self._world
        spectator = world.spectator.transform
        header = _EPISODE_HEADER.pack(episode, time.monotonic() - self._start, world.delta, 0, 0, 0, 0)
        begin = sensor_header(0, frame, world.elapsed, spectator)
        return b"".join((begin, header, *(array.tobytes() for array in self._rows())))

    def _rows(self) -> Sequence[NDArray[np.void]]:
        world = self._world
        actors = tuple(world.actors)
        if actors != self._ids:
            self._ids = actors
            self._assemble(list(world.actors.values()))
        vehicles, walkers, lights, _, others = self._arrays
        if len(vehicles):
            self._fill_vehicles(vehicles)
        if len(walkers):
            _move(walkers, world.walkers)
            for name in ("direction", "speed", "jump"):
                walkers[name] = getattr(world.walkers, name)
        for name in _TIMES:
            lights[name] = getattr(world.signals, name)
        lights["state"] = world.signals.state
        for row, transform in zip(others, transforms(self._others), strict=True):
            row["numbers"][:6] = _pose(transform)
        return self._arrays

    def _assemble(self, actors: list[Actor]) -> None:
        world = self._world
        signs = [actor for actor in actors if isinstance(actor, Sign) and not isinstance(actor, TrafficLight)]
        self._others = [actor for actor in actors if not isinstance(actor, (MovingActor, Sign))]
        self._tracker = LaneTracker(world.town, world.vehicles)
        self._arrays = [
            _blank(VEHICLE, world.vehicles.actors),
            _blank(WALKER, world.walkers.actors),
            _blank_signs(LIGHT, world.traffic_lights),
            _blank_signs(SIGN, signs),
            _blank(OTHER, self._others),
        ]

    def _fill_vehicles(self, rows: NDArray[np.void]) -> None:
        vehicles = self._world.vehicles
        _move(rows, vehicles)
        for name in _CONTROLS:
            rows[name] = getattr(vehicles, name)
        if self._tracker.moved():
            lane, s = self._tracker.positions()
            self._light = self._lights_ahead.at(lane, s)
            rows["speed_limit"] = self._world.town.index.limit(lane, s) * _KM_PER_H
            rows["at_light"] = self._light != NO_LIGHT
            rows["light"] = self._light_ids[self._light]
        rows["shown"] = np.append(self._world.signals.state, GREEN)[self._light]


class LightsAhead:
    """The stretches before the stop lines of traffic lights."""

    def __init__(self, town: Town) -> None:
        stretches: set[tuple[int, float, float, int]] = set()
        lights = (signal for signal in town.signals if signal.kind is SignalKind.LIGHT)
        remaining = [(lane, stop, _REACH, row) for row, light in enumerate(lights) for lane, stop in light.stops]
        for lane, end, reach, row in remaining:  # grows
            stretch = lane, end - reach, end, row
            if end < reach and stretch not in stretches:
                before = [other for other in town.lanes[lane].predecessors if town.lanes[other].junction is None]
                remaining += [(other, town.lanes[other].length, reach - end, row) for other in before]
            stretches.add(stretch)
        self._stretches: defaultdict[int, list[tuple[float, float, int]]] = defaultdict(list)
        for lane, begin, end, row in sorted(stretches, key=lambda stretch: (stretch[1], -stretch[3])):  # nearest lines first
            self._stretches[lane].append((begin, end, row))

    def at(self, lane: Integers, s: Floats) -> Integers:
        """Return the rows of the lights ahead of places at some distances along lanes in m, (n,); `NO_LIGHT` for none."""
        places = zip(lane.tolist(), s.tolist(), strict=True)
        rows = [next((row for begin, end, row in self._stretches[on] if begin <= at <= end), NO_LIGHT) for on, at in places]
        return np.array(rows, np.int64)


class LaneTracker:
    """The positions of vehicles on their lanes: looked up now and then, and extrapolated in between.

    It is valid until an actor is spawned or destroyed.
    """

    def __init__(self, town: Town, vehicles: Vehicles) -> None:
        self._town = town
        self._vehicles = vehicles
        count = len(vehicles)
        self._reference = np.full((count, 3), np.inf)
        self._forward = np.zeros((count, 2))
        self._lane = np.zeros(count, np.int64)
        self._s = np.zeros(count)
        self._last = np.full((count, 3), np.inf)

    def moved(self) -> bool:
        """Return whether a vehicle has moved since the last call."""
        position = self._vehicles.position
        if np.array_equal(position, self._last):
            return False
        self._last = position.copy()
        return True

    def positions(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the lanes of all vehicles, and how far along each vehicle is, in m.

        All vehicles that have moved are looked up once one has moved far: a look-up of many takes little longer than one of
        few, so that those of all together are cheaper.
        """
        vehicles = self._vehicles
        moved = vehicles.position - self._reference
        if (np.abs(moved) > _FAR).any():
            rows = np.flatnonzero(moved.any(axis=1))
            position, heading = vehicles.position[rows], np.radians(vehicles.rotation[rows, 1])
            self._reference[rows] = position
            self._forward[rows] = np.stack((np.cos(heading), np.sin(heading)), axis=1)
            x, y, z = position.T
            self._lane[rows], self._s[rows] = self._town.nearest_lane(x, y, z=z, heading=heading)
            moved[rows] = 0.0
        return self._lane, self._s + (moved[:, :2] * self._forward).sum(axis=1)


def _blank(dtype: np.dtype[np.void], actors: Iterable[Actor]) -> NDArray[np.void]:
    ids = [actor.id for actor in actors]
    rows = np.zeros(len(ids), dtype)
    rows["id"] = ids
    rows["activity"] = _ACTIVE
    return rows


def _blank_signs(dtype: np.dtype[np.void], signs: Sequence[Sign]) -> NDArray[np.void]:
    rows = _blank(dtype, signs)
    rows["opendrive_id"] = [sign.signal.opendrive_id.encode()[:31] for sign in signs]
    for row, sign in zip(rows, signs, strict=True):
        row["numbers"][:6] = _pose(sign.transform)
    return rows


def _move(rows: NDArray[np.void], movers: MovingBodies) -> None:
    numbers = rows["numbers"]
    for column, name in enumerate(("position", "rotation", "velocity", "angular_velocity", "acceleration")):
        numbers[:, 3 * column : 3 * column + 3] = getattr(movers, name)


def _pose(transform: Transform) -> tuple[float, ...]:
    location, rotation = transform.location, transform.rotation
    return location.x, location.y, location.z, rotation.pitch, rotation.yaw, rotation.roll
