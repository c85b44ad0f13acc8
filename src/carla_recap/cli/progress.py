"""Progress bars: wrappers of what a command goes through, which show a bar on a terminal, and nothing in a pipe."""

from __future__ import annotations

import math
import os
import sys
from contextlib import contextmanager
from itertools import count
from stat import S_ISFIFO
from typing import TYPE_CHECKING, Any, Self, TypeVar

import click

from carla_recap.cli.output import is_quiet

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from rich.progress import Progress as Bar

    from carla_recap.formats.base import Reader
    from carla_recap.replay.player import Player

T = TypeVar("T")


def _is_shown() -> bool:
    """Return whether bars are shown: on terminals that can, unless the command is quiet, or a worker process."""
    is_command = click.get_current_context(silent=True) is not None
    return is_command and sys.stderr.isatty() and os.environ.get("TERM") not in ("dumb", "unknown") and not is_quiet()


def watch(title: str) -> Callable[..., Iterable[Any]]:
    """Return a wrapper of the batches of a recording, or of its scenes, or of a list."""

    def progress(items: Iterable[Any], source: Reader | Player | None = None) -> Iterable[Any]:
        if source is None:
            items, done = list(items), count()
            return _bar(items, title, len(items), lambda _: next(done))
        if hasattr(source, "extent"):
            return _bar(items, title, source.extent().duration, lambda batch: batch.elapsed[-1].item())
        return _bar(items, title, source.stop - source.start, lambda scene: scene.time - source.start)

    return progress


def watch_ticks(title: str, seconds: float) -> Callable[[Iterable[float]], Iterable[float]]:
    """Return a wrapper of the elapsed seconds of a simulation that ends after a number of seconds."""
    return lambda ticks: _bar(ticks, title, seconds, float)


class SourcesBar:
    """A bar that counts recordings; a context manager, in which it is shown.

    It is not shown while stdout is a pipe, whose reader may print on the same terminal.
    """

    is_open = False  # whether there is one, which is then the only bar

    def __init__(self, title: str, total: int | None) -> None:
        self._title = title
        self._total = total
        self._bar: Bar | None = None
        self._task: Any = None

    @staticmethod
    def is_shown() -> bool:
        """Return whether such bars are shown."""
        return _is_shown() and not S_ISFIFO(os.fstat(sys.stdout.fileno()).st_mode)

    def __enter__(self) -> Self:
        SourcesBar.is_open = True
        if self.is_shown():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
            self._bar = Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=False)
            self._task = self._bar.add_task(self._title, total=self._total)
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove the bar for good."""
        SourcesBar.is_open = False
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def counted(self, items: Iterable[T], total: int | None = None) -> Iterator[T]:
        """Yield items, a number that may be known by now, and count each when it has been taken in."""
        if self._bar is not None and total is not None:
            self._bar.update(self._task, total=total)
        for item in items:
            yield item
            if self._bar is not None:
                self._bar.advance(self._task)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Remove the bar from the terminal in a `with` block, which prints."""
        if self._bar is None:
            yield
            return
        self._bar.stop()
        yield
        self._bar.start()


def _bar(items: Iterable[T], title: str, total: float, position: Callable[[T], float]) -> Iterator[T]:
    if SourcesBar.is_open or not _is_shown():
        yield from items
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=total if math.isfinite(total) else None)
        for item in items:
            bar.update(task, completed=position(item))
            yield item
