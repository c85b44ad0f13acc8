"""How captures and live views end, as their processes do."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import carla
import pytest

from carla_recap.server import running as server
from carla_recap.util.files import partials
from tests.capture.conftest import started
from tests.server.client import connect
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from collections.abc import Iterator

KEPT = 5.0  # s of a recording that may be lost


@contextmanager
def running(path: Path, port: int) -> Iterator[subprocess.Popen[str]]:
    """What records a server to a path, or shows it there, once it writes."""

    def is_writing() -> bool:
        with suppress(FileNotFoundError):  # at first, it tries whether it can write
            return any(left.stat().st_size for left in partials(path))
        return False

    with started(path, port) as capture:
        wait_until(is_writing)
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


def test_no_callback_of_the_client_is_left_when_the_interpreter_ends(tmp_path: Path) -> None:
    """One that is would end the process by SIGABRT, now and then: `terminate called without an active exception`."""

    def interrupted(number: int) -> tuple[int, str]:
        with running(tmp_path / f"{number}.mcap", port) as process:
            time.sleep(0.1 * number)
            process.send_signal(signal.SIGINT)
            said, _ = process.communicate(timeout=PATIENCE)
        return process.returncode, said

    with server() as port, ThreadPoolExecutor(3) as threads:
        world = connect(port).get_world()
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
