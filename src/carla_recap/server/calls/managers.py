"""Calls about the traffic managers that clients run."""

from __future__ import annotations

from carla_recap.server.client import Client
from carla_recap.server.table import call


@call
def is_traffic_manager_running(client: Client, port: int) -> bool:
    """Whether a client runs a manager at this port."""
    return client.host.managers.host(port) is not None


@call
def get_traffic_manager_running(client: Client, port: int) -> tuple[str, int]:
    """Where the manager of a port runs."""
    host = client.host.managers.host(port)
    return ("", 0) if host is None else (host, port)


@call
def add_traffic_manager_running(client: Client, address: tuple[str, int]) -> bool:
    """Tell that a client runs a manager."""
    return client.host.managers.add(*address, client)


@call
def destroy_traffic_manager(client: Client, port: int) -> None:
    """Tell that a client runs no manager any more."""
    client.host.managers.remove(port)
