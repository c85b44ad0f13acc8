"""What is to be seen in scenes: the only description, which viewers, videos, pages and cameras translate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.lives import ActorLife
from carla_recap.model.presence import FAR
from carla_recap.model.records import Spawn
from carla_recap.replay.player import Player
from carla_recap.replay.pose import ROTATION, right_handed, rotations
from carla_recap.replay.selection import NO_IDS, find, index_in
from carla_recap.scene.appearance import UNKNOWN, look_of_present
from carla_recap.scene.falls import UPRIGHT, FallChange, FallenWalkers, RecordedContacts
from carla_recap.scene.lamps import VehicleLamps, lamps_of_lights, lamps_of_vehicles
from carla_recap.scene.marks import MARKED, CollisionMarks
from carla_recap.scene.materials import Tag

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.recording import Recording
    from carla_recap.replay import SceneBatch
    from carla_recap.scene.appearance import Look
    from carla_recap.scene.falls import Fall
    from carla_recap.util.arrays import Booleans, Floats, Ids, Indices, Integers

    Lamps = NDArray[np.uint64]

_STEERED: Final = math.radians(40)  # of the front wheels at full steering
LYING: Final = 0.7
"""The part of its height up to which the head of a walker that lies is above its feet."""

_LOOK_BACK: Final = MARKED + 0.5  # s before a moment that decide which lamps are lit then, and where marks are


class LookColumns:
    """The looks of actors as arrays.

    Attributes:
        ids: The ids of the actors, ascending.
        looks: Their looks.
        models: Their models, as indices of `carla_recap.scene.models.MODELS`.
        half_extents: Half the sizes of their boxes in m, (actors, 3).
        centers: The centres of these in their own axes in m, (actors, 3).
        colors: Red, green, blue of the paint, (actors, 3).
        tags: The semantic tags.
    """

    def __init__(self, ids: Ids, looks: Sequence[Look]) -> None:
        self.ids = ids
        self.looks = looks
        self.models = np.array([look.model for look in looks], np.uint16)
        self.half_extents = np.array([look.half_extents for look in looks], np.float32).reshape(-1, 3)
        self.centers = np.array([look.center for look in looks]).reshape(-1, 3)
        self.colors = np.array([look.color for look in looks], np.uint8).reshape(-1, 3)
        self.tags = np.array([look.tag for look in looks], np.uint8)

    def look_of(self, id: int) -> Look | None:
        """Return the look of an actor; None if it is not among these."""
        row = index_in(self.ids, id)
        return None if row is None else self.looks[row]


@dataclass(frozen=True, eq=False)
class _Places:
    """Where the poses of actors are to be found."""

    rows: Indices  # the positions of the actors among the recorded poses; -1 without one, (actors,)
    # the poses of those without recorded ones, in m and degrees, right-handed; NaN of all others, (actors, 6)
    standing: Floats
    attached: list[tuple[int, int]]  # the positions and ids of those that move with a parent


@dataclass(frozen=True, eq=False)
class SceneDescription:
    """What is to be seen in the scenes of a batch; the actors are those with a look: no sensors, no spectator.

    An actor of which the recording has poses, but no spawn, is among them: its look is `UNKNOWN`.
    """

    batch: SceneBatch  # the scenes
    lives: Mapping[int, ActorLife]  # the present actors, by their ids, those without a spawn included
    actors: LookColumns  # the looks of those that have one; the same object as before if they are the same
    vehicles: Ids  # the ids of the vehicles, ascending
    flags: Integers  # their lit lamps as bits of CARLA's VehicleLightState, (scenes, vehicles)
    falls: list[FallChange]  # the walkers that fall and get up in these scenes
    fallen: Mapping[int, Fall]  # how the walkers lie that have fallen before these scenes, by their ids
    # the rows at which marks of collisions appear or disappear, and where all marks are from then on, (marks, 3) in m,
    # right-handed
    marks: list[tuple[int, Floats]]
    marked: Floats  # where the marks are before these scenes
    _places: _Places

    def __len__(self) -> int:
        return len(self.batch)

    @property
    def ids(self) -> Ids:
        """The ids of the actors, ascending."""
        return self.actors.ids

    @cached_property
    def recorded_poses(self) -> Floats:
        """The recorded poses of all actors that have any, with a look or not, (scenes, batch.ids, 6), as `poses`."""
        return right_handed(self.batch.poses)

    @cached_property
    def recorded_shown(self) -> Booleans:
        """Whether each of these is somewhere to be seen, or would be if it had a look, (scenes, batch.ids)."""
        return _are_near(self.recorded_poses) & ~self.batch.away

    @property
    def poses(self) -> Floats:
        """The poses in m and degrees, right-handed, (scenes, ids, 6); NaN where they are unknown."""
        return self._everywhere[0]

    @property
    def shown(self) -> Booleans:
        """Whether an actor is somewhere to be seen, (scenes, ids)."""
        return self._everywhere[1]

    @cached_property
    def _everywhere(self) -> tuple[Floats, Booleans]:
        places, others = self._places, self._places.rows < 0
        nothing = np.empty((len(self), len(self.ids), 6))
        poses = nothing if others.all() else self.recorded_poses.take(places.rows, axis=1)
        poses[:, others] = places.standing[others]
        for row, id in places.attached:
            pose = self.batch.pose_of(id)
            poses[:, row] = np.nan if pose is None else right_handed(pose)
        shown = _are_near(poses)
        if self.batch.away.any():
            shown[:, ~others] &= ~self.batch.away[:, places.rows[~others]]
        return poses, shown

    @cached_property
    def lamps(self) -> Lamps:
        """The lit lamps: a bit `1 << material` for each lamp `Material` that is lit and to be seen, (scenes, ids)."""
        lamps = np.zeros((len(self.batch), len(self.ids)), np.uint64)
        columns, known = find(self.vehicles, self.ids)
        lamps[:, columns[known]] = lamps_of_vehicles(self.flags[:, known])
        states = self.batch.light_states
        columns, known = find(states["id"][0], self.ids)
        lamps[:, columns[known]] |= lamps_of_lights(states["state"][:, known].astype(np.int64))
        lamps[~self.shown] = 0
        return lamps

    @cached_property
    def steering(self) -> Floats:
        """The angles of the front wheels in radians, positive to the left, (scenes, ids)."""
        steering = np.zeros((len(self.batch), len(self.ids)))
        controls = self.batch.records("vehicle_controls")
        columns, known = find(controls["id"][0], self.ids)
        steer = np.nan_to_num(controls["steer"][:, known].astype(np.float64))
        steering[:, columns[known]] = np.clip(-steer, -1, 1) * _STEERED
        return steering

    def pose_of(self, id: int, row: int) -> Floats | None:
        """Return the pose of an actor in a scene, with a look or not, (6,), as `poses`; None if it is unknown."""
        pose = self.batch.pose_of(id, row)
        return None if pose is None or not np.isfinite(pose).all() else right_handed(pose)

    def fallen_at(self, row: int) -> dict[int, Fall]:
        """Return how walkers lie in a scene, by their ids."""
        found = dict(self.fallen)
        for change in self.falls:
            if change.row <= row:
                found.pop(change.id, None)
                if change.fall is not None:
                    found[change.id] = change.fall
        return found

    def lying_at(self, row: int) -> dict[int, float]:
        """Return the walkers that lie in a scene, by their ids: the heading of their heads in degrees, right-handed."""
        fallen, poses, found = self.fallen_at(row), self.poses[row], dict[int, float]()
        leaning = (np.abs(poses[:, ROTATION][:, :2]) > UPRIGHT).any(axis=1) & (self.actors.tags == Tag.PEDESTRIANS)
        lying = np.isin(self.ids, list(fallen)) | leaning if fallen else leaning
        for column in np.flatnonzero(lying & self.shown[row]).tolist():
            id, turned = int(self.ids[column]), rotations(poses[column])
            x, y, z = (turned @ fallen[id].matrix if id in fallen else turned)[:, 2].tolist()
            if z < LYING:
                found[id] = math.degrees(math.atan2(y, x)) % 360
        return found

    def marks_at(self, row: int) -> Floats:
        """Return where marks are in a scene, (marks, 3) in m, right-handed."""
        return next((locations for since, locations in reversed(self.marks) if since <= row), self.marked)


def _are_near(poses: Floats) -> Booleans:
    """Return whether poses are known and not too far away to be drawn, (…)."""
    near = np.abs(poses) < FAR  # not so if it is NaN
    return np.ones(poses.shape[:-1], np.bool_) if near.all() else np.asarray(near.all(axis=-1))


class Uncut(NamedTuple):
    """What a clip is a part of."""

    recording: Recording
    begin: float  # its elapsed seconds at the first frame of the clip, whose own begin at 0


class SceneDescriber:
    """Describes batches of scenes, which have to come in order; after a seek, it begins anew.

    Args:
        signs: Whether signs are actors to be seen; those of a map are part of its `TownMesh`.
    """

    def __init__(self, *, signs: bool = False) -> None:
        self._signs = signs
        self._lamps = VehicleLamps()
        self._walkers = FallenWalkers()
        self._marks = CollisionMarks()
        self._present: Mapping[int, ActorLife] = {}
        self._lives: Mapping[int, ActorLife] = {}
        self._ids: Ids | None = None
        self._known: dict[int, tuple[ActorLife, Look | None]] = {}
        self._unspawned: dict[int, ActorLife] = {}
        self._actors = LookColumns(NO_IDS, [])
        self._places = _Places(np.zeros(0, np.intp), np.zeros((0, 6)), [])
        self._recalled = False

    def recall(self, player: Player, contacts: RecordedContacts | None = None) -> None:
        """Learn what of the time before the first scene of a player, which has not begun, is still to be seen then.

        The contacts of its recording are given if this is done for many moments, so that they are read once.
        """
        contacts = contacts or RecordedContacts(player.reader)
        self._lamps, self._walkers, self._marks = VehicleLamps(), FallenWalkers(), CollisionMarks()
        for batch in player.lead(_LOOK_BACK):
            if batch.fresh:
                self._walkers.recall(player.reader, batch, contacts)
            self._lamps.flags(batch, keep=True)
            self._walkers.changes(batch, keep=True)
            self._marks.changes(batch, keep=True)
        self._recalled = True

    def recall_uncut(self, uncut: Uncut) -> None:
        """Learn what of the time before a clip is still to be seen at its beginning: who lies, and marks of collisions.

        The next scene is the first one of the clip.
        """
        self.recall(Player(uncut.recording, start=uncut.begin))
        self._lamps = VehicleLamps()
        self._walkers.shift(uncut.begin)
        self._marks.shift(uncut.begin)

    def describe(self, batch: SceneBatch) -> SceneDescription:
        """Return what is to be seen in the next scenes."""
        keep, self._recalled = self._recalled, False
        if batch.ids is not self._ids or batch.actors != self._present:
            self._take(batch)
        flags = self._lamps.flags(batch, keep=keep)
        fallen, marked = dict(self._walkers.falls), self._marks.locations
        falls, marks = self._walkers.changes(batch, keep=keep), self._marks.changes(batch, keep=keep)
        if keep:  # what is recalled begins with the first scene
            falls = [*(FallChange(0, id, fall) for id, fall in fallen.items()), *falls]
            if len(marked) and not (marks and marks[0][0] == 0):
                marks = [(0, marked), *marks]
        actors = self._lives, self._actors
        return SceneDescription(batch, *actors, self._lamps.ids, flags, falls, fallen, marks, marked, self._places)

    def _take(self, batch: SceneBatch) -> None:
        """Take the actors of a batch."""
        self._ids, self._present = batch.ids, batch.actors
        self._unspawned = self._without_spawn(batch)
        self._lives = {**batch.actors, **self._unspawned} if self._unspawned else batch.actors
        known: dict[int, tuple[ActorLife, Look | None]] = {}
        for id, actor in self._lives.items():
            before = self._known.get(id)
            same = before is not None and before[0] is actor
            known[id] = before if before is not None and same else (actor, self._look_of(actor))
        self._known = known
        seen = sorted((id, look) for id, (_, look) in known.items() if look is not None)
        ids = np.array([id for id, _ in seen], np.uint32)
        looks = [look for _, look in seen]
        if looks != self._actors.looks or not np.array_equal(ids, self._actors.ids):
            self._actors = LookColumns(ids, looks)
        index, recorded = find(ids, batch.ids)
        standing, attached = np.full((len(ids), 6), np.nan), []
        for row in np.flatnonzero(~recorded).tolist():
            actor = batch.actors[int(ids[row])]
            if actor.attached:
                attached.append((row, actor.id))
            else:
                standing[row] = right_handed(actor.spawn_pose)
        self._places = _Places(np.where(recorded, index, -1), standing, attached)

    def _look_of(self, actor: ActorLife) -> Look | None:
        return UNKNOWN if actor.id in self._unspawned else look_of_present(actor, signs=self._signs)

    def _without_spawn(self, batch: SceneBatch) -> dict[int, ActorLife]:
        """Return the actors that have poses, but no spawn."""
        ids, time = sorted(set(batch.ids.tolist()).difference(batch.actors)), batch.time[0].item()
        return {id: self._unspawned.get(id) or ActorLife.of(Spawn(id), time) for id in ids}
