"""CARLA's server without CARLA: the official client connects to a simulated town, records, replays and queries."""

from carla_recap.errors import MissingExtra

try:
    import msgpack  # noqa: F401
except ModuleNotFoundError:
    raise MissingExtra("the server", "server") from None

from carla_recap.server.process import running

__all__ = ["running"]
