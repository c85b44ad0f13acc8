"""The command line: one function per command; what a command needs is imported when it runs.

Exit codes: 0; 1 if an assertion fails (`--max-rows`); 2 for bad input, with one line on stderr.
"""

from __future__ import annotations

import atexit
import re
import signal
import sys
import warnings
from typing import TYPE_CHECKING

import click

from carla_recap.cli import capture, files, queries, serve, show, simulate
from carla_recap.cli.output import log_to_stderr, say, warn
from carla_recap.errors import MissingExtra, RecapError, RecapWarning
from carla_recap.util.signals import ignore_termination, is_first, is_terminating, set_handlers

if TYPE_CHECKING:
    from types import FrameType

_IN_PYTHON = re.compile(r" \(in Python, [^)]*\)")  # what errors say for callers of the package
BAD_INPUT = 2
INTERRUPTED = 130


class _Commands(click.Group):
    """The commands; of one that lacks an extra, the error names what was asked for and all that it needs."""

    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except MissingExtra as error:
            extra = _EXTRAS.get((str(ctx.invoked_subcommand), error.extra), error.extra)
            raise MissingExtra(f"carla-recap {ctx.invoked_subcommand}", extra) from None


_EXTRAS = {("serve", "sim"): "server"}
"""By command and missing extra, the extra that brings all that the command needs."""


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="carla-recap", prog_name="carla-recap")
def cli() -> None:
    """Recordings of the driving simulator CARLA, without the simulator.

    FILE and SRC are recordings: CARLA's .log, or .mcap.
    """


for command in (*queries.COMMANDS, *files.COMMANDS, *show.COMMANDS, *simulate.COMMANDS, *serve.COMMANDS, *capture.COMMANDS):
    cli.add_command(command)


def main() -> None:
    """Run the command line."""
    if sys.stdout is None or sys.stderr is None:
        sys.exit(BAD_INPUT)  # nobody would see an answer
    warnings.simplefilter("always", RecapWarning)
    warnings.showwarning = _print_warning
    log_to_stderr()
    if hasattr(signal, "SIGPIPE"):
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    atexit.register(_ignore_more)  # as the first, so that it is called as the last
    set_handlers(_stop)
    try:
        sys.exit(cli(standalone_mode=False))
    except RecapError as error:
        _fail(_IN_PYTHON.sub("", str(error)))
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
    say(f"carla-recap: {message}")
    sys.exit(BAD_INPUT)


def _print_warning(message: Warning | str, *_: object, **__: object) -> None:
    warn(message)


def _stop(number: int, _: FrameType | None) -> None:
    if not is_first(number):
        return
    if number == signal.SIGINT:
        raise KeyboardInterrupt
    sys.exit(128 + number)


def _ignore_more() -> None:
    """Ignore further signals after a first one while the interpreter ends, which resets handlers."""
    if is_terminating():
        ignore_termination()
