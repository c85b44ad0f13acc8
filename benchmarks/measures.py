"""The measures and the near misses of an hour."""

from __future__ import annotations

from typing import TYPE_CHECKING

from benchmarks.measuring import Line, Subject, cpu_time
from carla_recap.recording import open_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from carla_recap.recording import Recording


def of_hero(subject: Subject) -> Iterator[Line]:
    """The measures of the hero against all."""
    yield _line("measures of the hero", subject, lambda recording: recording.measures("hero"), 12.0)


def near_misses(subject: Subject) -> Iterator[Line]:
    """The near misses of all pairs; the paths of the hour's vehicles cross without any rules."""
    yield _line("near misses of all", subject, lambda recording: recording.incidents(kinds=["near miss"]), 12.0)


def _line(name: str, subject: Subject, query: Callable[[Recording], object], hour: float) -> Line:
    recorded = subject.mcap  # which may be converted first

    def run() -> None:
        with open_recording(recorded) as recording:
            query(recording)

    seconds = cpu_time(run)
    goal = max(hour * subject.seconds / 3600, 1.0)
    each = f"{seconds / subject.frames * 1e6:.0f} µs a frame"
    return Line(f"{name}, {subject.length}", f"{seconds:.1f} s", each, f"≤ {goal:.0f} s", seconds <= goal)


ROWS = (of_hero, near_misses)
