"""What a world shows of a recording, which actors follow it, and how these go on afterwards."""

from __future__ import annotations

import shutil
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import carla_recap
from carla_recap.errors import FormatError, RecapError, RecapWarning
from carla_recap.model.frame import Frame
from carla_recap.model.records import Attribute, Spawn
from carla_recap.replay import Player
from carla_recap.sim.actors.moving import Vehicle, VehicleControl, Walker, WalkerControl
from carla_recap.sim.actors.props import Prop
from carla_recap.sim.errors import SimError
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector
from carla_recap.sim.physics.physics_control import Gear
from carla_recap.sim.replaying.replayer import _drive_on
from carla_recap.sim.settings import PRESETS
from carla_recap.sim.world import World
from tests.sim.flat import at, flat_world, lit_world, spawn_car, spawn_walker
from tests.sim.recordings import frames, record, written

DELTA = 0.05
AUDI = "vehicle.audi.tt"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten seconds: a hero that swerves and brakes, a motorcycle, a walker, a barrel, and a car that comes and goes.

    The ids are 4, 5, 6, 7, and 8 from 2 s to 6 s; the spectator has 1, the lights have 2 and 3.
    """
    world = lit_world()
    hero = spawn_car(world, at(20.0), AUDI, role_name="hero", color="1,2,3")
    rider = spawn_car(world, at(60.0, 8.0), "vehicle.kawasaki.ninja")
    walker = spawn_walker(world, at(80.0, 4.0, z=0.9), "walker.pedestrian.0002")
    world.spawn("static.prop.barrel", at(90.0, 6.0))
    path = tmp_path_factory.mktemp("drive") / "drive.mcap"
    world.recorder.start(path, True, in_process=True)
    for tick in range(200):
        braking, steer = tick >= 120, 0.1 * np.sin(tick / 15)
        hero.apply_control(VehicleControl(throttle=0.0 if braking else 0.6, steer=steer, brake=float(braking)))
        rider.apply_control(VehicleControl(throttle=0.3))
        walker.apply_control(WalkerControl(Vector(1.0, -0.2, 0.0), 1.4))
        hero.light_state = 0b1000 if braking else 0b1
        if tick == 40:
            guest = spawn_car(world, at(200.0, 4.0), AUDI)
            hero.set_door(5, True)
            world.weather = PRESETS["HardRainNoon"]
        if tick == 120:
            guest.destroy()
        world.spectator.transform = at(tick / 10, -10.0, z=5.0)
        world.tick()
    world.close()
    return path


def play(world: World, path: Path, ticks: int, **kwargs: Any) -> None:
    world.replay_file(path, **kwargs)
    for _ in range(ticks):
        world.tick()


def play_out(world: World) -> int:
    ticks = 0
    while world.replayer.is_playing:
        world.tick()
        ticks += 1
    return ticks


def played(world: World, id: int) -> Any:
    """Return the actor that follows one of the recording."""
    return world.actors[world.replayer.mapping[id]]


def way_of(path: Path, id: int = 4) -> Any:
    with carla_recap.open_recording(path) as recording:
        return recording.trajectory(id, axes="carla")


def x_at(path: Path, time: Any) -> Any:
    """Return where the hero has been along the road."""
    return np.interp(time, (way := way_of(path)).time, way.x)


def speed_at(path: Path, id: int, time: float) -> Any:
    """Return the recorded speed, about which a vehicle still has when it leaves the replay."""
    row = np.searchsorted((way := way_of(path, id)).time, time)
    return pytest.approx(np.hypot(way.vx[row], way.vy[row]), rel=0.1)


def yaw_between(a: Any, b: Any) -> Any:
    return np.abs((a - b + 180) % 360 - 180)


# --- what is shown -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".mcap", ".log"])
def test_a_replay_that_is_recorded_is_the_recording(tmp_path: Path, drive: Path, suffix: str) -> None:
    source = tmp_path / f"a{suffix}"
    carla_recap.convert(drive, source)
    world = lit_world()
    world.replay_file(source)
    world.start_recorder(tmp_path / f"b{suffix}", True)
    assert play_out(world) == 200
    world.close()
    ids = world.replayer.mapping
    first, second = frames(source), frames(tmp_path / f"b{suffix}")
    assert len(second) == 201
    for then, now in zip(first, second[:-1], strict=True):  # the last one is the first one by autopilot
        assert now.elapsed == pytest.approx(then.elapsed, abs=1e-9)
        _agree(then, now, ids)
    spawns = {spawn.id: spawn for spawn in second[0]["spawned"]}
    for spawn in first[0]["spawned"]:
        again = spawns[ids[spawn.id]] if spawn.type_id != "spectator" else spawns[world.spectator.id]
        assert (again.type_id, again.kind, again.uid) == (spawn.type_id, spawn.kind, spawn.uid)
        assert sorted((a.key, a.value) for a in again.attributes) == sorted((a.key, a.value) for a in spawn.attributes)
    assert [spawn.type_id for spawn in second[40]["spawned"]] == ["vehicle.audi.tt"]
    assert second[120]["destroyed"]["id"].tolist() == [second[40]["spawned"][0].id]


def test_a_replay_from_the_middle_is_the_recording_from_there(tmp_path: Path, drive: Path) -> None:
    world = lit_world()
    replay = world.replay_file(drive, start=5.0, duration=2.0)
    assert (replay.map_name, replay.loaded, replay.start, replay.duration) == ("Flat", False, 5.0, 2.0)
    assert (replay.path, replay.followed, replay.time_factor) == (drive, None, 1.0)
    assert replay.total == pytest.approx(9.95)
    assert played(world, 4).transform.location.x == pytest.approx(x_at(drive, 5.0), abs=1e-4)
    assert world.replayer.mapping.keys() == {2, 3, 4, 5, 6, 7, 8}
    assert (played(world, 4).open_doors, world.weather.precipitation) == ({5}, 100.0)
    world.start_recorder(tmp_path / "b.mcap", True)
    assert play_out(world) == 41
    world.close()
    for then, now in zip(frames(drive)[101:140], frames(tmp_path / "b.mcap")[1:40], strict=True):
        _agree(then, now, world.replayer.mapping)


def _agree(then: Frame, now: Frame, ids: Any) -> None:
    rows = {row["id"]: row for row in now["transforms"]}
    for row in then["transforms"]:
        if row["id"] not in ids:  # the spectator, and actors that are gone by the end of the replay
            continue
        other = rows[ids[row["id"]]]
        assert np.linalg.norm([row[axis] - other[axis] for axis in "xyz"]) < 1, row["id"]
        assert max(yaw_between(row[angle], other[angle]) for angle in ("roll", "pitch", "yaw")) < 0.1
    for name in ("vehicle_controls", "walker_controls", "vehicle_lights", "light_states"):
        again = {row[0]: row[1:] for row in now[name].tolist()}
        for id, *values in then[name].tolist():
            assert id not in ids or again[ids[id]] == tuple(values), name
    assert [row.tolist()[1:] for row in now["doors"]] == [row.tolist()[1:] for row in then["doors"]]
    if now.index:  # the first frame of a recording has it anyway
        assert now["weather"].tolist() == then["weather"].tolist()


def test_a_start_may_count_from_the_end(drive: Path) -> None:
    assert lit_world().replay_file(drive, start=-2.0).start == pytest.approx(7.95)
    assert lit_world().replay_file(drive, start=-20.0).start == 0


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"start": 20.0}, "nothing at 20 s"),
        ({"follow": 99}, "no actor 99 to follow"),
        ({"name": "absent"}, "absent: No such"),
    ],
)
def test_what_cannot_be_replayed_is_an_error_and_changes_nothing(drive: Path, options: Any, error: str) -> None:
    world = lit_world()
    with pytest.raises(RecapError, match=error):
        world.replay_file(**{"name": drive, **options})
    assert not world.replayer.is_playing
    assert len(world.vehicles) == 0


def test_between_frames_poses_are_interpolated_unless_time_flies(drive: Path) -> None:
    world = lit_world()
    world.replay_file(drive, start=5.0)
    world.tick(DELTA / 2)
    assert played(world, 4).transform.location.x == pytest.approx(x_at(drive, 5.0 + DELTA / 2), abs=1e-3)
    world = lit_world()
    world.replayer.time_factor = 20.0
    assert world.replay_file(drive).time_factor == 20
    seen = []
    for _ in range(9):
        world.tick(0.0512)
        seen.append(played(world, 4).transform.location.x)
    way = way_of(drive)
    shown = way.x[np.searchsorted(way.time, np.arange(1, 10) * 0.0512 * 20, side="right") - 1]
    assert seen == pytest.approx(shown.tolist(), abs=1e-4)


def test_the_time_factor_can_change_on_the_way(drive: Path) -> None:
    world = lit_world()
    world.replay_file(drive)
    for factor, ticks in ((0.5, 40), (1.5, 40), (0.0, 20), (1.0, 20)):
        world.replayer.time_factor = factor
        for _ in range(ticks):
            world.tick()
    assert played(world, 4).transform.location.x == pytest.approx(x_at(drive, 5.0), abs=1e-3)
    for factor in (-1.0, float("nan"), float("inf")):
        with pytest.raises(SimError, match="a time factor of"):
            world.replayer.time_factor = factor
    assert world.replayer.time_factor == 1


def test_the_spectator_stays_unless_it_is_asked_for(drive: Path) -> None:
    world = lit_world()
    world.spectator.transform = at(1.0, 2.0, z=3.0)
    play(world, drive, 100)
    assert world.spectator.transform == at(1.0, 2.0, z=3.0)
    world.stop_replayer()
    world.replayer.ignore_spectator = False
    play(world, drive, 100)
    place = world.spectator.transform.location
    assert (place.x, place.y, place.z) == pytest.approx((10.0, -10.0, 5.0), abs=1e-4)


@pytest.mark.parametrize("follow", [4, "hero", 0])
def test_the_spectator_follows(drive: Path, follow: Any) -> None:
    world = lit_world()
    assert world.replay_file(drive, follow=follow).followed == (4 if follow else None)
    for _ in range(50 if follow else 0):
        world.tick()
        hero, camera = played(world, 4).transform, world.spectator.transform
        behind = hero.transform(Location(-10.0))
        assert (camera.location.x, camera.location.y) == pytest.approx((behind.x, behind.y), abs=1e-3)
        assert camera.location.z == pytest.approx(hero.location.z + 5)
        assert (camera.rotation.pitch, camera.rotation.roll) == (-25, 0)


@pytest.mark.parametrize("role", ["hero", "autopilot"])
def test_sensors_come_when_they_are_asked_for_and_not_without_their_vehicle(tmp_path: Path, role: str) -> None:
    world, place = lit_world(), Transform(Location(1.0, 0.0, 2.0))
    world.spawn("sensor.other.collision", place, parent=spawn_car(world, at(20.0), AUDI, role_name=role))
    record(world, tmp_path / "a.log", 20)
    world = lit_world()
    play(world, tmp_path / "a.log", 5)
    assert 5 not in world.replayer.mapping
    world.replayer.ignore_hero = True
    play(world, tmp_path / "a.log", 5, replay_sensors=True)
    if role == "hero":
        assert world.replayer.mapping.keys() == {2, 3}
    else:
        assert played(world, 5).parent is played(world, 4)
        assert played(world, 5).relative_transform == place


# --- which actors follow -------------------------------------------------------------------------------------------------


def test_an_actor_of_the_same_id_and_blueprint_is_moved_and_others_are_not(drive: Path) -> None:
    world = lit_world()
    mine = spawn_car(world, at(500.0), AUDI)
    wrong = spawn_car(world, at(510.0), AUDI)
    play(world, drive, 10)
    assert played(world, 4) is mine
    assert mine.transform.location.x < 100
    assert played(world, 5) is not wrong
    assert wrong.transform.location.x == 510


def test_what_drives_a_vehicle_does_not_change_its_recorded_controls(tmp_path: Path) -> None:
    class Braking:
        def step(self, delta: float) -> None:
            car.apply_control(VehicleControl(brake=1.0))

    world = flat_world()
    car = spawn_car(world, at(10.0))
    car.apply_control(VehicleControl(throttle=0.25))
    record(world, tmp_path / "throttle.mcap", 10)
    world.controllers.append(Braking())
    play(world, tmp_path / "throttle.mcap", 3)
    assert (car.control.throttle, car.control.brake) == (0.25, 0.0)


@pytest.mark.parametrize(
    ("ids", "given"),
    [
        ((300, 234, 41), (300, 234, 41)),
        ((2, 4, 5, 9), (10, 11, 5, 9)),  # the lights have 2 and 3, the barrel 4
        ((0, 2**32 - 2), (5, 6)),  # which no actor can have
    ],
)
def test_actors_have_their_recorded_ids_unless_these_are_taken(
    tmp_path: Path, ids: tuple[int, ...], given: tuple[int, ...]
) -> None:
    world = lit_world()
    assert world.spawn("static.prop.barrel", at(500.0)).id == 4
    spawns = [Spawn(id, 1, x=2000.0 * number, type_id=AUDI) for number, id in enumerate(ids)]
    play(world, written(tmp_path / "a.log", {"spawned": spawns}, {}, {}), 1)
    assert world.replayer.mapping == dict(zip(ids, given, strict=True))
    assert spawn_car(world, at(500.0, 20.0), AUDI).id == max(given) + 1
    world.stop_replayer()  # the ids of actors that are destroyed are not given again
    play(world, tmp_path / "a.log", 1)
    assert not set(world.replayer.mapping.values()) & set(given)


@pytest.mark.parametrize("revolutions", [4000.0, 0.0])
def test_a_vehicle_drives_on_in_a_gear_that_it_has(revolutions: float) -> None:
    world = flat_world()
    car = spawn_car(world, at(0))
    car.physics_control = replace(car.physics_control, max_rpm=revolutions)
    car.set_simulate_physics(False)
    car.rows.gear[car.row] = 5  # recorded of a vehicle with more gears
    _drive_on(car, Vector(), 0.0)
    world.tick()
    assert car.rows.gear[car.row] <= car.gears == 1


def test_actors_that_come_and_go_between_two_ticks_leave_nothing_behind(drive: Path) -> None:
    world = lit_world()
    world.replayer.time_factor = 100.0
    world.replay_file(drive, start=1.5)
    world.tick()  # from 1.5 s to 6.5 s: actor 8 has come and gone
    assert world.replayer.mapping.keys() == {2, 3, 4, 5, 6, 7}
    assert len(world.vehicles) == 2


@pytest.mark.parametrize(
    ("type_id", "kind", "wheels", "substitute"),
    [
        ("vehicle.bmw.isetta", 1, "4", "vehicle.micro.microlino"),
        ("vehicle.honda.cub", 1, "2", "vehicle.yamaha.yzf"),
        ("vehicle.martian", 1, None, "vehicle.audi.a2"),
        ("walker.martian", 2, None, "walker.pedestrian.0009"),
        ("static.prop.martian", 0, None, "static.prop.container"),
        ("martian", 17, None, ""),
    ],
)
def test_unknown_blueprints_have_substitutes(
    tmp_path: Path, type_id: str, kind: int, wheels: str | None, substitute: str
) -> None:
    spawn = Spawn(9, kind, x=5000.0, type_id=type_id)
    if wheels:
        spawn.attributes = [Attribute(1, "number_of_wheels", wheels)]
    box = {"id": 9, "extent_x": 150, "extent_y": 70, "extent_z": 80}
    frames = {"spawned": [spawn], "bounding_boxes": box}, {"transforms": {"id": 9, "x": 5500.0}}
    world = lit_world()
    play(world, written(tmp_path / "a.log", *frames, interval=1.0), 10)
    actor = played(world, 9)
    assert actor.type_id == type_id
    extent = actor.box.extent
    assert world.replayer.substitutes == {type_id: substitute}
    if substitute:
        assert (extent.x, extent.y, extent.z) == pytest.approx((1.5, 0.7, 0.8), abs=1e-6)


def test_lights_are_the_nearest_ones_and_show_what_is_recorded(tmp_path: Path) -> None:
    places = {31: (9900, -290), 32: (9900, 290), 33: (90_000, 0)}
    spawns = [Spawn(id, 3, x=x, y=y, type_id="traffic.traffic_light") for id, (x, y) in places.items()]
    states = {"light_states": [(31, 0, 3.5, 1), (32, 1, 4.5, 3), (33, 0, 1.0, 2)]}
    world = lit_world()
    play(world, written(tmp_path / "a.log", {"spawned": spawns} | states, *[states] * 10, interval=1.0), 100)
    left, right = world.traffic_lights
    assert world.replayer.mapping == {31: right.id, 32: left.id}
    assert [(a.state, a.elapsed_time, a.frozen) for a in (right, left)] == [(1, 3.5, False), (3, 4.5, True)]
    play_out(world)
    assert not left.frozen
    world.run(20.0)
    assert left.state in (0, 1, 2)
    assert {left.state, right.state} != {3, 1}


# --- others, and what comes after --------------------------------------------------------------------------------------


def test_the_front_wheels_of_a_replayed_vehicle_follow_the_recording(drive: Path) -> None:
    world = lit_world()
    play(world, drive, 1, start=1.0)
    vehicles = world.vehicles
    np.testing.assert_allclose(vehicles.wheel_angle, vehicles.steer * vehicles.tables.of(vehicles.table).full_lock)
    assert abs(vehicles.wheel_angle).max() > 0.09


def test_a_vehicle_in_the_way_is_pushed_and_does_not_push_back(drive: Path) -> None:
    world = lit_world()
    victim = spawn_car(world, at(40.0, -1.0), "vehicle.audi.a2", role_name="hero")
    world.run(2.0)
    world.replay_file(drive)
    begin, collisions = victim.transform.location.x, []
    for _ in range(150):
        world.tick()
        collisions += world.events.collisions
        here = played(world, 4).transform.location
    assert victim.transform.location.x > begin + 3
    assert {(c.actor1, c.actor2) for c in collisions} >= {(victim.id, played(world, 4).id)}
    undisturbed = lit_world()
    play(undisturbed, drive, 150)
    assert here.distance(played(undisturbed, 4).transform.location) < 1e-6


def test_a_jump_pushes_no_vehicle_on_its_way(tmp_path: Path) -> None:
    frames: list[Any] = [{"transforms": {"id": 9, "x": x}} for x in (1000.0, 30_000.0) for _ in range(10)]
    frames[0]["spawned"] = [Spawn(9, 1, x=1000, type_id=AUDI)]
    written(tmp_path / "a.log", *frames)
    world = lit_world()
    standing = spawn_car(world, at(100.0), AUDI)
    world.run(1.0)
    play(world, tmp_path / "a.log", 15)
    assert played(world, 9).transform.location.x == pytest.approx(300)
    assert standing.transform.location.x == pytest.approx(100, abs=1e-6)


def test_bodies_stay_with_their_actors_whatever_a_client_does_to_these(drive: Path) -> None:
    world = lit_world()
    world.replay_file(drive, 1.0)
    world.run(0.5)
    hero = next(actor for actor in world.vehicles.actors if actor.is_hero)
    body = world.vehicles.bodies[hero.row]
    assert body.velocity.length > 1
    hero.set_target_velocity(Vector())
    hero.transform = at(300.0)
    world.tick()
    assert body.position == pytest.approx((hero.transform.location.x, hero.transform.location.y), abs=1e-6)


@pytest.mark.parametrize("id", [4, 6])
def test_physics_that_is_switched_on_moves_no_replayed_actor(drive: Path, id: int) -> None:
    world, alone = lit_world(), lit_world()
    for each in (world, alone):
        play(each, drive, 20)
    for _ in range(20):
        played(world, id).set_simulate_physics(True)
        for each in (world, alone):
            each.tick()
        assert played(world, id).transform == played(alone, id).transform
        assert played(world, id).velocity == played(alone, id).velocity


@pytest.mark.parametrize("factor", [1.0, 0.5, 3.0])
def test_at_the_end_vehicles_go_on_by_autopilot_and_walkers_stop(drive: Path, factor: float) -> None:
    world = lit_world()
    world.replayer.time_factor = factor
    world.replay_file(drive, duration=5.0)
    play_out(world)
    hero, rider, walker = played(world, 4), played(world, 5), played(world, 6)
    for id, vehicle in ((4, hero), (5, rider)):
        assert vehicle.autopilot
        assert vehicle.simulates_physics
        assert vehicle.velocity.length() == speed_at(drive, id, 5.0)
    place, begin = walker.transform.location, hero.transform.location.x
    world.run(2.0)
    assert walker.transform.location.distance(place) < 0.01
    assert hero.transform.location.x > begin + 10
    assert not world.signals.held


def test_stopping_takes_back_what_was_spawned_or_keeps_it(drive: Path) -> None:
    world = lit_world()
    mine = spawn_car(world, at(500.0), AUDI)
    play(world, drive, 60)
    guest = played(world, 8)
    world.stop_replayer()
    assert not world.replayer.is_playing
    assert mine.is_alive
    assert mine.autopilot
    assert not guest.is_alive
    assert [actor for actor in world.actors.values() if isinstance(actor, (Vehicle, Walker, Prop))] == [mine]
    world.stop_replayer()
    play(world, drive, 60)
    guest = played(world, 8)
    world.stop_replayer(keep_actors=True)
    assert guest.is_alive
    assert guest.simulates_physics
    world.run(1.0)


def test_actors_that_were_kept_play_the_same_recording_again(drive: Path) -> None:
    world = lit_world()
    taken = spawn_car(world, at(500.0))  # with the id of the hero
    assert taken.id == 4
    play(world, drive, 20, duration=1.0)
    world.stop_replayer(keep_actors=True)
    hero = played(world, 4)
    assert hero.id != 4
    world.run(1.0)
    play(world, drive, 20)
    assert played(world, 4) is hero
    hero.destroy()
    play(world, drive, 20)
    assert played(world, 4) is not hero


def test_a_new_replay_ends_the_one_before_and_a_recording(tmp_path: Path, drive: Path) -> None:
    world = lit_world()
    world.start_recorder(tmp_path / "a.log")
    world.run(1.0)
    with pytest.warns(RecapWarning, match=r"a\.log: ends here: a replay begins"):
        world.replay_file(drive)
    assert len(frames(tmp_path / "a.log")) == 20
    first = played(world, 4)
    world.tick()
    world.replay_file(tmp_path / "a.log")
    assert not first.is_alive
    assert world.replayer.mapping.keys() == {2, 3}


# --- actors that leave the replay --------------------------------------------------------------------------------------


def test_the_autopilot_drives_one_vehicle_while_the_others_follow_the_recording(drive: Path) -> None:
    world, beside = lit_world(), lit_world()
    play(world, drive, 60)
    play(beside, drive, 60)
    hero = played(world, 4)
    speed = hero.velocity.length()
    hero.set_autopilot()
    world.tick()
    beside.tick()
    assert hero.simulates_physics
    assert hero.velocity.length() == pytest.approx(speed, rel=0.1)
    for _ in range(100):
        world.tick()
        beside.tick()
    assert hero.transform.location.distance(played(beside, 4).transform.location) > 3  # the recorded hero brakes at 6 s
    assert hero.autopilot
    for id in (5, 6, 7):
        assert played(world, id).transform == played(beside, id).transform
    assert played(world, 4) is hero
    world.stop_replayer()
    assert hero.is_alive
    assert [actor for actor in world.actors.values() if isinstance(actor, (Vehicle, Walker, Prop))] == [hero]


def test_a_vehicle_that_gets_the_autopilot_at_the_start_has_its_recorded_speed(drive: Path) -> None:
    world = lit_world()
    world.replay_file(drive, start=5.0)
    hero = played(world, 4)
    hero.set_autopilot()
    world.run(4 * DELTA)
    assert hero.simulates_physics
    assert hero.velocity.length() == speed_at(drive, 4, 5.0)


def test_a_vehicle_that_is_released_obeys_its_control(drive: Path) -> None:
    world = lit_world()
    play(world, drive, 60, follow="hero")
    hero = played(world, 4)
    world.replayer.release(hero)
    hero.apply_control(VehicleControl(brake=1.0))
    for _ in range(100):
        world.tick()
    assert world.replayer.is_playing
    assert not hero.autopilot
    assert hero.velocity.length() < 0.1
    behind = hero.transform.transform(Location(-10.0))
    camera = world.spectator.transform.location
    assert (camera.x, camera.y) == pytest.approx((behind.x, behind.y), abs=0.01)
    with pytest.raises(SimError, match="no vehicle or walker that follows a recording"):
        world.replayer.release(hero)


def test_a_new_episode_ends_the_replay(drive: Path) -> None:
    world = lit_world()
    play(world, drive, 10)
    world.reload()
    assert not world.replayer.is_playing
    assert not world.signals.held
    play(world, drive, 10)
    assert world.replayer.mapping.keys() == {2, 3, 4, 5, 6, 7}


# --- which recording ---------------------------------------------------------------------------------------------------


def test_a_recording_is_found_by_its_name(tmp_path: Path, drive: Path) -> None:
    shutil.copy(drive, tmp_path / "one.mcap")
    carla_recap.convert(drive, tmp_path / "two.log")
    world = World(lit_world().town, recordings=tmp_path)
    for name, found in (("one", "one.mcap"), ("two", "two.log"), ("two.log", "two.log"), (str(tmp_path / "two"), "two.log")):
        assert world.replay_file(name).path == tmp_path / found
    (tmp_path / "text.log").write_text("hello")
    with pytest.raises(RecapError, match="is not a recording"):
        world.replay_file("text")


def test_a_recording_of_an_unknown_map_replays_on_its_corridors(
    tmp_path: Path, drive: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CARLA_RECAP_MAPS", raising=False)
    path = of_another_map(drive, tmp_path / "a.mcap")
    world = lit_world()
    with pytest.warns(RecapWarning, match=r"a\.mcap: there is no map 'Town42' in the folder"):
        replay = world.replay_file(path)
    assert replay.loaded
    assert replay.on_corridors
    assert world.town.name == "Town42"
    with carla_recap.open_recording(path) as recording:
        driven = [way for way in recording.trajectories("vehicle", axes="carla").values() if np.ptp(way.x) > 10]
    assert driven
    for way in driven:
        places = np.stack((way.x, way.y, way.z), axis=1)
        points = np.concatenate([lane.points for lane in world.town.lanes])
        assert np.linalg.norm(places[:, None] - points[None], axis=2).min(axis=1).max() < 1.0
    town = world.town
    world.run(replay.duration + 1)
    assert not world.replay_file(path).loaded  # known by now
    assert world.town is town
    with pytest.warns(RecapWarning, match=r"b\.mcap"):  # which has corridors of its own
        assert world.replay_file(of_another_map(drive, tmp_path / "b.mcap")).loaded


def test_a_recording_of_an_unknown_map_without_vehicles_has_a_road(tmp_path: Path) -> None:
    path, world = of_another_map(written(tmp_path / "b.mcap", {}), tmp_path / "a.mcap"), lit_world()
    with pytest.warns(RecapWarning, match="Town42"):
        world.replay_file(path)
    assert len(world.town.lanes) == 1


def test_a_map_that_the_caller_names_must_be_there(tmp_path: Path, drive: Path) -> None:
    world = lit_world()
    mine = spawn_car(world, at(500.0), AUDI)
    with pytest.raises(SimError, match=r"is a recording of the map 'Town42', which cannot be loaded: .*Town42"):
        next(world.replayer.begin(world.replayer.open(drive), world.reload, map_name="Town42"))
    assert mine.is_alive
    assert not world.replayer.is_playing


def of_another_map(recording: Path, path: Path) -> Path:
    """Copy a recording, as one of a map that does not exist."""
    carla_recap.convert(recording, path.with_suffix(".log"))
    log = path.with_suffix(".log")
    log.write_bytes(log.read_bytes().replace(b"\x04\x00Flat", b"\x06\x00Town42", 1))
    carla_recap.convert(log, path)
    log.unlink()
    return path


def test_a_recording_that_turns_out_to_be_damaged_ends_the_replay(drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: Player, delta: float) -> None:
        raise FormatError(drive, 1234, "a chunk is damaged")

    world = lit_world()
    play(world, drive, 10)
    hero = played(world, 4)
    monkeypatch.setattr(Player, "tick", fail)
    with pytest.warns(RecapWarning, match="the replay has ended: .*byte 1234: a chunk is damaged"):
        world.tick()
    assert isinstance(world.replayer.error, FormatError)
    assert hero.is_alive
    assert hero.autopilot
    world.run(0.5)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 2e8, 1e30])
def test_records_that_are_out_of_range_are_left_out(tmp_path: Path, bad: float) -> None:
    types = {1: "spectator", 9: AUDI, 10: "static.prop.barrel", 11: AUDI, 12: AUDI}
    places = {9: 1000.0, 10: 2000.0, 11: bad, 12: 5000.0}
    spawned = [Spawn(id, int(type == AUDI), x=places.get(id, 0.0), type_id=type) for id, type in types.items()]
    others = {"weather": {"cloudiness": [bad * 1e6]}, "doors": {"id": [9], "door": [200], "open": [1]}}
    frames: list[Any] = []
    for frame in range(5):
        x = bad if frame > 1 else 1000.0
        row = [x, x, 2 * x, bad, bad if not frame else 5000.0]
        frames.append(others | {"transforms": {"id": list(types), "x": row}})
    frames[0]["spawned"] = spawned
    written(tmp_path / "a.log", *frames)
    world = lit_world()
    world.replayer.ignore_spectator = False
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        world.replay_file(tmp_path / "a.log", follow=9)
        for _ in range(4):
            world.tick()
            assert [played(world, id).transform.location.x for id in (9, 10, 12)] == pytest.approx([10, 20, 50])
            assert world.replayer.is_playing
    assert played(world, 9).transform.rotation == Rotation()
    assert 11 not in world.replayer.mapping
    told = " ".join(str(each.message) for each in warned)
    poses = {what: told.count(f"{what}'): its recorded pose") for what in ("spectator", "audi.tt", "barrel")}
    assert poses == {"spectator": 1, "audi.tt": 2, "barrel": 1}
    assert [told.count(what) for what in ("audi.tt (11) is left out", "weather is left out")] == [1, 5]


@pytest.mark.parametrize(
    ("model", "control", "seconds"),
    [
        ("audi.tt", VehicleControl(throttle=0.6, steer=0.03), 6.0),
        ("lincoln.mkz_2017", VehicleControl(throttle=0.8), 7.0),
        ("carlamotors.firetruck", VehicleControl(throttle=1.0), 9.0),
    ],
)
def test_a_released_vehicle_drives_on_as_it_did(tmp_path: Path, model: str, control: VehicleControl, seconds: float) -> None:
    world = flat_world()
    car = world.spawn(f"vehicle.{model}", at(0.0))
    car.apply_control(control)
    world.recorder.start(tmp_path / "a.log", in_process=True)
    world.run(seconds)
    before = car.control, car.rows.engine[0], car.rows.steer_input[0]
    driven = []
    for _ in range(40):
        world.tick()
        driven.append((car.velocity.length(), car.transform.rotation.yaw))
    world.close()
    again = lit_world()
    play(again, tmp_path / "a.log", round(seconds / DELTA) - 1)
    car = played(again, car.id)
    again.replayer.release(car)
    car.apply_control(control)
    assert (car.control.gear, car.rows.engine[0], car.rows.steer_input[0]) == (
        before[0].gear,
        pytest.approx(before[1], rel=0.025),
        pytest.approx(before[2], abs=1e-6),
    )
    for speed, yaw in driven:
        again.tick()
        assert car.velocity.length() == pytest.approx(speed, abs=0.15)
        assert yaw_between(car.transform.rotation.yaw, yaw) == pytest.approx(0, abs=1.5)


def test_what_is_being_replayed_is_not_recorded_over(tmp_path: Path) -> None:
    world = flat_world()
    path = tmp_path / "a.mcap"
    record(world, path, 20)
    world.replay_file(path)
    (tmp_path / "link.mcap").symlink_to(path)
    for name in (path, tmp_path / "a", tmp_path / "link.mcap"):
        with pytest.raises(RecapError, match="is being replayed"):
            world.start_recorder(name)
    world.stop_replayer()
    world.start_recorder(path)
    world.close()


def test_a_replay_goes_on_when_an_actor_is_destroyed_before_all_are_spawned(tmp_path: Path) -> None:
    world = flat_world()
    car = spawn_car(world, at(20.0), speed=5.0)
    cone = "static.prop.trafficcone01"
    for transform, parent in ((at(150.0, 10.0), None), (at(-5.0, z=3.0), car)):
        world.spawn(cone, transform, parent=parent)
    record(world, tmp_path / "a.log", 10)
    for victim in (car.id, car.id + 1):
        again = flat_world()
        steps = again.replayer.begin(again.replayer.open(tmp_path / "a.log"), again.reload, keep_town=True)
        for _ in steps:
            assert not again.replayer.shows_start
            if victim in again.actors:
                again.actors[victim].destroy()
        assert again.replayer.shows_start
        again.tick()
        assert again.replayer.is_playing
        assert victim not in again.actors


def test_a_replay_that_was_given_up_does_not_end_the_next_one(drive: Path) -> None:
    world = lit_world()
    given_up = world.replayer.begin(world.replayer.open(drive), world.reload, keep_town=True)
    next(given_up)
    world.replay_file(drive, keep_town=True)
    given_up.close()
    world.tick()
    assert world.replayer.is_playing


def test_a_replayed_walker_that_meets_a_car_does_not_fall(tmp_path: Path) -> None:
    world = flat_world()
    walker = spawn_walker(world, at(100.0, 10.0, z=1.0))
    walker.apply_control(WalkerControl(Vector(1.0, 0.0, 0.0), 1.5))
    record(world, tmp_path / "a.log", 100)
    again = flat_world()
    again.replay_file(tmp_path / "a.log", keep_town=True)
    spawn_car(again, at(105.0, 10.0))
    replayed = again.walkers.actors[0]
    while again.replayer.is_playing:
        again.tick()
        assert not replayed.has_fallen
        assert replayed.transform.rotation.pitch == 0.0


@pytest.mark.parametrize(("start", "moved"), [(0.0, 0.0), (1.0, 0.0), (0.0, 100.0)])
def test_physics_that_change_in_a_recording_change_in_its_replay(tmp_path: Path, start: float, moved: float) -> None:
    """The places of wheels are recorded in the world, those of a change where the vehicle is then."""
    world = flat_world()
    car = spawn_car(world, at(20.0, yaw=30.0), speed=10.0)
    world.recorder.start(tmp_path / "a.log", True, in_process=True)
    car.apply_control(VehicleControl(throttle=0.5, steer=0.3))
    world.run(0.5)
    control = replace(car.physics_control, mass=2000.0, forward_gears=[Gear(4.0, 0.2, 0.4), Gear(2.0, 0.2, 0.4)])
    for wheel in control.wheels[:2]:
        wheel.position.x += moved
    car.physics_control = control
    world.run(1.0)
    world.close()
    again = flat_world()
    again.replay_file(tmp_path / "a.log", start=start)
    again.run(1.0)
    replayed = played(again, car.id)
    found = replayed.physics_control
    assert (found.mass, [gear.ratio for gear in found.forward_gears]) == (2000.0, [4.0, 2.0])
    for place, wheel in zip(control.wheels, found.wheels, strict=True):
        assert (wheel.position.x, wheel.position.y) == pytest.approx((place.position.x, place.position.y), abs=0.1)
