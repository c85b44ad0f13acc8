"""The benchmarks run, on a short recording; what they measure does not matter here."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROWS = ("mcap_to_log", "collisions", "blocked", "incidents", "differences", "info_all", "remote")


def test_the_benchmarks_run(tmp_path):
    pytest.importorskip("msgpack", reason="the extra `server` is not installed")
    command = [sys.executable, "-m", "benchmarks", "--frames", "100", *(f"--only={row}" for row in ROWS)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 1 + 3 + 3 + 4 + 2 + 4 + 1 + 4
    assert lines[0].split() == ["what", "measured", "ratio", "goal", "met?"]
    (equal,) = [line for line in lines if line.startswith(".log → .mcap → .log")]
    assert equal.endswith("ok")
