"""The script of the page: the file that is shipped is what its modules make."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

VIEWER = Path(__file__).parents[3] / "viewer"


def npm(*arguments: str) -> None:
    if shutil.which("npm") is None or not (VIEWER / "node_modules").is_dir():
        pytest.skip("viewer/node_modules is missing: 'make test' installs it where npm is")
    run = subprocess.run(["npm", "--prefix", VIEWER, *arguments], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr


def test_the_bundle_is_what_the_modules_make(tmp_path: Path) -> None:
    npm("run", "bundle", "--", f"--outfile={tmp_path / 'page.js'}")
    assert (tmp_path / "page.js").read_text() == (VIEWER / "page" / "page.js").read_text(), "run 'make bundle'"
