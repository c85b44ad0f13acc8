"""The state that the frames so far lead to: present actors, open doors, weather, lights."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.lives import ActorLife, BoundingBox
from carla_recap.model.presence import RoadHeights
from carla_recap.replay.events import Collided, Destroyed, Event, Parented, Spawned
from carla_recap.replay.selection import NO_IDS, Selection, merged

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from numpy.typing import NDArray

    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Frame
    from carla_recap.model.records import Physics, Spawn, Table
    from carla_recap.util.arrays import Ids

ALL_DOORS: Final = 6
DOORS: Final = range(ALL_DOORS)


class ReplayState:
    """The state after the frames that were applied; what it returns never changes afterwards.

    Args:
        table: The record types of the recording.
        ignore_hero: Leave the hero out.
        ignore_spectator: Leave the spectator out.

    Attributes:
        weather: The latest weather; None before the first.
        scene_lights: The latest state of each lamp of the scene, ascending by id.
        light_states: The latest state of each traffic light, ascending by id; that of an actor that was not spawned as a
            traffic light holds in its own frame only.
        lights: The present traffic lights, ascending.
        heights: Which of the present actors are far from the height of the roads.
        selections: The rows of each record type that count.
        hidden: The ids of ignored and destroyed actors, whose records do not count, ascending.
    """

    def __init__(self, table: Table, *, ignore_hero: bool, ignore_spectator: bool) -> None:
        self.weather: np.void | None = None
        self.scene_lights: NDArray[np.void] = np.empty(0, table.named("scene_lights").dtype)
        self.light_states: NDArray[np.void] = np.empty(0, table.named("light_states").dtype)
        self.hidden: Ids = NO_IDS
        self._hidden: set[int] = set()
        self._ignore_hero = ignore_hero
        self._ignore_spectator = ignore_spectator
        self._actors: dict[int, ActorLife] = {}
        self._doors: dict[int, frozenset[int]] = {}
        self._shared = False  # whether the two above have been returned, and must not be changed any more
        self.lights = NO_IDS
        self.heights = RoadHeights()
        self._stray_lights = False  # whether `light_states` has an actor that is no traffic light
        self._selection = Selection()
        self.selections: defaultdict[str, Selection] = defaultdict(Selection)
        self._spawned: set[int] = set()  # in this frame
        self._events: list[Event] = []
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
        self._events = []
        self._spawned.clear()
        for packet in frame.packets:
            handler = _HANDLERS.get(packet.type.name) if packet.type else None
            if handler is not None and len(packet.records):
                handler(self, packet.records, frame.elapsed)
        if self._actors_changed:
            self._finish_actors()
        self._apply_light_states(frame["light_states"][None])
        return self._events

    def apply_batch(self, batch: Batch) -> NDArray[np.void]:
        """Apply frames without events, each with the same ids.

        Returns:
            The latest state of each traffic light, ascending by id, (frames, lights).

        Raises:
            FormatError: A packet contradicts its layout.
        """
        return self._apply_light_states(batch.records("light_states"))

    def recall_lights(self, states: NDArray[np.void]) -> None:
        """Add light states of earlier frames."""
        self.light_states = merged(self.light_states, states)

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
        if id in self.light_states["id"]:
            self.light_states = self.light_states[self.light_states["id"] != id]

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
                self._actors[physics.id] = replace(self._actors[physics.id], physics=physics)

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
        self._stray_lights = len(self.light_states) > 0
        self.heights = RoadHeights(self.actors.values())
        for index, event in enumerate(self._events):
            if isinstance(event, Spawned):
                now = self._actors.get(event.actor.id)
                if now is not None and now.spawn is event.actor.spawn:
                    self._events[index] = Spawned(event.elapsed, now)

    def _apply_light_states(self, records: NDArray[np.void]) -> NDArray[np.void]:
        """Keep the states of frames with the same ids in each, and return the latest ones in each of them."""
        count = len(records)
        if not records.shape[1]:
            if self._stray_lights:
                self.light_states = self._traffic_light_states()
                self._stray_lights = False
            return np.broadcast_to(self.light_states, (count, len(self.light_states)))
        before = self._selection.ids
        states = records[:, self._selection.choose(records[0], self.hidden)]
        kept = self._selection.ids is before and states.shape[1] == len(self.light_states)
        if not kept or self._stray_lights:
            first = merged(self._traffic_light_states(), states[0])
            latest = np.repeat(first[None], count, axis=0)
            latest[:, np.searchsorted(first["id"], self._selection.ids)] = states
            states = latest
            self._stray_lights = not bool(np.isin(first["id"], self.lights).all())
        self.light_states = states[-1]
        return states

    def _traffic_light_states(self) -> NDArray[np.void]:
        """Return the light states that hold beyond their frame: those of traffic lights."""
        return self.light_states[np.isin(self.light_states["id"], self.lights)]


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
