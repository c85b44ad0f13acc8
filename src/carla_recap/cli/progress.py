"""Progress bars: wrappers of what a command goes through, which show a bar on a terminal, and nothing in a pipe."""

from __future__ import annotations

import math
import sys
from time import monotonic
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from carla_recap.editing.convert import Progress
    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.queries.incidents import Incident
    from carla_recap.replay.player import Player
    from carla_recap.replay.player import Progress as SceneProgress
    from carla_recap.replay.scene import Scene

T = TypeVar("T")

_INTERVAL = 0.1  # s between two updates of a bar


def watch(title: str) -> Progress:
    """Return a wrapper of the batches of a recording."""

    def progress(batches: Iterable[Batch], reader: Reader) -> Iterable[Batch]:
        return _bar(batches, title, reader.extent().duration, lambda batch: batch.elapsed[-1].item())

    return progress


def watch_scenes(title: str) -> SceneProgress:
    """Return a wrapper of the scenes of a recording."""

    def progress(scenes: Iterable[Scene], player: Player) -> Iterable[Scene]:
        return _bar(scenes, title, player.stop - player.start, lambda scene: scene.time - player.start)

    return progress


def watch_incidents(title: str) -> Callable[[Sequence[Incident]], Iterable[Incident]]:
    """Return a wrapper of incidents."""

    def progress(found: Sequence[Incident]) -> Iterable[Incident]:
        return _bar(found, title, len(found), found.index)

    return progress


def watch_ticks(title: str, seconds: float) -> Callable[[Iterable[float]], Iterable[float]]:
    """Return a wrapper of the elapsed seconds of a simulation that ends after a number of seconds."""
    return lambda ticks: _bar(ticks, title, seconds, float)


def watch_recordings(title: str) -> Callable[[Iterable[T], int], Iterable[T]]:
    """Return a wrapper of the outcomes of a number of recordings."""

    def progress(outcomes: Iterable[T], count: int) -> Iterable[T]:
        if not sys.stderr.isatty():
            return outcomes
        numbered = _watched(enumerate(outcomes, 1), title, count, lambda item: item[0])
        return (outcome for _, outcome in numbered)

    return progress


def _bar(items: Iterable[T], title: str, total: float, position: Callable[[T], float]) -> Iterable[T]:
    return _watched(items, title, total, position) if sys.stderr.isatty() else items


def _watched(items: Iterable[T], title: str, total: float, position: Callable[[T], float]) -> Iterator[T]:
    from rich.console import Console
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=total if math.isfinite(total) else None)
        due = 0.0
        for item in items:
            if monotonic() >= due:
                bar.update(task, completed=position(item))
                due = monotonic() + _INTERVAL
            yield item
