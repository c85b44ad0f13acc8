"""What clients can call: a function for each remote procedure of CARLA, under its name."""

from carla_recap.server.calls import (
    accepted,
    actors,
    batches,
    episodes,
    lights,
    managers,
    recorder,
    session,
    vehicles,
    walkers,
    world,
)

__all__ = [
    "accepted",
    "actors",
    "batches",
    "episodes",
    "lights",
    "managers",
    "recorder",
    "session",
    "vehicles",
    "walkers",
    "world",
]
