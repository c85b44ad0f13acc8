"""Settings of the whole suite, and recordings that several modules use."""

from __future__ import annotations

import os
import signal
from datetime import timedelta
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

from carla_recap.model.frame import Header
from tests.samples import drive, save, small_log, write

if TYPE_CHECKING:
    from pathlib import Path

# Whoever runs the suite in the background, or under nohup, ignores signals, and commands take that over; tests send them.
for _signal, _handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(_signal) is signal.SIG_IGN:
        signal.signal(_signal, _handler)

# The same examples in every run; HYPOTHESIS_PROFILE=search looks for new ones, and longer.
_CALM = {
    "deadline": timedelta(seconds=20),
    "suppress_health_check": [
        HealthCheck.function_scoped_fixture,  # tests overwrite what is in their directory
        HealthCheck.too_slow,
        HealthCheck.data_too_large,
    ],
}
settings.register_profile("suite", max_examples=60, derandomize=True, database=None, **_CALM)
settings.register_profile("search", max_examples=1500, **_CALM)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "suite"))


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """Return the path of the small log."""
    return save(tmp_path / "small.log", small_log())


@pytest.fixture
def small_mcap(small: Path) -> Path:
    """Return the path of the small log as MCAP."""
    from carla_recap import convert

    convert(small, small.with_suffix(".mcap"))
    return small.with_suffix(".mcap")


@pytest.fixture
def driven(tmp_path):
    """Return the path of a drive of half a minute."""
    return write(tmp_path / "drive.mcap", Header("Town01", 1_600_000_000), drive())
