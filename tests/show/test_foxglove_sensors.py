"""Sensors of a recording in an export to Foxglove."""

from __future__ import annotations

import pytest

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra `foxglove` is not installed")

from mcap.reader import make_reader

from carla_recap import export, open_recording


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
