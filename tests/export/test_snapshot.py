"""Pictures of recordings, and invalid times, destinations and actors."""

from __future__ import annotations

import io
import os
import subprocess
import sys

import pytest

pytest.importorskip("rerun", reason="the extra `rerun` is not installed")

from PIL import Image

from carla_recap import open_recording
from carla_recap.errors import RecapError
from carla_recap.export.screenshots import picture, snapshot
from carla_recap.export.style import COLLISION, HERO, STYLES
from carla_recap.model.records import ActorKind
from tests.export.conftest import SAMPLE
from tests.export.test_screenshots import share
from tests.replay.scripts import pose, spawn, write
from tests.samples import carla_log, names_in, time_limit

BLUE = STYLES[ActorKind.VEHICLE].color


@pytest.fixture
def crossing():
    with open_recording(SAMPLE) as recording:
        yield recording


@pytest.fixture
def draws(crossing_rrd):
    """Skips the test where the viewer cannot draw."""


def test_the_collision_of_the_hero(crossing, tmp_path, temporary, draws):
    destination = tmp_path / "crash.png"
    with time_limit(20):
        snapshot(crossing, destination, at=24.6, size=(640, 360))
    assert names_in(tmp_path) == ["crash.png", "temporary"]
    data = destination.read_bytes()
    image = Image.open(destination)
    assert image.size == (640, 360)
    assert image.format == "PNG"
    assert 0.01 < share(data, HERO) < 0.05
    assert share(data, COLLISION) > 0.0002
    middle = image.convert("RGB").getpixel((320, 155))  # the hero's roof: the camera is behind it
    assert middle[0] > middle[2]


def test_from_above_the_hero_is_in_the_middle_and_points_up(crossing, draws):
    data = picture(crossing, at=22, view="top", size=(400, 400))
    image = Image.open(io.BytesIO(data)).convert("RGB")
    red, green, blue = HERO
    hero = image.point([255 * (abs(n - c) < 12) for c in (red, green, blue) for n in range(256)])
    left, upper, right, lower = hero.convert("L").point(lambda n: 255 * (n > 250)).getbbox()
    assert left < 200 < right
    assert 150 < upper < 200
    assert lower == 400  # it drives upwards, and has its trail below


@pytest.mark.parametrize("size", [(64, 64), (333, 517), (1921, 1081)])
def test_pictures_have_the_given_size(crossing, draws, size):
    assert Image.open(io.BytesIO(picture(crossing, at=24, size=size))).size == size


def test_pictures_of_the_beginning_and_of_the_end(crossing, draws):
    first, last = (picture(crossing, at=at, size=(320, 180)) for at in (0, 53))
    assert share(first, HERO) > 0.01 < share(last, HERO)
    assert last == picture(crossing, at=crossing.info.duration, size=(320, 180))


def test_another_actor_can_be_followed(crossing, draws):
    data = picture(crossing, at=20, follow=101, size=(320, 180))
    assert share(data, BLUE) > share(picture(crossing, at=20, size=(320, 180)), BLUE)


def test_a_real_recording(draws):
    with open_recording(carla_log("carla-0.9.13-lane-center.log")) as recording, time_limit(20):
        assert 0.01 < share(picture(recording, at=-1), HERO) < 0.05


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"at": 60}, "crossing.log: nothing at 60 s; the recording ends at 53 s"),
        ({"at": float("nan")}, "nothing at nan s"),
        ({"at": 5, "follow": 999}, "no actor 999 to follow; near ids are"),
        ({"at": 5, "follow": 104}, "actor 104 is not there at 5 s, so it cannot be followed"),
        ({"at": 5, "size": (10, 10)}, "the sides of a picture are from 64 to 4096 pixels"),
    ],
)
def test_invalid_arguments_are_errors_of_one_line(crossing, tmp_path, temporary, options, message):
    with pytest.raises(RecapError, match=message) as caught:
        snapshot(crossing, tmp_path / "out.png", **options)
    assert "\n" not in str(caught.value)
    assert names_in(tmp_path) == ["temporary"]


def test_an_actor_whose_pose_is_nan_is_an_error_of_one_line(tmp_path, temporary):
    nowhere = [{"transforms": [pose(1, float("nan"))], "spawned": [spawn(1)] * (n == 0)} for n in range(3)]
    source = write(tmp_path / "nan.log", nowhere)
    with open_recording(source) as recording, pytest.raises(RecapError) as caught:
        snapshot(recording, tmp_path / "out.png", at=1, follow=1)
    assert str(caught.value) == f"{source}: actor 1 has no place at 1 s: its pose is no number"
    assert names_in(tmp_path) == ["nan.log", "temporary"]


@pytest.mark.skipif(os.name != "posix", reason="there are no such limits")
def test_a_full_disk_for_temporary_files_is_an_error_of_one_line(tmp_path, temporary, limited):
    lines = (
        "from carla_recap import open_recording",
        "from carla_recap.export.screenshots import snapshot",
        f"with open_recording({str(SAMPLE)!r}) as recording:",
        f"    snapshot(recording, {str(tmp_path / 'out.png')!r}, at=24)",
    )
    done = limited("\n".join(lines), 10_000)
    assert done.stderr.splitlines()[-1].endswith("moment.rrd: cannot be written: File too large")
    assert names_in(tmp_path) == ["temporary"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("out.jpg", "out.jpg: a picture is written as .png"),
        ("nowhere/out.png", "nowhere/out.png: cannot be written: No such file"),
        ("there.png", "there.png: exists already"),
    ],
)
def test_invalid_destinations_are_errors(crossing, tmp_path, name, message):
    (tmp_path / "there.png").write_bytes(b"before")
    with pytest.raises(RecapError, match=message):
        snapshot(crossing, tmp_path / name, at=5)
    assert (tmp_path / "there.png").read_bytes() == b"before"


def test_a_failure_leaves_the_earlier_picture(crossing, tmp_path, monkeypatch, draws):
    monkeypatch.setenv("VK_ICD_FILENAMES", "/nonexistent")
    monkeypatch.setenv("VK_DRIVER_FILES", "/nonexistent")
    there = tmp_path / "there.png"
    there.write_bytes(b"before")
    with pytest.raises(RecapError, match="mesa-vulkan-drivers"):
        snapshot(crossing, there, at=5, force=True)
    assert there.read_bytes() == b"before"
    assert names_in(tmp_path) == ["there.png"]


def test_without_rerun_the_error_names_the_extra():
    code = "import sys; sys.modules['rerun'] = None; import carla_recap.export.screenshots"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)
    assert done.stderr.splitlines()[-1].endswith(
        "needs an optional dependency: pip install '.[rerun]' in a clone of carla-recap"
    )
