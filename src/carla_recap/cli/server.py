"""The command that serves a simulated town to CARLA's client."""

from __future__ import annotations

import sys
import warnings
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from carla_recap.cli import options
from carla_recap.cli.output import log_to_stderr, note, warn
from carla_recap.cli.parameter_types import FOLLOW, POSITIVE
from carla_recap.errors import RecapError, RecapWarning

if TYPE_CHECKING:
    from carla_recap.rendering.camera import Quality
    from carla_recap.replay.follow import Follow
    from carla_recap.server.viewer import ViewerProcess
    from carla_recap.sim import Town

_LOOPBACK = "127.0.0.1"
_EVERYWHERE = ("0.0.0.0", "::")
_FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)


@click.command()
@click.option("--host", default=_LOOPBACK, show_default=True, metavar="ADDRESS", help="The address to listen on.")
@click.option(
    "--port",
    type=click.IntRange(0, 65534),
    default=2000,
    show_default=True,
    help="The port for calls.",
)
@click.option(
    "--streaming-port",
    type=click.IntRange(0, 65535),
    metavar="PORT",
    help="The port for streams; else the next one after the port for calls.",
)
@click.option("--town", default="", metavar="NAME", help="A map's name or an .xodr; else the built-in town.")
@click.option("--maps", type=_FOLDER, metavar="DIR", help="The folder of maps.")
@click.option("--recordings", type=click.Path(path_type=Path), metavar="DIR", help="The folder of recordings.")
@click.option("--confine", is_flag=True, help="Refuse recordings outside that folder.")
@click.option("--stand-in", is_flag=True, help="Serve the built-in town under the name of a map that is missing.")
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, metavar="K", help="The seed of everything random."
)
@click.option("--fps", type=POSITIVE, metavar="N", help="Ticks of equal length, N in a second; else as time passes.")
@click.option(
    "--quality",
    type=click.Choice(["low", "epic"], case_sensitive=False),
    default="epic",
    show_default=True,
    help="The images of cameras without or with shadows and smooth edges.",
)
@options.carla
@click.option("--rerun", is_flag=True, help="Show the world live in Rerun's viewer.")
@click.option(
    "--rerun-to", metavar="FILE|URL", help="The same in an .rrd, or in the viewer that listens at rerun+http://..."
)
@options.foxglove
@click.option(
    "--follow",
    type=FOLLOW,
    metavar="ID|hero",
    help="The actor that its camera follows; else the hero, or one that moves.",
)
@options.models
@click.option("--attached", is_flag=True, hidden=True, help="End when the standard input does.")
def serve(
    host: str,
    port: int,
    streaming_port: int | None,
    town: str,
    maps: Path | None,
    recordings: Path | None,
    confine: bool,
    stand_in: bool,
    seed: int,
    fps: float | None,
    quality: Quality,
    carla: str,
    rerun: bool,
    rerun_to: str | None,
    foxglove: bool,
    foxglove_port: int | None,
    follow: Follow | None,
    attached: bool,
) -> None:
    """Serve a simulated town to CARLA's own client."""
    import asyncio

    from carla_recap.server.host import Host
    from carla_recap.server.protocol import release_named
    from carla_recap.server.serving import serve as serve_clients
    from carla_recap.sim import World
    from carla_recap.util.files import make_folder

    log_to_stderr()
    if attached and sys.stdin is None:
        raise RecapError("--attached needs a standard input")
    if recordings is not None:
        make_folder(recordings)
    foxglove_port = options.foxglove_port_of(foxglove, foxglove_port)
    if foxglove_port is not None and (rerun or rerun_to):
        raise click.UsageError("--foxglove or --rerun was expected, not both.")
    is_shown = rerun or rerun_to or foxglove_port is not None or follow is not None
    viewer = _viewer(rerun_to, follow, foxglove_port) if is_shown else nullcontext()
    with viewer as shown, World(_town(town, maps, stand_in), seed=seed, recordings=recordings, maps=maps) as world:

        def ready(port: int) -> None:
            if host not in (_LOOPBACK, "localhost", "::1"):
                warn(f"{host} can be reached from other machines, and the protocol has no authentication")
            _announce(world.town.name, host, port, hint=not attached)
            if shown is not None:
                shown.open(host, port)

        warnings.simplefilter("once", RecapWarning)  # however often a client asks about a damaged recording
        with asyncio.Runner() as runner:
            release = release_named(carla)
            served = Host(world, confined=confine, stand_in=stand_in, quality=quality, release=release)
            if fps is not None:
                served.apply_settings(replace(served.settings, fixed_delta_seconds=1 / fps))
            runner.run(serve_clients(served, host, port, ready, streaming_port=streaming_port, attached=attached))


def _town(name: str, maps: Path | None, stand_in: bool) -> Town:
    from carla_recap.roads.find import find_map, plain_name
    from carla_recap.sim import load_town

    if stand_in and name and not name.endswith(".xodr") and find_map(name, maps) is None:
        town = load_town()
        warn(f"{name}: there is no such map; {town.name} stands in for it")
        return town.renamed(plain_name(name))
    return load_town(name, maps)


def _viewer(to: str | None, follow: Follow | None, foxglove_port: int | None) -> ViewerProcess:
    from carla_recap.server.viewer import ViewerProcess

    return ViewerProcess(to, "hero" if follow is None else follow, foxglove_port)


def _announce(town: str, host: str, port: int, *, hint: bool) -> None:
    click.echo(f"{town} is served at {host}:{port}")  # for programs, which wait for it
    sys.stdout.flush()
    if not hint:
        return
    if host in _EVERYWHERE:
        note(f"connect to it: carla.Client('HOST', {port}), with the name or address of this machine; Ctrl-C ends it")
    else:
        note(f"connect to it: carla.Client({host!r}, {port}); Ctrl-C ends it")
