"""Settings of the whole suite, and recordings that several modules use."""

from __future__ import annotations

import gc
import os
import re
import signal
import sys
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from carla_recap import formats
from carla_recap.model.frame import Header
from tests.browser import chromium, shared_browser
from tests.samples import drive, save, small_log, write
from tests.waiting import PATIENCE

__all__ = ["chromium", "shared_browser"]

# CARLA's library is not published for every system and Python.
collect_ignore = [] if all(map(find_spec, ("carla", "pymunk", "msgpack"))) else ["capture", "server", "sim"]

# Workers and the hundreds of processes that tests start compile each module once, and not all modules each time.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# In the background, or under nohup, signals are ignored, which commands would inherit; tests send them.
for _signal, _handler in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(_signal) is signal.SIG_IGN:
        signal.signal(_signal, _handler)

formats._PATIENCE = PATIENCE  # s: a recording that a server completes is waited for, even on a busy machine

# The same examples in every run; HYPOTHESIS_PROFILE=search tries more and new ones.
_SETTINGS = {
    "deadline": None,
    "suppress_health_check": [
        HealthCheck.function_scoped_fixture,  # tests overwrite what is in their directory
        HealthCheck.too_slow,
        HealthCheck.data_too_large,
    ],
}
settings.register_profile("suite", max_examples=30, derandomize=True, database=None, **_SETTINGS)
settings.register_profile("search", max_examples=2000, **_SETTINGS)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "suite"))


_NEEDS = {
    "not part of the rep|recordings of CARLA are not here|is absent": "CARLA's recordings or maps, which are not public",
    "chromium|selenium": "a browser: on Debian, install chromium and chromium-driver",
    "libgl1-mesa-dri|graphics driver|driver to draw": "a driver for OpenGL: on Debian, install libegl1 and libgl1-mesa-dri",
    "npm|no node": "node and npm, with which `make test` installs what they need",
    "make clients": "other releases of CARLA's client: `make clients`",
    "make nuscenes": "nuscenes-devkit: `make nuscenes`",
    "not installed|could not import": "packages of extras: `make test` installs them",
}
"""What skipped tests need, by a pattern of the reason."""


_LONG = (
    *("test_releases", "test_notebooks", "test_docs", "test_samples", "test_pytest_plugin", "test_viewer"),
    *("test_memory", "test_campaign", "test_sim", "test_hostile"),
)
"""Modules that take half a minute or more: as the last ones, they would leave the other processes idle."""


def pytest_configure(config: pytest.Config) -> None:
    """Let one process have all tests of a file, whose fixtures are made once, in the order of `_LONG` and the alphabet."""
    if config.getoption("dist", None) == "load":
        config.option.dist = "loadfile"
    config.option.loadscopereorder = False


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Let long modules begin first."""
    items.sort(key=lambda item: _LONG.index(item.path.stem) if item.path.stem in _LONG else len(_LONG))


def pytest_collection_finish() -> None:
    """Keep what is collected out of the search for garbage, which looks at all of it again and again."""
    gc.collect()
    gc.freeze()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print in one line what skipped tests need, and how to have it."""
    reasons = [report.longrepr[2] for report in terminalreporter.stats.get("skipped", ()) if report.longrepr]
    found = Counter(next((need for reason, need in _NEEDS.items() if re.search(reason, said)), None) for said in reasons)
    needs = [f"{count} need {need}" for need, count in found.most_common() if need is not None]
    if needs:
        terminalreporter.write_line(f"skipped tests: {'; '.join(needs)}")


@pytest.fixture(scope="session")
def driver() -> None:
    """Skip the test where nothing can be drawn."""
    from tests.rendering.shapes import create

    create(None).close()


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


@pytest.fixture(scope="session")
def _drive(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return write(tmp_path_factory.mktemp("driven") / "drive.mcap", Header("Town01", 1_600_000_000), drive()).read_bytes()


@pytest.fixture
def driven(_drive: bytes, tmp_path: Path) -> Path:
    """Return the path of a drive of half a minute."""
    return save(tmp_path / "drive.mcap", _drive)
