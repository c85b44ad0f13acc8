"""Kinematic replay: moves all replayed actors along a recording, with velocities that make contacts push others.

Replayed actors move through each other, so that physics finds no collisions between them: the recorded ones are reported.
"""

from __future__ import annotations

import warnings
from collections import defaultdict, deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.model.lives import is_object
from carla_recap.model.motion import LONGEST_STEP, possible_step
from carla_recap.model.records import CM_PER_M
from carla_recap.replay.pose import wrap
from carla_recap.replay.selection import find
from carla_recap.sim.actors.lights import Sign
from carla_recap.sim.actors.moving import MovingActor
from carla_recap.sim.actors.stepping import is_watched
from carla_recap.sim.episode import Collision
from carla_recap.sim.geometry import Location, Vector
from carla_recap.sim.physics.physics_control import GEARS
from carla_recap.sim.recording.packets import possible, transform
from carla_recap.sim.replaying.actor_mapping import TRAFFIC

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorLife
    from carla_recap.replay import Collided, Scene
    from carla_recap.sim.episode import Actor, Episode
    from carla_recap.sim.physics.moving_bodies import MovingBodies
    from carla_recap.sim.replaying.actor_mapping import ActorMapping
    from carla_recap.util.arrays import Floats, Ids

    Rows = NDArray[np.intp]

_SHORTEST: Final = 1e-3  # s; velocities are not computed over less
_PITCH_YAW_ROLL: Final = [4, 5, 3]
"""Their indices in a pose."""
_MOST_TICKS: Final = int(LONGEST_STEP / _SHORTEST) + 2  # whose velocities are kept
_ROUNDING: Final = 0.01  # the part of an interval between frames by which ticks may be shorter
_SAME_CONTACT: Final = 0.25  # s of the recording between two collisions of the same actors


@dataclass(frozen=True, eq=False, slots=True)
class _Velocities:
    """The recorded velocities of vehicles or walkers in a tick, in m/s, (n, 3); NaN where they are not known, as in a jump.

    The time is the end of the tick, in elapsed seconds of the recording; the ids, (n,), are those of the replayed actors.
    """

    time: float
    ids: Ids
    values: Floats

    def of(self, ids: Ids) -> Floats:
        """Return the velocities of actors; NaN where they are not known."""
        if np.array_equal(ids, self.ids):
            return self.values
        order = np.argsort(self.ids)
        where, known = find(ids, self.ids[order])
        found = np.full((len(ids), 3), np.nan)
        found[known] = self.values[order[where[known]]]
        return found


class KinematicReplay:
    """Moves the actors of a replay, which are rows of arrays.

    Their velocities are the ways between two ticks through the time. Their accelerations are the differences of two such
    velocities, of ticks that are at least as far apart as the frames of the recording: between two frames, poses are
    interpolated, and velocities constant.
    """

    def __init__(self, episode: Episode, mapping: ActorMapping) -> None:
        self._episode = episode
        self._mapping = mapping
        self._pairs = np.empty((2, 0), np.int64)  # of the ids of the recording, ascending, and those of the world
        self._changes_of_pairs = -1
        self._motions: dict[int, list[float]] = {}
        self._set_poses: dict[int, bytes] = {}
        self._impossible: set[int] = set()  # recorded ids of which a warning has told
        self._in_motion: dict[str, Ids] = {}
        self._moved: defaultdict[str, Ids] = defaultdict(lambda: np.empty(0, np.int64))
        self._latest: defaultdict[str, deque[_Velocities]] = defaultdict(lambda: deque(maxlen=_MOST_TICKS))

    def move(self, scene: Scene, delta: float, seconds: float) -> None:
        """Move all replayed actors to their poses in a scene, the end of a tick of delta s; 0 moves them at once.

        In the tick, some seconds of the recording pass.
        """
        if self._changes_of_pairs != self._mapping.changes:
            self._changes_of_pairs = self._mapping.changes
            pairs = sorted((id, actor.id) for id, actor in self._mapping.replayed.items())
            self._pairs = np.array(pairs, np.int64).reshape(-1, 2).T
        for id in scene.ids[~possible(scene.poses)].tolist():
            if id in self._mapping.replayed and id not in self._impossible:
                self._impossible.add(id)
                told = (
                    f"its recorded pose at {scene.time:g} s is out of range; it is not moved to it, nor to later such ones"
                )
                warnings.warn(f"{self._mapping.replayed[id]!r}: {told}", RecapWarning, stacklevel=5)
        for name, movers in (("vehicles", self._episode.vehicles), ("walkers", self._episode.walkers)):
            rows, indices = self._linked(scene.ids, movers.id)
            for row in rows[movers.simulated[rows]].tolist():  # its physics has been switched on meanwhile
                movers.set_simulated(row, False)
            poses = scene.poses[indices]
            usable = possible(poses)
            rows, poses = rows[usable], poses[usable]
            self._stop(name, movers, rows)
            velocities = self._move(name, movers, rows, poses, delta, seconds)
            movers.acceleration[rows] = 0.0
            if velocities is not None:
                changes = self._changes(name, _Velocities(scene.time, movers.id[rows], velocities), scene)
                movers.acceleration[rows] = changes * (seconds / delta) ** 2
        self._set_other_poses(scene)
        self._set_controls(scene)
        self._set_walks(scene)
        self._set_lights(scene)

    def has_moved(self, actor: MovingActor) -> bool:
        """Return whether the recorded velocity of an actor is known."""
        return actor.id in self._motions

    def motion(self, actor: MovingActor) -> list[float]:
        """Return the recorded velocity of an actor, in m/s along the world's axes, and its yaw rate in degrees/s."""
        return self._motions.get(actor.id, [0.0] * 4)

    def _stop(self, name: str, movers: MovingBodies, rows: Rows) -> None:
        """Let replayed actors stand still that have no pose any more."""
        ids = movers.id[rows]
        if not np.array_equal(ids, self._moved[name]):
            left = np.isin(movers.id, self._moved[name]) & ~np.isin(movers.id, ids) & ~movers.simulated
            for column in (movers.velocity, movers.angular_velocity, movers.acceleration):
                column[left] = 0.0

    def _move(
        self, name: str, movers: MovingBodies, rows: Rows, poses: Floats, delta: float, seconds: float
    ) -> Floats | None:
        """Move vehicles or walkers; return their recorded velocities in m/s, NaN where they are unknown, if time passes."""
        position, rotation = poses[:, :3] / CM_PER_M, poses[:, _PITCH_YAW_ROLL]
        path = position - movers.position[rows]
        turn = wrap(rotation - movers.rotation[rows])
        distance = np.linalg.norm(path, axis=1)
        ids, velocities = movers.id[rows], None
        if seconds >= _SHORTEST:
            jumps = distance > possible_step(seconds, least=0.0)
            path[jumps], turn[jumps] = 0.0, 0.0
            velocities = path / seconds
            self._motions |= zip(ids.tolist(), np.column_stack((velocities, turn[:, 1] / seconds)).tolist(), strict=True)
            velocities[jumps] = np.nan
            if not np.array_equal(ids, self._moved[name]):
                velocities[~np.isin(ids, self._moved[name])] = np.nan
        self._moved[name] = ids
        pushing = distance <= possible_step(delta, least=0.0)  # an actor that jumps pushes none on its way
        for row, (x, y, z), (pitch, yaw, roll) in zip(rows[~pushing], position[~pushing], rotation[~pushing], strict=True):
            movers.place(int(row), (x, y, z), (pitch, yaw, roll))
        rate = 1 / delta if delta else 0.0
        motions = np.zeros((len(movers), 3))
        motions[rows, :2] = path[:, :2] * rate * pushing[:, None]
        motions[rows, 2] = np.radians(turn[:, 1]) * rate * pushing
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
        movers.angular_velocity[rows] = _turning(rotation, turn) * rate
        return velocities

    def _changes(self, name: str, latest: _Velocities, scene: Scene) -> Floats:
        """Return the changes of the recorded velocities in m/s², 0 where unknown, and keep the latest velocities."""
        following, known = scene.batch.following, self._latest[name]
        interval = min(following.elapsed - scene.frame.elapsed, LONGEST_STEP) if following is not None else 0.0
        before = latest.time - interval * (1 - _ROUNDING)
        while len(known) > 1 and known[1].time <= before:
            known.popleft()
        earlier = known[0] if known and known[0].time <= before else None
        known.append(latest)
        if earlier is None:
            return np.zeros_like(latest.values)
        changes = (latest.values - earlier.of(latest.ids)) / (latest.time - earlier.time)
        changes[np.isnan(changes)] = 0.0
        return changes

    def _set_other_poses(self, scene: Scene) -> None:
        """Set the poses of props and the spectator."""
        for id, actor in self._mapping.replayed.items():
            if isinstance(actor, (MovingActor, Sign)) or actor.parent is not None:
                continue
            index = scene.index_of(id)
            if index is None:
                continue
            pose = scene.poses[index]
            if self._set_poses.get(id) != pose.tobytes() and possible(pose):
                actor.transform = transform(pose)
                self._set_poses[id] = pose.tobytes()

    def _set_controls(self, scene: Scene) -> None:
        vehicles = self._episode.vehicles
        yaw = np.radians(vehicles.yaw)
        cos, sin = np.cos(yaw), np.sin(yaw)
        kinematic = ~vehicles.simulated
        x, y = vehicles.velocity[:, 0], vehicles.velocity[:, 1]
        np.copyto(vehicles.speed, cos * x + sin * y, where=kinematic)
        np.copyto(vehicles.sideways, cos * y - sin * x, where=kinematic)
        rows, indices = self._linked(scene.vehicle_controls["id"], vehicles.id)
        controls = scene.vehicle_controls[indices]
        vehicles.steer[rows] = controls["steer"]
        vehicles.throttle[rows] = controls["throttle"]
        vehicles.brake[rows] = controls["brake"]
        vehicles.hand_brake[rows] = controls["hand_brake"]
        vehicles.reverse[rows] = controls["gear"] < 0
        vehicles.manual[rows] = True
        vehicles.gear[rows] = np.clip(controls["gear"], -1, GEARS - 2)
        rows, indices = self._linked(scene.vehicle_lights["id"], vehicles.id)
        vehicles.light_state[rows] = scene.vehicle_lights["flags"][indices]

    def _set_walks(self, scene: Scene) -> None:
        walkers = self._episode.walkers
        rows, indices = self._linked(scene.walker_controls["id"], walkers.id)
        walkers.speed[rows] = scene.walker_controls["speed"][indices] / CM_PER_M
        yaw = np.radians(walkers.yaw[rows])
        walkers.direction[rows] = np.column_stack((np.cos(yaw), np.sin(yaw), np.zeros(len(rows))))

    def _set_lights(self, scene: Scene) -> None:
        signals = self._episode.signals
        rows, indices = self._linked(scene.light_states["id"], signals.id)
        states = scene.light_states[indices]
        signals.state[rows] = states["state"]
        signals.elapsed[rows] = states["elapsed"]
        signals.frozen[rows] = states["frozen"] != 0

    def _linked(self, ids: Ids, world_ids: NDArray[np.int64]) -> tuple[Rows, Rows]:
        """Return the rows of the world to which recorded ids are mapped, and the indices of these ids."""
        where, is_mapped = find(ids, self._pairs[0])
        order = np.argsort(world_ids)
        rows, is_present = find(self._pairs[1][where[is_mapped]], world_ids[order])
        return order[rows[is_present]], np.flatnonzero(is_mapped)[is_present]


def _turning(rotation: Floats, turn: Floats) -> Floats:
    """Return turns of pitch, yaw and roll, in degrees, (n, 3), as vectors along the axes of the world: angular velocities.

    In CARLA's recordings, too, a positive pitch or roll turns around the negative axis. `rotation` is that after the turn.
    """
    vectors: Floats = np.zeros_like(turn)
    vectors[:, 2] = turn[:, 1]
    if not turn[:, ::2].any():
        return vectors
    pitch, yaw = np.radians(rotation[:, 0]), np.radians(rotation[:, 1])
    cos, sin, still = np.cos(yaw), np.sin(yaw), np.zeros(len(yaw))
    right = np.stack((-sin, cos, still), axis=1)
    ahead = np.stack((np.cos(pitch) * cos, np.cos(pitch) * sin, np.sin(pitch)), axis=1)
    vectors -= turn[:, 0, None] * right + turn[:, 2, None] * ahead
    return vectors


class CollisionReplay:
    """Adds the recorded collisions of replayed actors to the events of the world.

    A collision is reported for the actor for which it was recorded, and for the other one if it is watched, as by two
    collision sensors. A light or sign that the town does not have counts as a barrier; collisions with other actors that are
    not replayed are left out. A pair of actors has one collision in a tick, however many frames of the recording pass in it.

    Recordings contain no impulses. That between two actors is the impulse of an inelastic impact along the line between
    their centres, from their masses and their recorded velocities before it, and 0 while the contact lasts. That with a
    barrier is the mass times the recorded change of velocity in the tick.
    """

    def __init__(self, episode: Episode, mapping: ActorMapping, kinematic: KinematicReplay) -> None:
        self._episode = episode
        self._mapping = mapping
        self._kinematic = kinematic
        self._collided: list[Collided] = []
        self._recorded: Mapping[int, ActorLife] = {}
        self._actors: dict[int, Actor] = {}
        self._velocities: dict[int, Floats] = {}
        self._latest: dict[tuple[int, int | None], float] = {}

    def prepare(self, scene: Scene) -> None:
        """Keep what is needed of the actors that collide, before they are moved to a scene, or destroyed."""
        self._collided, self._recorded, replayed = scene.collisions, scene.actors, self._mapping.replayed
        ids = {id for each in self._collided for id in (each.actor1, each.actor2)}
        self._actors = {id: replayed[id] for id in ids if id in replayed}
        self._velocities = {actor.id: self._velocity(actor) for actor in self._actors.values()}

    def report(self) -> None:
        """Add the collisions of that scene to the pending events, after the actors have moved."""
        if not self._collided:
            return
        actors = {**self._actors, **self._mapping.replayed}
        pairs: dict[tuple[int, int | None], tuple[Actor, Actor | None, Collided]] = {}
        for each in self._collided:
            first, second = actors.get(each.actor1), actors.get(each.actor2)
            if first is not None and (second is not None or self._is_barrier(each.actor2)):
                pairs.setdefault((first.id, None if second is None else second.id), (first, second, each))
        for first, second, each in list(pairs.values()):
            if second is not None and is_watched(second):
                pairs.setdefault((second.id, first.id), (second, first, each))
        for pair, (first, second, each) in pairs.items():
            is_new = not abs(each.elapsed - self._latest.get(pair, -np.inf)) < _SAME_CONTACT
            self._latest[pair] = each.elapsed
            self._episode.pending.collisions.append(self._collision(first, second, each.number, is_new=is_new))

    def _is_barrier(self, id: int) -> bool:
        """Return whether a recorded id that stands for no actor of the world is that of something that never moves."""
        actor = self._recorded.get(id)
        return is_object(id, self._recorded) or (actor is not None and actor.type_id.startswith(TRAFFIC))

    def _collision(self, first: Actor, second: Actor | None, number: int, *, is_new: bool) -> Collision:
        if second is None:
            point, impulse = _position(first), self._impulse_of_barrier(first)
        else:
            point = (_position(first) + _position(second)) / 2
            impulse = self._impulse(first, second) if is_new else np.zeros(3)
        return Collision(
            first.id,
            None if second is None else second.id,
            Location(*point.tolist()),
            Vector(*impulse.tolist()),
            first.is_hero,
            second is not None and second.is_hero,
            number,
        )

    def _impulse(self, first: Actor, second: Actor) -> Floats:
        """Return the estimated impulse of an actor on the first one, in N s."""
        line = _position(first) - _position(second)
        line[2] = 0.0
        distance, per_mass = np.linalg.norm(line).item(), _per_mass(first) + _per_mass(second)
        if not distance or not per_mass:
            return np.zeros(3)
        line /= distance
        closing = float((self._velocity_before(second) - self._velocity_before(first)) @ line)
        return max(closing, 0.0) / per_mass * line

    def _impulse_of_barrier(self, actor: Actor) -> Floats:
        """Return the estimated impulse of a barrier on an actor, in N s."""
        per_mass = _per_mass(actor)
        return (self._velocity(actor) - self._velocity_before(actor)) / per_mass if per_mass else np.zeros(3)

    def _velocity_before(self, actor: Actor) -> Floats:
        return self._velocities.get(actor.id, np.zeros(3))

    def _velocity(self, actor: Actor) -> Floats:
        return np.array(self._kinematic.motion(actor)[:3] if isinstance(actor, MovingActor) else (0.0, 0.0, 0.0))


def _position(actor: Actor) -> Floats:
    location = actor.transform.location
    return np.array((location.x, location.y, location.z))


def _per_mass(actor: Actor) -> float:
    """Return 1 through the mass of an actor in kg: 0 for one that nothing moves."""
    if not (isinstance(actor, MovingActor) and actor.is_alive):
        return 0.0
    mass: float = actor.rows.mass[actor.row].item()
    return 1.0 / max(mass, 1.0)
