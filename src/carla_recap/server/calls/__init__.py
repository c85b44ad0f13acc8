"""What clients can call: a function for each remote procedure of CARLA, under its name."""

from carla_recap.server.calls import actors, managers, session

__all__ = ["actors", "managers", "session"]
