"""Names that are imported when they are first used."""

from __future__ import annotations

import subprocess
import sys

from tests.waiting import PATIENCE


def test_a_name_imports_only_its_module():
    code = "import sys; from carla_recap.sim import Location; sys.exit('pymunk' in sys.modules or 'numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=PATIENCE).returncode == 0
