"""The live view of a server, without a display: written to an .rrd, and read and pictured from there."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING

import carla
import pytest

from carla_recap.errors import RecapError
from tests.cli.command import COMMAND, ENVIRONMENT, error
from tests.waiting import PATIENCE, wait_until

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytest.importorskip("rerun", reason="the extra `rerun` is not installed")


@contextmanager
def showing(*options: object) -> Iterator[carla.World]:
    """The world of a server that shows itself."""
    command = [COMMAND, "serve", "--port=0", *map(str, options)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT) as process:
        try:
            assert process.stdout is not None
            client = carla.Client("127.0.0.1", int(process.stdout.readline().split(":")[-1]))
            client.set_timeout(PATIENCE)
            yield client.get_world()
            process.terminate()
            process.wait(PATIENCE)
        finally:
            process.kill()


@pytest.fixture(scope="module")
def rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A hero comes, and drives until it hits something."""
    path = tmp_path_factory.mktemp("live") / "live.rrd"
    with showing("--rerun-to", path) as world:
        world.apply_settings(carla.WorldSettings(synchronous_mode=True, fixed_delta_seconds=0.05))

        def is_written_to() -> bool:
            world.tick()
            return any(path.parent.glob(".live.rrd.*"))

        wait_until(is_written_to, pause=0.05)
        library, place = world.get_blueprint_library(), world.get_map().get_spawn_points()[0]
        hero = library.find("vehicle.tesla.model3")
        hero.set_attribute("role_name", "hero")
        driven = world.spawn_actor(hero, place)
        world.spawn_actor(library.find("sensor.other.collision"), carla.Transform(), attach_to=driven)
        place.location += 20.0 * place.get_forward_vector()
        world.spawn_actor(library.find("vehicle.volkswagen.t2"), place)
        world.tick()
        driven.apply_control(carla.VehicleControl(throttle=1.0))
        for _ in range(100):
            world.tick()
            time.sleep(0.02)
        (live,) = path.parent.glob(".live.rrd.*")
        copy = path.with_name("copy.rrd")

        def has_collision() -> bool:
            copy.write_bytes(live.read_bytes())
            with pytest.warns(Warning, match="no footer"):
                return any("collides with vehicle.volkswagen.t2" in text for text in events(copy))

        wait_until(has_collision, pause=0.1)
    return path


def events(path: Path) -> list[str]:
    """Return the texts of the events in an .rrd."""
    from rerun.chunk import RrdReader

    return [
        text.as_py()[0]
        for chunk in RrdReader(path).stream().filter(content="/events", is_static=False).to_chunks()
        for text in chunk.to_record_batch().column("TextLog:text")
    ]


def test_it_is_what_an_export_holds(rrd: Path) -> None:
    from rerun.chunk import RrdReader

    reader = RrdReader(rrd)
    paths = {str(path) for path in reader.store().schema().entity_paths()}
    assert {"/world/chase", "/world/map/roads", "/ego/speed_kmh", "/ego/controls", "/map/actors", "/events"} <= paths
    assert any(path.startswith("/world/actors/") for path in paths)
    assert any("collides with vehicle.volkswagen.t2" in text for text in events(rrd))


def test_the_camera_follows_the_hero(rrd: Path) -> None:
    from tests.screenshots import ScreenshotTaker

    try:
        with ScreenshotTaker(rrd) as screenshots:
            names = {view.name for view in screenshots.state.views}
            picture = screenshots.take(4.0)
    except RecapError as failure:
        pytest.skip(str(failure))
    assert {"Chase", "Map", "Events"} <= names
    assert any(name.startswith("Light ahead of") for name in names)
    assert len(picture) > 20_000


def test_without_a_display_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delitem(ENVIRONMENT, name, raising=False)
    expected = "there is no display for the Rerun viewer; an .rrd can be written instead"
    for options in (("--rerun",), ("--follow", "hero")):
        assert error("serve", "--port", 0, *options) == expected


def test_what_it_cannot_be_written_to(tmp_path: Path) -> None:
    assert error("serve", "--rerun-to", "live.png").startswith("live.png: an .rrd, or the address of a viewer")
    (tmp_path / "live.rrd").touch()
    assert "exists already" in error("serve", "--rerun-to", tmp_path / "live.rrd")


def test_without_rerun_it_says_so() -> None:
    code = "import sys; sys.modules['rerun'] = None; from carla_recap.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code, "serve", "--rerun"], capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "pip install '.[rerun]'" in done.stderr


def test_without_physics_it_asks_for_the_server() -> None:
    code = "import sys; sys.modules['pymunk'] = None; from carla_recap.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code, "serve"], capture_output=True, text=True, timeout=PATIENCE)
    assert done.stderr.startswith("carla-recap: carla-recap serve needs an optional dependency: pip install '.[server]'")
