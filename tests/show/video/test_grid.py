"""Videos by the cameras of sensors: their stored images, or drawn anew, alone or side by side."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("av", reason="the extra `video` is not installed")

import av
from click.testing import CliRunner

from carla_recap import export_video, open_recording
from carla_recap.cli.export import video as video_command
from carla_recap.errors import RecapError
from carla_recap.sensors.decoding import StoredImages
from carla_recap.show.video.video import CameraGrid
from tests.sensed import CRASH
from tests.show.conftest import SENSORS
from tests.show.conftest import sensed_recording as sensed_recording


def pictures(path):
    with av.open(str(path)) as video:
        return [frame.to_ndarray(format="rgb24").astype(int) for frame in video.decode(video=0)]


def test_a_camera_films_its_stored_images(sensed_recording, tmp_path):
    with open_recording(sensed_recording) as recording:
        written = export_video(
            recording, tmp_path / "front.mp4", cameras=["front"], start=11.0, duration=1.0, rate=10, overlay=False
        )
        images = StoredImages(recording.reader, "front")
        expected = [images.at(11.0 + index / 10) for index in range(10)]
    assert written.size == (160, 120)
    found = pictures(tmp_path / "front.mp4")
    assert len(found) == written.frames == 10
    for one, other in zip(found, expected, strict=True):
        assert np.abs(one - other).mean() < 6


def test_all_cameras_are_tiled_with_their_names(sensed_recording, tmp_path):
    with open_recording(sensed_recording) as recording:
        written = export_video(
            recording, tmp_path / "all.mp4", cameras="all", start=11.0, duration=0.5, rate=10, overlay=False
        )
        front = StoredImages(recording.reader, "front").at(11.0)
        back = StoredImages(recording.reader, "back").at(11.0)
    assert written.size == (320, 120)
    first = pictures(tmp_path / "all.mp4")[0]
    for shown, image in ((first[:, :160], front), (first[:, 160:], back)):
        assert np.abs(shown[:90] - image[:90]).mean() < 6
    assert np.abs(first[90:, 100:160] - front[90:, 100:]).max() > 150  # the name


def test_cameras_of_a_rig_film_a_recording_without_sensors_from_the_same_place(sensed_recording, tmp_path):
    rig, destination = tmp_path / "rig.json", tmp_path / "rig.mp4"
    rig.write_text(json.dumps([sensor for sensor in SENSORS if sensor["id"] == "front"]))
    options = ["--rig", str(rig), "--grid", "--start", "11", "--duration", "0.3", "--fps", "10", "--no-overlay"]
    found = CliRunner().invoke(video_command, [str(CRASH), str(destination), *options], catch_exceptions=False)
    assert found.exit_code == 0, found.output
    with open_recording(sensed_recording) as recording:
        stored = StoredImages(recording.reader, "front").at(11.0)
    assert np.abs(pictures(destination)[0] - stored)[:90].mean() < 12  # one has shadows, the other has none


def test_what_is_known_of_the_scene_is_written_on_the_picture(sensed_recording, tmp_path):
    options = {"cameras": ["front"], "start": 11.0, "duration": 0.2, "rate": 10, "size": (640, 480)}
    with open_recording(sensed_recording) as recording:
        for name, overlay in (("with", True), ("without", False)):
            export_video(recording, tmp_path / f"{name}.mp4", overlay=overlay, **options)
    one, other = (pictures(tmp_path / f"{name}.mp4")[0] for name in ("with", "without"))
    assert np.abs(one - other).max() > 100
    assert np.abs(one - other)[180:300, 240:400].mean() < 4  # the middle is free


def test_tiles_keep_the_shape_of_images_and_missing_ones_stay_dark():
    grid = CameraGrid({f"c{index}": (400, 300) for index in range(6)})
    assert grid.size == (1200, 600)
    white = np.full((300, 400, 3), 255, np.uint8)
    picture = grid.picture({"c1": white, "c5": white}, names=False)
    assert picture[:300, 400:800].min() == picture[300:, 800:].min() == 255
    assert picture[:300, :400, :3].max() < 40
    narrow = CameraGrid({"one": (100, 300)}, (400, 300)).picture({"one": white[:, :100]}, names=False)
    assert (narrow[:, 150:250] == 255).all()
    assert narrow[:, :149, :3].max() < 40
    many = CameraGrid({f"c{index}": (4000, 3000) for index in range(9)})
    assert max(many.size) <= 4096


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["--camera", "front", "--grid"], "--grid shows all cameras"),
        (["--camera", "front", "--view", "top"], "--view goes without --camera"),
        (["--rig", str(CRASH.with_name("rigs") / "front_camera.json")], "--rig goes with --camera or --grid"),
    ],
)
def test_what_does_not_fit_together_is_an_error(sensed_recording, tmp_path, arguments, error):
    found = CliRunner().invoke(video_command, [str(sensed_recording), str(tmp_path / "a.mp4"), *arguments])
    assert found.exit_code == 2
    assert error in found.output
    assert not (tmp_path / "a.mp4").exists()


def test_a_camera_that_is_not_there_is_an_error(sensed_recording, tmp_path):
    for source, cameras, message in (
        (sensed_recording, ["side"], r"has no RGB camera 'side'; one of front, back was expected$"),
        (CRASH, "all", r"crash.mcap: has no data of cameras; --rig RIG.json"),
    ):
        with open_recording(source) as recording, pytest.raises(RecapError, match=message):
            export_video(recording, tmp_path / "side.mp4", cameras=cameras)
    assert not (tmp_path / "side.mp4").exists()
