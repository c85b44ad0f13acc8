"""A server for the official CARLA client: it simulates a town, records, replays and answers queries."""

from carla_recap.errors import MissingExtra

try:
    import msgpack  # noqa: F401
except ModuleNotFoundError:
    raise MissingExtra("the server", "server") from None

from carla_recap.server.process import running

__all__ = ["running"]
