"""The actors of a recording at a moment, as instances of models."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.replay.pose import LOCATION, right_handed, rotations
from carla_recap.replay.selection import find
from carla_recap.scene.appearance import Look, look_of, look_of_present
from carla_recap.scene.collisions import MARK_RADIUS, CollisionMarks, FallenWalkers, collision_scenes
from carla_recap.scene.instances import Instances
from carla_recap.scene.materials import MATERIALS, Color, Material, Tag
from carla_recap.scene.models import INDEX

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.model.actors import ActorLife
    from carla_recap.recording import Recording
    from carla_recap.replay import Scene, SceneBatch
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

_MARK_IDS: Final = 0xFFFF_0000  # ids from here on are those of marks
_MARK_COLOR: Final[Color] = MATERIALS[Material.COLLISION_MARK].color

_BRAKING: Final = 0.02  # of the brake control, from which on the lamps are lit
_STEERED: Final = math.radians(40)  # of the front wheels at full steering


def instances(ids: Sequence[int] | Ids, looks: Sequence[Look], poses: Floats) -> Instances:
    """Return instances of actors that are drawn, all lamps off.

    Args:
        ids: Their ids, ascending.
        looks: Their looks.
        poses: CARLA's poses in the world: x, y, z in cm and roll, pitch, yaw in degrees, (n, 6).
    """
    return _LookColumns(np.array(ids, np.uint32), looks).at(poses)


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


class _LookColumns:
    """The looks of actors as arrays."""

    def __init__(self, ids: Ids, looks: Sequence[Look]) -> None:
        self.ids = ids
        self.models = np.array([look.model for look in looks], np.uint16)
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
        self._present: Mapping[int, ActorLife] = {}
        self._ids: Ids | None = None
        self._actors = _LookColumns(np.zeros(0, np.uint32), [])
        self._rows = np.zeros(0, np.intp)
        self._standing: Floats = np.zeros((0, 6))  # the poses of those without recorded ones
        self._attached: list[tuple[int, int]] = []  # rows and ids of those that move with a parent
        self._looks: dict[int, tuple[ActorLife, Look | None]] = {}
        self._fallen = FallenWalkers()
        self._marks = CollisionMarks()
        self._recalled = False  # whether what is known belongs to a moment before the next scene

    def at(self, scene: Scene) -> Instances:
        """Return the instances of a scene."""
        if scene.batch is not self._batch:
            self._enter(scene.batch)
        self._leave_behind(scene.batch[scene.row : scene.row + 1], keep=self._recalled)
        self._recalled = False
        poses = self._poses(scene)
        found = self._actors.at(poses)
        self._light(found, scene)
        self._lay(found)
        sound = np.all(np.abs(poses) < 1e9, axis=1)  # and no NaN
        if not sound.all():
            found = found.take(sound)
        return self._with_marks(found)

    def recall(self, recording: Recording, time: float) -> None:
        """Learn what collisions before a moment have left behind; the next scene is one of that moment.

        Args:
            recording: The recording.
            time: The moment, in elapsed seconds.
        """
        self._fallen, self._marks, self._recalled = FallenWalkers(), CollisionMarks(), True
        for batch in collision_scenes(recording, time):
            self._leave_behind(batch, keep=True)

    def _leave_behind(self, scene: SceneBatch, *, keep: bool) -> None:
        """Take the collisions of a scene."""
        self._fallen.changes(scene, keep=keep)
        if self._marks_wanted:
            self._marks.changes(scene, keep=keep)

    def _enter(self, batch: SceneBatch) -> None:
        """Take the actors of a batch, if they are others than before."""
        self._batch = batch
        if batch.ids is self._ids and batch.actors == self._present:
            return
        self._ids, self._present = batch.ids, batch.actors
        looks: dict[int, tuple[ActorLife, Look | None]] = {}
        for id, actor in batch.actors.items():
            known = self._looks.get(id)
            looks[id] = (
                known if known is not None and known[0] is actor else (actor, look_of_present(actor, signs=self._signs))
            )
        self._looks = looks
        drawn = sorted((id, look) for id, (_, look) in looks.items() if look is not None)
        ids = np.array([id for id, _ in drawn], np.uint32)
        self._actors = _LookColumns(ids, [look for _, look in drawn])
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

    def _lay(self, found: Instances) -> None:
        """Lay down the walkers that were knocked down."""
        for id, fall in self._fallen.falls.items():
            row = int(found.ids.searchsorted(id))
            if row < len(found) and found.ids[row] == id:
                upright = found.rotations[row].astype(np.float64)
                found.rotations[row] = upright @ fall.matrix
                found.locations[row] += upright @ (fall.offset - self._actors.centers[row])

    def _with_marks(self, found: Instances) -> Instances:
        locations = self._marks.locations
        if not len(locations):
            return found
        count = len(locations)
        added = Instances(
            np.arange(_MARK_IDS, _MARK_IDS + count, dtype=np.uint32),
            np.full(count, INDEX["collision mark"], np.uint16),
            locations,
            np.broadcast_to(np.eye(3, dtype=np.float32), (count, 3, 3)),
            np.broadcast_to(np.array((MARK_RADIUS, MARK_RADIUS, 0.001), np.float32), (count, 3)),
            np.broadcast_to(np.array(_MARK_COLOR, np.uint8), (count, 3)),
            np.zeros(count, np.uint64),
            np.zeros(count, np.float32),
            np.ones(count, np.float32),
            np.full(count, Tag.ROADS, np.uint8),
        )
        columns = zip(vars(found).values(), vars(added).values(), strict=True)
        return Instances(*(np.concatenate(pair) for pair in columns))
