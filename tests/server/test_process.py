from __future__ import annotations

import os
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


def test_a_recording_starts_soon_where_interpreters_start_slowly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slowly = "import sys, time\nif any('writer_process' in word for word in sys.orig_argv): time.sleep(2.5)\n"
    (tmp_path / "sitecustomize.py").write_text(slowly)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    with running(recordings=tmp_path) as port:
        client = carla.Client("127.0.0.1", port)
        client.set_timeout(2.0)
        for name in ("a.mcap", "b.mcap"):
            time.sleep(5.0)  # the process that writes is started meanwhile
            assert client.start_recorder(name) == str(tmp_path / name)
            client.set_timeout(10.0)
            client.stop_recorder()
            client.get_server_version()
            client.set_timeout(2.0)
