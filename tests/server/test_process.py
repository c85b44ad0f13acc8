"""The server as a process of its own: it ends with its parent, and completes its recording."""

from __future__ import annotations

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest

from carla_recap import RecapError, open_recording
from carla_recap.server import running
from tests.server.client import SYNCHRONOUS, connect, refuses_connections, ticks
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from pathlib import Path

KILLED = """
import os, sys
import carla
from carla_recap.server import running

with running(recordings=sys.argv[1]) as port:
    client = carla.Client("127.0.0.1", port)
    client.set_timeout(600.0)
    client.get_world()
    client.start_recorder("drive.mcap")
    client.get_world().wait_for_tick()
    print(port, flush=True)
    os.kill(os.getpid(), 9)
"""


def test_a_server_ends_with_a_killed_parent(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", KILLED, tmp_path], stdout=subprocess.PIPE, text=True, timeout=PATIENCE, check=False
    )
    wait_until(lambda: refuses_connections(int(done.stdout)))
    wait_until((tmp_path / "drive.mcap").exists)
    with open_recording(tmp_path / "drive.mcap") as recording:
        assert recording.info.frames > 0


def test_the_end_of_the_block_completes_the_recording_and_nothing_is_printed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with running(recordings=tmp_path) as port:
        client = connect(port)
        world = client.get_world()
        world.apply_settings(SYNCHRONOUS)
        client.start_recorder("drive.mcap")
        ticks(world, 10)
    with open_recording(tmp_path / "drive.mcap") as recording:
        assert recording.info.frames == 10
    assert capfd.readouterr() == ("", "")


def test_a_server_that_does_not_start_says_why() -> None:
    with pytest.raises(RecapError, match="Atlantis"), running("Atlantis"):
        pass


def test_other_clients_are_served_while_the_process_that_writes_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    starts, may_start = tmp_path / "starts", tmp_path / "may start"
    slowly = f"""
import os, sys, time
if any("writer_process" in word for word in sys.orig_argv):
    open({str(starts)!r}, "w").close()
    while not os.path.exists({str(may_start)!r}):
        time.sleep(0.02)
"""
    (tmp_path / "sitecustomize.py").write_text(slowly)
    monkeypatch.syspath_prepend(tmp_path)  # which started processes have, too
    with running(recordings=tmp_path) as port, ThreadPoolExecutor(1) as pool:
        client, other = connect(port), connect(port)
        answer = pool.submit(client.start_recorder, "a.mcap")
        try:
            wait_until(starts.exists)
            assert other.get_server_version()
            assert not answer.done()
        finally:
            may_start.touch()
        assert answer.result(PATIENCE) == str(tmp_path / "a.mcap")
        client.stop_recorder()
    with open_recording(tmp_path / "a.mcap") as recording:
        assert recording.info.frames
