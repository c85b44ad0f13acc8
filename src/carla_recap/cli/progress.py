"""How far a command is: a bar on a terminal, nothing in a pipe."""

from __future__ import annotations

import math
import sys
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

_REST = 256  # items between two looks at the bar
_LIVE_REST = 10  # the same, where items come one by one


def watch(what: str) -> Progress:
    """Watches a stream of batches go by; `what` is being done to them."""

    def progress(batches: Iterable[Batch], reader: Reader) -> Iterable[Batch]:
        return _bar(batches, what, reader.extent().duration, lambda batch: batch.elapsed[-1].item(), rest=1)

    return progress


def watch_scenes(what: str) -> SceneProgress:
    """Watches a recording being played; `what` is being done to it."""

    def progress(scenes: Iterable[Scene], player: Player) -> Iterable[Scene]:
        return _bar(scenes, what, player.stop - player.start, lambda scene: scene.time - player.start)

    return progress


def watch_incidents(what: str) -> Callable[[Sequence[Incident]], Iterable[Incident]]:
    """Watches incidents go by; `what` is being done to them."""

    def progress(found: Sequence[Incident]) -> Iterable[Incident]:
        places = iter(range(len(found)))
        return _bar(found, what, len(found), lambda _: next(places), rest=1)

    return progress


def watch_ticks(what: str, seconds: float) -> Callable[[Iterable[float]], Iterable[float]]:
    """Watches a simulation, whose ticks tell the time; `what` is being done for so many seconds."""
    return lambda ticks: _bar(ticks, what, seconds, lambda elapsed: elapsed)


def watch_live(what: str, seconds: float) -> Callable[[Iterable[float]], Iterable[float]]:
    """Watches a world whose ticks come in their own time, and tell the time; `what` is being done for so many seconds."""
    return lambda ticks: _bar(ticks, what, seconds, lambda elapsed: elapsed, rest=_LIVE_REST)


def _bar(items: Iterable[T], title: str, total: float, position: Callable[[T], float], rest: int = _REST) -> Iterable[T]:
    return _watched(items, title, total, position, rest) if sys.stderr.isatty() else items


def _watched(items: Iterable[T], title: str, total: float, position: Callable[[T], float], rest: int) -> Iterator[T]:
    from rich.console import Console
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=total if math.isfinite(total) else None)
        for number, item in enumerate(items):
            if number % rest == 0:
                bar.update(task, completed=position(item))
            yield item
