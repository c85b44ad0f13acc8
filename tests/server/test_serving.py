from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pytest

from carla_recap import RecapError, open_recording
from carla_recap.server import running
from carla_recap.server.host import Host
from carla_recap.server.rpc.structs import EpisodeSettings
from carla_recap.server.serving import Ticker
from carla_recap.sim import World, load_town
from tests.cli.command import error
from tests.server.client import SYNCHRONOUS, connect, refuses_connections, serving, ticks
from tests.sim.flat import flat_world
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from pathlib import Path


def test_an_invalid_name_of_a_host_is_an_error_in_one_line() -> None:
    assert error("serve", "--port=0", "--host", "a..b").startswith("a..b:0: cannot be listened at: ")


def test_invalid_folders_are_errors_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    absent = tmp_path / "absent"
    assert f"Directory '{absent}' does not exist" in error("serve", "--port=0", "--maps", absent)
    assert "/x: cannot be written: Not a directory" in error("serve", "--port=0", "--recordings", tmp_path / "file" / "x")
    message = error("serve", "--port=0", "--rerun-to", tmp_path / "file" / "x.rrd")
    assert message == f"{tmp_path / 'file'}: is a file; a folder was expected"


def test_serving_other_machines_prints_how_they_connect() -> None:
    with serving("--host=0.0.0.0") as (process, port):
        process.terminate()
        _, said = process.communicate(timeout=PATIENCE)
    assert f"carla.Client('HOST', {port}), with the name or address of this machine" in said


def test_a_warning_is_printed_once(tmp_path: Path) -> None:
    with World(load_town(), recordings=tmp_path) as world:
        world.start_recorder("cut.log")
        for _ in range(10):
            world.tick()
    path = tmp_path / "cut.log"
    path.write_bytes(path.read_bytes()[:-100])
    with serving("--recordings", tmp_path) as (process, port):
        client = connect(port)
        for _ in range(3):
            assert "Frames: " in client.show_recorder_file_info("cut.log", False)
        process.terminate()
        _, errors = process.communicate(timeout=PATIENCE)
    (warning,) = [line for line in errors.splitlines() if not line.startswith("connect to it: ")]
    assert warning.startswith(f"carla-recap: warning: {path}")


@pytest.mark.parametrize(
    ("fails", "messages"),
    [("listener", ["a tick goes on without function: 'lost'"]), ("publish", ["a tick has failed: KeyError('lost')"] * 3)],
)
async def test_a_failing_tick_is_logged_and_others_follow(
    fails: str, messages: list[str], caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    host = Host(flat_world())
    host.apply_settings(EpisodeSettings(fixed_delta_seconds=0.002))
    failures = iter(range(3))

    def fail() -> None:
        if next(failures, None) is not None:
            raise KeyError("lost")

    if fails == "listener":
        host.world.listeners.append(fail)
    else:
        monkeypatch.setattr(host, "publish", fail)

    pace = asyncio.create_task(Ticker(host).run())
    while host.frame < 6:
        assert not pace.done()
        await asyncio.sleep(0.005)
    pace.cancel()
    assert caplog.messages == messages


async def test_calls_are_served_between_ticks_that_take_longer_than_they_last(monkeypatch: pytest.MonkeyPatch) -> None:
    host, pauses, sleep = Host(flat_world()), [], asyncio.sleep
    host.apply_settings(EpisodeSettings(fixed_delta_seconds=0.002))
    monkeypatch.setattr(host, "tick", lambda _: time.sleep(0.02))

    async def pause(seconds: float) -> None:
        pauses.append(seconds)
        await sleep(0)

    monkeypatch.setattr(asyncio, "sleep", pause)
    pace = asyncio.create_task(Ticker(host).run())
    while len(pauses) < 4:
        await sleep(0)
    pace.cancel()
    assert min(pauses[1:4]) >= 0.002


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
