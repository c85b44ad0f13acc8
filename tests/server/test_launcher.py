"""`CarlaUE4.sh`, run as scripts do that start a server of CARLA, and CARLA's own client."""

from __future__ import annotations

import os
import signal
import socket
from pathlib import Path

import pytest

from carla_recap.cli.server import serve_arguments
from tests.server.client import connect, free_port, refuses_connections, running
from tests.waiting import PATIENCE

LAUNCHER = Path(__file__).parents[2] / "CarlaUE4.sh"
USUAL = "-RenderOffScreen -nosound -benchmark -windowed -ResX=800 -ResY=600 -opengl -vulkan -prefernvidia -carla-server"

pytestmark = pytest.mark.skipif(os.name != "posix", reason="a shell script")


def test_the_usual_arguments_start_a_server_for_clients_until_it_is_terminated() -> None:
    arguments = ("Brickfield", *USUAL.split(), "-carla-rpc-port=0", "-quality-level=Low", "-fps=10")
    with running(LAUNCHER, *arguments) as (process, port):
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
    with running(LAUNCHER, "/Game/Carla/Maps/Town77", *arguments) as (process, port):
        assert port == calls
        world = connect(calls).get_world()
        assert world.wait_for_tick(PATIENCE).frame > 0
        assert world.get_map().name.endswith("Town77")
        socket.create_connection(("127.0.0.1", streams)).close()
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
        assert refuses_connections(port)


def test_a_killed_launcher_leaves_no_server() -> None:
    with running(LAUNCHER, "-carla-rpc-port=0") as (process, port):
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


@pytest.mark.parametrize("argument", ["-teleport", "-carla-rpc-port", "-quality-level=Cinematic", "", "-ports=3", "Town02"])
def test_unknown_arguments_are_ignored_with_a_warning(argument: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert serve_arguments(["-nosound", argument, "-fps=20"]) == ["--fps=20"]
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"carla-recap: warning: {argument}: is ") or "neither Low nor Epic" in line
