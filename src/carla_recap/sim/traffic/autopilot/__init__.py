"""The autopilot: drives vehicles along the lanes, with regard for everybody else."""

from carla_recap.sim.traffic.autopilot.pilot import Autopilot

__all__ = ["Autopilot"]
