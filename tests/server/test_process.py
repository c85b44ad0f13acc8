from __future__ import annotations

import socket
import subprocess
import sys
import time
from contextlib import suppress
from typing import TYPE_CHECKING

import carla
import pytest

from carla_recap import RecapError, open_recording
from carla_recap.server import running

if TYPE_CHECKING:
    from pathlib import Path

TEST = """
import carla

def test_the_town(carla_server):
    client = carla.Client("127.0.0.1", carla_server)
    client.set_timeout(30.0)
    assert client.get_world().get_map().name.endswith("Brickfield")
"""

KILLED = """
import os, sys
import carla
from carla_recap.server import running

with running(recordings=sys.argv[1]) as port:
    client = carla.Client("127.0.0.1", port)
    client.set_timeout(30.0)
    client.get_world()
    client.start_recorder("drive.mcap")
    client.get_world().wait_for_tick()
    print(port, flush=True)
    os.kill(os.getpid(), 9)
"""
SOON = 20.0  # s


def test_a_server_ends_with_a_killed_parent(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", KILLED, tmp_path], stdout=subprocess.PIPE, text=True, timeout=60, check=False
    )
    port, end = int(done.stdout), time.monotonic() + SOON
    with suppress(ConnectionRefusedError):
        while time.monotonic() < end:
            socket.create_connection(("127.0.0.1", port)).close()
            time.sleep(0.05)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", port))
    while not (tmp_path / "drive.mcap").exists() and time.monotonic() < end:
        time.sleep(0.05)
    with open_recording(tmp_path / "drive.mcap") as recording:
        assert recording.info.frames > 0


def test_the_end_of_the_block_completes_the_recording(tmp_path: Path) -> None:
    with running(recordings=tmp_path) as port:
        client = carla.Client("127.0.0.1", port)
        client.set_timeout(30.0)
        world = client.get_world()
        world.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
        client.start_recorder("drive.mcap")
        for _ in range(10):
            world.tick()
    with open_recording(tmp_path / "drive.mcap") as recording:
        assert recording.info.frames == 10


def test_a_server_that_does_not_start_says_why() -> None:
    with pytest.raises(RecapError, match="Atlantis"), running("Atlantis"):
        pass


def test_users_tests_have_a_fixture(tmp_path: Path) -> None:
    (tmp_path / "test_town.py").write_text(TEST)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", tmp_path],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    assert "1 passed" in done.stdout
