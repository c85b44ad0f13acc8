"""Any sequence of world operations leaves a sound physics space: `python -m tests.sim.sequences` runs many more."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from pathlib import Path

SEQUENCES = 15
COMMAND = (sys.executable, "-X", "faulthandler", "-m", "tests.sim.sequences", f"--examples={SEQUENCES}")


def test_sequences_of_operations_neither_crash_nor_break_the_invariants_of_the_space(tmp_path: Path) -> None:
    trace = tmp_path / "operations.txt"
    done = subprocess.run([*COMMAND, f"--trace={trace}"], capture_output=True, text=True, timeout=PATIENCE, check=False)
    operations = trace.read_text() if trace.exists() else ""
    assert done.returncode == 0, f"{done.stdout[-4000:]}\n{done.stderr[-4000:]}\nthe latest operations:\n{operations}"
