"""Recordings with further topics, such as those of sensors, whose messages are made up."""

from __future__ import annotations

import json
import random
from typing import TYPE_CHECKING

from carla_recap.formats.base import Topic
from carla_recap.formats.mcap.writer import McapWriter
from carla_recap.model.frame import Header
from tests.samples import drive

if TYPE_CHECKING:
    from pathlib import Path

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
