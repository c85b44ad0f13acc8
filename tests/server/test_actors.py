"""Calls about actors: spawning, attributes, records, transforms and forces; and those that are destroyed."""

from __future__ import annotations

import asyncio
import gc
import math
import re
import weakref
from typing import TYPE_CHECKING, Any

import carla
import msgpack
import pytest

from carla_recap.errors import RecapError
from carla_recap.server import actor_records
from carla_recap.server import host as served
from carla_recap.server.actor_records import DestroyedActor, check_attributes
from carla_recap.server.controllers import AckermannSettings
from carla_recap.server.host import Host
from carla_recap.server.protocol import DEFAULT
from carla_recap.sim.actors.moving import Vehicle
from carla_recap.sim.blueprints import standard_library
from carla_recap.sim.errors import DeadActor
from carla_recap.sim.town.loading import load_town
from carla_recap.sim.world import World
from tests.server.client import FAR, spawn, ticks
from tests.server.inside import Inside, connected
from tests.sim.flat import at, flat_world

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from carla_recap.sim.episode import Actor


def test_all_blueprints_can_be_spawned_and_their_attributes_read_back(client: carla.Client, world: carla.World) -> None:
    blueprints = list(world.get_blueprint_library())
    spots = [
        carla.Transform(carla.Location(1000.0 + 30 * (i % 15), 1000.0 + 30 * (i // 15), 1.0)) for i in range(len(blueprints))
    ]
    commands = [carla.command.SpawnActor(*pair) for pair in zip(blueprints, spots, strict=True)]
    answers = client.apply_batch_sync(commands, True)
    assert [answer.error for answer in answers if answer.has_error()] == []
    actors = {actor.id: actor for actor in world.get_actors([answer.actor_id for answer in answers])}
    assert len(actors) == len(blueprints) == 214
    for blueprint, answer in zip(blueprints, answers, strict=True):
        actor = actors[answer.actor_id]
        assert actor.type_id == blueprint.id
        assert actor.attributes.keys() == {attribute.id for attribute in blueprint}
        for attribute in blueprint:
            if attribute.is_modifiable:
                assert actor.attributes[attribute.id] == attribute.recommended_values[0], (blueprint.id, attribute.id)
    client.apply_batch_sync([carla.command.DestroyActor(id) for id in actors], True)


def test_an_actor_that_is_destroyed_before_a_tick_is_known(inside: Inside) -> None:
    id = inside.call("spawn_actor", [0, "vehicle.audi.tt", []], [[500.0, 0.0, 0.0], [0.0, 0.0, 0.0]])[0]
    assert inside.call("destroy_actor", id) is True
    assert inside.call("destroy_actor", id) is False
    assert inside.call("get_actor_bounding_box", id)[3] == id
    inside.call("set_actor_simulate_physics", id, False)
    inside.call("set_actor_collisions", id, False)
    with pytest.raises(RecapError, match=rf"actor {id} \(vehicle.audi.tt\) has been destroyed"):
        inside.call("set_actor_transform", id, [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    with pytest.raises(RecapError, match="actor 99999 not found"):
        inside.call("get_actor_bounding_box", 99999)


def test_a_constant_velocity_is_kept_in_the_axes_of_the_vehicle(world: carla.World) -> None:
    car = spawn(world, at=carla.Transform(FAR.location, carla.Rotation(yaw=90.0)))
    car.enable_constant_velocity(carla.Vector3D(10.0, 0.0, 0.0))
    ticks(world, 20)
    assert (car.get_velocity().x, car.get_velocity().y) == pytest.approx((0.0, 10.0), abs=1e-4)
    assert car.get_location().y == pytest.approx(510.0, abs=0.05)
    car.disable_constant_velocity()
    ticks(world, 20)
    assert 5.0 < car.get_velocity().y < 9.95


def test_impulses_and_forces_push_and_turn(inside: Inside, parked: Vehicle) -> None:
    rows, mass, ahead = inside.world.vehicles, parked.physics_control.mass, parked.transform.forward()
    for name, push, speed in (("add_actor_impulse", 5.0, 5.0), ("add_actor_force", 40.0, 7.0)):
        inside.call(name, parked.id, [push * mass * ahead.x, push * mass * ahead.y, 0.0])
        assert rows.speed[rows.row(parked.id)] == pytest.approx(speed)
    moment, at = rows.moment[rows.row(parked.id)].item(), parked.transform.location
    inside.call("add_actor_impulse_at_location", parked.id, [0.0, moment, 0.0], [at.x + 0.5, at.y, at.z])
    assert rows.turning[rows.row(parked.id)] == pytest.approx(0.5)
    inside.call("add_actor_angular_impulse", parked.id, [0.0, 0.0, math.degrees(moment)])
    assert rows.turning[rows.row(parked.id)] == pytest.approx(1.5)
    inside.call("add_actor_torque", parked.id, [0.0, 0.0, math.degrees(moment) * 20])
    assert rows.turning[rows.row(parked.id)] == pytest.approx(2.5)
    inside.call("add_actor_force_at_location", parked.id, [0.0, moment * 20, 0.0], [at.x + 0.5, at.y, at.z])
    assert rows.turning[rows.row(parked.id)] == pytest.approx(3.0)


def test_a_push_that_is_refused_leaves_nothing(inside: Inside, parked: Vehicle) -> None:
    at = parked.transform.location
    with pytest.raises(RecapError, match="at most"):
        inside.call("add_actor_impulse_at_location", parked.id, [0.0, 5e7, 0.0], [at.x + 0.001, at.y, at.z])
    assert inside.world.vehicles.turning[inside.world.vehicles.row(parked.id)] == 0.0


def test_the_dead_neither_walk_nor_drive(inside: Inside) -> None:
    places = inside.world.town.spawn_points
    car, walker = (
        inside.world.spawn(name, places[n]) for n, name in ((3, "vehicle.audi.tt"), (4, "walker.pedestrian.0001"))
    )
    inside.call("apply_ackermann_control_to_vehicle", car.id, [0.0, 0.0, 9.0, 0.0, 0.0])
    for actor in (car, walker):
        inside.call("set_actor_dead", actor.id)
    inside.host.tick()
    assert walker.has_fallen  # type: ignore[attr-defined]
    assert car.control.brake == 1.0  # type: ignore[attr-defined]


@pytest.mark.parametrize("bad", [math.nan, 3e38])
@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("set_actor_transform", lambda n: [[[0.0, 0.0, 0.0], [0.0, n, 0.0]]]),
        ("set_actor_location", lambda n: [[0.0, 0.0, n]]),
        ("set_actor_target_angular_velocity", lambda n: [[0.0, 0.0, n]]),
        ("enable_actor_constant_velocity", lambda n: [[n, 0.0, 0.0]]),
        ("add_actor_impulse_at_location", lambda n: [[1.0, 0.0, 0.0], [0.0, n, 0.0]]),
        ("add_actor_force_at_location", lambda n: [[1.0, 0.0, 0.0], [0.0, n, 0.0]]),
        ("add_actor_angular_impulse", lambda n: [[0.0, 0.0, n]]),
        ("add_actor_torque", lambda n: [[0.0, 0.0, n]]),
        ("apply_control_to_walker", lambda n: [[[1.0, 0.0, 0.0], n, False]]),
        ("cast_ray", lambda n: [[0.0, 0.0, 0.0], [n, 0.0, 0.0]]),
        ("project_point", lambda n: [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], n]),
        ("apply_control_to_vehicle", lambda _: [[0.0, math.nan, 0.0, False, False, False, 0]]),
        ("apply_ackermann_control_to_vehicle", lambda _: [[0.0, 0.0, math.nan, 0.0, 0.0]]),
        ("enable_actor_constant_velocity", lambda _: [[9000.0, 9000.0, 0.0]]),
    ],
)
def test_numbers_that_are_none_or_too_large_are_refused(
    inside: Inside, parked: Vehicle, name: str, arguments: Callable[[float], list[Any]], bad: float
) -> None:
    before, walker = parked.transform, inside.world.place("walker.pedestrian.0001", parked.transform)
    actors = [] if name in ("cast_ray", "project_point") else [walker.id if "walker" in name else parked.id]
    with pytest.raises(RecapError, match=r"finite|at most"):
        inside.call(name, *actors, *arguments(bad))
    inside.host.tick()
    assert parked.transform.location.distance(before.location) < 1.0
    walker.destroy()


def test_attributes_that_no_recording_could_have_are_refused(inside: Inside) -> None:
    place = [[600.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    for value in ("x" * 1001, "\udcff"):
        with pytest.raises(RecapError, match="1000 bytes of UTF-8"):
            inside.call("spawn_actor", [0, "vehicle.audi.tt", [["role_name", 4, value]]], place)
    id = inside.call("spawn_actor", [0, "vehicle.audi.tt", [["parent", 4, "x"], ["blueprint", 4, "y"]]], place)[0]
    assert "parent" not in inside.world.actors[id].attributes


async def test_the_records_of_many_actors_keep_no_other_client_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(served, "_SLICE", 0.0)
    host = Host(flat_world())
    ids = list(host.world.actors)
    (one, other), transports = zip(*(connected(host) for _ in range(2)), strict=True)
    one.data_received(msgpack.packb([0, 1, "get_actors_by_id", [[False], [*ids, *ids]]]))
    other.data_received(msgpack.packb([0, 1, "version", [[False]]]))
    assert [len(transport.replies) for transport in transports] == [0, 1]
    for _ in range(2 * len(ids) + 5):
        await asyncio.sleep(0)
    ((_, _, _, ((_, records),)),) = transports[0].replies
    assert [record[0] for record in records] == ids


@pytest.fixture
def walker(world: carla.World) -> carla.Walker:
    return spawn(world, "walker.pedestrian.0001", FAR)


@pytest.mark.parametrize("simulated", [True, False])
def test_a_walker_is_put_where_the_client_leads_it(
    world: carla.World, client: carla.Client, walker: carla.Walker, simulated: bool
) -> None:
    walker.set_simulate_physics(simulated)
    there = carla.Transform(carla.Location(505.0, 500.0, 0.9), carla.Rotation(yaw=90.0))
    (answer,) = client.apply_batch_sync([carla.command.ApplyWalkerState(walker.id, there, 1.5)], True)
    assert not answer.has_error()
    assert walker.get_location().x == pytest.approx(505.0, abs=1e-3)
    assert walker.get_location().y == pytest.approx(500.075 if simulated else 500.0, abs=1e-3)
    assert (walker.get_velocity().x, walker.get_velocity().y) == pytest.approx((0.0, 1.5), abs=1e-3)


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


CAR, WALKER, CAMERA, IMU = "vehicle.audi.tt", "walker.pedestrian.0001", "sensor.camera.rgb", "sensor.other.imu"
BAD = [
    *((CAR, "color", value) for value in ("256,0,0", "1,2", "1,2,3,4", "a,b,c", "-1,0,0", "", "0x1,0,0", "1.5,0,0")),
    *((CAR, "sticky_control", value) for value in ("maybe", "1", "")),
    (WALKER, "is_invincible", "2"),
    *((WALKER, "speed", value) for value in ("fast", "nan", "inf", "1e39", "1_0", "٣", "")),
    (CAMERA, "sensor_tick", "1e400"),
    (IMU, "noise_accel_stddev_x", "abc"),
    *((CAMERA, "image_size_x", value) for value in ("abc", "2147483648", "1.5", "9" * 5000)),
    *((CAMERA, "image_size_y", value) for value in ("0", "-5", "4097")),
]
GOOD = [
    *((CAR, "color", value) for value in ("0,0,0", "255,255,255", "255, 0, 0")),
    *((CAR, "sticky_control", value) for value in ("true", "False")),
    *((WALKER, "speed", value) for value in ("1", "-1.5", ".5", "2.", "1e-3", "3.4e38")),
    *((CAMERA, "image_size_x", value) for value in ("1", "4096", "800.0")),
    (CAR, "role_name", ""),
]


@pytest.mark.parametrize(("name", "key", "value"), BAD)
def test_a_bad_value_is_refused(name: str, key: str, value: str) -> None:
    with pytest.raises(RecapError, match=re.escape(f"{name}: {key} of {value[:60]!r}")):
        check_attributes(standard_library().get(name), {key: value})


@pytest.mark.parametrize(("name", "key", "value"), GOOD)
def test_a_good_value_is_none_of_the_bad_ones(name: str, key: str, value: str) -> None:
    check_attributes(standard_library().get(name), {key: value})


def test_each_way_of_spawning_refuses_it(inside: Inside) -> None:
    before = len(inside.world.actors)
    place, bad = [[600.0, 0.0, 0.0], [0.0, 0.0, 0.0]], [0, CAR, [["color", 5, "256,0,0"]]]
    with pytest.raises(RecapError, match="color of '256,0,0'"):
        inside.call("spawn_actor", bad, place)
    with pytest.raises(RecapError, match="color of '256,0,0'"):
        inside.call("spawn_actor_with_parent", bad, place, inside.world.spectator.id, 0, "")
    for parent in ([False], [True, inside.world.spectator.id]):
        ((answer,),) = inside.batch([0, [bad, place, parent, 0, "", []]])
        assert answer[0] == 0
        assert "color of '256,0,0'" in answer[1][0]
    assert len(inside.world.actors) == before


def test_clients_can_read_the_actors_of_a_recording_with_bad_values(
    client: carla.Client, world: carla.World, recordings: Path
) -> None:
    with World(load_town()) as recorded:
        recorded.spawn(CAR, recorded.town.spawn_points[0], color="256,0,0", sticky_control="maybe", role_name="bad")
        recorded.start_recorder(recordings / "bad.log")
        for _ in range(20):
            recorded.tick()
    client.replay_file("bad.log", 0.0, 0.0, 0)
    world.tick()
    (car,) = world.get_actors().filter(CAR)
    defaults = standard_library().get(CAR).attributes
    assert {key: car.attributes[key] for key in ("color", "sticky_control", "role_name")} == {
        "color": defaults["color"],
        "sticky_control": defaults["sticky_control"],
        "role_name": "bad",
    }
