"""Snapshots of a world as CARLA streams them: a header, and 119 bytes for each actor."""

from __future__ import annotations

import struct
import time
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.actors.actors import Mover, Sign, TrafficLight
from carla_recap.sim.town.rules import NO_LIGHT, Rules
from carla_recap.sim.traffic.lights import GREEN

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from carla_recap.sim.actors.actors import Actor
    from carla_recap.sim.geometry import Transform
    from carla_recap.sim.physics.movers import Movers
    from carla_recap.sim.world import World

_WORLD: Final = 17
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
_FAR: Final = 3.0  # m: a vehicle that has come so far is looked up on the lanes anew before the next snapshot,
_NEAR: Final = 2.0  # m: one that has come so far when there is time


def _dtype(*fields: tuple[str, str]) -> np.dtype[np.void]:
    """The layout of an actor: what all have, then what its kind has, then nothing up to the size of all."""
    told = [*_BASE, *fields]
    return np.dtype([*told, ("nothing", f"V{_SIZE - np.dtype(told).itemsize}")])


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


def sensor_header(kind: int, frame: int, seconds: float, place: Transform) -> bytes:
    """What each frame of a sensor begins with.

    Args:
        kind: Of the sensor, as CARLA numbers them.
        frame: The frame.
        seconds: Since the episode began.
        place: Where the sensor is.
    """
    at, turn = place.location, place.rotation
    return _SENSOR_HEADER.pack(kind, frame, seconds, at.x, at.y, at.z, turn.pitch, turn.yaw, turn.roll)


def telling_of_map(snapshot: bytes) -> bytes:
    """A snapshot that tells whoever gets it to ask for the map anew."""
    return snapshot[:_FLAGS] + bytes((_MAP_CHANGED,)) + snapshot[_FLAGS + 1 :]


class Photographer:
    """Takes the snapshots of an episode.

    Args:
        world: The world.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._rules = Rules(world.town)
        self._light_ids = np.array([*(light.id for light in world.traffic_lights), 0])  # row NO_LIGHT is the last
        self._registry: object = None
        self._arrays: list[NDArray[np.void]] = []
        self._others: list[Actor] = []
        self._drives = Drives(world)
        self._light = np.empty(0, np.int64)
        self._born = time.monotonic()

    def take(self, episode: int, frame: int) -> bytes:
        """The world as it is.

        Args:
            episode: The number of the episode.
            frame: The number of the frame.
        """
        world = self._world
        spectator = world.spectator.transform
        header = _EPISODE_HEADER.pack(episode, time.monotonic() - self._born, world.delta, 0, 0, 0, 0)
        begin = sensor_header(_WORLD, frame, world.elapsed, spectator)
        return b"".join((begin, header, *(array.tobytes() for array in self._rows())))

    def look_ahead(self) -> None:
        """Do some of what the next snapshot takes."""
        if tuple(self._world.actors) == self._registry:
            self._drives.look(_NEAR)

    def _rows(self) -> Sequence[NDArray[np.void]]:
        world = self._world
        actors = tuple(world.actors)
        if actors != self._registry:
            self._registry = actors
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
        for row, actor in zip(others, self._others, strict=True):
            row["numbers"][:6] = _pose(actor.transform)
        return self._arrays

    def _assemble(self, actors: list[Actor]) -> None:
        world = self._world
        signs = [actor for actor in actors if isinstance(actor, Sign) and not isinstance(actor, TrafficLight)]
        self._others = [actor for actor in actors if not isinstance(actor, (Mover, Sign))]
        self._drives = Drives(world)
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
        if self._drives.have_moved():
            notice = self._rules.at(*self._drives.now())
            rows["speed_limit"] = notice.speed_limit * _KM_PER_H
            rows["at_light"] = notice.light != NO_LIGHT
            rows["light"] = self._light_ids[notice.light]
            self._light = notice.light
        rows["shown"] = np.append(self._world.signals.state, GREEN)[self._light]


class Drives:
    """Where vehicles are on their lanes: looked up now and then, and reckoned from how far they have come since.

    Args:
        world: The world; as long as nobody comes or goes.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        count = len(world.vehicles)
        self._from = np.full((count, 3), np.inf)
        self._ahead = np.zeros((count, 2))
        self._lane = np.zeros(count, np.int64)
        self._s = np.zeros(count)
        self._last = np.full((count, 3), np.inf)

    def have_moved(self) -> bool:
        """Whether anybody is elsewhere than when this was last asked."""
        position = self._world.vehicles.position
        if np.array_equal(position, self._last):
            return False
        self._last = position.copy()
        return True

    def now(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """The lanes, and how far along each vehicle is, in m."""
        vehicles = self._world.vehicles
        self.look(_FAR)
        come = (vehicles.position - self._from)[:, :2]
        return self._lane, self._s + (come * self._ahead).sum(axis=1)

    def look(self, distance: float) -> None:
        """Look those up who have come farther than so many metres."""
        vehicles = self._world.vehicles
        rows = np.flatnonzero(np.abs(vehicles.position - self._from).max(axis=1, initial=0) > distance)
        if not len(rows):
            return
        position, heading = vehicles.position[rows], np.radians(vehicles.rotation[rows, 1])
        self._from[rows] = position
        self._ahead[rows] = np.stack((np.cos(heading), np.sin(heading)), axis=1)
        x, y, z = position.T
        self._lane[rows], self._s[rows] = self._world.town.nearest_lane(x, y, z=z, heading=heading)


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


def _move(rows: NDArray[np.void], movers: Movers) -> None:
    numbers = rows["numbers"]
    for column, name in enumerate(("position", "rotation", "velocity", "angular_velocity", "acceleration")):
        numbers[:, 3 * column : 3 * column + 3] = getattr(movers, name)


def _pose(transform: Transform) -> tuple[float, ...]:
    place, turn = transform.location, transform.rotation
    return place.x, place.y, place.z, turn.pitch, turn.yaw, turn.roll
