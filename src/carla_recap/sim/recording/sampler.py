"""Takes the frames of a recording out of a world, tick by tick: its actors, their poses and controls, and what happened.

The records, their times, their units and the order of the packets are those of CARLA's recorder. The differences:

- Actors that are attached when the recording begins are recorded with their parents, as are those that are attached later;
  CARLA omits these parents.
- Doors that stand open when the recording begins are recorded.
- Boxes are recorded of actors that have one; CARLA records boxes without size around sensors, too.
- The platform's clock is the simulated one, so that a recording depends on nothing but the seed and the steps.
- Wheels, bikers and bones are not recorded: their packets are present, and empty.
- In double precision, as of CARLA 0.10, no physics is recorded: the records there are memory images of the engine.
"""

from __future__ import annotations

from dataclasses import astuple, fields
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.frame import Packet
from carla_recap.model.packets import WITH_POSE, pose
from carla_recap.model.records import CM_PER_M, NO_ACTOR, UE4, UE5
from carla_recap.replay.selection import numbers
from carla_recap.sim.actors.lights import Sign, TrafficLight
from carla_recap.sim.actors.moving import MovingActor, Vehicle
from carla_recap.sim.episode import TickEvents, transforms
from carla_recap.sim.recording import packets
from carla_recap.sim.recording.packets import poses
from carla_recap.sim.recording.snapshots import SnapshotBatch, Timestamp

if TYPE_CHECKING:
    from collections.abc import Collection

    from carla_recap.sim.episode import Actor, Episode
    from carla_recap.sim.settings import Weather

    RecordsByType = dict[str, list[Any]]

LENGTH: Final = 50
"""The most snapshots of a batch: sending one has a cost, and what was not sent may be lost."""
SECONDS: Final = 5.0
"""The time after which a batch ends; the formats write that much of a recording to the disk at a time."""
_OF_VEHICLES: Final = ("steer", "throttle", "brake", "hand_brake", "gear")
_OF_LIGHTS: Final = ("frozen", "elapsed", "state")


class WorldSampler:
    """Samples an episode at the end of each tick; the actors that it contains at first are spawned in the first frame.

    With `wide`, records are in double precision, as of CARLA 0.10.

    Attributes:
        count: The number of snapshots.
        elapsed: The time from the first snapshot to the latest one, in s.
    """

    def __init__(self, episode: Episode, *, additional_data: bool, wide: bool = False) -> None:
        self._episode = episode
        self._additional = additional_data
        self._table = UE5 if wide else UE4
        self.count = 0
        self.elapsed = 0.0
        self._collisions = 0
        self._weather: Weather | None = None
        self._batch: SnapshotBatch | None = None
        self._batch_ends = 0.0
        self._find_actors()
        self._known: dict[str, int] | None = {
            field.name: len(getattr(episode.pending, field.name)) for field in fields(TickEvents)
        }
        self._replayed = list(episode.pending.collisions)
        actors = list(episode.actors.values())
        first = self._introduction(actors)
        first["parented"] = [(actor.id, actor.parent.id) for actor in actors if actor.parent is not None]
        first["doors"] = [(v.id, door, True) for v in episode.vehicles.actors for door in sorted(v.open_doors)]
        self._first = self._packed(first)
        for packet in self._first.values():
            _ = packet.payload  # data that no record can hold is an error now, and not in the first tick

    def sample_now(self) -> SnapshotBatch:
        """Take the first snapshot, of the world before its next tick; see `sample`."""
        return self._add(TickEvents(collisions=self._episode.pending.collisions), 0.0)

    def sample(self, delta: float) -> SnapshotBatch:
        """Take a snapshot of the world at the end of a tick of some s; the first one is at 0 s, however long its tick was.

        The batch that is returned contains it, and later ones may be added to that; the one before is complete.
        """
        return self._add(self._events(), delta)

    def _add(self, events: TickEvents, delta: float) -> SnapshotBatch:
        happened = self._packed(self._records(events))
        if self._batch is None:
            happened = self._joined(self._first, happened)
        else:
            self._batch.timestamps[-1].duration = delta
            self.elapsed += delta
        if events.spawned or events.destroyed:
            self._batch = None
            self._find_actors()
        self._update()
        batch = self._batch = self._current_batch()
        batch.add(Timestamp(self.count, self.elapsed, happened), self._rows)
        self.count += 1
        return batch

    def _current_batch(self) -> SnapshotBatch:
        """Return the latest batch, or a new one where it has ended."""
        batch = self._batch
        if batch is not None and batch.timestamps[-1].elapsed >= self._batch_ends:
            self._batch_ends = batch.timestamps[-1].elapsed + SECONDS
            batch = None
        if batch is None or batch.is_full:
            return SnapshotBatch(self._rows, LENGTH, additional_data=self._additional, wide=self._table.wide)
        return batch

    # --- what holds for each frame ------------------------------------------------------------------------------------

    def _find_actors(self) -> None:
        """Make the records that each frame has, as long as no actor comes or goes, without what changes."""
        episode = self._episode
        vehicles, walkers = episode.vehicles.id.tolist(), episode.walkers.id.tolist()
        actors = [actor for actor in episode.actors.values() if actor.kind in WITH_POSE]
        self._others = [actor for actor in actors if not isinstance(actor, MovingActor)]
        index = {actor.id: number for number, actor in enumerate(actors)}
        self._at = [index[id] for id in (*vehicles, *walkers, *(actor.id for actor in self._others))]
        ids = {
            "transforms": list(index),
            "light_states": episode.signals.id.tolist(),
            "vehicle_controls": vehicles,
            "walker_controls": walkers,
            "vehicle_lights": vehicles,
            "velocities": [*vehicles, *walkers] if self._additional else [],
        }
        self._named = {name: np.zeros(len(of), self._table.named(name).dtype) for name, of in ids.items() if of}
        for name, rows in self._named.items():
            rows["id"] = ids[name]
        for clock in ("visual_time", "platform_time") if self._additional else ("visual_time",):
            self._named[clock] = np.zeros(1, self._table.named(clock).dtype)
        self._rows = {self._table.named(name).id: rows for name, rows in self._named.items()}

    def _update(self) -> None:
        """Set what changes in the records that each frame has."""
        episode, rows = self._episode, self._named
        vehicles, walkers, signals = episode.vehicles, episode.walkers, episode.signals
        others = np.array([pose(transform) for transform in transforms(self._others)]).reshape(-1, 6)
        numbers(rows["transforms"])[self._at] = np.concatenate((poses(vehicles), poses(walkers), others))
        if "velocities" in rows:
            both = [np.hstack((movers.velocity, movers.angular_velocity)) for movers in (vehicles, walkers)]
            numbers(rows["velocities"])[:] = np.concatenate(both)
        for name, owner, columns in (("vehicle_controls", vehicles, _OF_VEHICLES), ("light_states", signals, _OF_LIGHTS)):
            for column in columns if name in rows else ():
                rows[name][column] = getattr(owner, column)
        if "vehicle_lights" in rows:
            rows["vehicle_lights"]["flags"] = vehicles.light_state
        if "walker_controls" in rows:
            rows["walker_controls"]["speed"] = walkers.speed
            rows["walker_controls"]["speed"] *= CM_PER_M
        rows["visual_time"]["seconds"] = episode.clock.elapsed
        if "platform_time" in rows:
            rows["platform_time"]["seconds"] = self.elapsed

    # --- what has happened --------------------------------------------------------------------------------------------

    def _events(self) -> TickEvents:
        """Return what happened in the tick; in the first one, what happened since the beginning of the recording."""
        events, known = self._episode.events, self._known
        self._known = None
        if known is None:
            return events
        later = TickEvents(**{name: getattr(events, name)[count:] for name, count in known.items()})
        # Those of physics stand before those of a replay.
        later.collisions = [each for each in events.collisions if all(each is not other for other in self._replayed)]
        return later

    def _records(self, events: TickEvents) -> RecordsByType:
        records = self._introduction(events.spawned) if events.spawned else {}
        records |= {
            "destroyed": events.destroyed,
            "parented": events.parented,
            "collisions": self._collision_records(events),
            "doors": events.doors,
            "weather": self._changed_weather(),
        }
        if self._additional and (events.physics or events.light_times):
            vehicles = [actor for actor in events.physics if isinstance(actor, Vehicle) and actor.is_alive]
            lights = [actor for actor in events.light_times if isinstance(actor, TrafficLight)]
            records["physics"] = [*records.get("physics", []), *map(packets.physics, vehicles)]
            records["light_times"] = list(map(packets.light_times, lights))
        return records

    def _introduction(self, actors: Collection[Actor]) -> RecordsByType:
        """Return the records of actors that appear."""
        records: RecordsByType = {"spawned": [packets.spawn(actor) for actor in actors]}
        if self._additional:
            town = self._episode.town
            signs = [actor for actor in actors if isinstance(actor, Sign)]
            records["bounding_boxes"] = [packets.bounding_box(actor) for actor in actors if actor.box.extent.length() > 0]
            records["trigger_volumes"] = [row for sign in signs for row in packets.trigger_volumes(sign, town)]
            records["physics"] = [packets.physics(actor) for actor in actors if isinstance(actor, Vehicle)]
            records["light_times"] = [packets.light_times(sign) for sign in signs if isinstance(sign, TrafficLight)]
        return records

    def _collision_records(self, events: TickEvents) -> list[tuple[int, int, int, bool, bool]]:
        """Return each pair once, numbered from 0 in each recording; repetitions use up a number, too, as in CARLA."""
        rows: dict[tuple[int, int], tuple[int, int, int, bool, bool]] = {}
        for collision in events.collisions:
            pair = collision.actor1, NO_ACTOR if collision.actor2 is None else collision.actor2
            rows.setdefault(pair, (self._collisions, *pair, collision.hero1, collision.hero2))
            self._collisions += 1
        return list(rows.values())

    def _changed_weather(self) -> list[tuple[float, ...]]:
        weather = self._episode.weather
        if weather == self._weather:
            return []
        self._weather = weather
        return [astuple(weather)]

    # --- packets ------------------------------------------------------------------------------------------------------

    def _packed(self, records: RecordsByType) -> dict[int, Packet]:
        types = {self._table.named(name): rows for name, rows in records.items() if rows}
        return {
            type.id: Packet(type.id, type, records=type.records(rows)) for type, rows in types.items() if not type.opaque
        }

    def _joined(self, first: dict[int, Packet], then: dict[int, Packet]) -> dict[int, Packet]:
        """Join the packets of each type; those that only one side has stay as they are."""
        names = {self._table[id].name: (*first[id].records, *then[id].records) for id in first.keys() & then.keys()}
        return first | then | self._packed({name: [*records] for name, records in names.items()})
