"""Sensors of a recording in Rerun's viewer: images on pinholes, points and poses, in step with the scenes."""

from __future__ import annotations

import io
import sys

import numpy as np
import pytest

pytest.importorskip("rerun", reason="the extra `rerun` is not installed")

from PIL import Image
from rerun.chunk import RrdReader

from carla_recap import export_rerun, open_recording
from carla_recap.errors import FormatError, RecapWarning
from carla_recap.formats.mcap.writer import McapWriter
from carla_recap.show.rerun import entities
from tests.samples import drive
from tests.sensed import HEADER, camera, filmed
from tests.show.conftest import SENSED
from tests.show.rerun_reader import Arrangement

START = 11.02  # s, between the first image and the second one


@pytest.fixture(scope="module")
def rrd(sensed_recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("rerun") / "sensed.rrd"
    with open_recording(sensed_recording) as recording:
        export_rerun(recording, path, start=START)
    return path


def rows(path, entity, column):
    """The values of a component of an entity, and the nanoseconds and frames of its rows."""
    found, times, frames = [], [], []
    for chunk in RrdReader(path).stream().filter(content=entity, is_static=False).to_chunks():
        batch = chunk.to_record_batch()
        if column in batch.schema.names:
            found += batch.column(column).to_pylist()
            times += [value.value for value in batch.column("sim_time")]
            frames += batch.column("frame").to_pylist()
    return found, times, frames


def stored(path, topic):
    with open_recording(path) as recording:
        return list(recording.reader.messages(topic))


def test_each_image_is_shown_when_it_was_taken_with_its_frame(rrd, sensed_recording):
    images, times, frames = rows(rrd, entities.sensor("front", "image"), "EncodedImage:blob")
    recorded = [elapsed for elapsed, _ in stored(sensed_recording, "/sensors/front/image")]
    assert recorded[0] < START
    assert times == [round(max(elapsed, START) * 1e9) for elapsed in recorded]
    assert len(images) == len(recorded) > 20
    with open_recording(sensed_recording) as recording:
        expected = {round(frame.elapsed * 1e9): frame.id for frame in recording.frames(SENSED[0])}
    assert frames[1:] == [expected[time] for time in times[1:]]
    picture = Image.open(io.BytesIO(bytes(images[0][0])))
    assert (picture.format, picture.size) == ("JPEG", (160, 120))


def test_sensors_move_with_the_actor(rrd):
    places, times, _ = rows(rrd, entities.sensor("lidar"), "Transform3D:translation")
    cars, car_times, _ = rows(rrd, entities.actor(41), "Transform3D:translation")
    heights = []
    for place, time in zip(places, times, strict=True):
        if time in car_times:
            offset = np.array(place[0]) - cars[car_times.index(time)][0]
            assert np.hypot(*offset[:2]) < 0.3  # at the start, the pose is that before it
            heights.append(offset[2])
    assert len(heights) > 20
    assert heights == pytest.approx([2.5] * len(heights), abs=0.2)


def test_points_and_detections_have_colours(rrd, sensed_recording):
    for id, kind in (("lidar", "points"), ("radar", "detections")):
        path = entities.sensor(id, kind)
        points, _, _ = rows(rrd, path, "Points3D:positions")
        colors, _, _ = rows(rrd, path, "Points3D:colors")
        assert len(points) == len(stored(sensed_recording, f"/sensors/{id}/{kind}"))
        assert [len(each) for each in points] == [len(each) for each in colors]
        assert max(len(each) for each in points) > 20
    lidar = rows(rrd, entities.sensor("lidar", "points"), "Points3D:positions")[0][0]
    assert np.linalg.norm(lidar, axis=1).max() <= 51


def test_depth_is_in_metres_and_labels_are_kept(rrd, sensed_recording):
    depths, _, _ = rows(rrd, entities.sensor("depth", "depth"), "EncodedDepthImage:blob")
    tags, _, _ = rows(rrd, entities.sensor("tags", "semantic"), "SegmentationImage:buffer")
    ids, _, _ = rows(rrd, entities.sensor("ids", "instance"), "SegmentationImage:buffer")
    depth = np.asarray(Image.open(io.BytesIO(bytes(depths[0][0]))))
    assert depth.shape == (120, 160)
    assert 1_000 < depth[-1, 80] < 10_000  # mm, down to the road
    assert set(bytes(tags[0][0])) >= {1, 11}  # road, sky
    with open_recording(sensed_recording) as recording:
        assert set(np.frombuffer(bytes(ids[0][0]), "<u2").tolist()) - {0} <= set(recording.actors)


def test_positions_on_earth_are_not_shown_since_the_viewer_would_fetch_a_map(rrd):
    paths = RrdReader(rrd).store().schema().entity_paths()
    assert not [path for path in paths if "gnss" in path and "fix" in path]


def test_each_camera_has_a_view(rrd):
    views = [part.get("ViewBlueprint:display_name") for part in Arrangement(rrd).parts.values()]
    assert all([id] in views for id in ("front", "back", "depth", "tags", "ids"))


def test_videos_are_passed_on_as_they_are(tmp_path):
    pytest.importorskip("av", reason="the extra `video` is not installed")
    path = filmed(tmp_path / "video.mcap", {"front": (0.0, {n / 10: (10 * n, 0, 0) for n in range(8)})}, video=True)
    with open_recording(path) as recording:
        export_rerun(recording, tmp_path / "video.rrd", duration=1)
    packets, _, _ = rows(tmp_path / "video.rrd", entities.sensor("front", "video"), "VideoStream:sample")
    messages = [data for _, data in stored(path, "/sensors/front/video")]
    assert len(packets) == len(messages) > 5
    assert all(bytes(packet[0]) in data for packet, data in zip(packets, messages, strict=True))


def test_without_the_extra_the_sensors_are_left_out_with_a_warning(sensed_recording, tmp_path, monkeypatch):
    for name in ("carla_recap.show.rerun.sensor_writer", "carla_recap.sensors.decoding", "carla_recap.sensors.messages"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setitem(sys.modules, "foxglove_schemas_protobuf.CameraCalibration_pb2", None)
    warned = pytest.warns(RecapWarning, match=r"its sensors are left out: .*foxglove")
    with open_recording(sensed_recording) as recording, warned:
        export_rerun(recording, tmp_path / "without.rrd", start=11, duration=0.2)
    assert (tmp_path / "without.rrd").stat().st_size > 1000


def test_a_damaged_message_is_an_error_that_names_topic_and_time(tmp_path):
    with McapWriter(tmp_path / "damaged.mcap", HEADER) as writer:
        writer.add_topic(camera())
        for frame in drive(1.0):
            writer.write(frame)
        writer.write_message("/sensors/front/image", 0.5, b"\xff\xff")
    refused = pytest.raises(FormatError, match=r"damaged.mcap: a message of /sensors/front/image at 0.5 s: ")
    with open_recording(tmp_path / "damaged.mcap") as recording, refused:
        export_rerun(recording, tmp_path / "damaged.rrd")
    assert not (tmp_path / "damaged.rrd").exists()
