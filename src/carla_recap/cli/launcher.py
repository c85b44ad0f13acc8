"""`CarlaUE4.sh`: the server under the name, and with the arguments, of CARLA's own, for scripts that start one."""

from __future__ import annotations

import re
import sys
from itertools import islice
from typing import TYPE_CHECKING, Final

import click

from carla_recap.cli import main
from carla_recap.cli.output import say, warn
from carla_recap.cli.server import serve

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_PROJECT: Final = "CarlaUE4"
"""What CARLA's own script has as the first argument of the program that it starts."""
_OPTIONS: Final = {
    "carla-rpc-port": "--port",
    "carla-port": "--port",
    "carla-world-port": "--port",
    "world-port": "--port",
    "carla-streaming-port": "--streaming-port",
    "fps": "--fps",
    "carla-release": "--carla",
}
"""The options of `carla-recap serve` by CARLA's arguments with a value."""
_QUALITY: Final = "quality-level"
_QUALITIES: Final = ("low", "epic")
_WITHOUT_EFFECT: Final = re.compile(
    "benchmark|carla-no-networking|carla-primary-(host|port)|carla-secondary-port|carla-server|carla-settings|dx1[12]"
    "|fullscreen|graphicsadapter|log|no(rhithread|sound|splash|texturestreaming|verifygc|vsync)|nullrhi|opengl[34]?"
    "|prefer(nvidia|amd|intel)|ros2|renderoffscreen|res[xy]|stdout|unattended|usefixedtimestep|(use)?vsync|vulkan|windowed"
    "|win[xy]"
)
"""Arguments of CARLA and its engine that have no meaning here, in lower case."""


def launch() -> None:
    """Run the server with CARLA's arguments, in this process."""
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

    Unknown arguments are ignored, with a warning. The map is the first argument, as in CARLA. Options of `carla-recap
    serve` stay as they are.
    """
    left = iter(arguments[1:] if arguments[:1] == [_PROJECT] else arguments)
    return [found for number, argument in enumerate(left) for found in _translated(argument, left, is_first=not number)]


def _translated(argument: str, following: Iterator[str], *, is_first: bool) -> list[str]:
    name, has_value, value = argument.lstrip("-").partition("=")
    name = name.lower()
    if is_first and argument and not argument.startswith("-"):
        return ["--town", _map_name(argument)]
    if argument.startswith("-") and name in _OPTIONS and has_value:
        return [f"{_OPTIONS[name]}={value}"]
    if argument.startswith("-") and name == _QUALITY:
        return _quality(value)
    option = _serve_option(argument)
    if option is not None:
        return [argument] if option.is_flag or has_value else [argument, *islice(following, 1)]
    if not argument.startswith("-") or not _WITHOUT_EFFECT.fullmatch(name):
        warn(f"{argument}: is unknown, and ignored")
    return []


def _map_name(argument: str) -> str:
    """Return the map that CARLA's first argument names: a map, or its path in the engine, with options after it."""
    return argument.partition("?")[0] if argument.startswith("/Game/") else argument


def _quality(level: str) -> list[str]:
    if level.lower() not in _QUALITIES:
        warn(f"-{_QUALITY}={level}: is neither Low nor Epic, and ignored")
        return []
    return [f"--quality={level.lower()}"]


def _serve_option(argument: str) -> click.Option | None:
    """Return the option of `carla-recap serve` that an argument is."""
    name = argument.partition("=")[0]
    return next((each for each in serve.params if isinstance(each, click.Option) and name in each.opts), None)
