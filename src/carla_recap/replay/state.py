"""The state that the frames so far lead to: present actors, open doors, weather, lights."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.lives import ROAD_USERS, ActorLife, BoundingBox
from carla_recap.model.presence import RoadHeights
from carla_recap.replay.events import Collided, Destroyed, Event, Parented, Spawned
from carla_recap.replay.selection import NO_IDS, Selection, array, merged, numbers

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from numpy.typing import NDArray

    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Frame
    from carla_recap.model.records import Physics, Spawn, Table
    from carla_recap.util.arrays import Ids

ALL_DOORS: Final = 6
DOORS: Final = range(ALL_DOORS)


class LatestRecords:
    """The latest record of each actor, of one type.

    Attributes:
        records: The records, ascending by id.
        ids: Their ids; the same object until they change.
    """

    def __init__(self, dtype: np.dtype[np.void]) -> None:
        self.records: NDArray[np.void] = np.empty(0, dtype)
        self.ids = NO_IDS
        self._selection = Selection()

    def apply(self, new: NDArray[np.void], hidden: Ids, lasting: Ids) -> NDArray[np.void]:
        """Take the records of frames, (frames, records of each), and return the latest ones in each, (frames, ids).

        Args:
            new: The records, with the same ids in each frame.
            hidden: Ids to leave out; the same object until they change.
            lasting: The actors whose records hold beyond their frame.
        """
        found = new[:, self._selection.choose(new[0], hidden)]
        ids = self._selection.ids
        if ids is not self.ids:
            held = self.records[np.isin(self.ids, lasting) & ~np.isin(self.ids, ids)]
            if len(held):
                first = merged(held, found[0])
                latest = np.repeat(first[None], len(new), axis=0)
                latest[:, np.searchsorted(first["id"], ids)] = found
                found, ids = latest, _ids_of(first)
            if not len(held) or not np.array_equal(self.ids, ids):
                self.ids = ids
        self.records = found[-1]
        return found

    def recall(self, earlier: NDArray[np.void]) -> None:
        """Add records of earlier frames, or replace some by these."""
        self.records = merged(self.records, earlier)
        self.ids = _ids_of(self.records)

    def forget(self, id: int) -> None:
        """Forget the record of an actor."""
        if id in self.ids:
            self.records = self.records[self.ids != id]
            self.ids = _ids_of(self.records)


def _ids_of(records: NDArray[np.void]) -> Ids:
    ids = records["id"].astype(np.uint32)
    ids.setflags(write=False)
    return ids


class ReplayState:
    """The state after the frames that were applied; what it returns never changes afterwards.

    Attributes:
        weather: The latest weather; None before the first.
        scene_lights: The latest state of each lamp of the scene, ascending by id.
        latest: The latest transform of each actor and the latest state of each traffic light, by type; transforms of others
            than vehicles and walkers hold in their own frame only, as states of what was not spawned as a traffic light.
        lights: The present traffic lights, ascending.
        heights: Which of the present actors are far from the height of the roads.
        selections: The rows of each record type that count.
        hidden: The ids of ignored and destroyed actors, whose records do not count, ascending.
    """

    def __init__(self, table: Table, *, ignore_hero: bool, ignore_spectator: bool) -> None:
        self.weather: np.void | None = None
        self.scene_lights: NDArray[np.void] = np.empty(0, table.named("scene_lights").dtype)
        self.latest = {name: LatestRecords(table.named(name).dtype) for name in ("transforms", "light_states")}
        self.hidden: Ids = NO_IDS
        self._hidden: set[int] = set()
        self._ignore_hero = ignore_hero
        self._ignore_spectator = ignore_spectator
        self._actors: dict[int, ActorLife] = {}
        self._doors: dict[int, frozenset[int]] = {}
        self._shared = False  # whether the two above have been returned, and must not be changed any more
        self.lights = NO_IDS
        self.heights = RoadHeights()
        self._road_users = NO_IDS
        self.selections: defaultdict[str, Selection] = defaultdict(Selection)
        self._spawned: set[int] = set()  # in this frame
        self._events: list[Event] = []
        self._transforms: NDArray[np.void] = np.empty(0, table.named("transforms").dtype)  # of this frame
        self._actors_changed = False

    @property
    def actors(self) -> Mapping[int, ActorLife]:
        """The present actors by id, in order of appearance."""
        self._shared = True
        return MappingProxyType(self._actors)

    @property
    def doors(self) -> Mapping[int, frozenset[int]]:
        """The open doors of each actor that has any."""
        self._shared = True
        return MappingProxyType(self._doors)

    def apply(self, frame: Frame) -> list[Event]:
        """Apply a frame, and return its events."""
        self._events, self._transforms = [], array(frame["transforms"])
        self._spawned.clear()
        for packet in frame.packets:
            handler = _HANDLERS.get(packet.type.name) if packet.type else None
            if handler is not None and len(packet.records):
                handler(self, packet.records, frame.elapsed)
        if self._actors_changed:
            self._finish_actors()
        for name, latest in self.latest.items():
            latest.apply(frame[name][None], self.hidden, self.lasting(name))
        return self._events

    def apply_batch(self, batch: Batch) -> dict[str, NDArray[np.void]]:
        """Apply frames without events, each with the same ids.

        Returns:
            By type, the latest record of each actor, ascending by id, (frames, ids); see `latest`.

        Raises:
            FormatError: A packet contradicts its layout.
        """
        return {
            name: latest.apply(batch.records(name), self.hidden, self.lasting(name)) for name, latest in self.latest.items()
        }

    def lasting(self, name: str) -> Ids:
        """Return the actors whose records of a type hold beyond their frame, ascending."""
        return self.lights if name == "light_states" else self._road_users

    # --- handlers, one per record type -----------------------------------------------------------------------

    def _unshare(self) -> None:
        """Copy what has been returned, so that it can be changed."""
        if self._shared:
            self._actors, self._doors = dict(self._actors), dict(self._doors)
            self._shared = False

    def _spawn(self, spawns: Iterable[Spawn], elapsed: float) -> None:
        self._unshare()
        for spawn in spawns:
            self._forget(spawn.id)
            actor = ActorLife.of(spawn, elapsed)
            if (self._ignore_hero and actor.is_hero) or (self._ignore_spectator and actor.type_id == "spectator"):
                self._hidden.add(spawn.id)
                continue
            self._hidden.discard(spawn.id)
            self._actors[spawn.id] = actor
            self._spawned.add(spawn.id)
            self._events.append(Spawned(elapsed, actor))

    def _destroy(self, records: NDArray[np.void], elapsed: float) -> None:
        self._unshare()
        for id in records["id"].tolist():
            self._forget(id)
            if id not in self._hidden:
                self._hidden.add(id)
                self._events.append(Destroyed(elapsed, id))

    def _forget(self, id: int) -> None:
        self._actors_changed = True
        self._actors.pop(id, None)
        self._doors.pop(id, None)
        for latest in self.latest.values():
            latest.forget(id)

    def _parent(self, records: NDArray[np.void], elapsed: float) -> None:
        self._unshare()
        for id, parent in records.tolist():
            if id in self._hidden:
                continue
            if id in self._actors:
                self._actors[id] = replace(self._actors[id], parent=parent, attached=id in self._spawned)
            self._events.append(Parented(elapsed, id, parent))

    def _collide(self, records: NDArray[np.void], elapsed: float) -> None:
        for number, actor1, actor2, hero1, hero2 in records.tolist():
            self._events.append(Collided(elapsed, number, actor1, actor2, bool(hero1), bool(hero2)))

    def _move_doors(self, records: NDArray[np.void], elapsed: float) -> None:
        self._unshare()
        for id, door, is_open in records.tolist():
            if id in self._hidden:
                continue
            moved = frozenset(DOORS if door == ALL_DOORS else (door,))
            before = self._doors.get(id, frozenset())
            after = before | moved if is_open else before - moved
            if after:
                self._doors[id] = after
            else:
                self._doors.pop(id, None)

    def _box(self, records: NDArray[np.void], elapsed: float) -> None:
        self._unshare()
        for id, *sizes in records.tolist():
            if id in self._actors and (box := BoundingBox.of(sizes)) is not None:
                self._actors[id] = replace(self._actors[id], bounding_box=box)

    def _change_physics(self, records: Iterable[Physics], elapsed: float) -> None:
        self._unshare()
        for physics in records:
            if physics.id in self._actors:
                there = self._transforms[self._transforms["id"] == physics.id]
                pose = tuple(numbers(there)[0].tolist()) if len(there) else None
                self._actors[physics.id] = replace(self._actors[physics.id], physics=physics, physics_pose=pose)

    def _change_weather(self, records: NDArray[np.void], elapsed: float) -> None:
        self.weather = records[-1]

    def _change_scene_lights(self, records: NDArray[np.void], elapsed: float) -> None:
        self.scene_lights = merged(self.scene_lights, records)

    # --- at the end of a frame -------------------------------------------------------------------------------

    def _finish_actors(self) -> None:
        self._actors_changed = False
        if len(self._hidden) != len(self.hidden) or not self._hidden.issuperset(self.hidden.tolist()):
            self.hidden = np.array(sorted(self._hidden), np.uint32)
        lights = sorted(id for id, actor in self._actors.items() if actor.kind == "traffic_light")
        self.lights = np.array(lights, np.uint32)
        self._road_users = np.array(sorted(id for id, actor in self._actors.items() if actor.kind in ROAD_USERS), np.uint32)
        self.heights = RoadHeights(self.actors.values())
        for index, event in enumerate(self._events):
            if isinstance(event, Spawned):
                now = self._actors.get(event.actor.id)
                if now is not None and now.spawn is event.actor.spawn:
                    self._events[index] = Spawned(event.elapsed, now)


_HANDLERS: Final[dict[str, Callable[[ReplayState, Any, float], None]]] = {
    "spawned": ReplayState._spawn,
    "destroyed": ReplayState._destroy,
    "parented": ReplayState._parent,
    "collisions": ReplayState._collide,
    "doors": ReplayState._move_doors,
    "weather": ReplayState._change_weather,
    "bounding_boxes": ReplayState._box,
    "physics": ReplayState._change_physics,
    "scene_lights": ReplayState._change_scene_lights,
}

EVENTS: Final = tuple(_HANDLERS)
"""The record types that change the state now and then; all other ones are in each frame."""
