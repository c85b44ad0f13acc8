"""Another name for the module of traffic lights, until all imports are changed."""

from carla_recap.sim.actors.lights import GREEN, GREEN_TIME, OFF, RED, RED_TIME, UNKNOWN, YELLOW, YELLOW_TIME, Signals

__all__ = ["GREEN", "GREEN_TIME", "OFF", "RED", "RED_TIME", "UNKNOWN", "YELLOW", "YELLOW_TIME", "Signals"]
