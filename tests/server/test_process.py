from __future__ import annotations

import subprocess
import sys
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
