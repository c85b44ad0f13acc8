"""Calls about actors: spawning, records, transforms and forces."""

from __future__ import annotations

import asyncio
import math
from typing import TYPE_CHECKING, Any

import carla
import msgpack
import pytest

from carla_recap.errors import RecapError
from carla_recap.server import host as served
from carla_recap.server.host import Host
from tests.server.client import FAR, spawn, ticks
from tests.server.inside import Inside, connected
from tests.sim.flat import flat_world

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.sim.actors.moving import Vehicle


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


def test_repeated_ids_give_one_record(inside: Inside) -> None:
    id = inside.world.spectator.id
    assert [record[0] for record in inside.call("get_actors_by_id", [id, 99999, id])] == [id]


def test_a_constant_velocity_is_kept_in_the_axes_of_the_vehicle(world: carla.World) -> None:
    car = spawn(world, at=carla.Transform(FAR.location, carla.Rotation(yaw=90.0)))
    car.enable_constant_velocity(carla.Vector3D(10.0, 0.0, 0.0))
    ticks(world, 20)
    assert (car.get_velocity().x, car.get_velocity().y) == pytest.approx((0.0, 10.0), abs=1e-4)
    assert car.get_location().y == pytest.approx(510.0, abs=0.05)
    car.disable_constant_velocity()
    ticks(world, 20)
    assert 5.0 < car.get_velocity().y < 9.95


def test_impulses_and_forces_push(world: carla.World) -> None:
    car = spawn(world, at=FAR)
    mass = car.get_physics_control().mass
    car.add_impulse(carla.Vector3D(5.0 * mass, 0.0, 0.0))
    world.tick()
    assert car.get_velocity().x == pytest.approx(5.0, abs=0.15)
    car.add_force(carla.Vector3D(40.0 * mass, 0.0, 0.0))
    world.tick()
    assert car.get_velocity().x == pytest.approx(6.8, abs=0.2)


def test_pushes_at_a_place_and_torques_turn(inside: Inside, parked: Vehicle) -> None:
    rows = inside.world.vehicles
    moment, at = rows.moment[rows.row(parked.id)].item(), parked.transform.location
    inside.call("add_actor_impulse_at_location", parked.id, [0.0, moment, 0.0], [at.x + 0.5, at.y, at.z])
    assert rows.turning[rows.row(parked.id)] == pytest.approx(0.5)
    inside.call("add_actor_angular_impulse", parked.id, [0.0, 0.0, math.degrees(moment)])
    assert rows.turning[rows.row(parked.id)] == pytest.approx(1.5)
    inside.call("add_actor_torque", parked.id, [0.0, 0.0, math.degrees(moment) * 20])
    assert rows.turning[rows.row(parked.id)] == pytest.approx(2.5)
    inside.call("add_actor_force_at_location", parked.id, [0.0, moment * 20, 0.0], [at.x + 0.5, at.y, at.z])
    assert rows.turning[rows.row(parked.id)] == pytest.approx(3.0)


PUSHES: dict[str, Any] = {
    "set_actor_target_velocity": [[3e6, 0.0, 0.0]],
    "set_actor_target_angular_velocity": [[0.0, 0.0, 3e6]],
    "add_actor_impulse_at_location": [[3e6, 0.0, 0.0], [0.0, 0.0, 0.0]],
}


@pytest.mark.parametrize("name", PUSHES)
def test_a_walker_has_no_body_to_be_pushed(inside: Inside, name: str) -> None:
    walker = inside.world.place("walker.pedestrian.0001", inside.world.town.spawn_points[5])
    inside.call(name, walker.id, *PUSHES[name])
    inside.host.tick()
    assert walker.velocity.length() == 0.0
    walker.destroy()


def test_pushes_on_a_vehicle_without_physics_do_not_pile_up(inside: Inside, parked: Vehicle) -> None:
    rows = inside.world.vehicles
    inside.call("set_actor_simulate_physics", parked.id, False)
    inside.call("add_actor_impulse_at_location", parked.id, [9e3, 9e3, 9e5], [0.0, 0.0, 0.0])
    inside.call("set_actor_simulate_physics", parked.id, True)
    row = rows.row(parked.id)
    assert (rows.turning[row], rows.speed[row], rows.sideways[row]) == (0.0, 0.0, 0.0)


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
        ("set_actor_transform", lambda n: [[[n, 0.0, 0.0], [0.0, 0.0, 0.0]]]),
        ("set_actor_transform", lambda n: [[[0.0, 0.0, 0.0], [0.0, n, 0.0]]]),
        ("set_actor_location", lambda n: [[0.0, 0.0, n]]),
        ("set_actor_target_velocity", lambda n: [[0.0, 0.0, n]]),
        ("set_actor_target_angular_velocity", lambda n: [[0.0, 0.0, n]]),
        ("enable_actor_constant_velocity", lambda n: [[n, 0.0, 0.0]]),
        ("add_actor_impulse", lambda n: [[n, 0.0, 0.0]]),
        ("add_actor_force", lambda n: [[n, 0.0, 0.0]]),
        ("add_actor_impulse_at_location", lambda n: [[1.0, 0.0, 0.0], [0.0, n, 0.0]]),
        ("add_actor_force_at_location", lambda n: [[1.0, 0.0, 0.0], [0.0, n, 0.0]]),
        ("add_actor_angular_impulse", lambda n: [[0.0, 0.0, n]]),
        ("add_actor_torque", lambda n: [[0.0, 0.0, n]]),
    ],
)
def test_numbers_that_are_none_or_too_large_are_refused(
    inside: Inside, parked: Vehicle, name: str, arguments: Callable[[float], list[Any]], bad: float
) -> None:
    before = parked.transform
    with pytest.raises(RecapError, match=r"finite|at most"):
        inside.call(name, parked.id, *arguments(bad))
    inside.host.tick()
    assert parked.transform.location.distance(before.location) < 1.0


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
