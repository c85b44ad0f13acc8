"""Sensors of a rig: which there are, how they are placed, and what they measure."""

from __future__ import annotations

from carla_recap.sensors.kinds import SENSOR_TYPES, SensorAttribute, SensorType
from carla_recap.sensors.rig import SensorRig, SensorSpec

__all__ = ["SENSOR_TYPES", "SensorAttribute", "SensorRig", "SensorSpec", "SensorType"]
