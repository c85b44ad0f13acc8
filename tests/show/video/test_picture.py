"""Pictures of recordings, and invalid times, destinations and actors."""

from __future__ import annotations

import io
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from carla_recap.recording import Recording
from carla_recap.rendering.process import RenderProcess

pytest.importorskip("PIL", reason="the extra `cameras` is not installed")

from PIL import Image

from carla_recap import ActorKind, Spawn, attributes, open_recording
from carla_recap.errors import RecapError
from carla_recap.roads import find_map
from carla_recap.show.video import picture, snapshot
from carla_recap.town.mesh import load_town_mesh
from tests.cli.command import COMMAND, ENVIRONMENT, before_others, the_line
from tests.replay.scripts import pose, spawn, write
from tests.samples import names_in
from tests.show.video.conftest import SAMPLES
from tests.waiting import PATIENCE


def pixels(data: bytes) -> Any:
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)


@pytest.mark.parametrize(("name", "form"), [("crash.png", "PNG"), ("crash.jpg", "JPEG"), ("crash.JPEG", "JPEG")])
def test_a_snapshot_is_a_picture_of_the_size(
    crossing: Recording, tmp_path: Path, renderer: RenderProcess, name: str, form: str
) -> None:
    destination = tmp_path / name
    snapshot(crossing, destination, at=24.6, size=(640, 360))
    with Image.open(destination) as image:
        assert (image.size, image.format) == ((640, 360), form)
        assert len(image.convert("RGB").getcolors(1 << 24)) > 1000
    assert names_in(tmp_path) == [name]


def test_nothing_is_written_on_the_picture_of_a_recorded_camera_unless_that_is_asked_for(
    tmp_path: Path, renderer: RenderProcess
) -> None:
    camera = Spawn(2, ActorKind.SENSOR, x=150, type_id="sensor.camera.rgb", attributes=attributes(fov="90"))
    frames = [{"transforms": [pose(1, 100 * n)]} for n in range(3)]
    frames[0] |= {"spawned": [spawn(1, role_name="hero"), camera], "parented": [(2, 1)]}
    with open_recording(write(tmp_path / "camera.log", frames)) as recording:
        default, without, written = (
            picture(recording, at=1, view=2, size=(320, 180), renderer=renderer, **options)
            for options in ({}, {"overlay": False}, {"overlay": True})
        )
    assert default == without != written


def test_the_map_of_the_recording_is_found_by_its_name(renderer: RenderProcess) -> None:
    town = load_town_mesh(find_map("Brickfield"))
    with open_recording(SAMPLES / "crash.mcap") as recording:
        found, given = (picture(recording, at=12, size=(320, 180), **options) for options in ({}, {"town": town}))
    assert found == given


def test_another_time_is_another_picture(crossing: Recording, renderer: RenderProcess) -> None:
    first, second, again = (picture(crossing, at=at, size=(320, 180), renderer=renderer) for at in (20, 21, 20))
    assert first == again != second


def test_a_notebook_shows_a_picture_as_the_last_value_of_a_cell(crossing: Recording, renderer: RenderProcess) -> None:
    png, jpeg = (picture(crossing, at=20, size=(64, 64), renderer=renderer, form=form) for form in ("PNG", "JPEG"))
    assert (png._repr_png_(), png._repr_jpeg_()) == (bytes(png), None)
    assert (jpeg._repr_png_(), jpeg._repr_jpeg_()) == (None, bytes(jpeg))


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("out.png", {"at": 60}, "crossing.log: nothing at 60 s"),
        ("out.png", {"at": float("nan")}, "nothing at nan s"),
        ("out.png", {"at": 5, "follow": 104}, "actor 104 is not present at 5 s"),
        ("out.png", {"at": 5, "size": (10, 10)}, "the sides of a picture are from 64 to 4096 pixels"),
        ("out.webp", {"at": 5}, "out.webp: expected a name that ends in .png, .jpg, .jpeg, found .webp"),
        ("there.png", {"at": 5}, "there.png: exists already"),
    ],
)
def test_what_cannot_be_drawn_is_an_error_of_one_line(
    crossing: Recording, tmp_path: Path, name: str, options: Any, message: str
) -> None:
    (tmp_path / "there.png").write_bytes(b"before")
    with pytest.raises(RecapError, match=message) as caught:
        snapshot(crossing, tmp_path / name, **options)
    assert "\n" not in str(caught.value)
    assert names_in(tmp_path) == ["there.png"]
    assert (tmp_path / "there.png").read_bytes() == b"before"


def test_an_actor_whose_pose_is_nan_is_an_error(tmp_path: Path) -> None:
    frames = [{"transforms": [pose(1, float("nan"))], "spawned": [spawn(1)] * (n == 0)} for n in range(3)]
    source = write(tmp_path / "nan.log", frames)
    with open_recording(source) as recording, pytest.raises(RecapError, match="the pose of actor 1 at 1 s is not finite"):
        snapshot(recording, tmp_path / "out.png", at=1, follow=1)


def test_without_a_package_the_error_names_the_extra(tmp_path: Path) -> None:
    (tmp_path / "hidden").mkdir()
    (tmp_path / "hidden" / "PIL.py").write_text("raise ModuleNotFoundError(name='PIL')")
    command = [COMMAND, "snapshot", SAMPLES / "crossing.log", tmp_path / "out.png", "--at", "24"]
    environment = ENVIRONMENT | {"PYTHONPATH": before_others(tmp_path / "hidden")}
    done = subprocess.run(command, capture_output=True, env=environment, timeout=PATIENCE)
    expected = "carla-recap snapshot needs an optional dependency: pip install '.[cameras]' in a clone of carla-recap"
    assert (done.returncode, the_line(done.stderr)) == (2, expected)
    assert names_in(tmp_path) == ["hidden"]
