"""The cache of destroyed actors."""

from __future__ import annotations

import gc
import weakref
from typing import TYPE_CHECKING

import pytest

from carla_recap.server import actor_records
from carla_recap.server.actor_records import DestroyedActor
from carla_recap.server.controllers import AckermannSettings
from carla_recap.server.host import Host
from carla_recap.server.protocol import DEFAULT
from carla_recap.sim.actors.moving import Vehicle
from carla_recap.sim.errors import DeadActor
from tests.sim.flat import at, flat_world

if TYPE_CHECKING:
    from carla_recap.sim.episode import Actor


def spawned(host: Host, x: float = 0.0, role_name: str = "autopilot") -> Actor:
    actor = host.world.spawn("vehicle.audi.tt", at(x), role_name=role_name)
    host.remember(actor)
    return actor


def test_the_record_of_a_destroyed_actor_stays_as_it_was() -> None:
    host = Host(flat_world())
    car = spawned(host, role_name="hero")
    before = actor_records.record(car, host.streams, DEFAULT)
    place = car.transform.location
    car.destroy()
    host.tick()
    destroyed = host.known_actor(car.id)
    assert isinstance(destroyed, DestroyedActor)
    assert actor_records.record(destroyed, host.streams, DEFAULT) == before
    assert destroyed.transform.location.distance(place) == 0
    with pytest.raises(DeadActor, match=r"vehicle\.audi\.tt"):
        host.actor(car.id)


def test_a_destroyed_actor_is_released() -> None:
    host = Host(flat_world())
    car = spawned(host)
    assert isinstance(car, Vehicle)
    host.ackermann.set_settings(car, AckermannSettings())
    gone, id = weakref.ref(car), car.id
    car.destroy()
    del car
    host.tick()
    host.tick()
    gc.collect()
    assert gone() is None
    assert host.known_actor(id).type_id == "vehicle.audi.tt"


def test_the_actors_of_the_last_episode_are_destroyed() -> None:
    host = Host(flat_world())
    id = spawned(host).id
    host.world.reload()
    host.check_episode(0)
    assert isinstance(host.known_actor(id), DestroyedActor)


def test_the_latest_destroyed_actors_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(actor_records, "_MOST_DESTROYED", 2)
    host = Host(flat_world())
    ids = [spawned(host, 10.0 * number).id for number in range(3)]
    for id in ids:
        host.world.actors[id].destroy()
    host.tick()
    assert [host.known_actor(id).id for id in ids[1:]] == ids[1:]
    with pytest.raises(Exception, match=f"actor {ids[0]} not found"):
        host.known_actor(ids[0])
