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
from carla_recap.model.records import NO_ACTOR
from carla_recap.sim.actors.lights import Sign, TrafficLight
from carla_recap.sim.actors.moving import MovingActor, Vehicle
from carla_recap.sim.episode import TickEvents, transforms
from carla_recap.sim.recording import packets
from carla_recap.sim.recording.snapshots import TYPES, ActorSet, SnapshotBatch, Timestamp

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import NDArray

    from carla_recap.sim.episode import Actor, Episode
    from carla_recap.sim.settings import Weather

    RecordsByType = dict[str, list[Any]]

LENGTH: Final = 50
"""The most snapshots of a batch: sending one has a cost, and what was not sent may be lost."""
SECONDS: Final = 5.0
"""The time after which a batch ends; the formats write that much of a recording to the disk at a time."""


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
        self._wide = wide
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
        batch = self._batch = self._current_batch(changed=bool(events.spawned or events.destroyed))
        batch.add(Timestamp(self.count, self.elapsed, self._episode.clock.elapsed, happened), self._columns())
        self.count += 1
        return batch

    def _current_batch(self, *, changed: bool) -> SnapshotBatch:
        """Return the latest batch, or a new one where it has ended, or the actors have changed."""
        batch = self._batch
        if changed:
            self._find_actors()
        if batch is not None and batch.timestamps[-1].elapsed >= self._batch_ends:
            self._batch_ends = batch.timestamps[-1].elapsed + SECONDS
            changed = True
        if batch is None or changed or batch.is_full:
            return SnapshotBatch(self._actors, self._columns(), LENGTH)
        return batch

    # --- what holds for each frame ------------------------------------------------------------------------------------

    def _find_actors(self) -> None:
        """Note the actors and the arrays that snapshots are taken of, as long as no actor comes or goes."""
        episode = self._episode
        actors = [actor for actor in episode.actors.values() if actor.kind in WITH_POSE]
        others = _OtherActors([actor for actor in actors if not isinstance(actor, MovingActor)])
        self._actors = ActorSet(
            with_pose=[actor.id for actor in actors],
            vehicles=episode.vehicles.id.tolist(),
            walkers=episode.walkers.id.tolist(),
            others=[actor.id for actor in others.actors],
            lights=episode.signals.id.tolist(),
            additional_data=self._additional,
            wide=self._wide,
        )
        owners = {"vehicles": episode.vehicles, "walkers": episode.walkers, "signals": episode.signals, "others": others}
        self._sources = [(owners[owner], name) for owner, name in self._actors.columns]

    def _columns(self) -> list[NDArray[Any]]:
        """Return the state of all actors; see `ActorSet.columns`."""
        return [getattr(owner, name) for owner, name in self._sources]

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

    def _packed(self, records: RecordsByType) -> dict[str, Packet]:
        types = TYPES[self._wide]
        return {
            name: Packet(types[name].id, types[name], records=types[name].records(rows))
            for name, rows in records.items()
            if rows and not types[name].opaque
        }

    def _joined(self, first: dict[str, Packet], then: dict[str, Packet]) -> dict[str, Packet]:
        """Join the packets of each type; those that only one side has stay as they are."""
        both = self._packed({name: [*first[name].records, *then[name].records] for name in first.keys() & then.keys()})
        return first | then | both


class _OtherActors:
    """Actors that are neither vehicles nor walkers, which have no arrays of their own."""

    def __init__(self, actors: list[Actor]) -> None:
        self.actors = actors

    @property
    def poses(self) -> NDArray[np.float64]:
        """Their poses, (n, 6)."""
        return np.array([pose(transform) for transform in transforms(self.actors)]).reshape(-1, 6)
