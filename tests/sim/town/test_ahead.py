"""Parsing maps ahead."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING, Any

import psutil

from carla_recap.sim.town import ahead
from tests.waiting import wait_until

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def test_the_process_is_no_zombie_when_it_has_ended(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def start(_: list[str], **options: Any) -> subprocess.Popen[bytes]:
        started.append(popen([sys.executable, "-c", ""], **options))
        return started[-1]

    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen
    for name in ("A", "B"):
        (tmp_path / f"{name}.xodr").write_text("<OpenDRIVE/>")
    monkeypatch.setattr(ahead, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(subprocess, "Popen", start)
    with ahead.parsing_ahead(tmp_path):
        (process,) = started
        wait_until(lambda: not psutil.pid_exists(process.pid))
    assert process.returncode == 0
