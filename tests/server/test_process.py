"""The server as a process of its own: it ends with its parent, and completes its recording."""

from __future__ import annotations

import subprocess
import sys
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


def test_a_recording_begins_where_interpreters_start_slowly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The process that writes has been started before: here, none starts while the recording begins."""
    may_start = tmp_path / "may start"
    slowly = f"""
import os, sys, time
if any("writer_process" in word for word in sys.orig_argv):
    while not os.path.exists({str(may_start)!r}):
        time.sleep(0.02)
    open(os.path.join({str(tmp_path)!r}, f"{{os.getpid()}}.started"), "w").close()
"""
    (tmp_path / "sitecustomize.py").write_text(slowly)
    monkeypatch.syspath_prepend(tmp_path)  # which started processes have, too
    may_start.touch()
    with running(recordings=tmp_path) as port:
        client = connect(port)
        for count, name in enumerate(("a.mcap", "b.mcap"), 1):
            may_start.touch()
            wait_until(lambda count=count: len(list(tmp_path.glob("*.started"))) >= count)
            may_start.unlink()
            assert client.start_recorder(name) == str(tmp_path / name)
            client.stop_recorder()
            client.get_server_version()
        may_start.touch()
