"""Kinematic replay: moves all replayed actors along a recording, with velocities that make contacts push others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.motion import possible_step
from carla_recap.replay.pose import wrap
from carla_recap.sim.actors.lights import Sign
from carla_recap.sim.actors.moving import MovingActor
from carla_recap.sim.physics.drivetrain import GEARS
from carla_recap.sim.recording.poses import CM_PER_M, transform

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.replay import Scene
    from carla_recap.sim.interfaces import ReplayWorld
    from carla_recap.sim.physics.moving_bodies import MovingBodies
    from carla_recap.sim.replaying.actor_mapping import ActorMapping

    Floats = NDArray[np.float64]
    Rows = NDArray[np.intp]

_SHORTEST: Final = 1e-3  # s; velocities are not computed over less
_PITCH_YAW_ROLL: Final = [4, 5, 3]
"""Their indices in a pose."""


@dataclass(frozen=True, eq=False, slots=True)
class _Link:
    """Pairs of records and rows of the world.

    Attributes:
        rows: The rows of the world.
        indices: The indices of their records.
        recorded_ids: The ids of all records, as bytes.
        world_ids: The ids of all rows.
        changes: The number of changes of the mapping.
    """

    rows: Rows
    indices: Rows
    recorded_ids: bytes
    world_ids: NDArray[np.int64]
    changes: int


class KinematicReplay:
    """Moves the actors of a replay, which are rows of arrays.

    Args:
        world: The world.
        mapping: The replayed actors.
    """

    def __init__(self, world: ReplayWorld, mapping: ActorMapping) -> None:
        self._world = world
        self._mapping = mapping
        self._lights = np.array([light.id for light in world.traffic_lights], np.int64)
        self._links: dict[str, _Link] = {}
        self._speeds: dict[int, list[float]] = {}
        self._set_poses: dict[int, bytes] = {}
        self._in_motion: dict[str, NDArray[np.int64]] = {}

    def move(self, scene: Scene, delta: float, seconds: float) -> None:
        """Move all replayed actors to their recorded poses in the tick that begins.

        Args:
            scene: The recording at the end of the tick.
            delta: The length of the tick, in s; 0 moves them at once.
            seconds: The time of the recording that passes in it, in s.
        """
        for name, movers in (("vehicles", self._world.vehicles), ("walkers", self._world.walkers)):
            rows, indices = self._linked(name, scene.ids, movers.id)
            poses = scene.poses[indices]
            finite = np.isfinite(poses).all(axis=1)
            self._move(name, movers, rows[finite], poses[finite], delta, seconds)
        self._set_other_poses(scene)
        self._set_controls(scene)
        self._set_walks(scene)
        self._set_lights(scene)

    def has_moved(self, actor: MovingActor) -> bool:
        """Return whether the recorded velocity of an actor is known."""
        return actor.id in self._speeds

    def velocity(self, actor: MovingActor) -> list[float]:
        """Return the recorded velocity of an actor, in m/s along the world's axes."""
        return self._speeds.get(actor.id, [0.0, 0.0, 0.0])

    def _move(self, name: str, movers: MovingBodies, rows: Rows, poses: Floats, delta: float, seconds: float) -> None:
        position, rotation = poses[:, :3] / CM_PER_M, poses[:, _PITCH_YAW_ROLL]
        path = position - movers.position[rows]
        yaw_change = wrap(rotation - movers.rotation[rows])[:, 1]
        distance = np.linalg.norm(path, axis=1)
        if seconds >= _SHORTEST:
            path[distance > possible_step(seconds, least=0.0)] = 0
            self._speeds |= zip(movers.id[rows].tolist(), (path / seconds).tolist(), strict=True)
        pushing = distance <= possible_step(delta, least=0.0)  # an actor that jumps pushes none on its way
        for row, (x, y, z), (pitch, yaw, roll) in zip(rows[~pushing], position[~pushing], rotation[~pushing], strict=True):
            movers.place(int(row), (x, y, z), (pitch, yaw, roll))
        rate = 1 / delta if delta else 0.0
        motions = np.zeros((len(movers), 3))
        motions[rows, :2] = path[:, :2] * rate * pushing[:, None]
        motions[rows, 2] = np.radians(yaw_change) * rate * pushing
        moving: NDArray[np.bool_] = (motions != 0).any(axis=1)
        in_motion = self._in_motion.get(name, ())
        stopping = np.isin(movers.id, in_motion) & ~movers.simulated  # bodies keep the velocity of the tick before
        self._in_motion[name] = movers.id[moving]
        moving[rows] |= movers.velocity[rows].any(axis=1)
        movers.set_body_velocities(moving | stopping, motions)
        movers.plane.disturbed |= bool(moving.any())
        movers.position[rows] = position
        movers.rotation[rows] = rotation
        movers.velocity[rows] = path * rate
        movers.angular_velocity[rows, 2] = yaw_change * rate

    def _set_other_poses(self, scene: Scene) -> None:
        """Set the poses of props and the spectator."""
        for id, actor in self._mapping.replayed.items():
            if isinstance(actor, (MovingActor, Sign)) or actor.parent is not None:
                continue
            index = scene.index_of(id)
            if index is None:
                continue
            pose = scene.poses[index]
            if self._set_poses.get(id) != pose.tobytes() and np.isfinite(pose).all():
                actor.transform = transform(pose)
                self._set_poses[id] = pose.tobytes()

    def _set_controls(self, scene: Scene) -> None:
        vehicles = self._world.vehicles
        yaw = np.radians(vehicles.yaw)
        cos, sin = np.cos(yaw), np.sin(yaw)
        kinematic = ~vehicles.simulated
        x, y = vehicles.velocity[:, 0], vehicles.velocity[:, 1]
        np.copyto(vehicles.speed, cos * x + sin * y, where=kinematic)
        np.copyto(vehicles.sideways, cos * y - sin * x, where=kinematic)
        rows, indices = self._linked("controls", scene.vehicle_controls["id"], vehicles.id)
        controls = scene.vehicle_controls[indices]
        vehicles.steer[rows] = controls["steer"]
        vehicles.throttle[rows] = controls["throttle"]
        vehicles.brake[rows] = controls["brake"]
        vehicles.hand_brake[rows] = controls["hand_brake"]
        vehicles.reverse[rows] = controls["gear"] < 0
        vehicles.manual[rows] = True
        vehicles.gear[rows] = np.clip(controls["gear"], -1, GEARS - 2)
        rows, indices = self._linked("lights", scene.vehicle_lights["id"], vehicles.id)
        vehicles.light_state[rows] = scene.vehicle_lights["flags"][indices]

    def _set_walks(self, scene: Scene) -> None:
        walkers = self._world.walkers
        rows, indices = self._linked("walks", scene.walker_controls["id"], walkers.id)
        walkers.speed[rows] = scene.walker_controls["speed"][indices] / CM_PER_M
        yaw = np.radians(walkers.yaw[rows])
        walkers.direction[rows] = np.column_stack((np.cos(yaw), np.sin(yaw), np.zeros(len(rows))))

    def _set_lights(self, scene: Scene) -> None:
        signals = self._world.signals
        rows, indices = self._linked("signals", scene.light_states["id"], self._lights)
        states = scene.light_states[indices]
        signals.state[rows] = states["state"]
        signals.elapsed[rows] = states["elapsed"]
        signals.frozen[rows] = states["frozen"] != 0

    def _linked(self, name: str, ids: NDArray[np.unsignedinteger], world_ids: NDArray[np.int64]) -> tuple[Rows, Rows]:
        """Return the rows of the world to which recorded ids are mapped, and the indices of these ids.

        They are kept until either set of ids, or the mapping, changes.
        """
        link = self._links.get(name)
        recorded, changes = ids.tobytes(), self._mapping.changes
        if link is None or link.world_ids is not world_ids or link.changes != changes or link.recorded_ids != recorded:
            replayed = self._mapping.replayed
            row_of = {id: row for row, id in enumerate(world_ids.tolist())}
            pairs = [
                (row_of[replayed[id].id], index)
                for index, id in enumerate(ids.tolist())
                if id in replayed and replayed[id].id in row_of
            ]
            rows, indices = np.array(pairs, np.intp).reshape(-1, 2).T
            link = self._links[name] = _Link(rows, indices, recorded, world_ids, changes)
        return link.rows, link.indices
