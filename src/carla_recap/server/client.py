"""A connected client: the context of its calls."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from carla_recap.server.traffic_manager import TrafficManagerCycle

if TYPE_CHECKING:
    from collections.abc import Awaitable

    from carla_recap.server.host import Host
    from carla_recap.server.rpc.connection import ClientConnection
    from carla_recap.server.traffic_manager import TrafficManagerPause


class Client:
    """A client, and what the server knows of it.

    Args:
        host: The served world.
        connection: The connection of the client.

    Attributes:
        host: The served world.
        stream: The number of its stream of snapshots; see `SnapshotStreams`.
        cycle: The state of its traffic manager.
        pause: The pause of its traffic manager, while an episode begins.
    """

    stream: int

    def __init__(self, host: Host, connection: ClientConnection) -> None:
        self.host = host
        self.cycle = TrafficManagerCycle()
        self.pause: TrafficManagerPause | None = None
        self._connection = connection
        host.snapshots.open(self)

    @property
    def address(self) -> str:
        """The address of the client's machine."""
        return self._connection.address

    @property
    def known_episode(self) -> int:
        """The number of the episode that the client learns of; while its traffic manager pauses, of the one before.

        The first snapshot then tells the client of a new episode, which makes it reset its traffic manager.
        """
        return self.host.episode - (self.pause is not None)

    def in_background(self, work: Awaitable[None]) -> None:
        """Run something after the current call; it is cancelled when the client leaves."""
        self._connection.in_background(work)

    def begin_call(self, name: str) -> None:
        """Take note of a call of the client, or of its traffic manager: they share a connection."""
        self.cycle.begin_call(name)

    def hold(self, name: str, answer: Any) -> Any:
        """Return the answer to a call, or an awaitable of it while the traffic manager pauses."""
        return answer if self.pause is None else self.pause.hold(name, answer)

    def leave(self) -> None:
        """Release everything when the client has left."""
        self.cycle.expect([])
        self.host.traffic_managers.remove_all(self)
        self.host.snapshots.close(self)
