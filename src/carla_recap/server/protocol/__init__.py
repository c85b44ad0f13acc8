"""What the releases of CARLA's client say differently, as a table, and which release a client is of."""

from carla_recap.server.protocol.releases import DEFAULT, RELEASES, Release, release_named

__all__ = ["DEFAULT", "RELEASES", "Release", "release_named"]
