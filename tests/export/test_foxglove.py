"""Exports to Foxglove, read back with other libraries, and the layouts for them."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mcap.reader import make_reader

from carla_recap import MissingExtra, NotARecording, RecapError, Spawn, open_recording
from carla_recap.export.foxglove import export_foxglove, layout_files
from carla_recap.model.records import UE4, ActorKind
from tests.replay.scripts import light, pose, spawn, velocity, write
from tests.samples import carla_log, names_in

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra foxglove is not installed")

from mcap_protobuf.decoder import DecoderFactory

ROOT = Path(__file__).parents[2]
CROSSING = ROOT / "samples" / "crossing.log"
NODE = ROOT / "tests" / "node"
REAL = ("carla-0.9.10-lane-center.log", "carla-0.9.13-lane-center.log")
HERO, CYCLIST, GONE, FIRST_LIGHT = 100, 105, 103, 20  # of the crossing

SCHEMAS = {
    "/scene": "foxglove.SceneUpdate",
    "/scene/still": "foxglove.SceneUpdate",
    "/map": "foxglove.SceneUpdate",
    "/tf": "foxglove.FrameTransforms",
    "/hero": "carla_recap.v1.Followed",
    "/lights": "carla_recap.v1.ShownLights",
    "/log": "foxglove.Log",
}


def export(source: Path, destination: Path, **options):
    with open_recording(source) as recording:
        return export_foxglove(recording, destination, **options)


def read(path: Path):
    """Return the messages of each topic, each with its seconds since the first one."""
    topics = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        start = reader.get_summary().statistics.message_start_time
        for found in reader.iter_decoded_messages():
            topics[found.channel.topic].append(((found.message.log_time - start) / 1e9, found.decoded_message))
    return topics


def seen(messages, until: float = math.inf):
    """Return the entities that a viewer shows after all messages until some time."""
    entities = {}
    for time, message in messages:
        if time > until + 1e-6:
            break
        for deletion in message.deletions:
            entities.pop(deletion.id, None)
        entities.update((entity.id, entity) for entity in message.entities)
    return entities


def latest(messages, time: float):
    """Return the message that a viewer shows after it has sought a time."""
    return [message for at, message in messages if at <= time + 1e-6][-1]


def xyz(vector):
    return [vector.x, vector.y, vector.z]


@pytest.fixture(scope="module")
def crossing(tmp_path_factory):
    path = tmp_path_factory.mktemp("foxglove") / "crossing.mcap"
    played = export(CROSSING, path)
    assert played == (531, pytest.approx(53))
    return read(path)


@pytest.fixture
def record(tmp_path):
    """Return a function that writes a recording of some frames, exports it and reads the export."""

    def make(*frames, tick=0.1, times=None, **options):
        source = write(tmp_path / "source.log", frames, tick=tick, times=times)
        export(source, tmp_path / "export.mcap", **options)
        return read(tmp_path / "export.mcap")

    return make


# --- the file ------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not shutil.which("node"), reason="node is not installed")
@pytest.mark.parametrize("name", ["crossing", *REAL])
def test_foxgloves_own_libraries_read_an_export(tmp_path, name):
    if not (NODE / "node_modules").is_dir():
        pytest.skip("the libraries of the independent reader are not installed: npm ci --prefix tests/node")
    export(CROSSING if name == "crossing" else carla_log(name), tmp_path / "export.mcap")
    done = subprocess.run(
        ["node", NODE / "read.mjs", tmp_path / "export.mcap"], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert {topic: entry["schema"] for topic, entry in found["topics"].items()} == SCHEMAS
    assert all(entry["count"] for entry in found["topics"].values())
    assert found["topics"]["/map"]["count"] == 1
    assert found["profile"] == ""
    assert found["library"].startswith("carla-recap/")
    (metadata,) = found["metadata"]
    assert metadata["name"] == "carla_recap.export"
    assert metadata["metadata"]["followed"] == str(found["topics"]["/hero"]["first"]["id"])


def test_an_export_is_no_recording(tmp_path):
    export(CROSSING, tmp_path / "export.mcap", duration=1)
    with pytest.raises(NotARecording):
        open_recording(tmp_path / "export.mcap")


def test_a_file_is_overwritten_only_by_force(tmp_path):
    (tmp_path / "out.mcap").write_bytes(b"precious")
    with pytest.raises(RecapError, match="exists already; --force"):
        export(CROSSING, tmp_path / "out.mcap")
    assert (tmp_path / "out.mcap").read_bytes() == b"precious"
    export(CROSSING, tmp_path / "out.mcap", duration=1, force=True)
    assert read(tmp_path / "out.mcap")["/scene"]


def test_a_failure_leaves_no_file(tmp_path):
    def fail(scenes, player):
        yield next(iter(scenes))
        raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        export(CROSSING, tmp_path / "out.mcap", progress=fail)
    assert names_in(tmp_path) == []


def test_a_missing_folder_is_an_error(tmp_path):
    with pytest.raises(RecapError, match=r"nowhere.*out\.mcap: cannot be written"):
        export(CROSSING, tmp_path / "nowhere" / "out.mcap")


def test_an_unknown_actor_to_follow_leaves_no_file(tmp_path):
    with pytest.raises(RecapError, match="no actor 7 to follow; near ids are"):
        export(CROSSING, tmp_path / "out.mcap", follow=7)
    assert names_in(tmp_path) == []


def test_progress_is_given_every_scene(tmp_path):
    times = []

    def watch(scenes, player):
        for scene in scenes:
            times.append(scene.time / player.total)
            yield scene

    export(CROSSING, tmp_path / "out.mcap", start=-2, progress=watch)
    assert (len(times), times[0], times[-1]) == (21, pytest.approx(51 / 53), 1)


def test_without_the_extra_the_error_names_what_to_install(tmp_path):
    code = f"""
import sys
sys.modules["foxglove_schemas_protobuf"] = None
from carla_recap import MissingExtra, open_recording
from carla_recap.export.foxglove import export_foxglove, layout_files
assert layout_files()
try:
    export_foxglove(open_recording({str(CROSSING)!r}), {str(tmp_path / "out.mcap")!r})
except MissingExtra as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == str(MissingExtra("an export to Foxglove", "foxglove"))
    assert names_in(tmp_path) == []


@pytest.mark.parametrize("name", ["crossing", *REAL])
@pytest.mark.parametrize("together", [1, 7])
def test_messages_do_not_depend_on_how_many_are_made_at_once(tmp_path, monkeypatch, name, together):
    source = CROSSING if name == "crossing" else carla_log(name)
    export(source, tmp_path / "many.mcap", duration=15)
    monkeypatch.setattr("carla_recap.export.foxglove.writer._TOGETHER", together)
    export(source, tmp_path / "few.mcap", duration=15)
    many, few = (_serialized(tmp_path / f"{name}.mcap") for name in ("many", "few"))
    assert many == few


def _serialized(path):
    with path.open("rb") as file:
        return [(channel.topic, message.log_time, message.data) for _, channel, message in make_reader(file).iter_messages()]


# --- the scene -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("time", [0.3, 10.0, 24.7, 53.0])
def test_actors_have_their_recorded_poses(crossing, time):
    with open_recording(CROSSING) as recording:
        trajectory = recording.trajectory(HERO)
        box = recording.actors[HERO].bounding_box
    row = int(np.argmin(np.abs(trajectory.time - time)))
    entities = {**seen(crossing["/scene/still"], time), **seen(crossing["/scene"], time)}
    cube = entities[f"actor {HERO}"].cubes[0]
    place = [trajectory.x[row], trajectory.y[row], trajectory.z[row] + box.z]
    assert xyz(cube.pose.position) == pytest.approx(place, abs=1e-4)
    yaw = 2 * math.atan2(cube.pose.orientation.z, cube.pose.orientation.w)
    assert math.remainder(yaw - math.radians(trajectory.yaw[row]), 2 * math.pi) == pytest.approx(0, abs=1e-5)
    assert xyz(cube.size) == pytest.approx([2 * box.extent_x, 2 * box.extent_y, 2 * box.extent_z])


@pytest.mark.parametrize("name", REAL)
def test_actors_of_real_recordings_have_their_recorded_poses(tmp_path, name):
    source = carla_log(name)
    export(source, tmp_path / "export.mcap", follow="hero")
    topics = read(tmp_path / "export.mcap")
    with open_recording(source) as recording:
        (hero,) = recording.heroes
        trajectory = recording.trajectory(hero.id)
    for time, message in topics["/scene"]:
        for entity in message.entities:
            if entity.id == f"actor {hero.id}":
                cube = entity.cubes[0]
                x, y = (np.interp(time, trajectory.time, getattr(trajectory, axis)) for axis in "xy")
                assert math.dist((cube.pose.position.x, cube.pose.position.y), (x, y)) < 0.1
    assert f"actor {hero.id}" not in seen(topics["/scene"])
    times = [message.elapsed for _, message in topics["/hero"]]
    np.testing.assert_allclose(times, trajectory.time[: len(times)])
    assert len(times) >= len(trajectory.time) - 1


def test_a_box_with_a_center_turns_with_its_actor(record):
    box = (1, 100, 50, 75, 200, 100, 75)  # cm, left-handed: the middle is 1 m ahead and 0.5 m to the right
    frames = [{"spawned": [spawn(1)], "transforms": [pose(1)], "bounding_boxes": [box]}]
    frames += [{"transforms": [pose(1, x=1000 * n, y=200, yaw=90)]} for n in range(1, 3)]
    topics = record(*frames)
    cube = seen(topics["/scene"])["actor 1"].cubes[0]
    assert xyz(cube.pose.position) == pytest.approx([20 - 0.5, -2 - 1, 0.75])
    assert xyz(cube.size) == pytest.approx([4, 2, 1.5])


def test_a_destroyed_actor_is_deleted_at_its_time(crossing):
    (time,) = [time for time, message in crossing["/scene"] for gone in message.deletions if gone.id == f"actor {GONE}"]
    assert time == pytest.approx(27.0)
    assert f"actor {GONE}" in seen(crossing["/scene"], 26.9)
    assert f"actor {GONE}" not in seen(crossing["/scene"], 27.0)


@pytest.mark.parametrize("time", [0.0, 12.0, 24.7, 37.0, 53.0])
def test_seeking_shows_the_same_as_playing(crossing, time):
    for topic in ("/scene", "/scene/still"):
        sought = seen([(0, latest(crossing[topic], time))])
        assert sought == seen(crossing[topic], time)


@pytest.mark.parametrize("time", [0.0, 12.0, 24.7, 37.0, 53.0])
def test_every_actor_with_a_body_is_on_one_of_the_topics(crossing, time):
    from carla_recap.replay import Player

    with open_recording(CROSSING) as recording:
        there = {f"actor {id}" for id, actor in Player(recording).at(time).actors.items() if actor.kind != ActorKind.SENSOR}
    moved, still = seen(crossing["/scene"], time), seen(crossing["/scene/still"], time)
    assert moved.keys() | still.keys() == there
    assert not moved.keys() & still.keys()


def test_an_actor_that_stands_still_is_not_repeated(crossing):
    barrel = [time for time, message in crossing["/scene"] for entity in message.entities if entity.id == "actor 11"]
    assert not barrel
    assert len(crossing["/scene/still"]) < 60


def test_an_actor_that_starts_to_move_changes_the_topic(record):
    xs = [0, 0.2, 0.4, 50, 100, 100]
    topics = record(*({"spawned": [spawn(1)] if n == 0 else [], "transforms": [pose(1, x=x)]} for n, x in enumerate(xs)))
    assert [time for time, _ in topics["/scene/still"]] == pytest.approx([0, 0.3])
    assert topics["/scene/still"][1][1].deletions[0].id == "actor 1"
    assert not seen(topics["/scene/still"])
    found = [message.entities[0].cubes[0].pose.position.x for _, message in topics["/scene"] if message.entities]
    assert found == pytest.approx([0.5, 1, 1])


def test_an_entity_has_the_metadata_of_its_actor(crossing):
    entity = seen(crossing["/scene"])[f"actor {HERO}"]
    metadata = {pair.key: pair.value for pair in entity.metadata}
    assert metadata == {"actor": "hero 100", "type_id": "vehicle.tesla.model3", "role_name": "hero"}
    assert entity.frame_id == "world"
    assert [round(255 * part) for part in (entity.cubes[0].color.r, entity.cubes[0].color.g)] == [255, 176]


def test_entities_have_the_time_of_their_message(crossing):
    for time, message in crossing["/scene"][100:200]:
        stamps = {entity.timestamp.ToNanoseconds() for entity in message.entities}
        assert len(stamps) == 1
        start = crossing["/log"][0][1].timestamp.ToNanoseconds()
        assert stamps.pop() - start == pytest.approx(time * 1e9, abs=2)


def test_an_id_that_is_used_again_is_another_actor(record):
    topics = record(
        {"spawned": [spawn(1)], "transforms": [pose(1)]},
        {"transforms": [pose(1, x=100)]},
        {"destroyed": [1]},
        {"spawned": [spawn(1, "walker.pedestrian.0001", x=900)], "transforms": [pose(1, x=900)]},
        {"transforms": [pose(1, x=900)]},
    )
    assert not seen(topics["/scene"])
    (walker,) = seen(topics["/scene/still"]).values()
    assert {pair.key: pair.value for pair in walker.metadata}["type_id"] == "walker.pedestrian.0001"
    assert walker.cubes[0].size.z == pytest.approx(1.86)


def test_an_actor_without_a_spawn_is_shown(record):
    topics = record(*({"transforms": [pose(5, x=100 * n)]} for n in range(3)))
    assert list(seen(topics["/scene"])) == ["actor 5"]


def test_a_box_that_is_not_recorded_is_faint(record):
    bag = Spawn(2, ActorKind.OTHER, type_id="static.prop.bag")
    topics = record({"spawned": [spawn(1), bag], "transforms": [pose(1), pose(2)]})
    entities = seen(topics["/scene/still"])
    assert [entities[f"actor {id}"].cubes[0].color.a for id in (1, 2)] == [1.0, 0.35]


def test_an_attached_actor_moves_with_its_parent(record):
    bag = Spawn(2, ActorKind.OTHER, x=-100, type_id="static.prop.bag")
    frames = [{"spawned": [spawn(1), bag], "parented": [(2, 1)]}, {}, {}]
    topics = record(*({**frame, "transforms": [pose(1, x=1000 * n)]} for n, frame in enumerate(frames)))
    assert seen(topics["/scene"])["actor 2"].cubes[0].pose.position.x == pytest.approx(19)


def test_an_actor_at_nan_is_not_shown(record):
    xs = [0, 100, math.nan, 300]
    topics = record(
        *({"spawned": [spawn(1)] if n == 0 else [], "transforms": [pose(1, x=x)]} for n, x in enumerate(xs)), follow=1
    )
    assert [bool(seen(topics["/scene"], n / 10)) for n in range(4)] == [False, True, False, True]
    assert [message.x for _, message in topics["/hero"]] == [0, 1, 3]
    assert [message.transforms[0].translation.x for _, message in topics["/tf"]] == [0, 1, 1, 3]


def test_an_actor_ten_thousand_kilometres_away_is_not_shown(record):
    xs = [0, 1e9, 9.99e8]
    topics = record(*({"spawned": [spawn(1)] if n == 0 else [], "transforms": [pose(1, x=x)]} for n, x in enumerate(xs)))
    shown = [{**seen(topics["/scene"], n / 10), **seen(topics["/scene/still"], n / 10)} for n in range(3)]
    assert [bool(entities) for entities in shown] == [True, False, True]


def test_an_actor_that_stands_still_is_shown_once_its_location_is_a_number(record):
    xs = [math.nan, 100, 100]
    topics = record(*({"spawned": [spawn(1)] if n == 0 else [], "transforms": [pose(1, x=x)]} for n, x in enumerate(xs)))
    assert [bool(seen(topics["/scene/still"], n / 10)) for n in range(3)] == [False, True, True]


@pytest.mark.parametrize(
    "name", ["times.log", "physics_0910.log", "events.log", "collisions.log", "all_packets.log", "floats.log"]
)
def test_odd_recordings_are_exported(tmp_path, name):
    export(carla_log(name), tmp_path / "export.mcap")
    for topic in ("/scene", "/scene/still"):
        for _, message in read(tmp_path / "export.mcap")[topic]:
            for entity in message.entities:
                for shape in (*entity.cubes, *entity.spheres):
                    assert np.isfinite([*xyz(shape.pose.position), shape.pose.orientation.w]).all()


def test_a_fast_recording_is_thinned_except_for_the_followed_actor(record):
    times = [n / 100 for n in range(101)]
    frames = [{"spawned": [spawn(1)] if n == 0 else [], "transforms": [pose(1, x=10 * n)]} for n in range(101)]
    frames[33]["spawned"] = [spawn(2)]
    topics = record(*frames, times=times)
    assert 15 <= len(topics["/tf"]) <= 24
    assert len(topics["/hero"]) == 101
    assert 0.33 in [time for time, _ in topics["/scene/still"]]
    assert topics["/scene"][-1][0] == pytest.approx(1.0)


def test_a_recording_of_empty_frames_is_exported(record):
    topics = record({}, {}, {})
    assert set(topics) == set(SCHEMAS) - {"/hero"}
    (transform,) = topics["/tf"][-1][1].transforms
    assert transform.child_frame_id == "followed"


# --- lights --------------------------------------------------------------------------------------------------------


def lamp(entity):
    (pair,) = [pair.value for pair in entity.metadata if pair.key == "state"]
    return pair, [round(255 * getattr(entity.spheres[0].color, part)) for part in "rgb"]


def test_lamps_have_the_colour_of_their_state(crossing):
    with open_recording(CROSSING) as recording:
        states = recording.light_states(FIRST_LIGHT)
    for time in (0.0, 8.0, 30.0):
        state = states.state[int(np.argmin(np.abs(states.time - time)))]
        name, color = lamp(seen(crossing["/scene/still"], time)[f"actor {FIRST_LIGHT}"])
        assert name == ("red", "yellow", "green")[state]
        assert color == [[235, 50, 45], [245, 200, 40], [50, 205, 90]][state]
        told = latest(crossing["/lights"], time)
        assert [light.state for light in told.lights if light.id == FIRST_LIGHT] == [state]


def test_lights_are_written_when_they_change_and_at_the_end(record):
    states = [0, 0, 2, 2, 2]
    topics = record(
        *(
            {"spawned": [spawn(9, "traffic.traffic_light")] if n == 0 else [], "light_states": [light(9, state)]}
            for n, state in enumerate(states)
        )
    )
    assert [(time, told.lights[0].state) for time, told in topics["/lights"]] == [
        (0, 0),
        (pytest.approx(0.2), 2),
        (pytest.approx(0.4), 2),
    ]
    assert topics["/lights"][0][1].lights[0].entity in seen(topics["/scene/still"])


def test_the_light_ahead_is_the_nearest_in_front(record):
    lights = [spawn(id, "traffic.traffic_light", x=x) for id, x in ((8, 3000), (9, 5000), (10, 30_000))]
    states = [light(8, 0), light(9, 2), light(10, 1)]
    frames = [
        {"spawned": [spawn(1), *lights] if n == 0 else [], "transforms": [pose(1, x=x)], "light_states": states}
        for n, x in enumerate((0, 2000, 4000, 6000))
    ]
    topics = record(*frames, follow=1)
    told = [latest(topics["/lights"], n / 10).ahead for n in range(4)]
    assert [(one.id, one.state) for one in told] == [(8, 0), (8, 0), (9, 2), (0, 4)]


# --- the followed actor --------------------------------------------------------------------------------------------


def test_the_followed_actor_has_its_trajectory_and_controls(crossing):
    with open_recording(CROSSING) as recording:
        trajectory, controls = recording.trajectory(HERO), recording.controls(HERO)
    rows = [message for _, message in crossing["/hero"]]
    assert {(row.id, row.type_id) for row in rows} == {(HERO, "vehicle.tesla.model3")}
    for axis in ("x", "y", "z", "yaw"):
        np.testing.assert_allclose([getattr(row, axis) for row in rows], getattr(trajectory, axis), atol=1e-9)
    for name in ("throttle", "brake", "steer", "gear", "hand_brake"):
        assert [getattr(row, name) for row in rows] == getattr(controls, name).tolist()
    speeds = np.array([row.speed for row in rows[1:]])
    np.testing.assert_allclose(speeds, trajectory.speed[1:], atol=0.5)
    np.testing.assert_allclose([row.speed_kmh for row in rows[1:]], speeds * 3.6)


def test_the_recorded_speed_is_used(record):
    topics = record(
        *(
            {"spawned": [spawn(1)] if n == 0 else [], "transforms": [pose(1, x=n)], "velocities": [velocity(1, 7.5)]}
            for n in range(3)
        ),
        follow=1,
    )
    assert [message.speed for _, message in topics["/hero"]] == [7.5, 7.5, 7.5]


def test_a_jump_is_no_speed(record):
    xs = [0, 100, 90_000, 90_100]
    topics = record(
        *({"spawned": [spawn(1)] if n == 0 else [], "transforms": [pose(1, x=x)]} for n, x in enumerate(xs)), follow=1
    )
    told = [message.speed if message.HasField("speed") else None for _, message in topics["/hero"]]
    assert told == [None, pytest.approx(10), None, pytest.approx(10)]


def test_the_followed_frame_is_level_and_calm(record):
    yaws = [0, 90, 90, 90, 90, 90, 90]
    topics = record(
        *(
            {
                "spawned": [spawn(1, role_name="hero")] if n == 0 else [],
                "transforms": [pose(1, x=100 * n, roll=20, pitch=10, yaw=yaw)],
            }
            for n, yaw in enumerate(yaws)
        )
    )
    views, heroes = zip(*([*message.transforms] for _, message in topics["/tf"]), strict=True)
    assert {view.child_frame_id for view in views} == {"followed"}
    assert {hero.child_frame_id for hero in heroes} == {"hero"}
    assert {frame.parent_frame_id for frame in (*views, *heroes)} == {"world"}
    assert all(abs(view.rotation.x) + abs(view.rotation.y) < 1e-12 for view in views)
    headings = [-2 * math.degrees(math.atan2(view.rotation.z, view.rotation.w)) for view in views]
    assert headings[0] == pytest.approx(0)
    assert headings == sorted(headings)
    assert 5 < headings[1] < 45 < headings[-1] < 90
    assert [view.translation.x for view in views] == pytest.approx(range(7))
    assert abs(heroes[0].rotation.x) > 0.1


def test_another_actor_can_be_followed(tmp_path):
    export(CROSSING, tmp_path / "out.mcap", follow=101, duration=5)
    topics = read(tmp_path / "out.mcap")
    assert {message.id for _, message in topics["/hero"]} == {101}
    view, hero = topics["/tf"][-1][1].transforms
    assert xyz(view.translation) != pytest.approx(xyz(hero.translation), abs=1)


# --- events --------------------------------------------------------------------------------------------------------


def test_the_log_has_each_contact_once(crossing):
    told = [(round(time, 3), line.message) for time, line in crossing["/log"] if line.name == "collisions"]
    assert told == [
        (20.9, "vehicle.bh.crossbike (105) collides with walker.pedestrian.0004 (110)"),
        (24.6, "vehicle.tesla.model3 (100) collides with vehicle.audi.a2 (101)"),
    ]
    levels = {line.message: line.level for _, line in crossing["/log"]}
    assert [levels[text] for _, text in told] == [3, 4]


def test_the_log_begins_with_the_present_actors(crossing):
    assert crossing["/log"][0][1].message == "10 actors are there: 4 traffic lights, 4 vehicles, 2 others"


def test_the_log_has_spawns_and_destructions(crossing):
    lines = [(time, line.message) for time, line in crossing["/log"] if line.name == "actors" and line.level == 2]
    assert (pytest.approx(10.0), "vehicle.bh.crossbike (105) appears") in lines
    assert (pytest.approx(27.0), "vehicle.nissan.micra (103) disappears") in lines


def test_many_spawns_and_destructions_are_counted(record):
    crowd = range(10, 20)
    topics = record(
        {},
        {"spawned": [spawn(id, "walker.pedestrian.0001") for id in crowd]},
        {"destroyed": list(crowd)},
    )
    assert [line.message for _, line in topics["/log"]] == [
        "0 actors are there",
        "10 actors appear: 10 walkers",
        "10 actors disappear: 10 walkers",
    ]


# --- the map -------------------------------------------------------------------------------------------------------


def test_the_map_is_written_at_the_beginning(record):
    line = np.array([(0, 0, 0), (10, 0, 0), (20, 5, 1)], float)
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 0, 0)], float)
    roads = SimpleNamespace(
        name="here", lane_borders=[line, line + 1], centre_lines=[line], junctions=[square], crossings=[], stop_lines=[]
    )
    topics = record({}, {}, road_map=roads)
    ((time, message),) = topics["/map"]
    assert time == 0
    entities = {entity.id: entity.lines[0] for entity in message.entities}
    assert [xyz(point) for point in entities["centre lines"].points] == [[0, 0, 0], [10, 0, 0], [10, 0, 0], [20, 5, 1]]
    assert {name: len(lines.points) for name, lines in entities.items()} == {
        "lane borders": 8,
        "centre lines": 4,
        "junctions": 6,
        "crossings": 0,
        "stop lines": 0,
    }


# --- the layouts ---------------------------------------------------------------------------------------------------


def panels(layout):
    """Return kind and settings of the panels of a layout, in either form, in the order in which they are seen."""
    if "configById" in layout:
        return [(id.split("!")[0], layout["configById"][id]) for id in leaves(layout["layout"])]
    return [*contents(layout["content"])]


def leaves(node):
    return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])


def contents(node):
    if node["type"] == "split":
        for item in node["items"]:
            yield from contents(item["content"])
    else:
        assert node["type"] == "panel"
        yield node["panelType"], {**node["config"], "foxglovePanelTitle": node["title"]}


def texts(value):
    """Return all texts within a value, and all keys."""
    if isinstance(value, dict):
        return [text for pair in value.items() for part in pair for text in texts(part)]
    if isinstance(value, list):
        return [text for item in value for text in texts(item)]
    return [value] if isinstance(value, str) else []


@pytest.fixture(params=layout_files().values(), ids=lambda path: path.stem)
def layout(request):
    return json.loads(request.param.read_text("utf-8"))


def test_there_are_two_layouts():
    assert [path.name for path in layout_files().values()] == ["carla-recap.foxglove.json", "carla-recap.lichtblick.json"]


def test_both_layouts_have_the_same_panels():
    (new, old) = (json.loads(path.read_text("utf-8")) for path in layout_files().values())
    kinds = {"ThreeDee": "3D", "Log": "RosOut"}
    assert [(kinds.get(kind, kind), config) for kind, config in panels(new)] == panels(old)
    assert new["variables"] == old["globalVariables"]


def test_a_layout_names_only_topics_of_an_export(layout, record):
    named = {text for text in texts(layout) if text.startswith("/")}
    assert {re.match(r"/[a-z_/]+", text)[0] for text in named} <= set(SCHEMAS)
    assert set(SCHEMAS) - {"/tf"} <= {re.match(r"/[a-z_/]+", text)[0] for text in named}


def test_the_paths_of_a_layout_name_existing_fields(layout, crossing):
    paths = [path["value"] for _, config in panels(layout) for path in config.get("paths", [])]
    assert len(paths) == 7
    for path in paths:
        topic, *fields = re.sub(r"\[:\]\{\w+==\$\w+\}", "[:]", path).split(".")
        value = crossing[topic][-1][1]
        for field in fields:
            name = field.removesuffix("[:]")
            assert name in value.DESCRIPTOR.fields_by_name
            value = getattr(value, name)[0] if field.endswith("[:]") else getattr(value, name)
        for name in re.findall(r"\{(\w+)==", path):
            assert name in crossing["/lights"][0][1].lights[0].DESCRIPTOR.fields_by_name


def test_a_layout_follows_from_behind(layout, crossing):
    ((_, config),) = [panel for panel in panels(layout) if panel[0] in ("3D", "ThreeDee")]
    frames = {transform.child_frame_id for _, message in crossing["/tf"] for transform in message.transforms}
    assert config["followTf"] in frames
    assert config["followMode"] == "follow-pose"
    # Where Foxglove puts the camera: spherical coordinates around a target, from the y axis on.
    camera = config["cameraState"]
    distance, phi, theta = camera["distance"], math.radians(camera["phi"]), -math.radians(camera["thetaOffset"])
    place = np.array([math.sin(phi) * math.sin(theta), -math.sin(phi) * math.cos(theta), math.cos(phi)]) * distance
    assert place + camera["targetOffset"] == pytest.approx([-10, 0, 5], abs=0.01)


def test_the_event_log_is_shown(layout):
    ((_, config),) = [panel for panel in panels(layout) if panel[0] in ("RosOut", "Log")]
    assert (config["topicToRender"], config["minLogLevel"]) == ("/log", 2)


def test_no_topic_is_one_of_a_recording():
    assert not {type.topic for type in UE4} & set(SCHEMAS)
