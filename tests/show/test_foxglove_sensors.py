"""Sensors of a recording in an export to Foxglove."""

from __future__ import annotations

import pytest

pytest.importorskip("foxglove_schemas_protobuf", reason="the extra `foxglove` is not installed")

from carla_recap import export, open_recording
from carla_recap.show.foxglove.layouts import hints_of, layout_files, layout_hints
from tests.sensed import CRASH
from tests.show.foxglove_reader import raw


def test_data_of_sensors_are_kept(sensed_recording, tmp_path):
    with open_recording(sensed_recording) as recording:
        topics = [name for name in recording.reader.further_topics() if name.startswith(("/sensors/", "/tf/sensors"))]
        images = [data for _, data in recording.reader.messages("/sensors/front/image", 11.5, 12.0)]
        export(recording, tmp_path / "out.mcap", to="foxglove", start=11.5, duration=0.49)
    found = raw(tmp_path / "out.mcap")
    assert len(images) > 5
    assert [data for _, data in found["/sensors/front/image"]] == images
    assert set(found) >= {*topics, "/scene/vehicles"}


def test_a_part_begins_with_the_latest_message_of_each_topic(sensed_recording, tmp_path):
    with open_recording(sensed_recording) as recording:
        earlier = [data for _, data in recording.reader.messages("/sensors/front/image", 0, 11.52)][-1]
        export(recording, tmp_path / "out.mcap", to="foxglove", start=11.52, duration=0.1)
    found = raw(tmp_path / "out.mcap")
    assert found["/sensors/front/image"][0] == (found["/scene/vehicles"][0][0], earlier)


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
