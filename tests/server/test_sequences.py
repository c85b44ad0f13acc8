"""No client can stop the world of the others, whatever it calls; `python -m tests.server.sequences` makes more calls."""

from __future__ import annotations

from tests.server.sequences import run
from tests.waiting import PATIENCE

COUNT = 300
BRIEF = 1.0
"""The processor time in s for which one client keeps another waiting at most, on a busy machine."""


def test_random_calls_of_three_clients_keep_a_fourth_from_nothing() -> None:
    made, slowest, faults = run(PATIENCE, seed=1, most=COUNT)
    assert faults == []
    assert made.total() == COUNT
    assert slowest[0] < BRIEF, slowest
