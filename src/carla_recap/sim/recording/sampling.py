"""Takes the frames of a recording out of a world: who came and went, where everybody is, and what they do.

What is told, and how often, is what CARLA's recorder tells; so are the order of the packets and the units. Besides:

- Actors that are attached when the recording begins are told with their parents, as those are that are attached later;
  CARLA forgets these parents.
- Doors that stand open when the recording begins are told.
- Boxes are told of actors that have one; CARLA tells of boxes without size around sensors, too.
- The platform's clock is the simulated one, so that a recording depends on nothing but the seed and the steps.
- Wheels, bikers and bones are told of nobody: their packets are there, and empty.
"""

from __future__ import annotations

from dataclasses import astuple, fields
from typing import TYPE_CHECKING, Any, Final

from carla_recap.frame import Packet
from carla_recap.records import NO_ACTOR
from carla_recap.sim.actors.actors import Sign, TrafficLight, Vehicle
from carla_recap.sim.actors.registry import TickEvents
from carla_recap.sim.recording import describing
from carla_recap.sim.recording.roster import Roster
from carla_recap.sim.recording.snapshots import TYPES, Moment

if TYPE_CHECKING:
    from collections.abc import Collection

    from carla_recap.sim.actors.actors import Actor
    from carla_recap.sim.interfaces import RecordedWorld
    from carla_recap.sim.recording.snapshots import Strip
    from carla_recap.sim.weather import Weather

    Told = dict[str, list[Any]]  # records by type

LENGTH: Final = 50
"""So many snapshots go together at the most: each handing over costs, and what was not handed over may be lost."""
SECONDS: Final = 5.0
"""The formats put so much of a recording on the disk at a time; no strip goes on beyond that."""


class Sampler:
    """Sees a world from tick to tick.

    Args:
        world: The world; whoever is in it by now is told as spawned in the first frame.
        additional_data: Tell of velocities, boxes, physics, and the times of lights, too.

    Raises:
        RecapError: An actor cannot be told of.
    """

    def __init__(self, world: RecordedWorld, *, additional_data: bool) -> None:
        self._world = world
        self._additional = additional_data
        self._count = 0
        self._elapsed = 0.0
        self._collisions = 0
        self._weather: Weather | None = None
        self._roster = Roster(world, additional_data=additional_data)
        self._strip: Strip | None = None
        self._ends = 0.0
        self._known = {field.name: len(getattr(world.pending, field.name)) for field in fields(TickEvents)}
        actors = list(world.actors.values())
        first = self._introduce(actors)
        first["parented"] = [(actor.id, actor.parent.id) for actor in actors if actor.parent is not None]
        first["doors"] = [(v.id, door, True) for v in world.vehicles.actors for door in sorted(v.open_doors)]
        self._introduction = _packets(first)
        for packet in self._introduction.values():
            _ = packet.payload  # who cannot be told of is to be known now

    def snapshot(self, delta: float) -> Strip:
        """Take in the world at the end of a tick.

        Args:
            delta: How long the tick was, in s. The first snapshot stands at 0 s, whatever its tick took.

        Returns:
            The strip that the snapshot is on, and that later ones may be added to; the one before is complete.
        """
        events = self._events()
        told = _packets(self._told(events))
        if self._strip is None:
            told = _joined(self._introduction, told)
        else:
            self._strip.moments[-1].duration = delta
            self._elapsed += delta
        strip = self._strip = self._next_strip(changed=bool(events.spawned or events.destroyed))
        self._roster.take(strip, Moment(self._count, self._elapsed, self._world.elapsed, told))
        self._count += 1
        return strip

    def _next_strip(self, *, changed: bool) -> Strip:
        """The present strip, or another one where it is at its end, or other actors are there."""
        strip = self._strip
        if changed:
            self._roster = Roster(self._world, additional_data=self._additional)
        if strip is not None and strip.moments[-1].elapsed >= self._ends:
            self._ends = strip.moments[-1].elapsed + SECONDS
            changed = True
        return self._roster.strip(LENGTH) if strip is None or changed or strip.is_full else strip

    def _events(self) -> TickEvents:
        """What happened since the snapshot before; since the beginning of the recording, for the first."""
        if self._count:
            return self._world.events
        return TickEvents(**{name: getattr(self._world.events, name)[known:] for name, known in self._known.items()})

    def _told(self, events: TickEvents) -> Told:
        told = self._introduce(events.spawned) if events.spawned else {}
        told |= {
            "destroyed": events.destroyed,
            "parented": events.parented,
            "collisions": self._collided(events),
            "doors": events.doors,
            "weather": self._changed_weather(),
        }
        if self._additional and (events.physics or events.light_times):
            vehicles = [vehicle for vehicle in events.physics if vehicle.is_alive]
            told["physics"] = [*told.get("physics", []), *map(describing.physics, vehicles)]
            told["light_times"] = list(map(describing.light_times, events.light_times))
        return told

    def _introduce(self, actors: Collection[Actor]) -> Told:
        """What is told once of actors, when they come."""
        told: Told = {"spawned": [describing.spawn(actor) for actor in actors]}
        if self._additional:
            signs = [actor for actor in actors if isinstance(actor, Sign)]
            told["bounding_boxes"] = [describing.box(actor) for actor in actors if actor.box.extent.length() > 0]
            told["trigger_volumes"] = [row for sign in signs for row in describing.trigger_volumes(sign)]
            told["physics"] = [describing.physics(actor) for actor in actors if isinstance(actor, Vehicle)]
            told["light_times"] = [describing.light_times(sign) for sign in signs if isinstance(sign, TrafficLight)]
        return told

    def _collided(self, events: TickEvents) -> list[tuple[int, int, int, bool, bool]]:
        """Each pair once, numbered from 0 in each recording; repetitions use up a number, too, as with CARLA."""
        rows: dict[tuple[int, int], tuple[int, int, int, bool, bool]] = {}
        for collision in events.collisions:
            pair = collision.actor1, NO_ACTOR if collision.actor2 is None else collision.actor2
            rows.setdefault(pair, (self._collisions, *pair, collision.hero1, collision.hero2))
            self._collisions += 1
        return list(rows.values())

    def _changed_weather(self) -> list[tuple[float, ...]]:
        weather = self._world.weather
        if weather == self._weather:
            return []
        self._weather = weather
        return [astuple(weather)]


def _packets(told: Told) -> dict[str, Packet]:
    return {
        name: Packet(TYPES[name].id, TYPES[name], records=TYPES[name].records(rows)) for name, rows in told.items() if rows
    }


def _joined(first: dict[str, Packet], then: dict[str, Packet]) -> dict[str, Packet]:
    """Packets of each type as one; those of one side alone stay what they are."""
    both = _packets({name: [*first[name].records, *then[name].records] for name in first.keys() & then.keys()})
    return first | then | both
