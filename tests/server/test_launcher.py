"""`CarlaUE4.sh`, run as scripts do that start a server of CARLA, and CARLA's own client."""

from __future__ import annotations

import os
import random
import signal
import socket
import subprocess
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from carla_recap.cli.server import serve_arguments
from tests.cli.command import ENVIRONMENT
from tests.server.client import connect, port_of, refuses_connections
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from collections.abc import Iterator

LAUNCHER = Path(__file__).parents[2] / "CarlaUE4.sh"
USUAL = "-RenderOffScreen -nosound -benchmark -windowed -ResX=800 -ResY=600 -opengl -vulkan -prefernvidia -carla-server"

pytestmark = pytest.mark.skipif(os.name != "posix", reason="a shell script")


@contextmanager
def launched(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Run the launcher until the end of the block; yields its process and the port for calls."""
    with subprocess.Popen(
        [LAUNCHER, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
        env=ENVIRONMENT,
    ) as process:
        try:
            yield process, port_of(process)
        finally:
            process.kill()


def free_port() -> int:
    """Return a port that no program gets but one that asks for it."""
    for port in random.sample(range(10_000, 30_000), 100):
        with suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port
    return pytest.fail("there is no free port")


def test_the_usual_arguments_start_a_server_for_clients_until_it_is_terminated() -> None:
    with launched("Brickfield", *USUAL.split(), "-carla-rpc-port=0", "-quality-level=Low", "-fps=10") as (process, port):
        world = connect(port).get_world()
        assert world.get_map().name.endswith("Brickfield")
        assert world.get_settings().fixed_delta_seconds == 0.1
        assert world.wait_for_tick(PATIENCE).timestamp.delta_seconds == pytest.approx(0.1)
        process.terminate()
        _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0
    assert errors == f"connect to it: carla.Client('127.0.0.1', {port}); Ctrl-C ends it\n"
    assert refuses_connections(port)


def test_ports_are_those_of_the_arguments_a_missing_map_is_replaced_and_an_interrupt_ends_the_server() -> None:
    calls, streams = free_port(), free_port()
    arguments = (f"-carla-rpc-port={calls}", f"-carla-streaming-port={streams}")
    with launched("/Game/Carla/Maps/Town77", *arguments) as (process, port):
        assert port == calls
        world = connect(calls).get_world()
        assert world.wait_for_tick(PATIENCE).frame > 0
        assert world.get_map().name.endswith("Town77")
        socket.create_connection(("127.0.0.1", streams)).close()
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
        assert refuses_connections(port)


def test_a_killed_launcher_leaves_no_server() -> None:
    with launched("-carla-rpc-port=0") as (process, port):
        process.kill()
        assert process.wait(PATIENCE) == -signal.SIGKILL
        assert refuses_connections(port)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("-carla-port=3000", ["--port=3000"]),
        ("-carla-world-port=3000", ["--port=3000"]),
        ("--carla-rpc-port=3000", ["--port=3000"]),
        ("-carla-streaming-port=0", ["--streaming-port=0"]),
        ("-Quality-Level=EPIC", ["--quality=epic"]),
        ("-carla-release=0.9.15", ["--carla=0.9.15"]),
        ("CarlaUE4 Town02 -RenderOffscreen", ["--town", "Town02"]),
        ("/Game/Carla/Maps/Town03?listen", ["--town", "/Game/Carla/Maps/Town03"]),
        ("--maps folder --confine -nosound", ["--maps", "folder", "--confine"]),
        ("--maps=folder", ["--maps=folder"]),
        (USUAL, []),
    ],
)
def test_arguments_of_carla_are_translated(arguments: str, expected: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert serve_arguments(arguments.split()) == expected
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("argument", ["-teleport", "-carla-rpc-port", "-quality-level=Cinematic", "", "-ports=3"])
def test_unknown_arguments_are_ignored_with_a_warning(argument: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert serve_arguments(["-nosound", argument, "-fps=20"]) == ["--fps=20"]
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"carla-recap: warning: {argument}: is ") or "neither Low nor Epic" in line


def test_a_name_that_is_not_first_is_no_map(capsys: pytest.CaptureFixture[str]) -> None:
    assert serve_arguments(["-nosound", "Town02"]) == []
    assert "Town02: is unknown" in capsys.readouterr().err
