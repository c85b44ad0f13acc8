"""Sensors over the wire: what the sensors of a world send to the clients that listen."""

from carla_recap.server.sensors.dispatch import SENSOR_KINDS, Sensors, Support

__all__ = ["SENSOR_KINDS", "Sensors", "Support"]
