"""The simulated time of an episode."""

from __future__ import annotations

from dataclasses import dataclass


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
