"""What commands say on stderr: one line at a time."""

from __future__ import annotations

import click


def say(message: str) -> None:
    """Print a line on stderr; a name from a stranger's file must not steer the terminal, nor break the line."""
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in message)
    click.echo(line.encode("utf-8", "surrogateescape"), err=True)


def warn(message: object) -> None:
    """Print a warning."""
    say(f"carla-recap: warning: {message}")
