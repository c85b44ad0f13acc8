"""The command that stands in for CARLA's server."""

from __future__ import annotations

import asyncio
from pathlib import Path

import click

from carla_recap.cli.output import warn

_LOOPBACK = "127.0.0.1"


@click.command()
@click.option("--host", default=_LOOPBACK, show_default=True, metavar="ADDRESS", help="Where to listen.")
@click.option("--port", type=click.IntRange(0, 65534), default=2000, show_default=True, help="And the next, for streams.")
@click.option("--town", default="", metavar="NAME", help="A map's name or an .xodr; else the built-in town.")
@click.option("--maps", type=click.Path(path_type=Path), metavar="DIR", help="The folder of maps.")
@click.option("--recordings", type=click.Path(path_type=Path), metavar="DIR", help="The folder of recordings.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, metavar="K", help="Of all that is random.")
def serve(host: str, port: int, town: str, maps: Path | None, recordings: Path | None, seed: int) -> None:
    """Serve a simulated town to CARLA's own client."""
    from carla_recap.errors import MissingExtra

    try:
        from carla_recap.server.host import Host
        from carla_recap.server.serving import serve as serve_clients
        from carla_recap.sim import World, load_town
    except ImportError:
        raise MissingExtra("the server", "server") from None
    if host not in (_LOOPBACK, "localhost", "::1"):
        warn(f"{host} can be reached by others, and the protocol asks nobody who they are")
    with World(load_town(town, maps), seed=seed, recordings=recordings, maps=maps) as world:
        asyncio.run(serve_clients(Host(world), host, port, lambda port: _tell(world.town.name, host, port)))


def _tell(town: str, host: str, port: int) -> None:
    click.echo(f"{town} is served at {host}:{port}")
    click.echo(f"connect to it: carla.Client({host!r}, {port}); Ctrl-C ends it")


COMMANDS = (serve,)
