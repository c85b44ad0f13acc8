"""The traffic managers of clients: who runs one, and where."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from carla_recap.server.client import Client


class Managers:
    """The traffic managers by their ports; each is gone with its client, which alone could answer for it."""

    def __init__(self) -> None:
        self._running: dict[int, tuple[str, Client]] = {}

    def add(self, host: str, port: int, client: Client) -> bool:
        """Enter a manager; False if there is one at this port."""
        if port in self._running:
            return False
        self._running[port] = (host, client)
        return True

    def remove(self, port: int) -> None:
        """Forget a manager."""
        self._running.pop(port, None)

    def host(self, port: int) -> str | None:
        """Where the manager of a port runs; None if there is none."""
        return self._running[port][0] if port in self._running else None

    def owns_one(self, client: Client) -> bool:
        """Whether a client runs a manager."""
        return any(owner is client for _, owner in self._running.values())

    def leave(self, client: Client) -> None:
        """Forget the managers of a client."""
        self._running = {port: running for port, running in self._running.items() if running[1] is not client}
