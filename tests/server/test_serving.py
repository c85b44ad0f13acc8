from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import carla
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


async def test_a_failing_tick_is_logged_and_others_follow(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    host = Host(flat_world())
    host.apply_settings(EpisodeSettings(fixed_delta_seconds=0.002))
    failures = iter(range(3))

    def fail() -> None:
        if next(failures, None) is not None:
            raise KeyError("lost")

    monkeypatch.setattr(host, "publish", fail)
    pace = asyncio.create_task(Ticker(host).run())
    while host.frame < 6:
        assert not pace.done()
        await asyncio.sleep(0.005)
    pace.cancel()
    assert caplog.messages == ["a tick has failed: KeyError('lost')"] * 3


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
    with running(recordings=tmp_path, confine=True) as port:
        client = connect(port)
        world = client.get_world()
        world.apply_settings(SYNCHRONOUS)
        with pytest.raises(RuntimeError, match="is outside the folder of recordings"):
            client.start_recorder("../drive.mcap")
        client.start_recorder("drive.mcap")
        ticks(world, 10)
    with open_recording(tmp_path / "drive.mcap") as recording:
        assert recording.info.frames == 10
    assert capfd.readouterr() == ("", "")


def test_a_server_that_does_not_start_says_why() -> None:
    with pytest.raises(RecapError, match="Atlantis"), running("Atlantis"):
        pass


# --- several clients -------------------------------------------------------------------------------------------------------


DYING = """
import os, sys, carla
client = carla.Client("127.0.0.1", int(sys.argv[1]))
client.set_timeout(600.0)
world = client.get_world()
world.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
world.tick()
os.kill(os.getpid(), 9)
"""


def test_two_clients_tick_one_world(world: carla.World, other_client: carla.Client) -> None:
    theirs = other_client.get_world()
    frames = [ticking.tick() for _ in range(20) for ticking in (world, theirs)]
    assert frames == list(range(frames[0], frames[0] + 40))


def test_in_asynchronous_mode_a_tick_waits_for_the_next_frame(world: carla.World) -> None:
    world.apply_settings(carla.WorldSettings())
    frames = [world.tick() for _ in range(5)]
    assert frames == sorted(set(frames))
    assert world.get_snapshot().frame >= frames[-1]


def test_a_new_fixed_delta_applies_at_once(world: carla.World) -> None:
    def seconds_to_apply() -> float:
        world.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
        start = time.monotonic()
        world.apply_settings(carla.WorldSettings(synchronous_mode=False, fixed_delta_seconds=0.1))
        return time.monotonic() - start

    wait_until(lambda: seconds_to_apply() < 2.0)  # the client asks 30 times if need be
    assert world.wait_for_tick(PATIENCE).delta_seconds == pytest.approx(0.1)


def test_variable_ticks_are_as_long_as_the_clock_says(world: carla.World) -> None:
    world.apply_settings(carla.WorldSettings())

    def seconds_gained() -> float:
        first, start = world.wait_for_tick(PATIENCE), time.monotonic()
        for _ in range(20):
            last = world.wait_for_tick(PATIENCE)
        return last.elapsed_seconds - first.elapsed_seconds - (time.monotonic() - start)

    wait_until(lambda: abs(seconds_gained()) < 0.3)  # a machine without time for them has shorter ones


def test_a_world_stays_synchronous_when_its_client_dies_as_with_carla(port: int, other_client: carla.Client) -> None:
    subprocess.run([sys.executable, "-c", DYING, str(port)], timeout=PATIENCE, check=False)
    world = other_client.get_world()
    assert world.get_settings().synchronous_mode
    frame = wait_until(lambda: world.get_snapshot().frame)  # in synchronous mode get_world does not wait for the first one
    time.sleep(0.2)
    assert world.tick() == frame + 1
    world.apply_settings(carla.WorldSettings())


def test_a_port_in_use_is_an_error_in_one_line(port: int) -> None:
    expected = f":{port}: cannot be listened at: Address already in use; choose another port with --port"
    assert expected in error("serve", f"--port={port}")
