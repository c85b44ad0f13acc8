"""No client can stop the world of the others, whatever it calls; `python -m tests.server.sequences` makes more calls."""

from __future__ import annotations

from tests.server.sequences import run
from tests.waiting import PATIENCE

CALLS = 60
BRIEF = 1.0
"""The processor time in s for which one client keeps another waiting at most, on a busy machine."""


def test_random_calls_of_three_clients_keep_a_fourth_from_nothing() -> None:
    outcomes, slowest, faults = run(PATIENCE, seed=1, most=CALLS)
    assert faults == []
    assert outcomes.total() == CALLS
    assert slowest[0] < BRIEF, slowest
