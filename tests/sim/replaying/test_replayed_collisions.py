"""Recorded collisions, as events of a replay."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from carla_recap.model.records import NO_ACTOR, ActorKind, Spawn, attributes
from carla_recap.sim.actors.moving import VehicleControl
from carla_recap.sim.episode import Collision
from carla_recap.sim.geometry import Transform, Vector
from carla_recap.sim.world import World
from tests.sim.flat import at, flat_world, spawn_car
from tests.sim.recordings import written

DELTA = 0.05
AUDI = "vehicle.audi.tt"
HERO, PARKED = 2, 3
"""The ids of the recording."""


def collisions(world: World, ticks: int, act: Callable[[int], object] = lambda tick: None) -> dict[int, list[Collision]]:
    """Return the collisions of the next ticks that have any."""
    found = {}
    for tick in range(ticks):
        act(tick)
        world.tick()
        if world.events.collisions:
            found[tick] = world.events.collisions
    return found


@pytest.fixture(scope="module")
def crash(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[int, list[Collision]]]:
    """Five seconds, in which the hero hits a parked car and pushes it on; and their collisions."""
    path = tmp_path_factory.mktemp("crash") / "crash.mcap"
    world = flat_world()
    hero, parked = spawn_car(world, at(20.0), AUDI, role_name="hero"), spawn_car(world, at(40.0), AUDI)
    assert (hero.id, parked.id) == (HERO, PARKED)
    world.recorder.start(path, in_process=True)
    found = collisions(world, 100, lambda tick: hero.apply_control(VehicleControl(throttle=1.0)))
    world.close()
    return path, found


def replayed(path: Path, **options: Any) -> World:
    world = flat_world()
    world.replay_file(path, **options)
    return world


def test_the_collisions_of_a_recording_are_events_at_their_times(crash: tuple[Path, dict[int, list[Collision]]]) -> None:
    path, recorded = crash
    found = collisions(replayed(path), 98)
    expected = {tick - 1: [(HERO, PARKED, True, False)] for tick in recorded if tick < 99}  # a replay begins with a frame
    assert {
        tick: [(each.actor1, each.actor2, each.hero1, each.hero2) for each in events] for tick, events in found.items()
    } == expected


def test_the_first_impulse_of_a_contact_is_estimated(crash: tuple[Path, dict[int, list[Collision]]]) -> None:
    path, recorded = crash
    first, second, *_ = collisions(replayed(path), 98).values()
    impact = next(iter(recorded.values()))[0].impulse
    assert first[0].impulse.x == pytest.approx(impact.x, rel=0.1)
    assert first[0].impulse.y == pytest.approx(0.0, abs=1.0)
    assert second[0].impulse == Vector()


def test_the_other_actor_gets_the_collision_with_a_sensor(crash: tuple[Path, dict[int, list[Collision]]]) -> None:
    world = replayed(crash[0])
    world.spawn("sensor.other.collision", Transform(), parent=world.actors[PARKED])
    first = next(iter(collisions(world, 98).values()))
    assert [(each.actor1, each.actor2) for each in first] == [(HERO, PARKED), (PARKED, HERO)]
    assert first[1].impulse.x == pytest.approx(-first[0].impulse.x)


@pytest.mark.parametrize("factor", [0.25, 3.0])
def test_a_time_factor_changes_when_collisions_come(crash: tuple[Path, dict[int, list[Collision]]], factor: float) -> None:
    path, recorded = crash
    world = flat_world()
    world.replayer.time_factor = factor
    world.replay_file(path)
    found = collisions(world, int(90 / factor))
    assert min(found) == pytest.approx((min(recorded) - 1) / factor, abs=1 / factor + 1)
    assert all(len(events) == 1 for events in found.values())
    with_impulse = [tick for tick, (each,) in found.items() if each.impulse.length() > 1000.0]
    assert with_impulse == [min(found)]


def test_a_replay_that_starts_later_has_the_collisions_from_there_on(crash: tuple[Path, dict[int, list[Collision]]]) -> None:
    path, recorded = crash
    late = max(recorded) * DELTA - 1.0
    assert min(collisions(replayed(path, start=late), 10)) == 0
    assert collisions(replayed(path, duration=1.0), 30) == {}


def test_collisions_have_the_ids_of_the_world(crash: tuple[Path, dict[int, list[Collision]]]) -> None:
    world = flat_world()
    others = [world.spawn("static.prop.barrel", at(500.0 + 5 * number, 20.0)) for number in range(3)]
    assert {actor.id for actor in others} >= {HERO, PARKED}
    world.replay_file(crash[0])
    first = next(iter(collisions(world, 98).values()))
    ids = world.replayer.mapping
    assert [(each.actor1, each.actor2) for each in first] == [(ids[HERO], ids[PARKED])]
    assert ids[HERO] != HERO


def test_collisions_of_an_actor_that_is_left_out_or_destroyed_are_none(
    crash: tuple[Path, dict[int, list[Collision]]],
) -> None:
    world = flat_world()
    world.replayer.ignore_hero = True
    world.replay_file(crash[0])
    assert collisions(world, 98) == {}
    world = replayed(crash[0])
    world.actors[PARKED].destroy()
    assert collisions(world, 98) == {}


def test_physics_and_replay_report_a_collision_once(crash: tuple[Path, dict[int, list[Collision]]]) -> None:
    world = replayed(crash[0])
    parked = world.actors[PARKED]
    found = collisions(world, 98, lambda tick: parked.set_simulate_physics(True))
    assert found
    assert all(len({(each.actor1, each.actor2) for each in events}) == len(events) for events in found.values())


def test_a_recorded_collision_with_a_barrier_stops_the_actor(tmp_path: Path) -> None:
    car = Spawn(7, ActorKind.VEHICLE, type_id=AUDI, attributes=attributes(role_name="hero"))
    ways = [*range(50, 1050, 50), *[1000.0] * 20]  # cm: 10 m/s, and then none
    frames: list[Any] = [{"transforms": [(7, x, 0.0, 0.0, 0.0, 0.0, 0.0)]} for x in ways]
    frames[0]["spawned"], frames[20]["collisions"] = [car], [(0, 7, NO_ACTOR, True, False)]
    written(tmp_path / "wall.mcap", *frames)
    world = replayed(tmp_path / "wall.mcap")
    ((tick, (event,)),) = collisions(world, 38).items()
    mass = world.vehicles.mass[0]
    assert tick == 19
    assert event.actor2 is None
    assert event.impulse.x == pytest.approx(-10.0 * mass, rel=0.01)


def with_collision(path: Path, other: int, *spawns: Spawn) -> Path:
    """Write a recording in which car 7 collides with something at 0.1 s, and that with it."""
    car = Spawn(7, ActorKind.VEHICLE, type_id=AUDI)
    begin = {"spawned": [car, *spawns], "transforms": [(7, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)]}
    collided = {"collisions": [(0, 7, other, True, False), (1, other, 7, False, False)]}
    return written(path, begin, collided, *[{}] * 9, interval=0.1)


LIGHT = Spawn(9, ActorKind.TRAFFIC_LIGHT, type_id="traffic.traffic_light")


@pytest.mark.parametrize(
    ("other", "spawns", "expected"),
    [
        (9, (), []),  # an unknown actor
        (0, (), [(1, 7, None)]),  # a static object before CARLA 0.9.13
        (9, (LIGHT,), [(1, 7, None)]),  # a light that the town does not have
    ],
)
def test_a_recorded_collision_with_what_is_not_there_is_one_with_a_barrier_or_none(
    tmp_path: Path, other: int, spawns: tuple[Spawn, ...], expected: list[tuple[int, int, int | None]]
) -> None:
    found = collisions(replayed(with_collision(tmp_path / "odd.mcap", other, *spawns)), 10)
    assert [(tick, each.actor1, each.actor2) for tick, events in found.items() for each in events] == expected
