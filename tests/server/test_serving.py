from __future__ import annotations

import subprocess
import sys
from pkgutil import walk_packages
from typing import TYPE_CHECKING

import carla_recap.server
from carla_recap.sim import World, load_town
from tests.cli.command import error
from tests.server.client import connect, serving
from tests.waiting import PATIENCE

if TYPE_CHECKING:
    from pathlib import Path

IMPORTS = """
import importlib, sys
for name in sys.argv[1:]:
    for loaded in [loaded for loaded in sys.modules if loaded.startswith("carla_recap.server")]:
        del sys.modules[loaded]
    importlib.import_module(name)
"""

SERVES = """
import asyncio, gc, os, signal, sys
from carla_recap.server.host import Host
from carla_recap.server.serving import serve
from carla_recap.sim import World

def ready(port):
    print(gc.get_freeze_count(), sys.getswitchinterval())
    os.kill(os.getpid(), signal.SIGTERM)

asyncio.run(serve(Host(World()), "127.0.0.1", 0, ready))
"""


def test_each_module_can_be_imported_first() -> None:
    names = [module.name for module in walk_packages(carla_recap.server.__path__, "carla_recap.server.")]
    subprocess.run([sys.executable, "-c", IMPORTS, *names], timeout=PATIENCE, check=True)


def test_no_client_waits_for_a_search_for_cycles_among_what_stays_or_long_for_threads() -> None:
    run = subprocess.run([sys.executable, "-c", SERVES], timeout=PATIENCE, check=True, capture_output=True)
    frozen, interval = run.stdout.split()
    assert int(frozen) > 10_000  # objects, which no search visits
    assert float(interval) <= 1e-3  # s


def test_an_invalid_name_of_a_host_is_an_error_in_one_line() -> None:
    assert error("serve", "--port=0", "--host", "a..b").startswith("a..b:0: cannot be listened at: ")


def test_invalid_folders_are_errors_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    absent = tmp_path / "absent"
    assert f"Directory '{absent}' does not exist" in error("serve", "--port=0", "--maps", absent)
    assert "the folder of recordings cannot be made" in error("serve", "--port=0", "--recordings", tmp_path / "file" / "x")
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
