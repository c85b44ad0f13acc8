"""A recording at a moment."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, TypeVar

from carla_recap.replay.events import Collided, Destroyed, Event, Parented, Present, Spawned
from carla_recap.replay.pose import attach
from carla_recap.replay.rows import Ids, Selection, array

if TYPE_CHECKING:
    from collections import defaultdict
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from carla_recap.model.frame import Frame

E = TypeVar("E", bound=Event)

_PARENTS = 16  # so many actors can be attached one to the next


@dataclass(eq=False)
class Scene:
    """A recording at a moment; does not change any more. Arrays are not to be written to.

    Numbers are CARLA's: cm, degrees, m/s, left-handed (x forward, y right, z up); see `carla_recap.replay.pose` for the way
    to metres and right-handed axes.

    Attributes:
        time: The moment, in elapsed seconds.
        frame: The last frame at or before it, with the record types that a replay reads.
        fresh: Whether this is the first scene, or the first one after a leap: `events` then make the world out of nothing.
        events: What happened since the previous scene, in order. Of a fresh one: the spawn of each actor that is there,
            its parents, and the collisions of `frame`.
        ids: The actors that have a recorded pose, ascending.
        poses: Of each of them x, y, z in cm and roll, pitch, yaw in degrees.
        actors: The actors that are there, by id, in order of appearance. One without a recorded pose (lights, signs, and
            with CARLA 0.9.10 the props) is where it was spawned, or on its parent; see `pose_of`.
        light_states: Of each traffic light the latest id, frozen, elapsed (s), state (0 red, 1 yellow, 2 green, 3 off,
            4 unknown); ascending by id.
        doors: The open doors of each actor that has any: 0 front left, 1 front right, 2 rear left, 3 rear right,
            4 hood, 5 trunk.
        weather: The latest weather; None if none was recorded yet.
        scene_lights: The latest state of each lamp of the scene, ascending by id.
    """

    time: float
    frame: Frame
    fresh: bool
    events: tuple[Event, ...]
    ids: Ids
    poses: NDArray[np.float64]
    actors: Mapping[int, Present]
    light_states: NDArray[np.void]
    doors: Mapping[int, frozenset[int]]
    weather: np.void | None
    scene_lights: NDArray[np.void]
    hidden: Ids = field(repr=False)
    selections: defaultdict[str, Selection] = field(repr=False)

    @property
    def frame_id(self) -> int:
        """CARLA's number of the frame."""
        return self.frame.id

    @cached_property
    def vehicle_controls(self) -> NDArray[np.void]:
        """Of each vehicle id, steer, throttle, brake, hand_brake, gear as in the frame; ascending by id."""
        return self._rows("vehicle_controls")

    @cached_property
    def walker_controls(self) -> NDArray[np.void]:
        """Of each walker id and speed (cm/s) as in the frame; ascending by id."""
        return self._rows("walker_controls")

    @cached_property
    def vehicle_lights(self) -> NDArray[np.void]:
        """Of each vehicle id and flags of its lights as in the frame; ascending by id."""
        return self._rows("vehicle_lights")

    @cached_property
    def velocities(self) -> NDArray[np.void]:
        """Of each actor id, x, y, z (m/s), angular_x, … (degrees/s) as in the frame, where recorded; ascending by id."""
        return self._rows("velocities")

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

    def place_of(self, id: int) -> int | None:
        """The row of an actor in `poses`; None where it has none."""
        place = int(self.ids.searchsorted(id))
        return place if place < len(self.ids) and self.ids[place] == id else None

    def pose_of(self, id: int) -> NDArray[np.float64] | None:
        """Where an actor is, recorded or not: x, y, z in cm, roll, pitch, yaw in degrees; None where nothing tells."""
        relative: list[NDArray[np.float64]] = []
        for _ in range(_PARENTS):
            place, actor = self.place_of(id), self.actors.get(id)
            if place is not None:
                pose: NDArray[np.float64] = self.poses[place]
            elif actor is None:
                return None
            elif actor.attached and actor.parent is not None:
                relative.append(actor.spawn_pose)
                id = actor.parent
                continue
            else:
                pose = actor.spawn_pose
            for upon in reversed(relative):
                pose = attach(pose, upon)
            return pose
        return None

    def _events(self, kind: type[E]) -> list[E]:
        return [event for event in self.events if isinstance(event, kind)]

    def _rows(self, name: str) -> NDArray[np.void]:
        return self.selections[name].take(array(self.frame[name]), self.hidden)
