"""Sensors over the wire: what each tells those who listen to it."""

from carla_recap.server.sensors.kinds import KINDS, Support
from carla_recap.server.sensors.sending import Sensors

__all__ = ["KINDS", "Sensors", "Support"]
