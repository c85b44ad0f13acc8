"""The autopilot: drives vehicles along the lanes, with regard for other road users."""

from carla_recap.sim.traffic.autopilot.autopilot import Autopilot

__all__ = ["Autopilot"]
