"""CARLA's server without CARLA: the official client connects to a simulated town, records, replays and queries."""

from carla_recap.server.process import running

__all__ = ["running"]
