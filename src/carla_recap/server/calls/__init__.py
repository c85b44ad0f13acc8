"""The calls of clients: a function for each remote procedure of CARLA, under its name."""

from carla_recap.server.calls import actors, batches, recorder, session, unsupported, vehicles, world

__all__ = ["actors", "batches", "recorder", "session", "unsupported", "vehicles", "world"]
