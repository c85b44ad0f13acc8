"""How a command answers: a table on a terminal, CARLA's text in a pipe, JSON when asked."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import click

from carla_recap.queries.output.text import text
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Iterable

TOO_MANY = 1


def show(answer: Any, form: str | None, max_rows: int | None = None) -> None:
    """Print an answer; ends the program with exit code 1 if it has more rows than allowed.

    Args:
        answer: The answer of a query.
        form: "json", "text", or None: a table on a terminal, else text.
        max_rows: How many rows are allowed.
    """
    if form == "json" and getattr(answer, "compat", False):
        raise click.UsageError("--compat is about CARLA's text: it does not go with --json.")
    if form is None:
        form = "text" if getattr(answer, "compat", False) or not sys.stdout.isatty() else "table"
    if form == "text":
        _print(text(answer))
    elif form == "json":
        from carla_recap.queries.output.json import json

        _print(json(answer))
    else:
        from carla_recap.queries.output.table import table

        table(answer)
    if max_rows is not None and len(answer) > max_rows:
        click.echo(f"carla-recap: {len(answer)} rows, at most {max_rows} were allowed", err=True)
        sys.exit(TOO_MANY)


def _shown(piece: str) -> str:
    """Return some lines of a report for a terminal: whatever could control it is an escape sequence."""
    return "\n".join(map(visible, piece.split("\n")))


def _print(pieces: Iterable[str]) -> None:
    out = sys.stdout.buffer
    for piece in map(_shown, pieces) if sys.stdout.isatty() else pieces:
        out.write(piece.encode("utf-8", "surrogateescape"))
    out.flush()
