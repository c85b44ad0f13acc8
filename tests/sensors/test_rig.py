"""Rigs from files and lists: what is accepted, and what errors say."""

from __future__ import annotations

import json
import math
import re
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.sensors import SENSOR_TYPES, SensorRig, SensorSpec

RIGS = Path(__file__).parents[2] / "samples" / "rigs"
FRONT = {"type": "sensor.camera.rgb", "id": "front", "x": 1.5, "y": 0.0, "z": 1.6, "width": 320, "height": 240, "fov": 100}
LIDAR = {"type": "sensor.lidar.ray_cast", "id": "top", "x": 0.0, "y": 0.0, "z": 2.0}
RADAR = {"type": "sensor.other.radar", "id": "radar", "x": 2.0, "y": 0.0, "z": 1.0}


def without(members: dict[str, Any], *keys: str) -> dict[str, Any]:
    return {name: value for name, value in members.items() if name not in keys}


def sensor(kind: str, id: str, **members: Any) -> dict[str, Any]:
    return {"type": kind, "id": id, "x": 0.0, "y": 0.0, "z": 0.0, **members}


def test_a_sensor_has_its_pose_and_all_attributes() -> None:
    rig = SensorRig.of([{**FRONT, "yaw": -90, "gamma": 2}, LIDAR])
    front, top = rig
    assert (front.id, front.type, front.kind, front.image) == ("front", "sensor.camera.rgb", "camera", "rgb")
    assert (front.x, front.y, front.z, front.roll, front.pitch, front.yaw) == (1.5, 0.0, 1.6, 0.0, 0.0, -90.0)
    assert front.attributes.keys() == SENSOR_TYPES[front.type].attributes.keys()
    given = {"image_size_x": 320, "image_size_y": 240, "fov": 100, "gamma": 2, "iso": 100}
    assert {key: front.attributes[key] for key in given} == given
    assert front.attributes["enable_postprocess_effects"] is True
    assert (top.kind, top.image, top.number("channels"), top.number("lower_fov")) == ("lidar", None, 32.0, -30.0)
    assert (len(rig), rig["top"]) == (2, top)
    with pytest.raises(KeyError):
        rig["back"]


@pytest.mark.parametrize("kind", [kind for kind in SENSOR_TYPES if kind != "sensor.opendrive_map"])
def test_a_rig_can_have_each_type_and_is_made_again_of_its_dicts(kind: str) -> None:
    rig = SensorRig.of([sensor(kind, "a")])
    assert rig["a"].attributes == {key: attribute.default for key, attribute in SENSOR_TYPES[kind].attributes.items()}
    assert SensorRig.of(json.loads(json.dumps(rig.to_dicts()))) == rig


def test_the_leaderboard_fixes_all_but_sizes_and_angles() -> None:
    dicts = [
        {**FRONT, "gamma": 1.0},
        {**LIDAR, "range": 20.0, "channels": 16, "horizontal_fov": 90.0},
        {**RADAR, "horizontal_fov": 60, "range": 20},
        sensor("sensor.other.gnss", "gnss", noise_lat_bias=1.0),
        sensor("sensor.other.imu", "imu"),
        sensor("sensor.camera.depth", "depth", sensor_tick=0.5),
    ]
    rig = SensorRig.of(dicts, leaderboard=True)
    assert [rig["front"].attributes[key] for key in ("image_size_x", "fov", "gamma")] == [320, 100.0, 2.2]
    expected = {"range": 85.0, "channels": 64, "points_per_second": 600_000, "upper_fov": 10.0, "horizontal_fov": 360.0}
    assert {key: rig["top"].attributes[key] for key in expected} == expected
    assert [rig["radar"].attributes[key] for key in ("horizontal_fov", "vertical_fov", "range")] == [60.0, 30.0, 100.0]
    assert [rig["gnss"].attributes[f"noise_{key}"] for key in ("lat_stddev", "alt_stddev", "lat_bias")] == [5e-6, 5e-6, 0.0]
    deviations = [rig["imu"].attributes[f"noise_{key}"] for key in ("accel_stddev_x", "accel_stddev_z", "gyro_stddev_z")]
    assert deviations == [0.001, 0.015, 0.001]
    assert rig["depth"].attributes["sensor_tick"] == 0.5  # the Leaderboard has no such sensors


def test_the_map_of_the_leaderboard_is_left_out_with_a_warning() -> None:
    with pytest.warns(RecapWarning, match=r"^rig: sensor 'map': sensor\.opendrive_map is left out$"):
        rig = SensorRig.of([LIDAR, {"type": "sensor.opendrive_map", "id": "map", "reading_frequency": 1e-6}])
    assert [spec.id for spec in rig] == ["top"]


def test_a_speedometer_has_a_reading_frequency() -> None:
    speedometer = {"type": "sensor.speedometer", "id": "speed", "reading_frequency": 20}
    assert SensorRig.of([speedometer])["speed"].attributes == {"sensor_tick": 0.05}
    assert SensorRig.of([speedometer], leaderboard=True)["speed"].attributes == {"sensor_tick": 0.0}


OBJECTS = {
    "objects": [
        {"type": "sensor.pseudo.markers", "id": "markers"},
        {"type": "vehicle.audi.tt", "id": "other", "sensors": [{"type": "sensor.other.imu", "id": "imu"}]},
        {
            "type": "vehicle.tesla.model3",
            "id": "ego_vehicle",
            "spawn_point": {"x": 1.0, "y": 2.0, "z": 0.0, "roll": 0.0, "pitch": 0.0, "yaw": 0.0},
            "sensors": [
                {
                    "type": "sensor.camera.rgb",
                    "id": "left",
                    "spawn_point": {"x": 1.0, "y": 0.5, "z": 2.0, "roll": 5.0, "pitch": 20.0, "yaw": 90.0},
                    "image_size_x": 400,
                    "fov": "100.0",
                },
                {
                    "type": "sensor.lidar.ray_cast",
                    "id": "top",
                    "spawn_point": {"x": 1.0, "y": 0.0, "z": 2.0, "yaw": 90.0},
                    "attached_objects": [
                        {
                            "type": "sensor.other.radar",
                            "id": "radar",
                            "spawn_point": {"x": 1.0, "y": 0.5, "z": 0.5, "yaw": 10.0},
                        },
                        {"type": "actor.pseudo.control", "id": "control"},
                    ],
                },
                {"type": "sensor.other.gnss", "id": "gnss"},
                {"type": "sensor.other.collision", "id": "collision", "spawn_point": {"x": 0.0, "y": 0.0, "z": 0.0}},
                {"type": "sensor.pseudo.tf", "id": "tf"},
            ],
        },
    ]
}


def test_the_objects_of_ros_bridge_are_a_rig_in_carlas_axes(tmp_path: Path) -> None:
    (tmp_path / "objects.json").write_text(json.dumps(OBJECTS), "utf-8")
    with pytest.warns(
        RecapWarning, match="5 left out, which a rig cannot have: markers, other, collision, tf, control"
    ) as caught:
        rig = SensorRig.load(tmp_path / "objects.json")
    assert len(caught) == 1
    poses = {each.id: (each.x, each.y, each.z, each.roll, each.pitch, each.yaw) for each in rig}
    assert poses == {
        "left": pytest.approx((1.0, -0.5, 2.0, 5.0, -20.0, -90.0)),
        "top": pytest.approx((1.0, 0.0, 2.0, 0.0, 0.0, -90.0)),
        "gnss": pytest.approx((0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
        "radar": pytest.approx((0.5, -1.0, 2.5, 0.0, 0.0, -100.0)),  # 1 m before the lidar, which looks to the left
    }
    assert (rig["left"].attributes["image_size_x"], rig["left"].number("fov")) == (400, 100.0)


@pytest.mark.parametrize(
    ("objects", "message"),
    [
        (5, "objects: expected a list of objects"),
        ([{"type": "vehicle.a.b", "id": name, "sensors": []} for name in "ab"], "the id ego_vehicle, found 2"),
        (
            [{"type": "vehicle.a.b", "sensors": [{"id": "a", "type": "sensor.camera.rbg"}]}, {"type": "vehicle.a.b"}],
            "sensor.camera.rgb was expected",
        ),
        (
            [{"type": "vehicle.a.b", "sensors": [{**without(LIDAR, *"xyz"), "spawn_point": {"x": "1"}}]}],
            "'top': x: \"1\"; a number",
        ),
        ([{"type": "vehicle.a.b", "sensors": [{**without(LIDAR, *"xyz"), "spawn_point": {"w": 1}}]}], "'top': w: is no key"),
    ],
)
def test_objects_that_are_no_rig_are_refused(objects: Any, message: str) -> None:
    with pytest.raises(RecapError) as raised:
        SensorRig.of({"objects": objects})  # type: ignore[arg-type]
    assert message in str(raised.value)


WRONG: list[tuple[Any, str]] = [
    ({}, "a list of sensors"),
    ([], "has no sensors"),
    ([5], "sensor 1: 5; an object"),
    ([without(FRONT, "id")], "sensor 1: id is missing"),
    ([{**FRONT, "id": 3}], "sensor 1: id: 3; a text"),
    ([{**FRONT, "id": "a/b"}], 'sensor 1: id: "a/b"; a name'),
    ([{**FRONT, "id": "a" * 65}], "sensor 1: id: "),
    ([FRONT, FRONT], "sensor 2: id: 'front'; another one than that of sensor 1"),
    ([without(FRONT, "type")], "sensor 'front': type is missing"),
    ([{**FRONT, "type": "sensor.camera.rbg"}], 'type: "sensor.camera.rbg"; sensor.camera.rgb was expected'),
    ([without(FRONT, "z")], "sensor 'front': z is missing"),
    ([{**FRONT, "x": "1"}], "sensor 'front': x: \"1\"; a number"),
    ([{**FRONT, "x": math.nan}], "sensor 'front': x: nan; a number from -1000 to 1000"),
    ([{**FRONT, "z": 10**400}], "sensor 'front': z: a number of many digits; "),
    ([{**FRONT, "fov": 0}], "sensor 'front': fov: 0; a number from 0.1 to 175 degrees was expected"),
    ([{**FRONT, "width": 0}], "sensor 'front': width: 0; a whole number from 1 to 4096 pixels"),
    ([{**FRONT, "image_size_x": 320}], "sensor 'front': width: is image_size_x, which is given, too"),
    ([{**FRONT, "colour": 1}], "sensor 'front': colour: is no key of sensor.camera.rgb; one of type, id, x, y, z, "),
    ([{**FRONT, "pich": 1}], "pich: is no key of sensor.camera.rgb; pitch was expected"),
    ([{**FRONT, "exposure_mode": "auto"}], 'exposure_mode: "auto"; histogram or manual'),
    ([{**FRONT, "enable_postprocess_effects": 1}], "enable_postprocess_effects: 1; true or false"),
    ([{**LIDAR, "channels": 1_000_000}], "sensor 'top': channels: 1000000; a whole number from 1 to 512"),
    ([{**FRONT, "id": f"camera{number}"} for number in range(101)], "has 101 sensors; 100 at most"),
]


@pytest.mark.parametrize(("sensors", "message"), WRONG, ids=[message for _, message in WRONG])
def test_an_error_names_the_sensor_and_the_key(sensors: Any, message: str) -> None:
    with pytest.raises(RecapError) as raised:
        SensorRig.of(sensors)
    assert str(raised.value).startswith("rig: ")
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)
    assert len(str(raised.value)) < 500


def test_a_file_is_read_and_named_in_errors(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    path.write_text("\ufeff" + json.dumps([FRONT, LIDAR]), "utf-8")
    assert SensorRig.load(path) == SensorRig.of([FRONT, LIDAR])
    assert SensorRig.load(str(path), leaderboard=True) == SensorRig.of([FRONT, LIDAR], leaderboard=True)
    path.write_text(json.dumps([FRONT, {**LIDAR, "channels": None}]), "utf-8")
    with pytest.raises(RecapError) as raised:
        SensorRig.load(path)
    assert str(raised.value) == f"{path}: sensor 'top': channels: null; a whole number from 1 to 512 was expected"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "line 1: Expecting value; JSON was expected"),
        (b"[\xff]", "byte 1: expected UTF-8"),
        (b"[" * 100_000, "is nested too deeply"),
        (b"[" + b"1" * 5000 + b"]", "has a number of thousands of digits"),
        (b"[" + b" " * (1 << 20), "is larger than 1 MB"),
        (b'[{"id": "a", "type": "sensor.other.imu", "x": 1, "x": 2}]', "sensor 'a': x: is there twice"),
        (b'[{"id": "a", "type": "sensor.other.imu", "x": NaN}]', "sensor 'a': x: nan; "),
        (b'[{"id": "a", "type": "sensor.other.imu", "\\u001b[2J": 1}]', "sensor 'a': \\x1b[2J: is no key"),
    ],
)
def test_a_file_that_is_no_rig_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "rig.json"
    path.write_bytes(content)
    with pytest.raises(RecapError) as raised:
        SensorRig.load(path)
    assert str(raised.value).startswith(f"{path}: ")
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


KEYS = st.text(max_size=5) | st.sampled_from(["type", "id", *"xyz", "yaw", "fov", "width", "channels", "exposure_mode"])
SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8) | st.sampled_from([*SENSOR_TYPES])
VALUES = SCALARS | st.lists(SCALARS, max_size=2) | st.dictionaries(KEYS, SCALARS, max_size=2)
ALTERED = st.dictionaries(KEYS, VALUES, max_size=4).map(lambda changes: {**FRONT, **changes})


@settings(max_examples=60)
@given(rig=VALUES | st.lists(ALTERED, max_size=3))
def test_whatever_is_given_is_a_rig_or_an_error_of_one_line(rig: Any) -> None:
    found, message = None, ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecapWarning)
        try:
            found = SensorRig.of(rig)
        except RecapError as error:
            message = str(error)
    assert bool(message) == (found is None)
    assert message.isprintable()
    assert len(message) < 500
    assert found is None or SensorRig.of(found.to_dicts()) == found


@pytest.mark.parametrize(
    ("name", "kinds"),
    [
        ("front_camera", {"camera": 1}),
        ("leaderboard", {"camera": 6, "lidar": 1, "gnss": 1, "imu": 1, "speedometer": 1}),
        ("nuscenes", {"camera": 6, "lidar": 1, "radar": 5}),
    ],
)
def test_the_samples_have_their_sensors(name: str, kinds: dict[str, int]) -> None:
    rig = SensorRig.load(RIGS / f"{name}.json")
    assert Counter(sensor.kind for sensor in rig) == kinds
    assert name != "leaderboard" or SensorRig.load(RIGS / "leaderboard.json", leaderboard=True) == rig
    for sensor in rig if name == "nuscenes" else ():
        assert re.fullmatch(r"CAM_\w+|LIDAR_TOP|RADAR_\w+", sensor.id)
        assert np.sign(sensor.y) == sensor.id.endswith("_RIGHT") - sensor.id.endswith("_LEFT")
        assert ("BACK" in sensor.id) <= (abs(sensor.yaw) > 90)


def test_a_sensor_is_made_of_the_texts_of_an_actor() -> None:
    own = SensorRig.of([{"type": "sensor.camera.rgb", "id": "a", "x": 1.0, "y": 0.5, "z": 2.0, "fov": 70, "iso": 5e-6}])["a"]
    texts = own.texts()
    assert (texts["fov"], texts["image_size_x"], texts["enable_postprocess_effects"]) == ("70.0", "800", "true")
    pose = [own.x, own.y, own.z, own.roll, own.pitch, own.yaw]
    assert SensorSpec.of_texts("a", own.type, pose, {**texts, "role_name": "hero"}) == own
    assert SensorSpec.of_texts("a", own.type, (5000.0, 0, 0, 0, 0, 0), {}).x == 5000.0


@pytest.mark.parametrize(("key", "text"), [("fov", "180"), ("image_size_x", "many"), ("exposure_mode", "none")])
def test_texts_that_a_rig_cannot_have_are_errors(key: str, text: str) -> None:
    with pytest.raises(RecapError, match=f"sensor 'a': {key}: "):
        SensorSpec.of_texts("a", "sensor.camera.rgb", (0.0,) * 6, {key: text})
