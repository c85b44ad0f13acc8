"""Batches: all 22 commands, errors of single ones, what is done with those that were just spawned, and ticks."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import carla
import msgpack
import pytest

from carla_recap.server import host as served
from carla_recap.server.host import Host
from carla_recap.server.rpc.structs import EpisodeSettings
from carla_recap.sim.actors.moving import Vehicle
from tests.server.client import MODEL
from tests.server.inside import Inside, connected
from tests.sim.flat import flat_world

if TYPE_CHECKING:
    from carla_recap.sim.episode import Actor

command = carla.command
HERE = [[500.0, 500.0, 0.0], [0.0, 0.0, 0.0]]
STANDING = [[500.0, 520.0, 0.9], [0.0, 90.0, 0.0]]


@pytest.fixture
def inside() -> Inside:
    return Inside()


def place(inside: Inside, name: str = "vehicle.tesla.model3", number: int = 0) -> Actor:
    return inside.world.place(name, inside.world.town.spawn_points[number])


def boxes(host: Host) -> list[Actor]:
    return [actor for actor in host.world.actors.values() if actor.type_id == "static.prop.box01"]


def test_batches_spawn_and_destroy_actors(client: carla.Client, world: carla.World) -> None:
    blueprint, places = world.get_blueprint_library().find(MODEL), world.get_map().get_spawn_points()
    answers = client.apply_batch_sync([command.SpawnActor(blueprint, place) for place in (*places[:10], places[0])], True)
    assert [answer.has_error() for answer in answers] == [False] * 10 + [True]
    assert answers[10].error == "Spawn failed because of collision at spawn position"
    ids = [answer.actor_id for answer in answers[:10]]
    assert {actor.id for actor in world.get_actors().filter("vehicle.*")} == set(ids)
    answers = client.apply_batch_sync([command.DestroyActor(id) for id in (*ids, 99999)], True)
    assert [answer.error for answer in answers] == [""] * 10 + ["actor 99999 not found"]
    assert not world.get_actors().filter("vehicle.*")


@pytest.mark.parametrize(("leaves", "nested"), [(False, False), (True, False), (False, True)])
async def test_a_long_batch_keeps_no_other_client_waiting(
    monkeypatch: pytest.MonkeyPatch, leaves: bool, nested: bool
) -> None:
    monkeypatch.setattr(served, "_SLICE", 0.0)
    host = Host(flat_world())
    host.apply_settings(EpisodeSettings(synchronous_mode=True))
    present: list[int] = []
    host.world.listeners.append(lambda: present.append(len(boxes(host))))
    (one, other), transports = zip(*(connected(host) for _ in range(2)), strict=True)

    def prop(number: int, *after: Any) -> list[Any]:
        place = [[5.0 * number, 0.0, 0.0], [0.0, 0.0, 0.0]]
        return [[0, [[0, "static.prop.box01", []], place, [False], 0, "", list(after)]]]

    props = [prop(number) for number in range(9)]
    calls = [0, 1, "apply_batch", [[False], [prop(9, *props)] if nested else props, True]], [0, 2, "version", [[False]]]
    one.data_received(b"".join(map(msgpack.packb, calls)))
    for number, name in enumerate(("version", "tick_cue"), 1):
        other.data_received(msgpack.packb([0, number, name, [[False]]]))
    assert [len(transport.replies) for transport in transports] == [0, 1]
    if leaves:
        one.connection_lost(None)
    assert len(boxes(host)) == 1 + nested
    for _ in range(30):
        await asyncio.sleep(0)
    assert len(boxes(host)) == len(props) + nested
    assert [reply[1] for reply in transports[0].replies] == ([] if leaves else [1, 2])
    assert present == [len(props) + nested] * 2  # its own tick and that of the other client come after it


def test_all_22_commands_do_what_their_calls_do(inside: Inside) -> None:
    car, walker = place(inside), place(inside, "walker.pedestrian.0001", 3)
    assert isinstance(car, Vehicle)
    light = inside.world.traffic_lights[0]
    built = inside.call("get_physics_control", car.id)
    built[11] = 3000.0
    one = [1.0, 0.0, 0.0]
    commands = [
        [0, [[0, "vehicle.audi.tt", []], HERE, [False], 0, "", []]],
        [2, [car.id, [0.25, 0.0, 0.0, False, False, False, 0]]],
        [3, [car.id, [0.0, 0.0, 1.0, 0.0, 0.0]]],
        [4, [walker.id, [one, 1.0, False]]],
        [5, [car.id, built]],
        [6, [car.id, HERE]],
        [7, [walker.id, STANDING, 1.0]],
        *([number, [car.id, one]] for number in range(8, 14)),
        [14, [car.id, True]],
        [15, [car.id, True]],
        [16, [car.id, True]],
        [17, [car.id, True]],
        [18, [car.id, 3]],
        [19, [car.id, [510.0, 500.0, 0.0]]],
        [20, ["stat fps"]],
        [21, [light.id, 1]],
        [1, [walker.id]],
    ]
    answers = inside.batch(*commands)
    ids = [car.id if given[0] == car.id else 0 for _, given in commands]
    assert [answer[0][0] for answer in answers] == [1] * 22, answers
    assert [answer for answer, id in zip(answers, ids, strict=True) if id] == [[[1, car.id]]] * ids.count(car.id)
    assert (car.light_state, light.state, walker.is_alive) == (3, 1, False)
    assert car.physics_control.mass == 3000.0
    assert car.transform.location.x == 510.0
    assert not car.autopilot


def test_a_failing_command_does_not_stop_the_others(inside: Inside) -> None:
    car = place(inside)
    answers = inside.batch(
        [18, [99999, 1]],
        [22, [car.id]],
        [2, [car.id, [float("nan"), 0.0, 0.0, False, False, False, 0]]],
        [2, [car.id]],
        [2, []],
        [0, ["nonsense"]],
        [0, [[0, "vehicle.nobody.knows", []], HERE, [False], 0, "", []]],
        [0, [[0, "sensor.camera.rgb", []], HERE, [True, 99999], 0, "", []]],
        [7, [place(inside, "walker.pedestrian.0001", 3).id, STANDING, float("nan")]],
        [18, [car.id, 1]],
    )
    texts = [answer[0][1] for answer in answers]
    assert [answer[0][0] for answer in answers] == [0] * 9 + [1]
    for number, named in {0: "99999", 1: "22", 2: "nan", 3: "2 arguments", 6: "vehicle.nobody.knows", 7: "99999"}.items():
        assert named in texts[number][0]
    assert texts[9] == car.id
    assert inside.call("apply_batch", [7, None, [], [[]], [[2]]], False)[0][0][0] == 0


def test_errors_of_commands_for_a_new_actor_are_not_reported(inside: Inside) -> None:
    after = [[[4, [0, [[1.0, 0.0, 0.0], 1.0, False]]]], [[18, [0, 7]]], "nonsense"]
    (answer,) = inside.batch([0, [[0, "vehicle.audi.tt", []], HERE, [False], 0, "", after]])
    assert answer[0][0] == 1
    car = inside.world.actors[answer[0][1]]
    assert car.light_state == 7  # type: ignore[attr-defined]
    (answer,) = inside.batch([0, [[0, "sensor.camera.rgb", []], HERE, [True, car.id], 0, "", []]])
    assert inside.world.actors[answer[0][1]].parent is car


def test_a_tick_passes_afterwards_in_synchronous_mode_alone(inside: Inside) -> None:
    inside.call("apply_batch", [], True)
    assert inside.world.frame == 0
    inside.host.settings.synchronous_mode = True
    inside.call("apply_batch", [], True)
    assert inside.world.frame == 1
