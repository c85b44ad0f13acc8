"""The server of a simulated town for CARLA's client: as a command, and as `CarlaUE4.sh`, with CARLA's own arguments."""

from __future__ import annotations

import re
import sys
import warnings
from contextlib import nullcontext
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from carla_recap.cli import options
from carla_recap.cli.options import FOLLOW, PORT, POSITIVE, command, flag, option
from carla_recap.cli.output import log_to_stderr, note, say, warn
from carla_recap.errors import RecapError, RecapWarning

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from carla_recap.rendering.camera import Quality
    from carla_recap.replay.follow import Follow
    from carla_recap.server.viewer import ViewerProcess
    from carla_recap.sim import Town

_CARLA_OPTIONS: Final = {
    "carla-rpc-port": "--port",
    "carla-port": "--port",
    "carla-world-port": "--port",
    "world-port": "--port",
    "carla-streaming-port": "--streaming-port",
    "fps": "--fps",
    "carla-release": "--carla",
}
"""The options of `carla-recap serve` by CARLA's arguments with a value."""
_WITHOUT_EFFECT: Final = re.compile(
    "benchmark|carla-no-networking|carla-primary-(host|port)|carla-secondary-port|carla-server|carla-settings|dx1[12]"
    "|fullscreen|graphicsadapter|log|no(rhithread|sound|splash|texturestreaming|verifygc|vsync)|nullrhi|opengl[34]?"
    "|prefer(nvidia|amd|intel)|ros2|renderoffscreen|res[xy]|stdout|unattended|usefixedtimestep|(use)?vsync|vulkan|windowed"
    "|win[xy]"
)
"""Arguments of CARLA and its engine that have no meaning here, in lower case."""
_LOOPBACK = "127.0.0.1"
_EVERYWHERE = ("0.0.0.0", "::")
_FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)


@command(options.models)
def serve(
    host: str = option("--host", default=_LOOPBACK, metavar="ADDRESS", help="The address to listen on."),
    port: int = option("--port", type=click.IntRange(0, 65534), default=2000, help="The port for calls."),
    streaming_port: int | None = option(
        "--streaming-port",
        type=PORT,
        metavar="PORT",
        help="The port for streams; else the next one after the port for calls.",
    ),
    town: str = option(
        "--town", default="", show_default=False, metavar="NAME", help="A map's name or an .xodr; else the built-in town."
    ),
    maps: Path | None = option("--maps", type=_FOLDER, metavar="DIR", help="The folder of maps."),
    recordings: Path | None = option(
        "--recordings", type=click.Path(path_type=Path), metavar="DIR", help="The folder of recordings."
    ),
    confine: bool = flag("--confine", help="Refuse recordings outside that folder."),
    stand_in: bool = flag("--stand-in", help="Serve the built-in town under the name of a map that is missing."),
    seed: int = option("--seed", type=click.IntRange(min=0), default=0, metavar="K", help="The seed of everything random."),
    fps: float | None = option(
        "--fps", type=POSITIVE, metavar="N", help="Ticks of equal length, N in a second; else as time passes."
    ),
    quality: Quality = option(
        "--quality",
        type=click.Choice(["low", "epic"], case_sensitive=False),
        default="epic",
        help="The images of cameras without or with shadows and smooth edges.",
    ),
    carla: str = options.carla,
    rerun: bool = flag("--rerun", help="Show the world live in Rerun's viewer."),
    rerun_to: str | None = option(
        "--rerun-to",
        metavar="FILE|URL",
        help="The same in an .rrd, or in the viewer that listens at rerun+http://...",
    ),
    foxglove_port: int | None = options.foxglove,
    follow: Follow | None = option(
        "--follow",
        type=FOLLOW,
        metavar="ID|hero",
        help="The actor that its camera follows; else the hero, or one that moves.",
    ),
    attached: bool = option("--attached", is_flag=True, hidden=True, help="End when the standard input does."),
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


# --- CarlaUE4.sh -----------------------------------------------------------------------------------------------------


def launch() -> None:
    """Run the server with CARLA's arguments, in this process."""
    from carla_recap.cli import main

    arguments = sys.argv[1:]
    if {"-h", "-help", "--help"} & set(arguments):
        say("CarlaUE4.sh [MAP] [-carla-rpc-port=N] [-carla-streaming-port=N] [-quality-level=Low|Epic] [-fps=N]")
        say("            [-carla-release=0.9.15] ...")
        say("CARLA's other arguments have no effect. These options of carla-recap serve can be added:")
        arguments = ["--help"]
    else:
        arguments = ["--stand-in", *serve_arguments(arguments)]
    sys.argv = ["carla-recap", "serve", *arguments]
    main()


def serve_arguments(arguments: Sequence[str]) -> list[str]:
    """Return CARLA's arguments as those of `carla-recap serve`.

    Unknown arguments are ignored, with a warning. The map is the first argument, as in CARLA; but CARLA's own script has the
    name of the project before it. Options of `carla-recap serve` stay as they are.
    """
    left = iter(arguments[1:] if arguments[:1] == ["CarlaUE4"] else arguments)
    return [found for number, argument in enumerate(left) for found in _translated(argument, left, is_first=not number)]


def _translated(argument: str, following: Iterator[str], *, is_first: bool) -> list[str]:
    written, has_value, value = argument.partition("=")
    name = written.lstrip("-").lower()
    if not argument.startswith("-"):
        if is_first and argument:
            return ["--town", argument.partition("?")[0] if argument.startswith("/Game/") else argument]
        name = ""
    elif name in _CARLA_OPTIONS and has_value:
        return [f"{_CARLA_OPTIONS[name]}={value}"]
    elif name == "quality-level" and value.lower() in ("low", "epic"):
        return [f"--quality={value.lower()}"]
    options = (each for each in serve.params if isinstance(each, click.Option))
    option = next((each for each in options if written in each.opts), None)
    if option is not None:
        return [argument] if option.is_flag or has_value else [argument, *islice(following, 1)]
    if name == "quality-level":
        warn(f"{argument}: is neither Low nor Epic, and ignored")
    elif not _WITHOUT_EFFECT.fullmatch(name):
        warn(f"{argument}: is unknown, and ignored")
    return []
