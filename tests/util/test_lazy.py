"""Names that are imported when they are first used."""

from __future__ import annotations

import subprocess
import sys

import pytest

from carla_recap import sim
from tests.waiting import PATIENCE


def test_a_package_has_its_public_names():
    pytest.importorskip("pymunk", reason="the extra `sim` is not installed")
    assert {name for name in dir(sim) if not name.startswith("_")} == set(sim.__all__)
    for name in sim.__all__:
        assert getattr(sim, name) is getattr(sim, name)
    with pytest.raises(AttributeError, match=r"module 'carla_recap.sim' has no attribute 'wings'"):
        sim.wings  # noqa: B018


def test_a_name_imports_only_its_module():
    code = "import sys; from carla_recap.sim import Location; sys.exit('pymunk' in sys.modules or 'numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, timeout=PATIENCE).returncode == 0
