"""The actors of a recording at a moment, as instances of models."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.records import NO_ACTOR, ActorKind
from carla_recap.rendering.instances import Instances
from carla_recap.rendering.looks import Look, look_of, look_of_present
from carla_recap.rendering.materials import MATERIALS, Color, Material, Tag
from carla_recap.rendering.models import INDEX
from carla_recap.replay.player import Player
from carla_recap.replay.pose import LOCATION, ROTATION, right_handed, rotations
from carla_recap.replay.selection import find

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.recording import Recording
    from carla_recap.replay import Scene, SceneBatch
    from carla_recap.replay.events import Present
    from carla_recap.replay.selection import Ids

    Floats = NDArray[np.float64]

__all__ = ["Look", "SceneActors", "instances", "instances_of", "lamps_of_lights", "lamps_of_vehicles", "look_of"]

BRAKE, RIGHT_BLINKER, LEFT_BLINKER, REVERSE = 8, 16, 32, 64
_POSITION, _LOW, _HIGH, _FOG, _SPECIAL = 1, 2, 4, 128, 512 | 1024
_LIT_BY: Final = (
    (Material.HEADLIGHT, _LOW | _HIGH | _FOG),
    (Material.TAIL_LIGHT, _POSITION | _LOW | _HIGH | BRAKE),
    (Material.BRAKE_LIGHT, BRAKE),
    (Material.LEFT_INDICATOR, LEFT_BLINKER),
    (Material.RIGHT_INDICATOR, RIGHT_BLINKER),
    (Material.REVERSE_LIGHT, REVERSE),
    (Material.BEACON, _SPECIAL),
)
"""The lamps, and the bits of CARLA's VehicleLightState of which any lights them."""
_LIGHTS: Final = np.array([1 << Material.RED_LAMP, 1 << Material.YELLOW_LAMP, 1 << Material.GREEN_LAMP, 0, 0], np.uint64)

MARKED: Final = 5.0
"""The time in s for which the place of a collision is marked."""
_MARK: Final = 1.1  # m, the radius
_MARK_HEIGHT: Final = 0.03  # m above the ground
_MOST_MARKS: Final = 200
_MARK_IDS: Final = 0xFFFF_0000  # ids from here on are those of marks
_MARK_COLOR: Final[Color] = MATERIALS[Material.COLLISION_MARK].color

_MOST_RECALLED: Final = 50  # collisions
_LEAD: Final = 0.3  # s before a collision that are read, for the velocities
_SLACK: Final = 1e-6  # s

_BRAKING: Final = 0.02  # of the brake control, from which on the lamps are lit
_STEERED: Final = math.radians(40)  # of the front wheels at full steering
_KNOCKED: Final = 1.5  # m/s: from this speed on, a vehicle knocks a walker down
_UPRIGHT: Final = 45.0  # degrees; one that leans more lies already
_WALKING: Final = 20.0  # cm/s; one that walks again has got up


def instances(ids: Sequence[int] | Ids, looks: Sequence[Look], poses: Floats) -> Instances:
    """Return instances of actors that are drawn, all lamps off.

    Args:
        ids: Their ids, ascending.
        looks: Their looks.
        poses: CARLA's poses in the world: x, y, z in cm and roll, pitch, yaw in degrees, (n, 6).
    """
    return _Actors(np.array(ids, np.uint32), looks).at(poses)


def instances_of(scene: Scene, *, marks: bool = True) -> Instances:
    """Return the instances of a scene on its own; `SceneActors` is faster for many, and keeps what happened before.

    Args:
        scene: The scene.
        marks: Whether its collisions are marked on the ground.
    """
    return SceneActors(marks=marks).at(scene)


def lamps_of_vehicles(flags: NDArray[np.integer]) -> NDArray[np.uint64]:
    """Return the lit lamps of vehicles, by the bits of CARLA's VehicleLightState."""
    lamps = np.zeros(np.shape(flags), np.uint64)
    for material, bits in _LIT_BY:
        lamps |= np.where(flags & bits, np.uint64(1 << material), np.uint64(0))
    return lamps


def lamps_of_lights(states: NDArray[np.integer]) -> NDArray[np.uint64]:
    """Return the lit lamps of traffic lights, by CARLA's states: 0 red, 1 yellow, 2 green, none of others."""
    lamps: NDArray[np.uint64] = _LIGHTS[np.where((states >= 0) & (states < len(_LIGHTS)), states, -1)]
    return lamps


class _Actors:
    """The looks of actors as arrays."""

    def __init__(self, ids: Ids, looks: Sequence[Look]) -> None:
        self.ids = ids
        self.models = np.array([look.model for look in looks], np.uint8)
        self.half_extents = np.array([look.half_extents for look in looks], np.float32).reshape(-1, 3)
        self.centers = np.array([look.center for look in looks]).reshape(-1, 3)
        self.colors = np.array([look.color for look in looks], np.uint8).reshape(-1, 3)
        self.tags = np.array([look.tag for look in looks], np.uint8)

    def at(self, poses: Floats) -> Instances:
        """Return the instances at CARLA's poses."""
        converted = right_handed(poses)
        turned = rotations(converted)
        count = len(self.ids)
        return Instances(
            self.ids,
            self.models,
            converted[:, LOCATION] + (turned @ self.centers[..., None])[..., 0],
            turned.astype(np.float32),
            self.half_extents,
            self.colors,
            np.zeros(count, np.uint64),
            np.zeros(count, np.float32),
            np.ones(count, np.float32),
            self.tags,
        )


@dataclass
class _Mark:
    location: Floats
    until: float


class SceneActors:
    """Makes the instances of the scenes of a replay, one after the other.

    It keeps what the actors look like while the same ones are present, and what collisions have left behind.

    Args:
        marks: Whether collisions are marked on the ground for some seconds.
        signs: Whether signs are drawn; those of a map are part of its `TownMesh`.
    """

    def __init__(self, *, marks: bool = True, signs: bool = False) -> None:
        self._signs = signs
        self._marks_wanted = marks
        self._batch: SceneBatch | None = None
        self._present: Mapping[int, Present] = {}
        self._ids: Ids | None = None
        self._actors = _Actors(np.zeros(0, np.uint32), [])
        self._rows = np.zeros(0, np.intp)
        self._standing: Floats = np.zeros((0, 6))  # the poses of those without recorded ones
        self._attached: list[tuple[int, int]] = []  # rows and ids of those that move with a parent
        self._walkers: Ids = np.zeros(0, np.uint32)
        self._looks: dict[int, tuple[Present, Look | None]] = {}
        self._marks: dict[tuple[int, int], _Mark] = {}
        self._knocked: dict[int, Floats] = {}  # walkers, and the direction in which they were knocked down
        self._before: tuple[float, Ids, Floats] | None = None  # the scene before: time, ids, poses
        self._time = -math.inf
        self._recalled = False  # whether what is known belongs to a moment before the next scene

    def at(self, scene: Scene) -> Instances:
        """Return the instances of a scene."""
        if (scene.fresh and not self._recalled) or scene.time < self._time:
            self._forget()
        self._recalled = False
        self._learn(scene)
        poses = self._poses(scene)
        found = self._actors.at(poses)
        self._light(found, scene)
        self._lay(found, scene)
        sound = np.all(np.abs(poses) < 1e9, axis=1)  # and no NaN
        if not sound.all():
            found = found.take(sound)
        return self._with_marks(found, scene.time)

    def recall(self, recording: Recording, time: float) -> None:
        """Learn what collisions before a moment have left behind; the next scene is one of that moment.

        Args:
            recording: The recording.
            time: The moment, in elapsed seconds.
        """
        self._forget()
        rows = [row for row in recording.collisions() if row.elapsed <= time]
        lasting = [row for row in rows if "w" in (row.letter1, row.letter2) or row.elapsed > time - MARKED]
        for row in lasting[-_MOST_RECALLED:]:
            begin = max(row.elapsed - _LEAD, 0.0)
            for scene in Player(recording, start=begin, duration=2 * _LEAD).scenes():
                if scene.time > row.elapsed + _SLACK:
                    break
                self._learn(scene)
        self._time, self._before, self._recalled = -math.inf, None, True

    def _forget(self) -> None:
        self._marks.clear()
        self._knocked.clear()
        self._before = None

    def _learn(self, scene: Scene) -> None:
        """Take the actors and the collisions of a scene."""
        self._time = scene.time
        if scene.batch is not self._batch:
            self._enter(scene.batch)
        for event in scene.collisions:
            self._collide(event.actor1, event.actor2, scene)
        self._before = (scene.time, scene.ids, scene.poses)

    def _enter(self, batch: SceneBatch) -> None:
        """Take the actors of a batch, if they are others than before."""
        self._batch = batch
        if batch.ids is self._ids and batch.actors == self._present:
            return
        self._ids, self._present = batch.ids, batch.actors
        looks: dict[int, tuple[Present, Look | None]] = {}
        for id, actor in batch.actors.items():
            known = self._looks.get(id)
            looks[id] = (
                known if known is not None and known[0] is actor else (actor, look_of_present(actor, signs=self._signs))
            )
        self._looks = looks
        drawn = sorted((id, look) for id, (_, look) in looks.items() if look is not None)
        ids = np.array([id for id, _ in drawn], np.uint32)
        self._actors = _Actors(ids, [look for _, look in drawn])
        index, recorded = find(ids, batch.ids)
        self._rows = np.where(recorded, index, -1)
        self._standing = np.full((len(ids), 6), np.nan)
        self._attached = []
        for row in np.flatnonzero(~recorded).tolist():
            id = int(ids[row])
            if batch.actors[id].attached:
                self._attached.append((row, id))
            else:
                self._standing[row] = batch.actors[id].spawn_pose
        kinds = [batch.actors[int(id)].kind for id in ids]
        self._walkers = ids[[kind == ActorKind.WALKER for kind in kinds]] if kinds else ids

    def _poses(self, scene: Scene) -> Floats:
        poses = self._standing.copy()
        recorded = self._rows >= 0
        poses[recorded] = scene.poses[self._rows[recorded]]
        for row, id in self._attached:
            pose = scene.pose_of(id)
            poses[row] = np.nan if pose is None else pose
        return poses

    def _light(self, found: Instances, scene: Scene) -> None:
        """Set the lamps and the steering."""
        if not len(found):
            return
        states = scene.light_states
        rows, known = find(states["id"], found.ids)
        found.lamps[rows[known]] |= lamps_of_lights(states["state"][known].astype(np.int64))
        lights = scene.vehicle_lights
        rows, known = find(lights["id"], found.ids)
        found.lamps[rows[known]] |= lamps_of_vehicles(lights["flags"][known])
        controls = scene.vehicle_controls
        rows, known = find(controls["id"], found.ids)
        flags = BRAKE * (controls["brake"][known] > _BRAKING).astype(np.int64)
        flags |= REVERSE * (controls["gear"][known] < 0).astype(np.int64)
        found.lamps[rows[known]] |= lamps_of_vehicles(flags)
        steer = np.nan_to_num(controls["steer"][known].astype(np.float64))
        found.steering[rows[known]] = np.clip(-steer, -1, 1) * _STEERED

    def _collide(self, actor1: int, actor2: int, scene: Scene) -> None:
        """Mark a collision, and knock down a walker that was hit by a vehicle."""
        places = {id: pose for id in (actor1, actor2) if id != NO_ACTOR and (pose := scene.pose_of(id)) is not None}
        walkers = [id for id in places if id in self._present and self._present[id].kind == ActorKind.WALKER]
        if not places:
            return
        if self._marks_wanted:
            self._mark(actor1, actor2, [places[id] for id in walkers] or list(places.values()), [*places], scene.time)
        for walker in walkers:
            vehicle = actor2 if walker == actor1 else actor1
            if vehicle in places and vehicle not in walkers and walker not in self._knocked:
                velocity = self._velocity(vehicle, scene) - self._velocity(walker, scene)
                speed = float(np.linalg.norm(velocity))
                if speed > _KNOCKED:
                    self._knocked[walker] = velocity / speed

    def _mark(self, actor1: int, actor2: int, poses: list[Floats], ids: list[int], time: float) -> None:
        location = right_handed(np.mean(poses, axis=0))[LOCATION]
        if not np.isfinite(location).all():
            return
        bottoms = [self._bottom(id) for id in ids]
        location[2] += min(bottoms, default=0.0) + _MARK_HEIGHT
        pair = (min(actor1, actor2), max(actor1, actor2))
        known = self._marks.get(pair)
        if known is not None:
            known.until = time + MARKED  # the contact goes on: it is marked where it began
        elif len(self._marks) < _MOST_MARKS:
            self._marks[pair] = _Mark(location, time + MARKED)

    def _bottom(self, id: int) -> float:
        """Return the height of the lower side of an actor's box above its origin, in m."""
        _, look = self._looks.get(id, (None, None))
        return look.center[2] - look.half_extents[2] if look is not None else 0.0

    def _velocity(self, id: int, scene: Scene) -> Floats:
        """Return the horizontal velocity in m/s, right-handed: as recorded, else out of the last two poses."""
        rows = scene.velocities
        index, known = find(np.array([id], np.uint32), rows["id"])
        if known[0]:
            row = rows[index[0]]
            found = np.array((row["x"], -row["y"]), np.float64)
            if np.isfinite(found).all():
                return found
        pose = scene.pose_of(id)
        if self._before is not None and pose is not None and scene.time > self._before[0]:
            time, ids, poses = self._before
            index, known = find(np.array([id], np.uint32), ids)
            if known[0]:
                step = right_handed(pose - poses[index[0]])[:2] / (scene.time - time)
                if np.isfinite(step).all():
                    return np.array(step)
        return np.zeros(2)

    def _lay(self, found: Instances, scene: Scene) -> None:
        """Lay down the walkers that were knocked down and whose recorded poses are upright."""
        if not self._knocked:
            return
        controls = scene.walker_controls
        walking = set(controls["id"][controls["speed"] > _WALKING].tolist())
        for walker in [id for id in self._knocked if id in walking or id not in self._present]:
            del self._knocked[walker]
        for walker, direction in self._knocked.items():
            pose = scene.pose_of(walker)
            row = int(found.ids.searchsorted(walker))
            if pose is None or row >= len(found) or found.ids[row] != walker or np.abs(pose[ROTATION][:2]).max() > _UPRIGHT:
                continue
            on_back = found.rotations[row, :2, 0] @ direction <= 0
            forward = np.array((0.0, 0.0, 1.0 if on_back else -1.0))
            up = np.array((*direction, 0.0))
            found.rotations[row] = np.column_stack((forward, np.cross(up, forward), up))
            found.locations[row, 2] += float(found.half_extents[row, 0] - found.half_extents[row, 2])

    def _with_marks(self, found: Instances, time: float) -> Instances:
        for pair in [pair for pair, mark in self._marks.items() if mark.until < time]:
            del self._marks[pair]
        if not self._marks:
            return found
        locations = np.array([mark.location for mark in self._marks.values()])
        count = len(locations)
        added = Instances(
            np.arange(_MARK_IDS, _MARK_IDS + count, dtype=np.uint32),
            np.full(count, INDEX["collision mark"], np.uint8),
            locations,
            np.broadcast_to(np.eye(3, dtype=np.float32), (count, 3, 3)),
            np.broadcast_to(np.array((_MARK, _MARK, 0.001), np.float32), (count, 3)),
            np.broadcast_to(np.array(_MARK_COLOR, np.uint8), (count, 3)),
            np.zeros(count, np.uint64),
            np.zeros(count, np.float32),
            np.ones(count, np.float32),
            np.full(count, Tag.ROADS, np.uint8),
        )
        columns = zip(vars(found).values(), vars(added).values(), strict=True)
        return Instances(*(np.concatenate(pair) for pair in columns))
