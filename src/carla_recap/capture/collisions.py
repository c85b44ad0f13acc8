"""Collisions, as collision sensors report them: those of the world, and our own on heroes that have none."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Final

import carla

from carla_recap.capture.actors import OWN, UNANSWERED, UNREADABLE, parent_of
from carla_recap.model.records import NO_ACTOR, ActorKind

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.capture.actors import ActorTracker

    OnCollision = Callable[[int, int, int], None]

_SENSOR: Final = "sensor.other.collision"


class CollisionListener:
    """Listens to collision sensors. CARLA's recorder, too, knows collisions from these alone.

    The callback gets the frame and the ids of both actors of each collision, in a thread of CARLA's client. With `attach`,
    heroes without a collision sensor get one until the end.
    """

    def __init__(self, world: carla.World, callback: OnCollision, *, attach: bool) -> None:
        self._world = world
        self._callback = callback
        self._attach = attach
        self._others: dict[int, carla.Sensor] = {}
        self._own: dict[int, carla.Sensor] = {}  # by their hero

    def update(self, tracker: ActorTracker) -> None:
        """Listen to the sensors that are present now; own ones are spawned."""
        sensors = tracker.of(ActorKind.SENSOR)
        for id in self._others.keys() - sensors.keys():
            del self._others[id]
        for id, sensor in sensors.items():
            if id not in self._others and sensor.type_id == _SENSOR:
                self._others[id] = sensor
                self._listen(sensor)
        if self._attach:
            self._attach_own(tracker)

    def close(self, *, is_gone: bool = False) -> None:
        """Stop listening, and destroy own sensors, unless the server is gone, and with it all sensors."""
        if is_gone:
            return
        with suppress(*UNANSWERED):
            for sensor in self._others.values():
                if sensor.is_alive and sensor.is_listening:
                    sensor.stop()
        self._others.clear()
        for hero in list(self._own):
            self._destroy_own(hero)

    def _attach_own(self, tracker: ActorTracker) -> None:
        heroes = tracker.heroes & tracker.actors.keys()
        for hero in self._own.keys() - heroes:
            self._destroy_own(hero)
        with_sensor = {parent.id for sensor in self._others.values() if (parent := parent_of(sensor)) is not None}
        for hero in heroes - with_sensor - self._own.keys():
            with suppress(*UNANSWERED):  # the hero has been destroyed
                self._own[hero] = self._spawn(tracker.actors[hero])

    def _spawn(self, hero: carla.Actor) -> carla.Sensor:
        blueprint = self._world.get_blueprint_library().find(_SENSOR)
        blueprint.set_attribute("role_name", OWN)
        sensor = self._world.spawn_actor(blueprint, carla.Transform(), attach_to=hero)
        self._listen(sensor)
        return sensor

    def _destroy_own(self, hero: int) -> None:
        sensor = self._own.pop(hero)
        with suppress(*UNANSWERED):  # it has gone already, with its hero or with the server
            sensor.stop()
            sensor.destroy()

    def _listen(self, sensor: carla.Sensor) -> None:
        callback = self._callback
        sensor.listen(lambda event: callback(event.frame, event.actor.id, _other_id(event)))


def _other_id(event: carla.CollisionEvent) -> int:
    try:
        return int(event.other_actor.id)
    except UNREADABLE:
        return NO_ACTOR
