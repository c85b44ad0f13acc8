"""The simulated time of an episode, and the date of recordings that are to have the same bytes."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Final

_DATE: Final = 1767261600  # 2026-01-01 10:00 UTC


def seeded_date() -> int:
    """Return the date of recordings of a seed in Unix seconds: that of $SOURCE_DATE_EPOCH, else 2026-01-01 10:00 UTC."""
    return int(os.environ.get("SOURCE_DATE_EPOCH", _DATE))


@dataclass(slots=True)
class Clock:
    """The simulated time of an episode.

    Attributes:
        frame: The number of ticks so far.
        elapsed: The simulated time so far, in s.
        delta: The length of the latest tick, in s.
    """

    frame: int = 0
    elapsed: float = 0.0
    delta: float = 0.05

    def advance(self) -> None:
        """Count a tick of length `delta`."""
        self.frame += 1
        self.elapsed += self.delta
