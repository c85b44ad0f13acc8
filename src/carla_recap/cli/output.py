"""The lines that commands print on stderr: errors, warnings and the log."""

from __future__ import annotations

import logging
from functools import lru_cache
from typing import Final

import click

_MOST_KNOWN: Final = 256  # lines of the log that are not repeated


def say(message: str) -> None:
    """Print a line on stderr; a name from a stranger's file must not steer the terminal, nor break the line."""
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in message)
    click.echo(line.encode("utf-8", "surrogateescape"), err=True)


def warn(message: object) -> None:
    """Print a warning."""
    say(f"carla-recap: warning: {message}")


class _StderrHandler(logging.Handler):
    """Prints each record of the log as a line on stderr, unless the same line was printed recently."""

    def emit(self, record: logging.LogRecord) -> None:
        """See `logging.Handler`."""
        _print_once(record.levelno, record.getMessage())


@lru_cache(maxsize=_MOST_KNOWN)
def _print_once(level: int, message: str) -> None:
    if level == logging.WARNING:
        warn(message)
    else:
        say(f"carla-recap: {message}")


def log_to_stderr() -> None:
    """Print the package's log on stderr, from warnings upwards."""
    logging.getLogger("carla_recap").addHandler(_StderrHandler(logging.WARNING))
