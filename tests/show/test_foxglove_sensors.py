"""Sensors of a recording in an export to Foxglove."""

from __future__ import annotations

import pytest

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra `foxglove` is not installed")

from mcap.reader import make_reader

from carla_recap import export, open_recording
from carla_recap.show.foxglove.layouts import hints_of, layout_files, layout_hints
from tests.sensed import CRASH


def test_data_of_sensors_are_kept(sensed_recording, tmp_path):
    with open_recording(sensed_recording) as recording:
        topics = [name for name in recording.reader.further_topics() if name.startswith(("/sensors/", "/tf/sensors"))]
        images = [data for _, data in recording.reader.messages("/sensors/front/image", 11.5, 12.0)]
        export(recording, tmp_path / "out.mcap", to="foxglove", start=11.5, duration=0.49)
    with (tmp_path / "out.mcap").open("rb") as file:
        found = [
            (channel.topic, message.data, schema.name) for schema, channel, message in make_reader(file).iter_messages()
        ]
    kept = [(data, name) for topic, data, name in found if topic == "/sensors/front/image"]
    assert len(images) > 5
    assert kept == [(data, "foxglove.CompressedImage") for data in images]
    assert {topic for topic, *_ in found} >= {*topics, "/scene/vehicles"}


def test_a_part_begins_with_the_latest_message_of_each_topic(sensed_recording, tmp_path):
    with open_recording(sensed_recording) as recording:
        earlier = [data for _, data in recording.reader.messages("/sensors/front/image", 0, 11.52)][-1]
        export(recording, tmp_path / "out.mcap", to="foxglove", start=11.52, duration=0.1)
    with (tmp_path / "out.mcap").open("rb") as file:
        found = {channel.topic: message for _, channel, message in make_reader(file).iter_messages(reverse=True)}
    first = found["/sensors/front/image"]
    assert (first.data, first.log_time) == (earlier, found["/scene/vehicles"].log_time)


def test_layouts_beside_the_export_show_the_sensors(sensed_recording, tmp_path):
    with open_recording(sensed_recording) as recording:
        done = export(recording, tmp_path / "out.foxglove.mcap", start=11.5, duration=0.2)
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
        done = export(recording, tmp_path / "out.mcap", duration=0.2)
    assert [path.name for path in tmp_path.iterdir()] == ["out.mcap"]
    assert list(done.hints) == hints_of(layout_files())
