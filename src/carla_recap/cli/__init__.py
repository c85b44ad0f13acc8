"""The command line: one function per command; what a command needs is imported when it runs.

Exit codes: 0; 1 if an assertion fails (`--max-rows`); 2 for bad input, with one line on stderr.
"""

from __future__ import annotations

import math
import signal
import sys
import warnings
from typing import TYPE_CHECKING, Any

import click

from carla_recap.errors import RecapError, RecapWarning

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

BAD_INPUT = 2
INTERRUPTED = 130


class _Number(click.FloatRange):
    """A number of 0 or more."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        number = super().convert(value, param, ctx)
        return self.fail(f"{value} is not a number.", param, ctx) if math.isnan(number) else number


NUMBER = _Number(min=0)

_recording = click.argument("file", type=click.Path(), metavar="FILE")
_force = click.option("--force", is_flag=True, help="Overwrite DST.")
_source = click.argument("source", type=click.Path(), metavar="SRC")
_destination = click.argument("destination", type=click.Path(), metavar="DST")
_json = click.option("--json", "form", flag_value="json", help="Print JSON.")
_text = click.option("--text", "form", flag_value="text", help="Print CARLA's text, as in a pipe.")
_compat = click.option(
    "--compat",
    is_flag=True,
    help="Answer and print as CARLA 0.9.16 does, its slips included; implies --text.",
)
_max_rows = click.option(
    "--max-rows", type=click.IntRange(min=0), metavar="N", help="End with exit code 1 if there are more rows."
)


def _report(command: Callable[..., Any]) -> Callable[..., Any]:
    """The arguments of a query."""
    for decorate in (_compat, _text, _json, _recording):
        command = decorate(command)
    return command


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="carla-recap", prog_name="carla-recap")
def cli() -> None:
    """Recordings of the driving simulator CARLA, without the simulator.

    FILE, SRC and DST are recordings: CARLA's .log, or .mcap.
    """


@cli.command()
@_report
@click.option("--all", "everything", is_flag=True, help="Every record of every frame, not only the events.")
def info(file: str, everything: bool, form: str | None, compat: bool) -> None:
    """What is in a recording: spawns, collisions and other events."""
    from carla_recap.cli.report import show
    from carla_recap.formats import open_reader
    from carla_recap.queries import info as query

    show(query(open_reader(file), all=everything, compat=compat), form)


@cli.command()
@_report
@click.option(
    "--types",
    default="aa",
    show_default=True,
    metavar="AB",
    help="The two sides: h hero, v vehicle, w walker, t traffic light, o other, a any.",
)
@_max_rows
def collisions(file: str, types: str, form: str | None, compat: bool, max_rows: int | None) -> None:
    """Who collided with whom."""
    from carla_recap.cli.report import show
    from carla_recap.formats import open_reader
    from carla_recap.queries import collisions as query

    if len(types) != 2:
        raise click.BadParameter(f"{types!r} are not two letters, such as hv.", param_hint="--types")
    show(query(open_reader(file), *types, compat=compat), form, max_rows)


@cli.command()
@_report
@click.option("--min-time", type=NUMBER, default=30, show_default=True, metavar="S", help="Shortest stop to report, in s.")
@click.option("--min-distance", type=NUMBER, default=10, show_default=True, metavar="CM", help="What counts as moving.")
@_max_rows
def blocked(file: str, min_time: float, min_distance: float, form: str | None, compat: bool, max_rows: int | None) -> None:
    """Who stood still for long."""
    from carla_recap.cli.report import show
    from carla_recap.formats import open_reader
    from carla_recap.queries import blocked as query

    show(query(open_reader(file), min_time, min_distance, compat=compat), form, max_rows)


@cli.command()
@_recording
@_json
@_text
def actors(file: str, form: str | None) -> None:
    """Who was there, and when."""
    from carla_recap.cli.report import show
    from carla_recap.formats import open_reader
    from carla_recap.queries import actors as query

    show(query(open_reader(file)), form)


@cli.command()
@_source
@_destination
@_force
def convert(source: str, destination: str, force: bool) -> None:
    """Write a recording in another format; DST's suffix says which.

    .log to .mcap and back gives the same bytes.
    """
    from carla_recap.cli.progress import watch
    from carla_recap.conversion import convert as run

    extent = run(source, destination, force=force, progress=watch("converting"))
    _say(f"{destination}: {extent.frames} frames, {extent.duration:g} s")


@cli.command()
@_source
@_destination
@_force
def recover(source: str, destination: str, force: bool) -> None:
    """Save what is whole in a recording that is damaged, or was never finished."""
    from carla_recap.cli.progress import watch
    from carla_recap.recovery import recover as run

    result = run(source, destination, force=force, progress=watch("recovering"))
    _say(f"{destination}: {result}")


def main() -> None:
    """Run the command line."""
    if sys.stdout is None or sys.stderr is None:
        sys.exit(BAD_INPUT)  # nobody would see an answer
    warnings.simplefilter("always", RecapWarning)
    warnings.showwarning = _print_warning
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    signal.signal(signal.SIGTERM, _stop)
    try:
        sys.exit(cli(standalone_mode=False))
    except RecapError as error:
        _fail(str(error))
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        sys.exit(BAD_INPUT)
    except click.UsageError as error:
        _fail(error.format_message() + (f" Try '{error.ctx.command_path} --help'." if error.ctx else ""))
    except click.Abort:
        sys.exit(INTERRUPTED)
    except OSError as error:
        _fail(f"{error.filename or 'output'}: {error.strerror}")
    except MemoryError:
        _fail("not enough memory")


def _fail(message: str) -> None:
    _say(f"carla-recap: {message}")
    sys.exit(BAD_INPUT)


def _print_warning(message: Warning | str, *_: object, **__: object) -> None:
    _say(f"carla-recap: warning: {message}")


def _say(message: str) -> None:
    """Print a line on stderr; a name from a stranger's file must not steer the terminal, nor break the line."""
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in message)
    click.echo(line.encode("utf-8", "surrogateescape"), err=True)


def _stop(number: int, _: FrameType | None) -> None:
    sys.exit(128 + number)
