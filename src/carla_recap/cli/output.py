"""What commands print: answers on stdout; errors, warnings and the log on stderr, a line each."""

from __future__ import annotations

import os
import sys
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final, NoReturn

import click

from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.fleet.answers import Form

TOO_MANY: Final = 1
"""The exit code of an answer with more rows than allowed."""
BAD_INPUT: Final = 2
"""The exit code of an error."""
PYTHON_HINT: Final = r" \(in Python, [^)]*\)"
"""What errors say to callers of the package alone, as a pattern."""


def form_of(form: str | None, *, compat: bool) -> Form:
    """Return the form in which an answer is printed: json, text or table.

    Args:
        form: The form that was asked for; None: a table on a terminal, else text.
        compat: Whether the answer has the mistakes of CARLA 0.9.16, which are about its text.
    """
    if form == "json" and compat:
        raise click.UsageError("--compat is about CARLA's text: it does not go with --json.")
    if form is not None:
        return "json" if form == "json" else "text"
    return "text" if compat or not sys.stdout.isatty() else "table"


def show(answer: Any, form: str | None, max_rows: int | None = None) -> NoReturn:
    """Print an answer, and end the program, with exit code 1 if it has more rows than allowed.

    Args:
        answer: The answer of a query.
        form: "json", "text", or None: a table on a terminal, else text.
        max_rows: The number of rows that are allowed.
    """
    form = form_of(form, compat=getattr(answer, "compat", False))
    if form == "text":
        from carla_recap.queries.output.text import text

        print_pieces(text(answer))
    elif form == "json":
        from carla_recap.queries.output.json import json

        print_pieces(json(answer))
    else:
        from carla_recap.queries.output.table import table

        table(answer)
    sys.stdout.flush()
    too_many = max_rows is not None and len(answer) > max_rows
    if too_many:
        click.echo(f"carla-recap: {len(answer)} rows, at most {max_rows} were allowed", err=True)
    os._exit(TOO_MANY if too_many else 0)  # ending the interpreter takes longer than a small query


def print_pieces(pieces: Iterable[str]) -> None:
    """Print text; on a terminal, characters that could control it become escape sequences."""
    out, is_terminal = sys.stdout.buffer, sys.stdout.isatty()
    for piece in pieces:
        shown = "\n".join(map(visible, piece.split("\n"))) if is_terminal else piece
        out.write(shown.encode("utf-8", "surrogateescape"))
    out.flush()


def say(message: str) -> None:
    """Print a line on stderr; names from a recording can neither control the terminal nor break the line."""
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in message)
    click.echo(line.encode("utf-8", "surrogateescape"), err=True)


def warn(message: object) -> None:
    """Print a warning."""
    say(f"carla-recap: warning: {message}")


def log_to_stderr() -> None:
    """Print the package's log on stderr, from warnings upwards; a line that was printed recently is not repeated."""
    import logging

    @lru_cache(maxsize=256)
    def print_once(level: int, message: str) -> None:
        if level == logging.WARNING:
            warn(message)
        else:
            say(f"carla-recap: {message}")

    class StderrHandler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            print_once(record.levelno, record.getMessage())

    logging.getLogger("carla_recap").addHandler(StderrHandler(logging.WARNING))
