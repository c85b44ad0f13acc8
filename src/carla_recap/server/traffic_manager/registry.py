"""The registry of traffic managers by their ports."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import asyncio

    from carla_recap.server.traffic_manager.cycle import TrafficManagerCycle


class TrafficManagerOwner(Protocol):
    """A client that runs a traffic manager."""

    @property
    def address(self) -> str:
        """The address of the client's machine."""

    @property
    def cycle(self) -> TrafficManagerCycle:
        """The state of its traffic manager."""


class TrafficManagerRegistry:
    """The traffic managers by their ports; each is removed when its client leaves, since it runs inside the client."""

    def __init__(self) -> None:
        self._running: dict[int, tuple[str, TrafficManagerOwner]] = {}

    def add(self, host: str, port: int, client: TrafficManagerOwner) -> bool:
        """Add a manager; return False if there is one at this port."""
        if port in self._running:
            return False
        self._running[port] = (host, client)
        return True

    def remove(self, port: int) -> None:
        """Remove the manager of a port."""
        self._running.pop(port, None)

    def remove_all(self, client: TrafficManagerOwner) -> None:
        """Remove the managers of a client."""
        self._running = {port: running for port, running in self._running.items() if running[1] is not client}

    def host(self, port: int) -> str | None:
        """Return the machine on which the manager of a port runs; None if there is no manager."""
        return self._running[port][0] if port in self._running else None

    def has_one(self, client: TrafficManagerOwner) -> bool:
        """Return whether a client runs a manager."""
        return any(owner is client for _, owner in self._running.values())

    def unsettled(self) -> list[asyncio.Future[None]]:
        """Return futures that are done when no manager can miss a tick; see `TrafficManagerCycle`."""
        return [future for _, owner in self._running.values() for future in owner.cycle.unsettled()]

    def expect_cycles(self, client: TrafficManagerOwner) -> None:
        """Expect the managers of a client to begin their cycles: the client signals the tick to them itself."""
        ports = sorted(port for port, (_, owner) in self._running.items() if owner is client)
        if ports:
            client.cycle.expect([(client.address, port) for port in ports])
