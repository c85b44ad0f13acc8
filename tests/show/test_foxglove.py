"""Exports to Foxglove, read back with other libraries, and the layouts for them."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import carla_recap
from carla_recap import NotARecording, RecapWarning, open_recording
from carla_recap.model.records import UE4
from carla_recap.scene.ahead import NO_LIGHT, stop_points
from carla_recap.scene.follow import followed_series
from carla_recap.show.foxglove import export_foxglove, layout_files
from carla_recap.show.foxglove.layouts import hints_of, layout_hints
from carla_recap.town.mesh import town_mesh_of
from tests.replay.scripts import light, pose, spawn, write
from tests.samples import CRASH, CROSSING, ROOT, carla_log

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra foxglove is not installed")


from tests.show.foxglove_reader import BODIES, bodies, corners, latest, panels, raw, read, seen, xyz
from tests.waiting import PATIENCE

NODE = ROOT / "tests" / "node"
HERO, FIRST_LIGHT = 100, 20  # of the crossing

SCHEMAS = {
    **dict.fromkeys(BODIES, "foxglove.SceneUpdate"),
    "/scene/lamps": "foxglove.SceneUpdate",
    "/scene/signals": "foxglove.SceneUpdate",
    "/scene/marks": "foxglove.SceneUpdate",
    "/scene/ahead": "foxglove.SceneUpdate",
    "/map": "foxglove.SceneUpdate",
    "/tf": "foxglove.FrameTransforms",
    "/tf/actors": "foxglove.FrameTransforms",
    "/tf/still": "foxglove.FrameTransforms",
    "/hero": "carla_recap.v1.Followed",
    "/lights": "carla_recap.v1.ShownLights",
    "/log": "foxglove.Log",
    "/states": "carla_recap.v1.ShownStates",
}


def export(source: Path, destination: Path, **options):
    with open_recording(source) as recording:
        return export_foxglove(recording, destination, **options)


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    path = tmp_path_factory.mktemp("foxglove") / "crossing.mcap"
    export(CROSSING, path)
    return path


@pytest.fixture(scope="module")
def crossing(exported):
    return read(exported)


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
def test_foxgloves_own_libraries_read_an_export(exported):
    if not (NODE / "node_modules").is_dir():
        pytest.skip("the libraries of the independent reader are not installed: npm ci --prefix tests/node")
    command = ["node", NODE / "read.mjs", exported]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert {topic: entry["schema"] for topic, entry in found["topics"].items()} == SCHEMAS
    assert all(entry["count"] for topic, entry in found["topics"].items())
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


def test_messages_do_not_depend_on_how_many_are_made_at_once(tmp_path, monkeypatch):
    export(CROSSING, tmp_path / "many.mcap", duration=8, follow=101)
    assert {message.id for _, message in read(tmp_path / "many.mcap")["/hero"]} == {101}
    for together in (1, 7):
        monkeypatch.setattr("carla_recap.show.foxglove.topics._TOGETHER", together)
        export(CROSSING, tmp_path / f"{together}.mcap", duration=8, follow=101)
        assert raw(tmp_path / f"{together}.mcap") == raw(tmp_path / "many.mcap")


# --- the scene -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("time", [0.0, 24.7, 53.0])
def test_seeking_shows_the_same_as_playing(crossing, time):
    for topic in (*BODIES, "/scene/lamps", "/scene/signals", "/scene/ahead"):
        sought = seen([(0, latest(crossing[topic], time))])
        assert sought == seen(crossing[topic], time)


def test_an_actor_that_starts_to_move_changes_the_topic(record):
    xs = [0, 0.2, 0.4, 50, 100, 100]
    topics = record(*({"spawned": [spawn(1)] if n == 0 else [], "transforms": [pose(1, x=x)]} for n, x in enumerate(xs)))
    assert [time for time, _ in topics["/tf/still"]] == pytest.approx([0, 0.3])
    assert not topics["/tf/still"][1][1].transforms
    found = [message.transforms[0].translation.x for _, message in topics["/tf/actors"]]
    assert found == pytest.approx([0.5, 1, 1])
    assert len(topics["/scene/vehicles"]) == 1


def test_an_entity_has_the_metadata_of_its_actor(crossing):
    entity = bodies(crossing)[f"actor {HERO}"]
    metadata = {pair.key: pair.value for pair in entity.metadata}
    assert metadata == {"actor": "hero 100", "type_id": "vehicle.tesla.model3", "role_name": "hero"}


def test_a_body_has_the_recorded_colour(record):
    topics = record({"spawned": [spawn(1, color="255,0,51")], "transforms": [pose(1)]})
    colors = [shape.color for shape in bodies(topics)["actor 1"].triangles]
    assert (255, 0, 51) in [tuple(round(255 * part) for part in (each.r, each.g, each.b)) for each in colors]


def test_entities_have_the_time_of_their_message(crossing):
    start = crossing["/log"][0][1].timestamp.ToNanoseconds()
    for topic in (*BODIES, "/scene/lamps", "/scene/signals", "/tf/actors", "/tf/still"):
        for time, message in crossing[topic][:200]:
            parts = message.transforms if topic.startswith("/tf") else message.entities
            assert {part.timestamp.ToNanoseconds() - start for part in parts} <= {round(time * 1e9)}


def test_actors_that_come_and_go_all_the_time_become_boxes(record, monkeypatch):
    monkeypatch.setattr("carla_recap.show.foxglove.topics._MOST_BYTES", 200_000)
    with pytest.warns(RecapWarning, match=r"from [\d.]+ s on, all actors are boxes"):
        topics = record(
            {"spawned": [spawn(1)], "transforms": [pose(1)]},
            *(
                {"spawned": [spawn(id)], "transforms": [pose(1), pose(id)], "destroyed": [id - 1] * (id > 10)}
                for id in range(10, 60)
            ),
        )
    entities = bodies(topics)
    assert list(entities) == ["actor 1", "actor 59"]
    assert [(len(entity.cubes), len(entity.triangles)) for entity in entities.values()] == [(1, 0), (1, 0)]
    assert sum(message.ByteSize() for _, message in topics["/scene/vehicles"]) < 300_000


def test_further_actors_of_a_crowd_are_boxes(record, monkeypatch):
    monkeypatch.setattr("carla_recap.show.foxglove.actor_entities._MOST_MODELS", 3)
    topics = record({"spawned": [spawn(id) for id in range(1, 6)], "transforms": [pose(id) for id in range(1, 6)]})
    assert [len(entity.cubes) for entity in bodies(topics).values()] == [0, 0, 0, 1, 1]


@pytest.mark.parametrize("name", ["collisions.log", "floats.log"])
def test_odd_recordings_have_finite_numbers(tmp_path, name):
    export(carla_log(name), tmp_path / "export.mcap")
    topics = read(tmp_path / "export.mcap")
    for topic in ("/tf", "/tf/actors", "/tf/still"):
        for _, message in topics[topic]:
            for transform in message.transforms:
                assert np.isfinite([*xyz(transform.translation), transform.rotation.w]).all()
    assert all(
        np.isfinite(corners(entity)).all() for topic in BODIES for _, each in topics[topic] for entity in each.entities
    )
    assert not any(each.HasField("x") and not math.isfinite(each.x) for _, each in topics["/hero"])


def test_a_fast_recording_is_thinned_except_for_the_followed_actor(record):
    times = [n / 100 for n in range(101)]
    frames = [{"spawned": [spawn(1)] if n == 0 else [], "transforms": [pose(1, x=10 * n)]} for n in range(101)]
    frames[33]["spawned"] = [spawn(2)]
    topics = record(*frames, times=times)
    assert 15 <= len(topics["/tf"]) <= 24
    assert len(topics["/hero"]) == 101
    assert 0.33 in [time for time, _ in topics["/scene/vehicles"]]
    assert topics["/tf/actors"][-1][0] == pytest.approx(1.0)


def test_a_recording_of_empty_frames_is_exported(record):
    topics = record({}, {}, {})
    assert set(topics) == set(SCHEMAS) - {"/hero", "/tf/actors"}
    (transform,) = topics["/tf"][-1][1].transforms
    assert transform.child_frame_id == "followed"


# --- lights --------------------------------------------------------------------------------------------------------


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
    assert topics["/lights"][0][1].lights[0].entity in seen(topics["/scene/signals"])


# --- the followed actor --------------------------------------------------------------------------------------------


def test_the_followed_actor_has_its_trajectory_controls_and_series(crossing):
    with open_recording(CROSSING) as recording:
        trajectory, controls = recording.trajectory(HERO), recording.controls(HERO)
        series = followed_series(recording, HERO, {})
    rows = [message for _, message in crossing["/hero"]]
    assert {(row.id, row.type_id) for row in rows} == {(HERO, "vehicle.tesla.model3")}
    for axis in ("x", "y", "z", "yaw"):
        np.testing.assert_allclose([getattr(row, axis) for row in rows], getattr(trajectory, axis), atol=1e-9)
    for name in ("throttle", "brake", "steer", "gear", "hand_brake"):
        assert [getattr(row, name) for row in rows] == getattr(controls, name).tolist()
    expected = {"speed": series.speed, "speed_kmh": series.speed * 3.6, "acceleration": series.acceleration}
    expected |= dict(zip(("shown_throttle", "shown_brake"), series.pedals.T, strict=True))
    for name, values in expected.items():
        found = [getattr(row, name) if row.HasField(name) else math.nan for row in rows]
        assert found == pytest.approx(values.tolist(), abs=1e-6, nan_ok=True), name


def test_the_light_ahead_is_marked(crossing):
    with open_recording(CROSSING) as recording:
        series = followed_series(recording, HERO, stop_points(recording.reader))
    red, none = series.light_state.tolist().index(0), series.light.tolist().index(NO_LIGHT)
    (mark,) = seen(crossing["/scene/ahead"], series.time[red]).values()
    assert (mark.frame_id, mark.texts[0].text) == (f"actor {FIRST_LIGHT}", f"light {FIRST_LIGHT}: red")
    assert seen(crossing["/scene/ahead"], series.time[none]) == {}


def test_the_log_has_actors_and_each_contact_once(crossing):
    lines = [(round(time, 3), line.message, line.level) for time, line in crossing["/log"] if line.name != "incidents"]
    assert lines[0] == (0, "10 actors are there: 4 traffic lights, 4 vehicles, 2 others", 2)
    assert {
        (10.0, "vehicle.bh.crossbike (105) appears", 2),
        (20.9, "vehicle.bh.crossbike (105) collides with walker.pedestrian.0004 (110)", 3),
        (24.6, "hero collides with vehicle.audi.a2 (101)", 4),
        (27.0, "vehicle.nissan.micra (103) disappears", 2),
    } <= set(lines)
    assert sum("collides" in text for _, text, _ in lines) == 2


# --- the map -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def brickfield():
    pytest.importorskip("carla", reason="CARLA's library is not installed")
    from carla_recap.roads import find_map, load_map

    return load_map(find_map("Brickfield"))


def test_the_town_is_written_at_the_beginning(tmp_path, brickfield):
    export(CRASH, tmp_path / "export.mcap", road_map=brickfield, duration=1)
    ((time, message),) = read(tmp_path / "export.mcap")["/map"]
    assert time == 0
    assert {entity.frame_id for entity in message.entities} == {"world"}
    town = town_mesh_of(brickfield.opendrive, brickfield.name)
    shapes = [shape for entity in message.entities for shape in entity.triangles]
    assert sum(len(shape.indices) for shape in shapes) == sum(tile.triangles.size for tile in town.tiles)
    assert all(max(shape.indices) < len(shape.points) for shape in shapes)
    points = np.concatenate([corners(entity) for entity in message.entities])
    assert points.min(axis=0) == pytest.approx(town.bounds[:, 0].min(axis=0), abs=1e-3)
    assert points.max(axis=0) == pytest.approx(town.bounds[:, 1].max(axis=0), abs=1e-3)


# --- sensors -------------------------------------------------------------------------------------------------------


def test_data_of_sensors_are_kept(sensed_recording, tmp_path):
    with open_recording(sensed_recording) as recording:
        topics = [name for name in recording.reader.further_topics() if name.startswith(("/sensors/", "/tf/sensors"))]
        images = [data for _, data in recording.reader.messages("/sensors/front/image", 11.5, 12.0)]
        carla_recap.export(recording, tmp_path / "out.mcap", to="foxglove", start=11.5, duration=0.49)
    found = raw(tmp_path / "out.mcap")
    assert len(images) > 5
    assert [data for _, data in found["/sensors/front/image"]] == images
    assert set(found) >= {*topics, "/scene/vehicles"}


def test_a_part_begins_with_the_latest_message_of_each_topic(sensed_recording, tmp_path):
    with open_recording(sensed_recording) as recording:
        earlier = [data for _, data in recording.reader.messages("/sensors/front/image", 0, 11.52)][-1]
        carla_recap.export(recording, tmp_path / "out.mcap", to="foxglove", start=11.52, duration=0.1)
    found = raw(tmp_path / "out.mcap")
    assert found["/sensors/front/image"][0] == (found["/scene/vehicles"][0][0], earlier)


def test_layouts_beside_the_export_show_the_sensors(sensed_recording, tmp_path):
    with open_recording(sensed_recording) as recording:
        done = carla_recap.export(recording, tmp_path / "out.foxglove.mcap", start=11.5, duration=0.2)
    names = "out.foxglove.json", "out.lichtblick.json"
    assert [hint.rpartition(": ")[2] for hint in done.hints] == [str(tmp_path / name) for name in names]
    for name in names:
        text = (tmp_path / name).read_text()
        assert all(
            f'"{topic}"' in text for topic in ("/sensors/front/image", "/sensors/ids/instance", "/sensors/lidar/points")
        )
    assert layout_hints(tmp_path / "out.foxglove.mcap") == list(done.hints)


def test_without_sensors_the_layouts_are_those_of_all_exports(tmp_path):
    with open_recording(CRASH) as recording:
        done = carla_recap.export(recording, tmp_path / "out.mcap", duration=0.2)
    assert [path.name for path in tmp_path.iterdir()] == ["out.mcap"]
    assert list(done.hints) == hints_of(layout_files())


# --- the layouts ---------------------------------------------------------------------------------------------------


def texts(value):
    """Return all texts within a value, and all keys."""
    if isinstance(value, dict):
        return [text for pair in value.items() for part in pair for text in texts(part)]
    if isinstance(value, list):
        return [text for item in value for text in texts(item)]
    return [value] if isinstance(value, str) else []


@pytest.fixture
def layout():
    """Return one of the layouts; the other one has the same panels."""
    return json.loads(next(iter(layout_files().values())).read_text("utf-8"))


def test_both_layouts_have_the_same_panels_but_for_legends():
    (new, old) = (json.loads(path.read_text("utf-8")) for path in layout_files().values())
    kinds = {"ThreeDee": "3D", "Log": "RosOut"}
    legends = {"legendDisplay", "sidebarDimension"}  # Lichtblick's would cover the plot
    found, expected = (
        [(kinds.get(kind, kind), {key: config[key] for key in config.keys() - legends}) for kind, config in panels(each)]
        for each in (new, old)
    )
    assert found == expected
    assert new["variables"] == old["globalVariables"]


def test_a_layout_names_only_topics_of_an_export(layout, record):
    named = {text for text in texts(layout) if text.startswith("/")}
    assert {re.match(r"/[a-z_/]+", text)[0] for text in named} <= set(SCHEMAS)
    assert {topic for topic in SCHEMAS if not topic.startswith("/tf")} <= {re.match(r"/[a-z_/]+", text)[0] for text in named}


def test_the_paths_of_a_layout_name_existing_fields(layout, crossing):
    paths = [path["value"] for _, config in panels(layout) for path in config.get("paths", [])]
    assert len(paths) == 16
    for path in paths:
        topic, *fields = re.sub(r"\{[^}]*\}", "", path).split(".")
        value = crossing[topic][-1][1]
        for field in fields:
            name = field.removesuffix("[:]")
            assert name in value.DESCRIPTOR.fields_by_name
            value = getattr(value, name)[0] if field.endswith("[:]") else getattr(value, name)
        kind = crossing[topic][0][1].DESCRIPTOR.fields_by_name[fields[0].removesuffix("[:]")].message_type
        assert all(name in kind.fields_by_name for name in re.findall(r"\{(\w+)==", path))


def test_no_topic_is_one_of_a_recording():
    assert not {type.topic for type in UE4} & set(SCHEMAS)
