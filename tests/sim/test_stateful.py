"""Any sequence of world operations leaves a sound physics space: `python -m tests.sim.sequences` runs many more."""

from __future__ import annotations

import subprocess
import sys

from tests.waiting import PATIENCE


def test_sequences_of_operations_neither_crash_nor_break_the_invariants_of_the_space() -> None:
    command = [sys.executable, "-u", "-X", "faulthandler", "-m", "tests.sim.sequences", "15"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, f"the latest operations:\n{done.stdout[-8000:]}\n{done.stderr[-4000:]}"
