"""How far a command is: a bar on a terminal, nothing in a pipe."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from carla_recap.conversion import Progress
    from carla_recap.formats.base import Reader
    from carla_recap.frame import Frame


def watch(what: str) -> Progress:
    """Watches a stream of frames go by; `what` is being done to them."""

    def progress(frames: Iterable[Frame], reader: Reader) -> Iterable[Frame]:
        return _bar(frames, what, reader.extent().frames) if sys.stderr.isatty() else frames

    return progress


def _bar(frames: Iterable[Frame], title: str, total: int | None) -> Iterator[Frame]:
    from rich.console import Console
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=total)
        for number, frame in enumerate(frames):
            if number % 256 == 0:
                bar.update(task, completed=number)
            yield frame
