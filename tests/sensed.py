"""Recordings with further topics: those of sensors, drawn or cast, and ones whose messages are made up."""

from __future__ import annotations

import json
import random
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from carla_recap import open_recording
from carla_recap.formats.base import Topic, TopicMessage
from carla_recap.formats.mcap.writer import McapWriter
from carla_recap.model.frame import Header
from tests.samples import CRASH, drive

HEADER = Header("Town01", 1_600_000_000)


def noise(size: int, seed: int) -> bytes:
    """Bytes that cannot be compressed, as those of a JPEG."""
    return random.Random(seed).randbytes(size)


def camera(id: str = "front", name: str = "image") -> Topic:
    """A topic of a camera."""
    spec = {"id": id, "type": "sensor.camera.rgb", "attributes": {"fov": 90.0}}
    return Topic(f"/sensors/{id}/{name}", "foxglove.CompressedImage", lambda: b"image", {"sensor": json.dumps(spec)})


def plain(name: str) -> Topic:
    """A topic of JSON without a schema."""
    return Topic(name, "", bytes, {}, "json")


def sensed(path: Path, *, live: bool = False, seconds: float = 10.0, size: int = 20_000) -> Path:
    """A recording with an image of a camera in every other frame, and small messages of two topics that share chunks."""
    with McapWriter(path, HEADER, live=live) as writer:
        writer.add_topic(camera())
        writer.add_topic(plain("/sensors/imu/imu"), group="small")
        for frame in drive(seconds):
            writer.write(frame)
            if frame.index % 2 == 0:
                writer.write_message("/sensors/front/image", frame.elapsed, noise(size, frame.index))
            writer.write_message("/sensors/imu/imu", frame.elapsed, b"{}")
            if frame.index == 20:
                writer.add_topic(plain("/note"), group="small")
                writer.write_message("/note", frame.elapsed, b'"late"')
    return path


def filmed(path: Path, cameras: Mapping[str, tuple[float, Mapping[float, Any]]], **options: Any) -> Path:
    """Write a recording of 6 s with images of cameras: of each the yaw in degrees, and colours or arrays by their times."""
    from carla_recap.sensors import SensorRig
    from carla_recap.sensors.messages import SensorMessages
    from carla_recap.sensors.sensing import Sample

    place = {"x": 0.0, "y": 0.0, "z": 0.0, "width": 640, "height": 320}
    specs = [{"type": "sensor.camera.rgb", "id": id, "yaw": yaw, **place} for id, (yaw, _) in cameras.items()]
    rig = SensorRig.of(specs)
    with McapWriter(path, HEADER) as writer:
        messages = SensorMessages(rig, HEADER, **options)
        for topic in messages.topics:
            writer.add_topic(topic)
        for frame in drive(6.0, size=2):
            writer.write(frame)
        for id, (_, shown) in cameras.items():
            for time, color in shown.items():
                image = np.broadcast_to(np.asarray(color, np.uint8), (320, 640, 3)).copy()
                for message in messages.of([Sample(rig[id], time, np.zeros(6), image)]):
                    writer.write_message(*message)
    return path


def topics_of(path: Path) -> dict[str, tuple[Any, ...]]:
    """All that a file has of further topics, but for the groups' names and the schemas, which are read here."""
    with open_recording(path) as recording:
        return {
            name: (found.topic.message, found.topic.schema(), found.topic.metadata, found.count, found.first, found.last)
            for name, found in recording.reader.further_topics().items()
        }


def messages_of(path: Path) -> list[TopicMessage]:
    with open_recording(path) as recording:
        return list(recording.reader.further_messages())


def sensed_crash(path: Path, sensors: list[dict[str, Any]], start: float = 11.0, stop: float = 13.0) -> Path:
    """Some seconds around the crash of the sample, with what sensors on the hero would have measured.

    Args:
        path: The destination, an .mcap.
        sensors: The rig.
        start: The elapsed time of the first measurements, in s; the frames are those from the beginning on.
        stop: The elapsed time of the end, in s.
    """
    from carla_recap.sensors import SensorRig
    from carla_recap.sensors.messages import SensorMessages
    from carla_recap.sensors.sensing import sense

    rig = SensorRig.of(sensors)
    with open_recording(CRASH) as recording, McapWriter(path, recording.header) as writer:
        messages = SensorMessages(rig, recording.header)
        for topic in messages.topics:
            writer.add_topic(topic)
        for frame in recording.frames(stop=stop + 0.01):
            writer.write(frame)
        for sensed_frame in sense(recording, rig, start=start, duration=stop - start, quality="low"):
            for message in messages.of(sensed_frame.samples.values()):
                writer.write_message(*message)
    return path
