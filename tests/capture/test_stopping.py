"""How captures and live views end, as their processes do."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import carla
import pytest

from carla_recap import create_recording, open_recording
from carla_recap.capture.live import watch
from carla_recap.model.records import Attribute, Spawn
from carla_recap.server import running as server
from carla_recap.util.files import partials
from tests.capture.conftest import settle, started, wait_for
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from collections.abc import Iterator

KEPT = 5.0  # s of a recording that may be lost
GHOST, SOUND = 500, 501


@contextmanager
def running(path: Path, port: int) -> Iterator[subprocess.Popen[str]]:
    """What records a server to a path, or shows it there, once it writes."""
    with started(path, port) as capture:
        wait_until(lambda: partials(path))
        yield capture.process


@pytest.mark.parametrize(("name", "gap"), [("a.mcap", 0.001), ("a.rrd", 0.05)])
def test_further_signals_do_not_prevent_its_completion(port: int, tmp_path: Path, name: str, gap: float) -> None:
    if name.endswith(".rrd"):
        pytest.importorskip("rerun", reason="the extra `rerun` is not installed")
    with running(tmp_path / name, port) as process:
        time.sleep(0.5)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGINT, signal.SIGTERM):
            process.send_signal(number)
            time.sleep(gap)
        said, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, said
    assert "stopped by SIGINT" in said.splitlines()[-1]
    assert "Traceback" not in said
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).stat().st_size > 1000


def test_watch_ends_after_a_duration(port: int, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="the extra `rerun` is not installed")
    said = watch(tmp_path / "a.rrd", port=port, duration=0.5)
    assert said == "the duration has passed"
    assert [path.name for path in tmp_path.iterdir()] == ["a.rrd"]


def test_no_callback_of_the_client_is_left_when_the_interpreter_ends(tmp_path: Path) -> None:
    """One that is would end the process by SIGABRT, now and then: `terminate called without an active exception`."""

    def interrupted(number: int) -> tuple[int, str]:
        with running(tmp_path / f"{number}.mcap", port) as process:
            time.sleep(0.1 * number)
            process.send_signal(signal.SIGINT)
            said, _ = process.communicate(timeout=PATIENCE)
        return process.returncode, said

    with server() as port, ThreadPoolExecutor(3) as threads:
        client = carla.Client("127.0.0.1", port)
        client.set_timeout(PATIENCE)
        world = client.get_world()
        world.apply_settings(carla.WorldSettings(fixed_delta_seconds=0.002))  # hundreds of ticks in a second
        hero = world.get_blueprint_library().find("vehicle.tesla.model3")
        hero.set_attribute("role_name", "hero")
        for pose in world.get_map().get_spawn_points()[:10]:
            world.try_spawn_actor(hero, pose)
        ended = list(threads.map(interrupted, range(3)))
    assert [code for code, _ in ended] == [0] * 3, ended


def test_a_live_file_is_on_the_disk_while_it_is_written(port: int, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="the extra `rerun` is not installed")
    with running(tmp_path / "a.rrd", port) as process:
        (live,) = partials(tmp_path / "a.rrd")

        def chunks() -> int:
            """Return the number of chunks that Rerun reads; the last one may be cut off."""
            read = [Path(sys.executable).with_name("rerun"), "rrd", "print", live]
            return subprocess.run(read, capture_output=True, check=False).stdout.count(b"\n")

        wait_until(lambda: chunks() > 20, pause=0.2)
        process.kill()
        process.wait(PATIENCE)
        assert chunks() > 20


def test_an_actor_that_the_client_cannot_read_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with showing_a_ghost(tmp_path) as (port, world), running(path, port) as process:
        wait_for(world, lambda: "vehicle.tesla.model3" in types(world))
        with pytest.raises(ValueError, match="color"):
            list(world.get_actors())
        for _ in range(10):
            world.tick()
        settle(process)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, said
    warning, last = said.splitlines()[-2:]
    assert "warning: actors that CARLA's client cannot make out are left out: " in warning
    assert "stopped by SIGINT" in last
    with open_recording(path) as recording:
        recorded = {spawned.type_id for frame in recording for spawned in frame["spawned"]}
    assert "vehicle.tesla.model3" in recorded
    assert "vehicle.audi.tt" not in recorded


def types(world: carla.World) -> list[str]:
    """The blueprints of all actors that can be made out."""
    listed, found = world.get_actors(), []
    for index in range(len(listed)):
        try:
            found.append(listed[index].type_id)
        except ValueError:
            continue
    return found


@contextmanager
def showing_a_ghost(folder: Path) -> Iterator[tuple[int, carla.World]]:
    """A server in synchronous mode that replays a recording in which an actor has an invalid color."""
    path = folder / "ghost.log"
    with create_recording(path, map_name="Brickfield") as recorder:
        ghost = Spawn(GHOST, 1, 1000.0, type_id="vehicle.audi.tt", attributes=[Attribute(4, "color", "256,0,0")])
        sound = Spawn(SOUND, 1, type_id="vehicle.tesla.model3")
        places = {"id": [GHOST, SOUND], "x": [1000.0, 0.0]}
        recorder.add_frame(0.0, spawned=[ghost, sound], transforms=places)
        recorder.add_frame(60.0, transforms=places)
    code = "from carla_recap.server import actor_records; actor_records.readable_attributes = lambda _, given, __: given; "
    code += "from carla_recap.cli import main; main()"
    command = [sys.executable, "-c", code, "serve", "--port=0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            port = int(process.stdout.readline().split(":")[-1])
            client = carla.Client("127.0.0.1", port)
            client.set_timeout(PATIENCE)
            world = client.get_world()
            world.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))
            client.replay_file(str(path), 0.0, 0.0, 0)
            yield port, world
            path.unlink()
        finally:
            process.terminate()
            process.wait(PATIENCE)
