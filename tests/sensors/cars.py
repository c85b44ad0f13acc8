"""A hero in Brickfield's axes, with a car ahead and one on each side."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

import carla_recap
from carla_recap.model.records import ActorKind, Spawn, attributes
from carla_recap.replay.pose import attach
from carla_recap.sensors.rig import SensorRig

if TYPE_CHECKING:
    from pathlib import Path


HERO, AHEAD, LEFT, RIGHT = 100, 70_001, 3, 4
HERO_POSE = np.array((2000.0, 3000.0, 0.0, 0.0, 0.0, 30.0))  # cm and degrees, left-handed
BOX = (0, 0, 75, 240, 95, 75)  # cm: centre and half extents
CAMERA_FORWARD, CAMERA_HEIGHT = 2.0, 1.2  # m
GAP = 15.0  # m from the camera to the rear of the car ahead
CARS = {
    AHEAD: ((CAMERA_FORWARD + GAP) * 100 + BOX[3], 0.0),
    LEFT: (1800.0, -700.0),  # cm: to the right is positive
    RIGHT: (1800.0, 500.0),
}
RAISED = 1.2  # m
UP = np.array((0.0, 0.0, 100 * RAISED, 0.0, 0.0, 0.0))
SPEED = 5.0  # m/s, of the car ahead, away from the hero
STEP = 0.05  # s
CAMERA = {"x": CAMERA_FORWARD, "y": 0.0, "z": CAMERA_HEIGHT, "width": 800, "height": 600, "fov": 90.0}
ROOF = {"x": CAMERA_FORWARD, "y": 0.0, "z": CAMERA_HEIGHT, "yaw": 0.0}
RAYS = {"range": 50.0, "channels": 64, "points_per_second": 2_000_000, "rotation_frequency": 20.0, "lower_fov": -20.0}
EXACT = {"dropoff_general_rate": 0.0, "dropoff_zero_intensity": 0.0}
IMAGES = {
    "front": "rgb",
    "depth": "depth",
    "tags": "semantic_segmentation",
    "ids": "instance_segmentation",
    "normals": "normals",
    "flow": "optical_flow",
}
RIG = SensorRig.of(
    [
        *({"type": f"sensor.camera.{kind}", "id": id, **CAMERA} for id, kind in IMAGES.items()),
        {"type": "sensor.lidar.ray_cast", "id": "lidar", **ROOF, **RAYS, **EXACT},
        {"type": "sensor.lidar.ray_cast_semantic", "id": "semantic_lidar", **ROOF, **RAYS},
        {"type": "sensor.other.radar", "id": "radar", **ROOF, "points_per_second": 40_000, "horizontal_fov": 120.0},
        {"type": "sensor.other.gnss", "id": "gnss", "sensor_tick": 0.1},
        {"type": "sensor.other.imu", "id": "imu"},
        {"type": "sensor.speedometer", "id": "speed"},
    ]
)


def car_pose(id: int, time: float) -> np.ndarray:
    forward, right = CARS[id]
    forward += SPEED * 100 * time if id == AHEAD else 0.0
    return attach(HERO_POSE, np.array((forward, right, 0.0, 0.0, 0.0, 0.0)))


def drive(path: Path, frames: int = 3, raised: int | None = None, **further: Any) -> Path:
    """Write a recording of the hero at rest and the cars, one of which may be raised above the road."""
    with carla_recap.create_recording(path, map_name="Brickfield", date=0) as recorder:
        for frame in range(frames):
            time = frame * STEP
            poses = {HERO: HERO_POSE, **{id: car_pose(id, time) + UP * (id == raised) for id in CARS}}
            records: dict[str, Any] = {"transforms": [(id, *pose) for id, pose in poses.items()], **further}
            if not frame:
                records["spawned"] = [spawn(id, pose) for id, pose in poses.items()]
                records["bounding_boxes"] = [(id, *BOX) for id in poses]
            recorder.add_frame(time, **records)
    return path


def spawn(id: int, pose: np.ndarray, role: str = "") -> Spawn:
    x, y, z, roll, pitch, yaw = pose.tolist()
    own = attributes(role_name=role or ("hero" if id == HERO else "autopilot"), color="200,20,20")
    blueprint = "vehicle.ford.ambulance" if id == AHEAD else "vehicle.tesla.model3"  # whose rear is as wide as its box
    return Spawn(id, ActorKind.VEHICLE, x, y, z, roll, pitch, yaw, 0, blueprint, own)


MOTION = SensorRig.of([{"type": "sensor.other.imu", "id": "imu"}, {"type": "sensor.speedometer", "id": "speed"}])
"""A rig that needs no driver, and hardly any time."""
