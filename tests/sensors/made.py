"""Samples that are made up."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from carla_recap.model.frame import Header
from carla_recap.sensors.rig import SensorRig
from carla_recap.sensors.sensing import Sample

pytest.importorskip("foxglove_schemas_protobuf")


HEADER = Header("Town01", 1_600_000_000)
WIDTH, HEIGHT = 64, 48
POSE = np.array((10.0, 20.0, 2.0, 0.0, 0.0, 90.0))  # it looks along y


def sample(type: str, data: Any, time: float = 1.5, **values: Any) -> Sample:
    """Return a sample of a sensor that is called `own`."""
    if type.startswith("sensor.camera."):
        values = {"width": WIDTH, "height": HEIGHT, "fov": 90.0, "x": 0.0, "y": 0.0, "z": 0.0} | values
    elif type.startswith("sensor.lidar.") or type.endswith("radar"):
        values = {"x": 0.0, "y": 0.0, "z": 0.0}
    spec = SensorRig.of([{"type": type, "id": "own", **values}])["own"]
    return Sample(spec, time, POSE, np.asarray(data))


def picture() -> np.ndarray:
    """Return a picture that is red on the left, blue on the right, and dark below."""
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    image[:, : WIDTH // 2, 0] = image[:, WIDTH // 2 :, 2] = 200
    image[HEIGHT // 2 :] //= 4
    return image
