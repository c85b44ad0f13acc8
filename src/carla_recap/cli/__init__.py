"""The command line: one function per command, imported when the command is run, as is all that it uses.

Exit codes: 0; 1 if an assertion fails (`--max-rows`); 2 for bad input, with one line on stderr.
"""

from __future__ import annotations

import atexit
import gc
import os
import re
import signal
import sys
import warnings
from contextlib import suppress
from importlib import import_module
from keyword import iskeyword
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from carla_recap.cli.output import BAD_INPUT, INTERRUPTED, PYTHON_HINT, ask_quiet, fail, log_to_stderr, print_written, warn
from carla_recap.errors import MissingExtra, RecapError, RecapWarning
from carla_recap.util.signals import ignore_termination, is_first, is_terminating, set_handlers

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import FrameType


_COMMANDS: Final = {
    "queries": ("info", "summary", "collisions", "blocked", "actors", "incidents", "measures"),
    "editing": ("convert", "recover", "clip", "import"),
    "export": ("export", "clips", "view", "snapshot", "video", "sense", "report"),
    "sim": ("record", "replay"),
    "server": ("serve",),
    "capture": ("capture", "watch"),
    "check": ("check", "metrics", "diff"),
    "campaign": ("campaign",),
    "score": ("score",),
    "index": ("index", "sql"),
    "doctor": ("doctor",),
}
"""The commands of each module."""
_MODULES: Final = {command: module for module, commands in _COMMANDS.items() for command in commands}
_EXTRAS: Final = {
    ("serve", "sim"): "server",
    ("sql", "arrow"): "sql",
    **{(command, "foxglove"): "foxglove-live" for command in ("serve", "view", "watch")},
}
"""By command and missing extra, the extra that brings all that the command needs."""


class _Commands(click.Group):
    """The commands; if an extra is missing, the error names the command and the extra that brings all that it needs."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _MODULES:
            return super().get_command(ctx, cmd_name)
        function = f"{cmd_name}_" if iskeyword(cmd_name) else cmd_name
        command: click.Command = getattr(import_module(f"carla_recap.cli.{_MODULES[cmd_name]}"), function)
        if not any(each.name == "quiet" for each in command.params):
            command.params += _of_all()
        return command

    def invoke(self, ctx: click.Context) -> object:
        succeeds = False
        try:
            answer = super().invoke(ctx)
            succeeds = True
            return answer
        except MissingExtra as error:
            extra = _EXTRAS.get((str(ctx.invoked_subcommand), error.extra), error.extra)
            raise MissingExtra(f"carla-recap {ctx.invoked_subcommand}", extra) from None
        finally:
            print_written(empty=succeeds)


def _set_verbose(_: click.Context, __: click.Parameter, value: int) -> None:
    if value:
        log_to_stderr(value)


def _of_all() -> list[click.Parameter]:
    """Return the options of all commands, before and after their names."""
    verbose = "Log on stderr what is opened, found and kept; -vv also what is read and written."
    quiet = "Print neither progress nor what was written; errors and warnings stay."
    return [
        click.Option(["-v", "--verbose"], count=True, expose_value=False, callback=_set_verbose, help=verbose),
        click.Option(["-q", "--quiet"], is_flag=True, expose_value=False, callback=ask_quiet, help=quiet),
    ]


@click.group(cls=_Commands, commands=dict.fromkeys(_MODULES), context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="carla-recap", prog_name="carla-recap")
def cli() -> None:
    """Recordings of the driving simulator CARLA, without the simulator.

    FILE and SRC are recordings: CARLA's .log, or .mcap. SOURCE... are recordings, folders or globs in quotes, in any
    number, or - for a list on stdin. The options -q and -v go before a command or after it.
    """


cli.params += _of_all()


def main() -> None:
    """Run the command line."""
    if sys.stdout is None or sys.stderr is None:
        sys.exit(BAD_INPUT)  # an answer could not be printed
    warnings.simplefilter("always", RecapWarning)
    warnings.showwarning = _print_warning
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    atexit.register(_prepare_end)  # as the first, so that it is called as the last
    set_handlers(_stop)
    sys.exit(run())


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command, and return its exit code, unless it ends the process itself; errors are a line on stderr."""
    name = None if arguments is None else "carla-recap"
    try:
        return int(cli(arguments, name, standalone_mode=False) or 0)
    except RecapError as error:
        return _fail(re.sub(PYTHON_HINT, "", str(error)))
    except click.exceptions.NoArgsIsHelpError as error:
        error.show()
        return BAD_INPUT
    except click.UsageError as error:
        return _fail(error.format_message() + (f" Try '{error.ctx.command_path} --help'." if error.ctx else ""))
    except click.Abort:
        return INTERRUPTED
    except OSError as error:
        if error.filename is None:
            _discard_output()
        return _fail(f"{error.filename or 'output'}: {error.strerror}")
    except MemoryError:
        return _fail("not enough memory")


def _discard_output() -> None:
    """Have what is left of the output, which cannot be written, go nowhere: Python writes it at its end."""
    with suppress(OSError, ValueError), Path(os.devnull).open("wb") as nowhere:
        os.dup2(nowhere.fileno(), sys.stdout.fileno())


def _fail(message: str) -> int:
    fail(message)
    return BAD_INPUT


def _print_warning(message: Warning | str, *_: object, **__: object) -> None:
    warn(message)


def _stop(number: int, _: FrameType | None) -> None:
    if not is_first(number):
        return
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(128 + number)


def _prepare_end() -> None:
    """Keep the end of the interpreter short, which looks for cycles of objects and resets the handlers of signals."""
    gc.freeze()
    if is_terminating():
        ignore_termination()
