"""Collisions, as collision sensors tell of them: those that are there, and our own on heroes that have none."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Final

import carla

from carla_recap.capture.asking import UNANSWERED, UNREADABLE, parent_of
from carla_recap.capture.cast import OWN
from carla_recap.records import NO_ACTOR, ActorKind

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.capture.cast import Cast

    Tell = Callable[[int, int, int], None]

_SENSOR: Final = "sensor.other.collision"


class Contacts:
    """Listens to collision sensors. CARLA's recorder, too, knows of collisions by these alone.

    Args:
        world: The world.
        tell: Is told of each contact: the frame, and the ids of both actors; in a thread of CARLA's client.
        attach: Whether heroes that have no collision sensor get one until the end.
    """

    def __init__(self, world: carla.World, tell: Tell, *, attach: bool) -> None:
        self._world = world
        self._tell = tell
        self._attach = attach
        self._heard: dict[int, carla.Sensor] = {}
        self._own: dict[int, carla.Sensor] = {}  # by their hero

    def attend(self, cast: Cast) -> None:
        """Listen to those who are there now; the server is asked for new sensors."""
        sensors = cast.of(ActorKind.SENSOR)
        for id in self._heard.keys() - sensors.keys():
            del self._heard[id]
        for id, sensor in sensors.items():
            if id not in self._heard and sensor.type_id == _SENSOR:
                self._heard[id] = sensor
                self._listen(sensor)
        if self._attach:
            self._guard(cast)

    def close(self) -> None:
        """Stop listening, and take our own sensors away."""
        with suppress(*UNANSWERED):  # the server is gone, and with it all of them
            for sensor in self._heard.values():
                if sensor.is_alive and sensor.is_listening:
                    sensor.stop()
        self._heard.clear()
        for hero in list(self._own):
            self._release(hero)

    def _guard(self, cast: Cast) -> None:
        heroes = cast.heroes & cast.actors.keys()
        for hero in self._own.keys() - heroes:
            self._release(hero)
        watched = {parent.id for sensor in self._heard.values() if (parent := parent_of(sensor)) is not None}
        for hero in heroes - watched - self._own.keys():
            with suppress(*UNANSWERED):  # it is gone
                self._own[hero] = self._spawn(cast.actors[hero])

    def _spawn(self, hero: carla.Actor) -> carla.Sensor:
        blueprint = self._world.get_blueprint_library().find(_SENSOR)
        blueprint.set_attribute("role_name", OWN)
        sensor = self._world.spawn_actor(blueprint, carla.Transform(), attach_to=hero)
        self._listen(sensor)
        return sensor

    def _release(self, hero: int) -> None:
        sensor = self._own.pop(hero)
        with suppress(*UNANSWERED):  # it is gone already, with its hero or with the server
            sensor.stop()
            sensor.destroy()

    def _listen(self, sensor: carla.Sensor) -> None:
        tell = self._tell
        sensor.listen(lambda event: tell(event.frame, event.actor.id, _other(event)))


def _other(event: carla.CollisionEvent) -> int:
    try:
        return int(event.other_actor.id)
    except UNREADABLE:
        return NO_ACTOR
