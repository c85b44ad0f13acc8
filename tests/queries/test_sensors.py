"""The sensors of a recording: topics whose metadata have their specifications."""

from __future__ import annotations

import json

import pytest

from carla_recap import RecapError, RecapWarning, open_recording
from carla_recap.formats.base import Topic
from carla_recap.formats.mcap.writer import McapWriter
from carla_recap.output.json import json as json_text
from carla_recap.output.text import text
from carla_recap.queries.info import info
from carla_recap.queries.summary import summary
from tests.samples import drive, reading, write
from tests.sensed import HEADER, camera, plain, sensed


def of_spec(text, name="/sensors/front/image"):
    return Topic(name, "", bytes, {"sensor": text}, "json")


def written(path, *topics):
    with McapWriter(path, HEADER) as writer:
        for topic in topics:
            writer.add_topic(topic)
    return path


def test_all_topics_of_a_sensor_are_its_own(tmp_path):
    with McapWriter(tmp_path / "run.mcap", HEADER) as writer:
        for topic in (camera(), camera("rear"), camera(name="calibration")):
            writer.add_topic(topic)
        writer.write_message("/sensors/front/calibration", 0.5, b"lens")
        for time in (1.0, 2.0):
            writer.write_message("/sensors/front/image", time, b"front")
            writer.write_message("/sensors/rear/image", time, b"rear")
    with open_recording(tmp_path / "run.mcap") as recording:
        front, rear = recording.sensors
        assert (front.topics, front.count) == (["/sensors/front/image", "/sensors/front/calibration"], 3)
        assert (front.first, front.last, rear.first) == (0.5, 2.0, 1.0)
        assert list(recording.sensor_messages("front")) == [
            ("/sensors/front/calibration", 0.5, b"lens"),
            ("/sensors/front/image", 1.0, b"front"),
            ("/sensors/front/image", 2.0, b"front"),
        ]
        assert [message.elapsed for message in recording.sensor_messages("rear", 1.5, 2.5)] == [2.0]
        with pytest.raises(RecapError, match="has no data of a sensor 'side'; it has those of front, rear"):
            recording.sensor_messages("side")


def test_a_log_has_no_sensors(small):
    with open_recording(small) as recording:
        assert recording.sensors == []
        assert recording.sensors.to_arrow().num_rows == 0
        with pytest.raises(RecapError, match="it has those of none"):
            recording.sensor_messages("front")


@pytest.mark.parametrize(
    "metadata",
    [
        "",
        "{",
        "[]",
        "null",
        "{}",
        '{"type": 1}',
        "[" * 100_000,
        '{"type": "a", "b": ' + "[" * 40 + "]" * 40 + "}",
        "1" * 5000,
    ],
)
def test_a_topic_with_broken_metadata_is_no_sensor(tmp_path, metadata):
    with open_recording(written(tmp_path / "run.mcap", of_spec(metadata), camera("rear"))) as recording:
        assert [sensor.id for sensor in recording.sensors] == ["rear"]
        assert list(recording.reader.further_topics()) == ["/sensors/front/image", "/sensors/rear/image"]


@pytest.mark.parametrize(
    "name", ["/sensors", "/sensors/", "/sensors/front", "/sensors//image", "/other/front/image", "sensors/a/b"]
)
def test_topics_elsewhere_are_no_sensors(tmp_path, name):
    spec = json.dumps({"type": "sensor.camera.rgb"})
    with open_recording(written(tmp_path / "run.mcap", of_spec(spec, name), plain("/sensors/imu/imu"))) as recording:
        assert recording.sensors == []
        assert name in recording.reader.further_topics()


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return sensed(tmp_path_factory.mktemp("sensed") / "run.mcap")


def test_the_summary_lists_them(run):
    with open_recording(run) as recording, pytest.warns(RecapWarning, match="is unknown"):
        (found,) = rows = summary(recording.reader)
    assert found.sensors == {"front": "sensor.camera.rgb"}
    assert "Sensor data: front (sensor.camera.rgb)" in "".join(text(rows)).splitlines()
    (row,) = json.loads("".join(json_text(rows)))["rows"]
    assert row["sensors"] == {"front": "sensor.camera.rgb"}


def test_info_lists_them_as_json_and_not_in_carlas_text(run, tmp_path):
    write(tmp_path / "run.log", HEADER, drive(10.0))
    with reading(run) as sensed, reading(tmp_path / "run.log") as plain:
        (found,) = json.loads("".join(json_text(info(sensed))))["sensors"]
        assert (found["id"], found["type"], found["count"]) == ("front", "sensor.camera.rgb", 100)
        assert (found["topics"], found["first"]) == (["/sensors/front/image"], 0)
        for compat in (False, True):
            assert "".join(text(info(sensed, compat=compat))) == "".join(text(info(plain, compat=compat)))
        assert json.loads("".join(json_text(info(plain))))["sensors"] == []


def test_names_of_sensors_cannot_control_a_terminal(tmp_path):
    path = written(tmp_path / "run.mcap", of_spec(json.dumps({"type": "\x1b[2J"}), "/sensors/\x1b[31m/image"))
    with reading(path) as reader, pytest.warns(RecapWarning, match="is unknown"):
        assert r"Sensor data: \x1b[31m (\x1b[2J)" in "".join(text(summary(reader)))
