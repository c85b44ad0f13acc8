"""What commands print: answers on stdout; errors, warnings and the log on stderr, a line each."""

from __future__ import annotations

import os
import sys
import warnings
from functools import lru_cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, NoReturn, TextIO, cast

import click

from carla_recap.util.text import number, visible

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from carla_recap.fleet.answers import Form

UNMET: Final = 1
"""The exit code if what was demanded is not so: too many rows, broken rules, recordings that differ or are cut short."""
BAD_INPUT: Final = 2
"""The exit code of an error."""
INTERRUPTED: Final = 130
"""The exit code after Ctrl-C."""
PYTHON_HINT: Final = r" \(in Python, [^)]*\)"
"""What errors say to callers of the package alone, as a pattern."""
_QUIET: Final = "carla_recap.quiet"
_WRITTEN: Final = "carla_recap.written"


def form_of(form: str | None, *, compat: bool) -> Form:
    """Return the form in which an answer is printed; without one, a table on a terminal, else text, as with `compat`."""
    if form in ("json", "csv") and compat:
        raise click.UsageError(f"--compat is about CARLA's text: it does not go with --{form}.")
    if form is None:
        return "text" if compat or not sys.stdout.isatty() else "table"
    return cast("Form", form)


def collect_warnings() -> list[str]:
    """Return a list to which each warning is added from now on; they are printed as before."""
    found: list[str] = []
    printed = warnings.showwarning

    def collect(message: Warning | str, *about: Any, **more: Any) -> None:
        found.append(str(message))
        printed(message, *about, **more)

    warnings.showwarning = collect
    return found


def show(answer: Any, form: Form, max_rows: int | None = None, warned: Sequence[str] | None = None) -> NoReturn:
    """Print an answer, in JSON with the warnings, and end the program, with exit code 1 if it has more rows than allowed."""
    write = getattr(import_module(f"carla_recap.output.{form}"), form)
    emit(form, **{form: lambda: write(answer, warned) if form == "json" else write(answer)})
    end(unmet=is_too_many(0 if max_rows is None else len(answer), max_rows))


def emit(form: str | None, **forms: Callable[[], Iterable[str] | None]) -> None:
    """Print what one of some functions returns, the one of a form; without a form, of a table on a terminal, else of text.

    Such as a table prints itself.
    """
    form = form or ("table" if "table" in forms and sys.stdout.isatty() else "text")
    print_pieces(forms[form]() or ())
    sys.stdout.flush()


def is_too_many(rows: int, most: int | None) -> bool:
    """Return whether there are more rows than allowed, which is printed."""
    too_many = most is not None and rows > most
    if too_many:
        fail(f"{counted(rows, 'row')}, at most {most} were allowed")
    return too_many


def end(*, failed: object = False, unmet: object = False) -> NoReturn:
    """End the program: with exit code 2 if something failed, else with 1 if what was demanded is not so."""
    sys.stdout.flush()
    sys.exit(BAD_INPUT if failed else UNMET if unmet else 0)


def indented(value: object) -> list[str]:
    """Return a value that has no numbers but finite ones as JSON with indentation."""
    import json

    return [json.dumps(value, indent=1, allow_nan=False) + "\n"]


def print_pieces(pieces: Iterable[str]) -> None:
    """Print text; on a terminal, characters that could control it become escape sequences."""
    out, is_terminal = sys.stdout.buffer, sys.stdout.isatty()
    for piece in pieces:
        shown = "\n".join(map(visible, piece.split("\n"))) if is_terminal else piece
        out.write(shown.encode("utf-8", "surrogateescape"))
    out.flush()


def is_quiet() -> bool:
    """Return whether the command was asked to print neither progress nor success lines."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.meta.get(_QUIET))


def ask_quiet(context: click.Context, _: click.Parameter, value: bool) -> None:
    """Print neither progress nor success lines from now on, if an option is given."""
    if value:
        context.meta[_QUIET] = True


def ask_json(context: click.Context, _: click.Parameter, value: bool) -> None:
    """Print what `wrote` was called with as JSON on stdout, when the command ends, if an option is given."""
    if value:
        context.meta.setdefault(_WRITTEN, {"written": []})


def json_of_written() -> dict[str, list[Any]] | None:
    """Return what will be printed as JSON; None unless `ask_json` was called."""
    context = click.get_current_context(silent=True)
    return None if context is None else context.meta.get(_WRITTEN)


def has_colors(stream: TextIO) -> bool:
    """Return whether colours are printed: on terminals other than dumb ones; `NO_COLOR` and `FORCE_COLOR` prevail."""
    if os.environ.get("NO_COLOR"):
        return False
    return bool(os.environ.get("FORCE_COLOR")) or (os.environ.get("TERM") not in ("dumb", "unknown") and stream.isatty())


def say(message: str, *, before: str = "", color: str = "", stream: TextIO | None = None) -> None:
    """Print a line on stderr, with coloured words before it; no name can control the terminal or break the line."""
    stream = stream or sys.stderr
    line = "".join(c if c.isprintable() else repr(c)[1:-1] for c in message)
    if before:
        shown = click.style(before, fg=color, bold=True) if color and has_colors(stream) else before
        line = f"{shown} {line}"
    click.echo(line.encode("utf-8", "surrogateescape"), file=stream)


def note(message: str) -> None:
    """Print a line that says what happens, on stderr, unless the command was asked to be quiet."""
    if not is_quiet():
        say(message)


def wrote(
    path: str | Path,
    *notes: str,
    frames: int | None = None,
    seconds: float | None = None,
    size: int | None = None,
    **facts: Any,
) -> None:
    """Say that a file or folder was written: `wrote crash.mp4: 300 frames, 10 s, 2.1 MB`; `facts` are for JSON."""
    if size is None:
        from carla_recap.util.files import size_of

        size = size_of(path)
    if (listed := json_of_written()) is not None:
        known = {"path": os.fspath(path), "frames": frames, "seconds": seconds, "bytes": size, **facts}
        listed["written"].append({name: value for name, value in known.items() if value is not None})
    if is_quiet():
        return
    told = [
        "" if frames is None else counted(frames, "frame"),
        "" if seconds is None else f"{number(seconds)} s",
        *notes,
        "" if size is None else _bytes(size),
    ]
    about = ", ".join(filter(None, told))
    say(f"{os.fspath(path)}: {about}" if about else os.fspath(path), before="wrote", color="green")


def print_written(*, empty: bool) -> None:
    """Print what was written as one JSON object, if the command was asked for it, also an `empty` one if that is so."""
    listed = json_of_written()
    if listed is not None and (empty or any(listed.values())):
        from carla_recap.output.json import encoded

        print_pieces([encoded(listed) + "\n"])


def _bytes(size: int) -> str:
    """Return a size in words, with two digits at least."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= 0.9995 * factor:
            value = size / factor
            return f"{value:.1f} {unit}" if value < 9.95 else f"{value:.0f} {unit}"
    return f"{size} bytes"


def counted(count: int, thing: str) -> str:
    """Return a number of things, with a plural of s."""
    return f"{count} {thing}{'' if count == 1 else 's'}"


def fail(message: str) -> None:
    """Print an error."""
    say(message, before="carla-recap:", color="red")


def warn(message: object) -> None:
    """Print a warning."""
    say(str(message), before="carla-recap: warning:", color="yellow")


def log_to_stderr(verbosity: int = 0) -> None:
    """Print warnings and errors of the log on stderr, with a verbosity of 1 also what is done, with 2 its details.

    A line that was printed recently is not repeated.
    """
    import logging

    @lru_cache(maxsize=256)
    def print_once(level: int, message: str) -> None:
        if level == logging.WARNING:
            warn(message)
        elif level > logging.WARNING:
            fail(message)
        else:
            say(message, before=f"carla-recap: {logging.getLevelName(level).lower()}:", color="cyan")

    class StderrHandler(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            print_once(record.levelno, record.getMessage())

    logger, level = logging.getLogger("carla_recap"), (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbosity, 2)]
    handler = next((each for each in logger.handlers if type(each).__name__ == StderrHandler.__name__), None)
    if handler is None:
        handler = StderrHandler(level)
        logger.addHandler(handler)
    handler.setLevel(min(handler.level, level))
    if verbosity:
        logger.setLevel(level)
