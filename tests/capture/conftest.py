"""The server for the tests, and a capture of it as a process of its own, as CARLA's client needs."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.cli.command import COMMAND, ENVIRONMENT
from tests.server.conftest import client, port, recordings, world
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import carla

__all__ = ["client", "port", "recordings", "world"]

BEHIND = 0.5  # s: a world may tick faster than a client can follow, which asks for some data now and then


class Capture:
    """A capture that runs.

    Attributes:
        path: Its destination.
    """

    def __init__(self, path: Path, process: subprocess.Popen[str]) -> None:
        self.path = path
        self.process = process

    def end(self, number: signal.Signals = signal.SIGINT) -> str:
        """End it by a signal, when it has observed the present world; return its output."""
        settle(self.process)
        self.process.send_signal(number)
        return self.ended()

    def ended(self, code: int = 0) -> str:
        """Wait until it has ended with an exit code, and return its output."""
        said, _ = self.process.communicate(timeout=PATIENCE)
        assert self.process.returncode == code, said
        assert "Traceback" not in said
        return said


@contextmanager
def started(path: Path, port: int, *options: str, before: str = "") -> Iterator[Capture]:
    """Start a capture, or a live view if the path is of an .rrd, in whose process a statement is executed before it."""
    arguments = ["watch", "--to", path] if path.suffix == ".rrd" else ["capture", path]
    command = [COMMAND, *arguments, "--port", str(port), *options]
    if before:
        code = f"{before}; from carla_recap.cli import main; main()"
        command = [sys.executable, "-c", code, *command[1:]]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=ENVIRONMENT) as process:
        try:
            yield Capture(path, process)
        finally:
            process.kill()


@pytest.fixture
def capturing(port: int, world: carla.World, tmp_path: Path) -> Iterator[Callable[..., Capture]]:
    """Start a capture of a world with a hero; the sensor of the capture shows that it runs."""

    def begin(name: str, *options: str) -> Capture:
        capture = stack.enter_context(started(tmp_path / name, port, *options))
        wait_for(world, lambda: own_sensors(world))
        return capture

    with ExitStack() as stack:
        yield begin


def settle(process: subprocess.Popen[str]) -> None:
    """Wait until a process has handled what it has been sent, and has asked the server again: until no thread of it runs."""
    threads = Path(f"/proc/{process.pid}/task")

    def is_idle() -> bool:
        states = [stat.read_text().rpartition(")")[2].split()[0] for stat in threads.glob("*/stat")]
        return not {"R", "D"} & set(states)

    def stays_idle() -> bool:
        for _ in range(4):
            if not is_idle():
                return False
            time.sleep(0.005)
        return True

    time.sleep(BEHIND)
    if threads.exists():
        wait_until(stays_idle)


def wait_for(world: carla.World, condition: Callable[[], object]) -> None:
    """Tick until a condition is met."""

    def met() -> object:
        found = condition()
        if not found:
            world.tick()
        return found

    wait_until(met, pause=0.05)


def own_sensors(world: carla.World) -> list[carla.Actor]:
    return [actor for actor in world.get_actors().filter("sensor.*") if actor.attributes["role_name"] == "carla-recap"]
