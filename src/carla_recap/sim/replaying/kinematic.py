"""Moves the actors of a replay as a recording has it: all at once, with velocities that let contacts look right."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.replay.pose import wrap
from carla_recap.sim.actors.actors import Mover, Sign
from carla_recap.sim.physics.drivetrain import GEARS
from carla_recap.sim.recording.poses import CM_PER_M, transform

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.replay import Scene
    from carla_recap.sim.interfaces import ReplayWorld
    from carla_recap.sim.physics.movers import Movers
    from carla_recap.sim.replaying.actor_mapping import Cast

    Floats = NDArray[np.float64]
    Rows = NDArray[np.intp]

JUMP: Final = 100.0
"""m/s; what seems to be faster has jumped, and pushes nobody on its way."""
_LEAST: Final = 1e-3  # s; too short a time to tell a velocity from
_PITCH_YAW_ROLL: Final = [4, 5, 3]
"""Where they are in a pose."""


@dataclass(frozen=True, eq=False, slots=True)
class _Link:
    """Which rows of the world some records are for.

    Attributes:
        rows: In the world.
        places: In the records.
        ids: Of the records, as bytes.
        there: The ids of the rows.
        changes: Those of the cast.
    """

    rows: Rows
    places: Rows
    ids: bytes
    there: NDArray[np.int64]
    changes: int


class KinematicReplay:
    """The actors of a replay, as rows of arrays.

    Args:
        world: The world.
        cast: Who plays whom.
    """

    def __init__(self, world: ReplayWorld, cast: Cast) -> None:
        self._world = world
        self._cast = cast
        self._lights = np.array([light.id for light in world.traffic_lights], np.int64)
        self._links: dict[str, _Link] = {}
        self._speeds: dict[int, list[float]] = {}
        self._put: dict[int, bytes] = {}

    def move(self, scene: Scene, delta: float, seconds: float) -> None:
        """Have everybody go to where they are in the recording, in the tick that begins.

        Args:
            scene: The recording at the end of the tick.
            delta: How long the tick is, in s; 0: they are put there at once.
            seconds: How much of the recording passes in it.
        """
        for name, movers in (("vehicles", self._world.vehicles), ("walkers", self._world.walkers)):
            rows, places = self._linked(name, scene.ids, movers.id)
            poses = scene.poses[places]
            sound = np.isfinite(poses).all(axis=1)
            self._send(movers, rows[sound], poses[sound], delta, seconds)
        self._put_others(scene)
        self._turn_wheels(scene)
        self._walk(scene)
        self._light(scene)

    def velocity(self, actor: Mover) -> list[float]:
        """How fast an actor was in the recording, in m/s along the world's axes."""
        return self._speeds.get(actor.id, [0.0, 0.0, 0.0])

    def _send(self, movers: Movers, rows: Rows, poses: Floats, delta: float, seconds: float) -> None:
        position, rotation = poses[:, :3] / CM_PER_M, poses[:, _PITCH_YAW_ROLL]
        way = position - movers.position[rows]
        turn = wrap(rotation - movers.rotation[rows])[:, 1]
        distance = np.linalg.norm(way, axis=1)
        if seconds >= _LEAST:
            way[distance > JUMP * seconds] = 0
            self._speeds |= zip(movers.id[rows].tolist(), (way / seconds).tolist(), strict=True)
        pushing = distance <= JUMP * delta
        for row, place, angles in zip(rows[~pushing], position[~pushing], rotation[~pushing], strict=True):
            movers.put(int(row), (place[0], place[1], place[2]), (angles[0], angles[1], angles[2]))
        rate = 1 / delta if delta else 0.0
        motions = np.zeros((len(movers), 3))
        motions[rows, :2] = way[:, :2] * rate * pushing[:, None]
        motions[rows, 2] = np.radians(turn) * rate * pushing
        moving: NDArray[np.bool_] = (motions != 0).any(axis=1)
        moving[rows] |= movers.velocity[rows].any(axis=1)
        movers.tell(moving, motions)
        movers.plane.disturbed |= bool(moving.any())
        movers.position[rows] = position
        movers.rotation[rows] = rotation
        movers.velocity[rows] = way * rate
        movers.angular_velocity[rows, 2] = turn * rate

    def _put_others(self, scene: Scene) -> None:
        """Put props and the spectator where they are."""
        for id, actor in self._cast.roles.items():
            if isinstance(actor, (Mover, Sign)) or actor.parent is not None:
                continue
            place = scene.place_of(id)
            if place is None:
                continue
            pose = scene.poses[place]
            if self._put.get(id) != pose.tobytes() and np.isfinite(pose).all():
                actor.transform = transform(pose)
                self._put[id] = pose.tobytes()

    def _turn_wheels(self, scene: Scene) -> None:
        vehicles = self._world.vehicles
        yaw = np.radians(vehicles.yaw)
        ahead, aside = np.cos(yaw), np.sin(yaw)
        puppets = ~vehicles.simulated
        x, y = vehicles.velocity[:, 0], vehicles.velocity[:, 1]
        np.copyto(vehicles.speed, ahead * x + aside * y, where=puppets)
        np.copyto(vehicles.sideways, ahead * y - aside * x, where=puppets)
        rows, places = self._linked("controls", scene.vehicle_controls["id"], vehicles.id)
        controls = scene.vehicle_controls[places]
        vehicles.steer[rows] = controls["steer"]
        vehicles.throttle[rows] = controls["throttle"]
        vehicles.brake[rows] = controls["brake"]
        vehicles.hand_brake[rows] = controls["hand_brake"]
        vehicles.reverse[rows] = controls["gear"] < 0
        vehicles.manual[rows] = True
        vehicles.gear[rows] = np.clip(controls["gear"], -1, GEARS - 2)
        rows, places = self._linked("lights", scene.vehicle_lights["id"], vehicles.id)
        vehicles.light_state[rows] = scene.vehicle_lights["flags"][places]

    def _walk(self, scene: Scene) -> None:
        walkers = self._world.walkers
        rows, places = self._linked("walks", scene.walker_controls["id"], walkers.id)
        walkers.speed[rows] = scene.walker_controls["speed"][places] / CM_PER_M
        yaw = np.radians(walkers.yaw[rows])
        walkers.direction[rows] = np.column_stack((np.cos(yaw), np.sin(yaw), np.zeros(len(rows))))

    def _light(self, scene: Scene) -> None:
        signals = self._world.signals
        rows, places = self._linked("signals", scene.light_states["id"], self._lights)
        states = scene.light_states[places]
        signals.state[rows] = states["state"]
        signals.elapsed[rows] = states["elapsed"]
        signals.frozen[rows] = states["frozen"] != 0

    def _linked(self, name: str, ids: NDArray[np.unsignedinteger], there: NDArray[np.int64]) -> tuple[Rows, Rows]:
        """The rows of the world that play some ids, and the places of these ids; kept for as long as both stay."""
        link = self._links.get(name)
        recorded = ids.tobytes()
        if link is None or link.there is not there or link.changes != self._cast.changes or link.ids != recorded:
            roles = self._cast.roles
            row_of = {id: row for row, id in enumerate(there.tolist())}
            pairs = [
                (row_of[roles[id].id], place)
                for place, id in enumerate(ids.tolist())
                if id in roles and roles[id].id in row_of
            ]
            rows, places = np.array(pairs, np.intp).reshape(-1, 2).T
            link = self._links[name] = _Link(rows, places, recorded, there, self._cast.changes)
        return link.rows, link.places
