"""Live views of a server: Rerun's, without a display, and Foxglove's, for a client of the real protocol."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any

import carla
import pytest

from carla_recap.errors import RecapError
from carla_recap.server.viewer import ViewerProcess
from tests.cli.command import ENVIRONMENT, error
from tests.server.client import SYNCHRONOUS, ahead, connect, place, serving, spawn
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_what_rerun_gets_is_what_an_export_holds(tmp_path: Path) -> None:
    """A hero comes, and drives until it hits something."""
    read = pytest.importorskip("rerun.chunk", reason="the extra `rerun` is not installed").RrdReader
    path = tmp_path / "live.rrd"
    with serving("--rerun-to", path) as (process, port):
        world = connect(port).get_world()
        world.apply_settings(SYNCHRONOUS)
        wait_until(lambda: world.tick() and any(tmp_path.glob(".live.rrd.*")), pause=0.05)
        hero = spawn(world, role_name="hero")
        place(world, "sensor.other.collision", carla.Transform(), hero)
        place(world, "vehicle.volkswagen.t2", ahead(hero.get_transform(), 20.0))
        hero.apply_control(carla.VehicleControl(throttle=1.0))
        for _ in range(100):
            world.tick()
            time.sleep(0.02)
        process.terminate()
        process.wait(PATIENCE)
    paths = {str(chunk.entity_path) for chunk in read(path).stream().to_chunks()}
    assert {"/world/chase", "/world/map/roads", "/ego/speed_kmh", "/ego/controls", "/map/actors", "/events"} <= paths
    assert any(path.startswith("/world/actors/") for path in paths)
    events = read(path).stream().filter(content="/events", is_static=False).to_chunks()
    texts = [text.as_py()[0] for chunk in events for text in chunk.to_record_batch().column("TextLog:text")]
    assert any("collides with vehicle.volkswagen.t2" in text for text in texts)


def test_without_a_display_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rerun", reason="the extra `rerun` is not installed")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delitem(ENVIRONMENT, name, raising=False)
        monkeypatch.delenv(name, raising=False)
    expected = "there is no display for the Rerun viewer; an .rrd can be written instead"
    with pytest.raises(RecapError, match=f"^{re.escape(expected)}$"):
        ViewerProcess()
    assert error("serve", "--port", 0, "--follow", "hero") == expected


def test_what_it_cannot_be_written_to(tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="the extra `rerun` is not installed")
    (tmp_path / "live.rrd").touch()
    for to, reason in (("live.png", "an .rrd, or the address of a viewer"), (str(tmp_path / "live.rrd"), "exists already")):
        with pytest.raises(RecapError, match=rf"^{re.escape(to)}: .*{reason}"):
            ViewerProcess(to)


@pytest.mark.parametrize(
    ("module", "options", "extra"), [("rerun", ("--rerun",), "rerun"), ("pymunk", (), "server")], ids=["rerun", "physics"]
)
def test_without_what_it_needs_it_says_so(module: str, options: tuple[str, ...], extra: str) -> None:
    code = f"import sys; sys.modules[{module!r}] = None; from carla_recap.cli import main; main()"
    command = [sys.executable, "-c", code, "serve", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert f"pip install '.[{extra}]'" in done.stderr


@pytest.fixture
def foxglove() -> Any:
    """Foxglove's server and its client."""
    pytest.importorskip("foxglove", reason="the extra foxglove-live is not installed")
    pytest.importorskip("foxglove_schemas_protobuf", reason="the extra foxglove is not installed")
    pytest.importorskip("tornado", reason="tornado is not installed")
    from carla_recap.show.foxglove.websocket import FoxgloveServer
    from tests.show import foxglove_client

    return FoxgloveServer, foxglove_client


def test_a_viewer_sees_what_a_client_does(foxglove: Any) -> None:
    _, client = foxglove
    with serving("--fps", 20, "--foxglove-port", 0) as (process, port):
        hero = spawn(connect(port).get_world(), role_name="hero")
        assert process.stdout is not None
        with client.connected(process.stdout.readline().strip()) as viewer:
            found = viewer.latest("/map", "/hero", "/scene/vehicles")
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0
    assert client.decoded(viewer, "/hero", found["/hero"]).id == hero.id
    assert [entity.id for entity in client.decoded(viewer, "/scene/vehicles", found["/scene/vehicles"]).entities] == [
        f"actor {hero.id}"
    ]
    assert len(client.decoded(viewer, "/map", found["/map"]).entities) > 1


def test_what_is_shown_in_one_viewer_only() -> None:
    expected = "--foxglove or --rerun was expected, not both."
    assert expected in error("serve", "--port", 0, "--foxglove", "--rerun-to", "live.rrd")


def test_a_port_in_use_is_an_error_before_the_server_starts(foxglove: Any) -> None:
    with foxglove[0]("first", 0) as server:
        port = server.address.rpartition(":")[2]
        assert error("serve", "--port", 0, "--foxglove-port", port).endswith("Address already in use")
