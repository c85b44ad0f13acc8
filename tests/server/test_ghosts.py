"""What is kept of actors that have been destroyed."""

from __future__ import annotations

import gc
import weakref
from typing import TYPE_CHECKING

import pytest

from carla_recap.server import actor_records, ghosts
from carla_recap.server.ackermann import AckermannSettings
from carla_recap.server.ghosts import Ghost
from carla_recap.server.host import Host
from carla_recap.sim.actors.actors import Vehicle
from carla_recap.sim.errors import DeadActor
from tests.sim.flat import at, flat_world

if TYPE_CHECKING:
    from carla_recap.sim.actors.actors import Actor


def spawned(host: Host, x: float = 0.0, role_name: str = "autopilot") -> Actor:
    actor = host.world.spawn("vehicle.audi.tt", at(x), role_name=role_name)
    host.remember(actor)
    return actor


def test_a_ghost_is_told_of_as_its_actor_was() -> None:
    host = Host(flat_world())
    car = spawned(host, role_name="hero")
    before = actor_records.record(car, host.streams)
    place = car.transform.location
    car.destroy()
    host.tick()
    ghost = host.actor_or_ghost(car.id)
    assert isinstance(ghost, Ghost)
    assert actor_records.record(ghost, host.streams) == before
    assert ghost.transform.location.distance(place) == 0
    with pytest.raises(DeadActor, match=r"vehicle\.audi\.tt"):
        host.actor(car.id)


def test_nothing_holds_an_actor_that_is_no_more() -> None:
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
    assert host.actor_or_ghost(id).type_id == "vehicle.audi.tt"


def test_the_actors_of_an_episode_that_is_over_are_ghosts() -> None:
    host = Host(flat_world())
    id = spawned(host).id
    host.world.reload()
    host.notice(0)
    assert isinstance(host.actor_or_ghost(id), Ghost)


def test_the_latest_ones_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ghosts, "_MOST", 2)
    host = Host(flat_world())
    ids = [spawned(host, 10.0 * number).id for number in range(3)]
    for id in ids:
        host.world.actors[id].destroy()
    host.tick()
    assert [host.actor_or_ghost(id).id for id in ids[1:]] == ids[1:]
    with pytest.raises(Exception, match=f"actor {ids[0]} not found"):
        host.actor_or_ghost(ids[0])
