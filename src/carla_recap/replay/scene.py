"""A recording at a moment, and at the moments of consecutive frames."""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from carla_recap.replay.events import Collided, Destroyed, Event, Parented, Spawned
from carla_recap.replay.pose import attach
from carla_recap.replay.selection import index_in

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Frame
    from carla_recap.replay.state import ReplayState

E = TypeVar("E", bound=Event)

_MAX_PARENTS = 16


class SceneBatch:
    """The scenes of consecutive frames, as arrays: the same actors in each, and no events after the first.

    A scene between frames is a batch of one. Arrays are read-only. Numbers are CARLA's: cm, degrees, m/s, left-handed (x
    forward, y right, z up); `carla_recap.replay.pose` converts them to metres and right-handed axes.

    Attributes:
        time: The moments, in elapsed seconds, (scenes,).
        frames: The last frame at or before each moment, with the record types that a replay reads.
        fresh: Whether the first scene is the first one of all or after a seek: `events` then build up the state from
            nothing.
        following: The frame after the last scene; None at the end, while it is still being made, and where it is not known.
        events: The events since the previous scene, in order; all of them belong to the first scene. Those of a fresh one
            are the spawn of each present actor, its parents, and the collisions of the frame.
        ids: The actors that have a recorded pose, ascending; the same object as in the previous batch if they are the same.
            A vehicle or walker of which a frame has no pose is where it was last.
        poses: x, y, z in cm and roll, pitch, yaw in degrees of each of them, (scenes, ids, 6).
        actors: The present actors by id, in order of appearance. One without a recorded pose (lights, signs, and with
            CARLA 0.9.10 the props) is where it was spawned, or on its parent; see `pose_of`.
        light_states: The latest state of each traffic light, ascending by id, (scenes, lights): id, frozen, elapsed (s),
            state (0 red, 1 yellow, 2 green, 3 off, 4 unknown).
        doors: The open doors of each actor that has any: 0 front left, 1 front right, 2 rear left, 3 rear right,
            4 hood, 5 trunk.
        weather: The latest weather; None if none was recorded yet.
        scene_lights: The latest state of each lamp of the scene, ascending by id.
    """

    def __init__(
        self,
        state: ReplayState,
        time: NDArray[np.float64],
        frames: Batch,
        poses: NDArray[np.float64],
        light_states: NDArray[np.void],
        events: tuple[Event, ...] = (),
        *,
        fresh: bool = False,
        following: Frame | None = None,
    ) -> None:
        self.time = time
        self.frames = frames
        self.fresh = fresh
        self.following = following
        self.events = events
        self.ids = state.latest["transforms"].ids
        self.poses = poses
        self.light_states = light_states
        self.actors = state.actors
        self.doors = state.doors
        self.weather = state.weather
        self.scene_lights = state.scene_lights
        self._heights = state.heights
        self._hidden = state.hidden
        self._selections = state.selections
        self._records: dict[str, NDArray[np.void]] = {}

    def __len__(self) -> int:
        return len(self.time)

    def __iter__(self) -> Iterator[Scene]:
        return (Scene(self, row) for row in range(len(self)))

    def __getitem__(self, rows: slice) -> SceneBatch:
        """Return some consecutive scenes."""
        part, later = copy(self), rows.indices(len(self))[0] > 0
        part.time, part.frames = self.time[rows], self.frames[rows]
        part.poses, part.light_states = self.poses[rows], self.light_states[rows]
        part.fresh, part.events = self.fresh and not later, () if later else self.events
        stop = rows.indices(len(self))[1]
        part.following = self.following if stop == len(self) else self.frames.frame(stop)
        part._records = {}
        if "away" in vars(self):
            part.away = self.away[rows]
        return part

    @cached_property
    def away(self) -> NDArray[np.bool_]:
        """Whether an actor is so far from the height of the roads that it is not there, (scenes, ids)."""
        return self._heights.away(self.ids, self.poses)

    @cached_property
    def held(self) -> NDArray[np.bool_]:
        """Whether the frames have no pose of an actor, which is where it was last, (ids,)."""
        return np.asarray(~np.isin(self.ids, self.records("transforms")["id"][0]))

    def scene(self, row: int) -> Scene:
        """Return one of the scenes."""
        return Scene(self, row)

    def records(self, name: str) -> NDArray[np.void]:
        """Return the records of a type as in the frames, the last one of each id, ascending by id: (scenes, ids)."""
        if name not in self._records:
            records = self.frames.records(name)
            self._records[name] = records[:, self._selections[name].choose(records[0], self._hidden)]
        return self._records[name]

    def index_of(self, id: int) -> int | None:
        """Return the index of an actor in `ids`; None if it has no recorded pose."""
        return index_in(self.ids, id)

    def pose_of(self, id: int, row: int | None = None) -> NDArray[np.float64] | None:
        """Return the poses of an actor, recorded or not, (scenes, 6); None if they are unknown.

        Args:
            id: The actor.
            row: The position of the only scene to look at, whose pose is returned, (6,).
        """
        poses = self.poses if row is None else self.poses[row]
        relative: list[NDArray[np.float64]] = []
        for _ in range(_MAX_PARENTS):
            index, actor = self.index_of(id), self.actors.get(id)
            if index is not None:
                pose: NDArray[np.float64] = poses[..., index, :]
            elif actor is None:
                return None
            elif actor.attached and actor.parent is not None:
                relative.append(actor.spawn_pose)
                id = actor.parent
                continue
            else:
                pose = np.broadcast_to(actor.spawn_pose, (*poses.shape[:-2], 6))
            for upon in reversed(relative):
                pose = attach(pose, upon)
            return pose
        return None


class Scene:
    """A recording at a moment: one of a `SceneBatch`, whose attributes it has, as they are then.

    Args:
        batch: The batch.
        row: The position in it.

    Attributes:
        time: The moment, in elapsed seconds.
        fresh: Whether this is the first scene, or the first one after a seek.
        events: The events since the previous scene.
        ids: The actors that have a pose, ascending, (ids,).
        poses: x, y, z in cm and roll, pitch, yaw in degrees of each of the `ids`, (ids, 6).
        actors: The actors that exist, by id.
        light_states: The latest state of each traffic light, ascending by id.
        doors: The open doors of each vehicle.
        weather: The latest weather; None if none was recorded yet.
        scene_lights: The latest state of each street or house light, ascending by id.
    """

    def __init__(self, batch: SceneBatch, row: int = 0) -> None:
        self.batch = batch
        self.row = row
        self.time = float(batch.time[row])
        self.fresh = batch.fresh and not row
        self.events: tuple[Event, ...] = () if row else batch.events
        self.ids = batch.ids
        self.poses: NDArray[np.float64] = batch.poses[row]
        self.actors = batch.actors
        self.light_states: NDArray[np.void] = batch.light_states[row]
        self.doors = batch.doors
        self.weather = batch.weather
        self.scene_lights = batch.scene_lights

    @property
    def frame_id(self) -> int:
        """CARLA's number of the frame."""
        return self.frame.id

    @cached_property
    def frame(self) -> Frame:
        """The last frame at or before the moment, with the record types that a replay reads."""
        return self.batch.frames.frame(self.row)

    @property
    def vehicle_controls(self) -> NDArray[np.void]:
        """id, steer, throttle, brake, hand_brake, gear of each vehicle as in the frame; ascending by id."""
        return self._records("vehicle_controls")

    @property
    def walker_controls(self) -> NDArray[np.void]:
        """The id and speed (cm/s) of each walker as in the frame; ascending by id."""
        return self._records("walker_controls")

    @property
    def vehicle_lights(self) -> NDArray[np.void]:
        """The id and light flags of each vehicle as in the frame; ascending by id."""
        return self._records("vehicle_lights")

    @property
    def velocities(self) -> NDArray[np.void]:
        """id, x, y, z (m/s), angular_x, … (degrees/s) of each actor as in the frame, if recorded; ascending by id."""
        return self._records("velocities")

    @property
    def spawned(self) -> list[Spawned]:
        """The spawns among the events."""
        return self._events(Spawned)

    @property
    def destroyed(self) -> list[Destroyed]:
        """The destructions among the events."""
        return self._events(Destroyed)

    @property
    def parented(self) -> list[Parented]:
        """The attachments among the events."""
        return self._events(Parented)

    @property
    def collisions(self) -> list[Collided]:
        """The collisions among the events."""
        return self._events(Collided)

    def index_of(self, id: int) -> int | None:
        """Return the index of an actor in `ids` and `poses`; None if it has no recorded pose."""
        return self.batch.index_of(id)

    def pose_of(self, id: int) -> NDArray[np.float64] | None:
        """Return the pose of an actor, recorded or not: x, y, z in cm, roll, pitch, yaw in degrees; None if unknown."""
        return self.batch.pose_of(id, self.row)

    def _records(self, name: str) -> NDArray[np.void]:
        records: NDArray[np.void] = self.batch.records(name)[self.row]
        return records

    def _events(self, kind: type[E]) -> list[E]:
        return [event for event in self.events if isinstance(event, kind)]
