"""What a recorder writes about a world, where, and what happens when something goes wrong."""

from __future__ import annotations

import gc
import os
import re
import resource
import signal
import subprocess
import sys
import textwrap
import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

import carla_recap
from carla_recap import formats
from carla_recap.errors import RecapError, RecapWarning
from carla_recap.formats.carla_log import is_log
from carla_recap.model.frame import Frame
from carla_recap.model.records import NO_ACTOR, ActorKind
from carla_recap.sim.actors.moving import VehicleControl, WalkerControl
from carla_recap.sim.episode import Collision
from carla_recap.sim.errors import DestinationError
from carla_recap.sim.geometry import Location, Transform, Vector
from carla_recap.sim.recording.recorder import recording_path, recordings_folder
from carla_recap.sim.settings import PRESETS
from carla_recap.sim.world import World
from tests.sim.flat import at, flat_town, flat_world, lit_world, spawn_car, spawn_walker
from tests.sim.recordings import disk_of, frames, handed_over, record, run_until_it_fails, writer_pid
from tests.waiting import PATIENCE, time_limit, wait_until


def command(script: str, *arguments: object) -> list[str]:
    """Return the command that runs a script in another interpreter."""
    return [sys.executable, "-c", textwrap.dedent(script), *map(str, arguments)]


def named(frame: Frame, name: str) -> list[dict[str, Any]]:
    return [dict(zip(frame[name].dtype.names, row, strict=True)) for row in frame[name].tolist()]


# --- what is recorded --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("additional_data", "first", "later"),
    [
        (False, [20, 2, 3, 4, 5, 23, 6, 7, 8, 9, 10, 21, 22, 24, 1], [20, 2, 3, 4, 5, 23, 6, 7, 8, 9, 10, 21, 22, 1]),
        (
            True,
            [20, 2, 3, 4, 5, 23, 6, 7, 8, 9, 10, 21, 22, 24, 12, 13, 17, 14, 15, 16, 19, 1],
            [20, 2, 3, 4, 5, 23, 6, 7, 8, 9, 10, 21, 22, 12, 13, 14, 19, 1],
        ),
    ],
)
def test_packets_stand_in_the_order_of_carla(
    tmp_path: Path, additional_data: bool, first: list[int], later: list[int]
) -> None:
    world = lit_world()
    spawn_car(world, at(10.0))
    found = record(world, tmp_path / "a.log", 2, additional_data=additional_data)
    assert [packet.id for packet in found[0].packets] == first
    assert [packet.id for packet in found[1].packets] == later


@pytest.mark.parametrize("suffix", [".log", ".mcap"])
def test_frames_count_from_1_and_time_from_0_and_the_last_one_has_no_duration(tmp_path: Path, suffix: str) -> None:
    world = flat_world()
    world.run(1.0)
    world.recorder.start(tmp_path / f"a{suffix}", True, in_process=True)
    deltas = (0.05, 0.1, np.float32(0.25), 0.3)
    for delta in deltas:
        world.tick(delta)  # type: ignore[arg-type]
    world.close()
    found = frames(tmp_path / f"a{suffix}")
    assert [frame.id for frame in found] == [1, 2, 3, 4]
    assert [frame.duration for frame in found] == [*deltas[1:], -1]
    assert found[0].elapsed == 0
    for frame, following in pairwise(found):
        assert frame.elapsed + frame.duration == following.elapsed
    assert [frame["platform_time"]["seconds"][0] for frame in found] == [frame.elapsed for frame in found]
    assert found[0]["visual_time"]["seconds"][0] == pytest.approx(1.05)


def test_the_first_frame_has_all_actors(tmp_path: Path) -> None:
    world = lit_world()
    hero = spawn_car(world, at(20.0), role_name="hero")
    camera = world.spawn("sensor.camera.rgb", Transform(Location(1.0, 0.0, 2.0)), parent=hero)
    barrel = world.spawn("static.prop.barrel", at(80.0))
    person = spawn_walker(world, at(50.0, 5.0, z=0.9))
    world.tick()
    first, second = record(world, tmp_path / "a.log", 2, additional_data=True)
    assert [spawn.id for spawn in first["spawned"]] == list(world.actors)
    spawns = {spawn.id: spawn for spawn in first["spawned"]}
    assert [spawns[id].kind for id in (1, 2, hero.id, camera.id, barrel.id, person.id)] == [
        ActorKind.OTHER,
        ActorKind.TRAFFIC_LIGHT,
        ActorKind.VEHICLE,
        ActorKind.SENSOR,
        ActorKind.OTHER,
        ActorKind.WALKER,
    ]
    assert (spawns[2].x, spawns[2].y, spawns[2].yaw) == (10_000, 300, -90)
    assert spawns[hero.id].attribute("role_name") == "hero"
    assert {a.key: a.type for a in spawns[hero.id].attributes}["number_of_wheels"] == 1
    assert spawns[hero.id].uid == hero.blueprint.uid
    assert (spawns[camera.id].x, spawns[camera.id].z) == (100, 200)
    assert first["parented"].tolist() == [(camera.id, hero.id)]
    assert [row["id"] for row in named(first, "bounding_boxes")] == [hero.id, barrel.id, person.id]
    assert named(first, "bounding_boxes")[0]["extent_x"] == pytest.approx(hero.box.extent.x * 100)
    assert [physics.id for physics in first["physics"]] == [hero.id]
    assert first["light_times"].tolist() == [(2, 10, 3, 2), (3, 10, 3, 2)]
    assert first["trigger_volumes"].tolist() == [(id, 9500, 0, 100, 175, 175, 100) for id in (2, 3)]
    assert [row["sun_altitude_angle"] for row in named(first, "weather")] == [45]
    for name in ("spawned", "parented", "bounding_boxes", "physics", "light_times", "trigger_volumes", "weather"):
        assert len(second[name]) == 0, name


def test_actors_that_come_and_go_are_recorded_when_they_do(tmp_path: Path) -> None:
    world = flat_world()
    early = spawn_car(world, at(10.0))
    early.destroy()
    stays = spawn_car(world, at(10.0))
    world.recorder.start(tmp_path / "a.mcap", True, in_process=True)
    world.tick()
    late = spawn_car(world, at(30.0))
    sensor = world.spawn("sensor.other.collision", Transform(Location(1.0)), parent=late)
    world.tick()
    world.tick()
    late.destroy()
    world.tick()
    world.close()
    found = frames(tmp_path / "a.mcap")
    assert [[spawn.id for spawn in frame["spawned"]] for frame in found] == [[1, stays.id], [late.id, sensor.id], [], []]
    assert found[1]["spawned"][1].x == 100
    assert [frame["parented"].tolist() for frame in found] == [[], [(sensor.id, late.id)], [], []]
    assert [frame["destroyed"]["id"].tolist() for frame in found] == [[], [], [], [sensor.id, late.id]]
    assert [len(frame["physics"]) for frame in found] == [1, 1, 0, 0]
    assert [frame["transforms"]["id"].tolist() for frame in found] == [
        [1, stays.id],
        *[[1, stays.id, late.id]] * 2,
        [1, stays.id],
    ]


def test_events_between_the_last_tick_and_the_start_are_recorded_once(tmp_path: Path) -> None:
    world = lit_world()
    hero = spawn_car(world, at(20.0))
    world.tick()
    camera = world.spawn("sensor.camera.rgb", Transform(), parent=hero)
    hero.set_door(0, True)
    hero.physics_control = hero.physics_control
    world.traffic_lights[0].green_time = 7.0
    world.recorder.start(tmp_path / "a.log", True, in_process=True)
    hero.set_door(1, True)
    other = spawn_car(world, at(40.0))
    world.tick()
    world.close()
    (first,) = frames(tmp_path / "a.log")
    assert [spawn.id for spawn in first["spawned"]] == [1, 2, 3, hero.id, camera.id, other.id]
    assert first["parented"].tolist() == [(camera.id, hero.id)]
    assert first["doors"].tolist() == [(hero.id, 0, 1), (hero.id, 1, 1)]
    assert [physics.id for physics in first["physics"]] == [hero.id, other.id]
    assert first["light_times"]["green"].tolist() == [7, 10]


def test_what_listeners_do_is_recorded_in_the_next_frame(tmp_path: Path) -> None:
    world = lit_world()
    world.listeners.append(lambda: spawn_car(world, at(10.0 * world.frame)))
    counts = [(len(frame["spawned"]), len(frame["transforms"])) for frame in record(world, tmp_path / "a.mcap", 3)]
    placed = counts[0][1]
    assert counts[1:] == [(1, placed + 1), (1, placed + 2)]


@pytest.mark.parametrize(("name", "wide"), [("a.mcap", False), ("a.mcap", True), ("a.log", True)])
def test_poses_controls_and_velocities(tmp_path: Path, name: str, wide: bool) -> None:
    world = lit_world()
    person, hero = spawn_walker(world, at(50.0, 5.0, z=0.9)), spawn_car(world, at(20.0))
    hero.light_state = 0b1010
    hero.apply_control(VehicleControl(throttle=0.75, steer=0.125, hand_brake=False))
    person.apply_control(WalkerControl(Vector(0.0, 1.0, 0.0), 1.5))
    last = record(world, tmp_path / name, 20, additional_data=True, wide=wide)[-1]
    precise = 0 if wide else 1e-3
    rows = {row["id"]: row for row in named(last, "transforms")}
    assert list(rows) == [1, person.id, hero.id]
    for actor in (person, hero):
        place, turn = actor.transform.location, actor.transform.rotation
        expected = (place.x * 100, place.y * 100, place.z * 100, turn.roll, turn.pitch, turn.yaw)
        found = [rows[actor.id][key] for key in ("x", "y", "z", "roll", "pitch", "yaw")]
        assert found == pytest.approx(expected, abs=precise, rel=1e-15)
    (control,) = named(last, "vehicle_controls")
    assert (control["steer"], control["throttle"], control["brake"]) == (0.125, 0.75, 0)
    assert control["gear"] == hero.control.gear
    assert last["vehicle_lights"].tolist() == [(hero.id, 0b1010)]
    green = world.traffic_lights[0]
    assert last["light_states"].tolist()[0] == (green.id, 0, pytest.approx(green.elapsed_time), 2)
    velocities = {row["id"]: row for row in named(last, "velocities")}
    assert list(velocities) == [hero.id, person.id]
    assert velocities[hero.id]["x"] == pytest.approx(hero.velocity.x)
    assert velocities[hero.id]["angular_z"] == pytest.approx(hero.angular_velocity.z)
    assert velocities[person.id]["y"] == pytest.approx(1.5)
    assert last["walker_controls"].tolist() == [(person.id, 150)]


def test_changes_are_recorded_when_they_happen(tmp_path: Path) -> None:
    world = lit_world()
    hero = spawn_car(world, at(20.0))
    world.recorder.start(tmp_path / "a.mcap", True, in_process=True)
    world.tick()
    world.weather = PRESETS["HardRainNoon"]
    hero.set_door(2, True)
    world.tick()
    control = hero.physics_control
    control.mass = 1234.0
    hero.physics_control = control
    hero.set_door(2, False)
    world.traffic_lights[1].red_time = 9.0
    world.tick()
    world.tick()
    world.close()
    found = frames(tmp_path / "a.mcap")
    assert [[row["precipitation"] for row in named(frame, "weather")] for frame in found] == [[0], [100], [], []]
    assert [frame["doors"].tolist() for frame in found] == [[], [(hero.id, 2, 1)], [(hero.id, 2, 0)], []]
    assert [[physics.mass for physics in frame["physics"]] for frame in found][1:] == [[], [1234], []]
    assert [frame["light_times"].tolist() for frame in found][1:] == [[], [(3, 10, 3, 9)], []]


def test_collisions_are_numbered_from_0_in_each_recording(tmp_path: Path) -> None:
    world = flat_world(barriers=[np.array([[60.0, -5.0, 0.0], [60.0, 5.0, 0.0]])])
    hero, other = spawn_car(world, at(20.0), role_name="hero"), spawn_car(world, at(30.0))
    hero.set_target_velocity(Vector(15.0))
    found = record(world, tmp_path / "a.mcap", 60)
    collided = [tuple(row) for frame in found for row in frame["collisions"].tolist()]
    assert [number for number, *_ in collided] == list(range(len(collided)))
    assert {tuple(rest) for _, *rest in collided} == {(hero.id, other.id, 1, 0)}
    other.destroy()
    hero.transform = at(50.0)
    hero.set_target_velocity(Vector(15.0))
    collided = [tuple(row) for frame in record(world, tmp_path / "b.mcap", 20) for row in frame["collisions"].tolist()]
    assert collided[0] == (0, hero.id, NO_ACTOR, 1, 0)


def record_a_drive(path: Path) -> bytes:
    world = lit_world()
    for x in (10.0, 30.0, 50.0):
        spawn_car(world, at(x)).set_autopilot(True)
    spawn_walker(world, at(50.0, 5.0, z=0.9)).apply_control(WalkerControl(Vector(1.0), 1.0))
    world.settings.collisions_of = "all"
    for _ in range(20):  # a pile-up
        world.place("vehicle.audi.tt", at(*world.random.uniform((300.0, -9.0, -180.0), (330.0, 9.0, 180.0))))
    record(world, path, 150, additional_data=True)
    return path.read_bytes()


_DRIVE = """
    import sys
    from pathlib import Path
    from tests.sim.recording.test_recorder import record_a_drive
    for path in map(Path, sys.argv[1:]):
        record_a_drive(path)
"""


def test_the_same_seed_and_steps_give_the_same_bytes_in_any_process_and_both_formats_hold_the_same(tmp_path: Path) -> None:
    paths = [tmp_path / f"theirs{suffix}" for suffix in (".mcap", ".log")]
    subprocess.run(command(_DRIVE, *paths), check=True, env={**os.environ, "PYTHONHASHSEED": "1"})
    ours = [record_a_drive(tmp_path / f"ours{path.suffix}") for path in paths]
    assert [path.read_bytes() for path in paths] == ours
    carla_recap.convert(tmp_path / "ours.mcap", tmp_path / "converted.log")
    assert (tmp_path / "converted.log").read_bytes() == ours[1]


# --- where it goes, and until when -------------------------------------------------------------------------------------


def test_names_go_to_the_folder_of_recordings_and_paths_do_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CARLA_RECAP_RECORDINGS", raising=False)
    assert str(recordings_folder()) == "recordings"
    monkeypatch.setenv("CARLA_RECAP_RECORDINGS", str(tmp_path / "of the environment"))
    assert recording_path("crash.log") == tmp_path / "of the environment" / "crash.log"
    assert recording_path("crash.log", tmp_path) == tmp_path / "crash.log"
    for path in ("./crash.log", "a/crash.log", r"a\crash.log", str(tmp_path / "crash.log")):
        assert str(recording_path(path, tmp_path / "b")) == path.removeprefix("./")
    for path in (r"c:\recordings\crash.log", "C:crash.log", "D:/crash.log"):
        assert recording_path(path, tmp_path) == (Path(path) if os.name == "nt" else tmp_path / "crash.log")
    with pytest.raises(RecapError, match="expected the name of a recording"):
        recording_path("")


def test_the_folder_of_recordings_and_those_below_it_are_made_and_others_are_not(tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    world = World(flat_town(), recordings=folder)
    for name, path in (("crash", "crash.mcap"), ("v.log", "v.log"), (folder / "a" / "b" / "crash.log", "a/b/crash.log")):
        assert world.start_recorder(name) == folder / path
    world.tick()
    world.close()
    assert len(frames(folder / "a" / "b" / "crash.log")) == 1
    assert sorted(path.name for path in folder.iterdir()) == ["a", "crash.mcap", "v.log"]
    for path in (tmp_path / "absent" / "a.mcap", folder / ".." / "absent" / "a.mcap"):
        with pytest.raises(DestinationError, match="No such file or directory"):
            world.start_recorder(path)
    (tmp_path / "file").touch()
    with pytest.raises(RecapError, match="the folder of recordings cannot be made: Not a directory"):
        World(flat_town(), recordings=tmp_path / "file" / "x").start_recorder("a")
    assert world.recorder.path is None
    world.tick()


@pytest.mark.parametrize("name", ["manual_recording.rec", "run_0.9.16", "x.LOG"])
def test_any_other_suffix_records_the_format_of_carla_under_that_very_name(tmp_path: Path, name: str) -> None:
    with World(flat_town(), recordings=tmp_path) as world:
        assert world.recorder.start(name, in_process=True) == tmp_path / name
        world.tick()
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert is_log((tmp_path / name).read_bytes())
    assert len(frames(tmp_path / name)) == 1


@pytest.mark.parametrize("suffix", [".mcap", ".log"])
def test_a_visible_recording_is_complete_at_every_moment(
    tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(formats, "_PATIENCE", 0.1)
    world, path = flat_world(), tmp_path / f"a{suffix}"
    record(world, path, 3)
    world.recorder.start(path, visible=True)
    world.run(12.0)
    with pytest.warns(RecapWarning, match="is being recorded, or was interrupted"):
        assert frames(path) == []
    if suffix == ".mcap":
        with path.open("rb") as file:
            assert make_reader(file).get_summary() is not None
    world.stop_recorder()
    assert len(frames(path)) == 240
    assert list(tmp_path.iterdir()) == [path]


def test_a_visible_recording_whose_writer_is_killed_is_recovered_from_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    world, done = flat_world(), handed_over(monkeypatch)
    path = world.recorder.start(tmp_path / "a.log", visible=True)
    world.run(12.0)
    wait_until(lambda: done.count("write") >= 4)
    os.kill(writer_pid(world), signal.SIGKILL)
    with pytest.warns(RecapWarning, match="the process that writes it has ended"):
        world.stop_recorder()
    (partial,) = tmp_path.iterdir()
    unfinished = f"was never finished; what was written of it until then is in {re.escape(str(partial))}"
    with pytest.raises(RecapError, match=unfinished):
        carla_recap.open_recording(path)
    with pytest.warns(RecapWarning, match=f"{unfinished}, which is recovered"):
        assert carla_recap.recover(path, path).frames >= 100
    assert len(frames(path)) >= 100


def test_a_visible_recording_that_is_being_completed_is_waited_for(tmp_path: Path) -> None:
    world = flat_world()
    path = world.recorder.start(tmp_path / "a.log", visible=True)
    world.run(1.0)
    threading.Timer(0.3, world.stop_recorder).start()
    assert len(frames(path)) == 20


@pytest.mark.parametrize("ticks", [0, 240])
def test_a_visible_recording_of_a_process_that_is_killed_is_completed(tmp_path: Path, ticks: int) -> None:
    path = tmp_path / "a.log"
    script = killed("os.kill(os.getpid(), 9)", batches=4 if ticks else 0)
    script = script.replace("world.start_recorder(Path(sys.argv[1]))", _VISIBLE).replace("12.0", f"{ticks / 20}")
    subprocess.run(command(script, path), stderr=subprocess.PIPE)
    assert len(frames(path)) > ticks - 102
    assert list(tmp_path.iterdir()) == [path]


_VISIBLE = "world.recorder.start(Path(sys.argv[1]), visible=True)"


def test_an_actor_that_no_record_can_hold_is_an_error_at_the_start_and_ends_a_recording(tmp_path: Path) -> None:
    world = flat_world()
    world.start_recorder(tmp_path / "a.mcap")
    world.tick()
    spawn_car(world, at(10.0)).attributes["role_name"] = "x" * 70_000
    with pytest.warns(RecapWarning, match="the recording has ended"):
        run_until_it_fails(world)
    with pytest.raises(RecapError):
        world.start_recorder(tmp_path / "b.log")
    assert world.recorder.path is None
    world.tick()
    assert not [path for path in tmp_path.iterdir() if path.name.startswith((".b", "b"))]


def test_a_file_appears_when_it_is_complete(tmp_path: Path) -> None:
    world = flat_world()
    path = world.start_recorder(tmp_path / "a.mcap")
    world.tick()
    assert world.recorder.path == path
    assert not path.exists()
    world.stop_recorder()
    assert len(frames(path)) == 1
    assert world.recorder.path is None
    world.stop_recorder()
    world.tick()
    assert list(tmp_path.iterdir()) == [path]


def test_another_recording_a_new_episode_and_the_end_of_the_world_complete_it(tmp_path: Path) -> None:
    world = flat_world()

    def begin(world: World, name: str, ticks: int) -> None:
        world.start_recorder(tmp_path / name)
        for _ in range(ticks):
            world.tick()

    begin(world, "a.log", 2)
    begin(world, "b.log", 3)
    assert len(frames(tmp_path / "a.log")) == 2
    begin(world, "b.log", 1)
    world.reload()
    assert len(frames(tmp_path / "b.log")) == 1
    begin(world, "c.mcap", 2)
    del world
    gc.collect()
    assert len(frames(tmp_path / "c.mcap")) == 2


_SCRIPT = """
    import os, sys, time
    from pathlib import Path
    from tests.sim.flat import flat_world
    world = flat_world()
    world.start_recorder(Path(sys.argv[1]))
    world.run(12.0)
"""


def killed(end: str, batches: int = 4) -> str:
    """Return the script with an end that kills it, once whole batches have been handed over to the process that writes."""
    waits = f"while done.count('write') < {batches}:\n    time.sleep(0.01)\n"
    return "".join((_COUNTING, textwrap.dedent(_SCRIPT), waits, textwrap.dedent(end)))


_COUNTING = """
import pytest
from tests.sim.recordings import handed_over
done = handed_over(pytest.MonkeyPatch())
"""


def test_ctrl_c_does_not_reach_the_process_that_writes(tmp_path: Path) -> None:
    script = """
        import os, signal, sys
        from pathlib import Path
        from tests.sim.flat import flat_world
        world = flat_world()
        world.start_recorder(Path(sys.argv[1]))
        world.run(1.0)
        try:
            os.killpg(0, signal.SIGINT)
            signal.pause()
        except KeyboardInterrupt:
            world.run(1.0)
    """
    done = subprocess.run(command(script, tmp_path / "a.mcap"), start_new_session=True, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(frames(tmp_path / "a.mcap")) == 40


def test_a_signal_to_the_whole_group_completes_the_recording(tmp_path: Path) -> None:
    script = killed("os.kill(world.recorder._writer.pid, 15)\nos.kill(os.getpid(), 15)")
    subprocess.run(command(script, tmp_path / "a.mcap"), stderr=subprocess.PIPE)
    assert len(frames(tmp_path / "a.mcap")) > 100
    assert list(tmp_path.iterdir()) == [tmp_path / "a.mcap"]


def test_a_writer_that_is_killed_does_not_end_a_command(tmp_path: Path) -> None:
    end = """
        import signal
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # as on the command line
        os.kill(world.recorder._writer.pid, 9)
        world.run(12.0)
        world.stop_recorder()
    """
    done = subprocess.run(command(killed(end), tmp_path / "a.mcap"), stderr=subprocess.PIPE, text=True)
    assert done.returncode == 0
    assert "the process that writes it has ended with exit code -9" in done.stderr


def test_a_killed_process_has_its_recording_completed_even_while_forked_ones_go_on_and_record(
    tmp_path: Path,
) -> None:
    path = tmp_path / "a.mcap"
    end = """
        child = os.fork()
        if not child:
            with flat_world() as another:
                another.start_recorder(Path(sys.argv[1]).with_name("b.mcap"))
                another.run(3.0)
            print(os.getpid(), flush=True)
            time.sleep(300)
            os._exit(0)
        os.kill(os.getpid(), 9)
    """
    with subprocess.Popen(command(killed(end), path), stdout=subprocess.PIPE, text=True) as process:
        child = int(process.stdout.readline())
        wait_until(path.exists)
        os.kill(child, signal.SIGKILL)
    assert len(frames(path.with_name("b.mcap"))) == 60
    found = frames(path)
    assert found[-1].elapsed > 12 - 5 - 0.1  # all but the last moments
    assert [frame.id for frame in found] == list(range(1, len(found) + 1))


def test_each_recording_has_the_umask_of_its_start(tmp_path: Path) -> None:
    before = os.umask(0o022)
    try:
        for mask, mode in ((0o077, 0o600), (0o022, 0o644)):
            os.umask(mask)
            record(flat_world(), path := tmp_path / f"{mask}.log", 1, in_process=False)
            assert path.stat().st_mode & 0o777 == mode
    finally:
        os.umask(before)


def test_a_script_without_a_guard_that_ends_completes_its_recording(tmp_path: Path) -> None:
    """What else is printed when an interpreter starts is passed over."""
    script, path = tmp_path / "script.py", tmp_path / "a.mcap"
    script.write_text(textwrap.dedent(_SCRIPT) + "print('once')\n")
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text("print('hello')")
    paths = [str(tmp_path / "site"), *filter(None, sys.path), str(Path.cwd())]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    done = subprocess.run([sys.executable, script, path], env=environment, capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stdout, done.stderr) == (0, "hello\nonce\n", "")
    assert len(frames(path)) == 240


def test_a_collision_of_a_replay_is_recorded_once_and_one_of_physics_with_the_tick_after(tmp_path: Path) -> None:
    world = flat_world()
    replayed, physical = (Collision(id, None, Location(), Vector(), False, False, 0) for id in (1, 2))
    world.episode.pending.collisions.append(replayed)
    path = tmp_path / "a.log"
    world.recorder.start(path, now=True)
    world.episode.end_tick([physical])
    world.recorder()
    world.stop_recorder()
    assert [[row[1] for row in frame["collisions"].tolist()] for frame in frames(path)] == [[1], [2]]


def record_in_a_worker(path: Path) -> int:
    return len(record(flat_world(), path, 3, in_process=False))


def test_the_workers_of_a_pool_record(tmp_path: Path) -> None:
    with get_context("spawn").Pool(1) as pool:
        assert pool.map(record_in_a_worker, [tmp_path / name for name in ("a.mcap", "b.log")]) == [3, 3]


def test_several_threads_may_stop_a_recording(tmp_path: Path) -> None:
    world = flat_world()
    for number in range(3):
        path = world.start_recorder(tmp_path / f"{number}.log")
        world.tick()
        with ThreadPoolExecutor(4) as threads:
            for stopped in [threads.submit(world.stop_recorder) for _ in range(4)]:
                stopped.result(PATIENCE)
        assert len(frames(path)) == 1


def test_modules_in_the_working_directory_are_not_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("pickle", "carla_recap", "numpy"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit(7)")
    monkeypatch.chdir(tmp_path)
    assert len(record(flat_world(), tmp_path / "a.log", 2, in_process=False)) == 2


def test_a_script_may_go_to_another_folder_while_it_records(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        world = flat_world()
        assert str(world.start_recorder("./a.log")) == "a.log"
        world.tick()
        monkeypatch.chdir(tmp_path)
        world.stop_recorder()
        assert len(frames(tmp_path / name / "a.log")) == 1


# --- trouble -----------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not hasattr(resource, "prlimit"), reason="limits of other processes are Linux's")
def test_a_full_disk_ends_the_recording_and_not_the_simulation(tmp_path: Path) -> None:
    world = flat_world()
    world.start_recorder(tmp_path / "a.mcap")
    reason = r"has ended: .*a.mcap: cannot be written: File too large; what was recorded until then is in .*\.partial"
    with disk_of(world, 60_000), pytest.warns(RecapWarning, match=reason):
        run_until_it_fails(world)
    error = world.recorder.error
    assert isinstance(error, RecapError)
    world.tick()
    world.stop_recorder()
    assert world.recorder.error is error
    (partial,) = tmp_path.iterdir()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecapWarning)
        assert carla_recap.recover(partial, tmp_path / "b.mcap").frames > 100
    assert len(record(world, tmp_path / "c.mcap", 3, in_process=False)) == 3
    assert world.recorder.error is None


def test_without_an_interpreter_nothing_is_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for executable, end in (("/absent", "No such file"), ("/bin/true", "ended with exit code 0"), ("/bin/false", "code 1")):
        monkeypatch.setattr(sys, "executable", executable)
        with pytest.raises(RecapError, match=f"the process that writes recordings cannot be started: .*{end}"):
            flat_world().start_recorder(tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def test_a_slow_disk_makes_no_tick_wait(tmp_path: Path) -> None:
    world = flat_world()
    world.start_recorder(tmp_path / "a.mcap")
    os.kill(writer_pid(world), signal.SIGSTOP)
    durations = []
    with time_limit():
        for _ in range(220):
            begin = time.monotonic()
            world.tick()
            durations.append(time.monotonic() - begin)
    os.kill(writer_pid(world), signal.SIGCONT)
    assert sorted(durations)[200] < 0.2  # a busy machine interrupts a few
    world.close()
    assert len(frames(tmp_path / "a.mcap")) == 220


@pytest.mark.parametrize(("in_process", "has_links"), [(False, True), (True, False)])
def test_what_appeared_meanwhile_stays_if_it_must(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, in_process: bool, has_links: bool
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    if not has_links:
        monkeypatch.setattr(os, "link", refuse)  # as on FAT
    world = flat_world()
    free = world.recorder.start(tmp_path / "free.mcap", force=False, in_process=in_process)
    world.stop_recorder()
    assert list(tmp_path.iterdir()) == [free]
    free.unlink()
    path = world.recorder.start(tmp_path / "a.mcap", force=False, in_process=in_process)
    world.run(1.0)
    path.write_text("mine")
    with pytest.warns(RecapWarning, match=r"File exists; what was recorded until then is in .*\.partial"):
        world.stop_recorder()
    assert path.read_text() == "mine"
    (partial,) = set(tmp_path.iterdir()) - {path}
    assert len(frames(partial)) == 20
    with pytest.raises(RecapError, match="exists already"):
        world.start_recorder(path, force=False)


@pytest.mark.parametrize("name", [".", "..", "./", "a/", "a/..", "a\\", "nul\0.log", "./folder", "./" + "x" * 300])
def test_names_that_no_recording_can_have(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    with pytest.raises(RecapError, match=r"expected the name of a recording|File name too long"):
        flat_world().start_recorder(name)
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_the_date_is_when_the_recording_begins(tmp_path, monkeypatch):
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    dates = []
    with World(flat_town()) as world:
        for now in (1_000_000_000, 1_000_000_060):
            monkeypatch.setattr("carla_recap.sim.world.time.time", lambda now=now: now)
            path = world.start_recorder(tmp_path / f"{now}.log")
            world.tick()
            world.stop_recorder()
            with carla_recap.open_recording(path) as recording:
                dates.append(int(recording.info.date.timestamp()))
    assert dates == [1_000_000_000, 1_000_000_060]
