"""Videos, decoded: their frames, what is where in them, and that a browser plays them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

pytest.importorskip("av", reason="the extra `video` is not installed")

import av

from carla_recap import Player, open_recording
from carla_recap.errors import RecapError
from carla_recap.show.video import export_video
from carla_recap.show.video.film import Film
from carla_recap.town.mesh import load_town_of
from tests.cli.command import error, run
from tests.replay.scripts import pose, spawn, write
from tests.samples import names_in
from tests.show.video.conftest import SAMPLES

if TYPE_CHECKING:
    from pathlib import Path

    from selenium.webdriver import Chrome

    from carla_recap.recording import Recording
    from carla_recap.rendering.process import RenderProcess

SMALL = (320, 180)


def frames_of(path: Path) -> list[Any]:
    """Return the frames of a video, as red, green, blue."""
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def film(recording: Recording, path: Path, renderer: RenderProcess, **options: Any) -> list[Any]:
    export_video(recording, path, renderer=renderer, **{"size": SMALL} | options)
    return frames_of(path)


@pytest.mark.parametrize(
    ("options", "frames", "seconds"),
    [
        ({"start": 20, "duration": 2}, 60, 2.0),
        ({"start": 20, "duration": 2, "rate": 10}, 20, 2.0),
        ({"start": 20, "duration": 2, "speed": 4}, 15, 0.5),
        ({"start": 20, "duration": 0.5, "speed": 0.25, "rate": 20}, 40, 2.0),
        ({"start": -1, "rate": 12.5}, 12, 0.96),
        ({"start": 53, "rate": 10}, 1, 0.1),
    ],
)
def test_a_video_has_all_frames_of_its_time(
    crossing: Recording, tmp_path: Path, renderer: RenderProcess, options: Any, frames: int, seconds: float
) -> None:
    path = tmp_path / "out.mp4"
    written = export_video(crossing, path, renderer=renderer, size=SMALL, **options)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.frames, stream.width, stream.height) == (frames, *SMALL)
        assert float(stream.duration * stream.time_base) == pytest.approx(seconds, abs=0.01)
    assert (written.frames, written.seconds, written.size) == (frames, pytest.approx(seconds), SMALL)
    assert written.size_on_disk == path.stat().st_size
    assert names_in(tmp_path) == ["out.mp4"]


def test_the_followed_car_is_where_the_camera_sees_it(crossing: Recording, tmp_path: Path, renderer: RenderProcess) -> None:
    start = 23.0
    frames = film(crossing, tmp_path / "out.mp4", renderer, start=start, duration=3, rate=10, overlay=False)
    player = Player(crossing, start=start, duration=3)
    shots = list(Film(crossing, player, "chase", SMALL, rate=10, frames=30).shots())
    assert len(frames) == len(shots) == 30
    for frame, shot in zip(frames[::6], shots[::6], strict=True):
        row = int(shot.instances.ids.searchsorted(100))
        assert shot.instances.ids[row] == 100
        x, y, _ = shot.camera.project(shot.instances.locations[row : row + 1])[0]
        assert x == pytest.approx(SMALL[0] / 2, abs=2)
        road = frame[int(y) + 2, int(x) - 70].astype(int)
        assert np.abs(frame[int(y) - 2 : int(y) + 2, int(x)].astype(int) - road).sum(axis=-1).max() > 30


def test_views_differ(crossing: Recording, tmp_path: Path, renderer: RenderProcess) -> None:
    means = {
        view: film(crossing, tmp_path / f"{view}.mp4", renderer, start=20, duration=0.03, view=view, overlay=False)[0]
        for view in ("chase", "top", "driver")
    }
    sky = {view: frame[:20].astype(int) for view, frame in means.items()}
    for view in ("chase", "driver"):
        assert (sky[view][..., 2] > sky[view][..., 0]).mean() > 0.9  # blue
    assert (sky["top"][..., 2] > sky["top"][..., 0] + 20).mean() < 0.1


def test_a_recorded_camera_films_with_its_size_and_field_of_view(tmp_path: Path, renderer: RenderProcess) -> None:
    """It looks backwards at another car."""
    frames: list[dict[str, Any]] = [{"transforms": [pose(1, 10.0 * n), pose(2, 10.0 * n - 2000)]} for n in range(5)]
    sensor = spawn(3, "sensor.camera.rgb", -250, 180, fov="60", image_size_x="201", image_size_y="101")
    frames[0] |= {"spawned": [spawn(1), spawn(2, x=-2000), sensor], "parented": [(3, 1)]}
    with open_recording(write(tmp_path / "in.log", frames, tick=0.1)) as recording:
        written = export_video(recording, tmp_path / "out.mp4", view=3, renderer=renderer, overlay=False)
        film = Film(recording, Player(recording), 3, written.size, frames=5)
        shot = next(film.shots())
    assert written.size == (200, 100)
    assert shot.camera.fov == 60
    (x, _, depth), *_ = shot.camera.project(shot.instances.locations[shot.instances.ids == 2])
    assert depth == pytest.approx(17.5, abs=0.5)
    assert x == pytest.approx(100, abs=1)


NAN, FAR = float("nan"), 3e38
LOST: list[dict[str, Any]] = [{"transforms": [pose(1, x), pose(2, FAR, yaw=NAN)]} for x in (NAN, 100, FAR, NAN)]
LOST[0]["spawned"] = [spawn(1), spawn(2)]


@pytest.mark.parametrize(("frames", "follow"), [([{}] * 4, None), (LOST, 1)], ids=["empty", "poses that are no numbers"])
def test_odd_recordings_are_filmed(tmp_path: Path, renderer: RenderProcess, frames: Any, follow: int | None) -> None:
    with open_recording(write(tmp_path / "odd.log", frames, tick=0.1)) as recording:
        for view in ("chase", "top", "driver"):
            assert len(film(recording, tmp_path / f"{view}.mp4", renderer, view=view, follow=follow)) == 9


def test_the_roads_of_a_long_recording_without_map_are_those_around_what_is_shown(tmp_path: Path) -> None:
    frames = [{"transforms": [pose(1, 1000.0 * n)], "spawned": [spawn(1)] * (n == 0)} for n in range(401)]
    with open_recording(write(tmp_path / "long.log", frames)) as recording:
        (part, whole) = (load_town_of(recording, None, *span) for span in ((200.0, 1.0), (0.0, 0.0)))
    lengths = [float(np.ptp(town.bounds[..., 0])) for town in (part, whole)]
    assert 500 < lengths[0] < 1500
    assert lengths[1] > 4000


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("out.mp4", {"start": 60}, "nothing at 60 s"),
        ("out.mp4", {"follow": 999}, "no actor 999 to follow"),
        ("out.mp4", {"view": 100}, "crossing.log: no camera 100 is recorded; the recorded cameras are: none"),
        ("out.mp4", {"speed": 0}, "a speed of 0: a number above 0 was expected"),
        ("out.mp4", {"speed": 1e-9}, "a video has 1,000,000 frames at most"),
        ("out.avi", {}, "a video is written as .mp4 or .gif"),
        ("there.mp4", {}, "there.mp4: exists already"),
    ],
)
def test_invalid_arguments_are_errors_of_one_line(
    crossing: Recording, tmp_path: Path, name: str, options: Any, message: str
) -> None:
    (tmp_path / "there.mp4").write_bytes(b"before")
    with pytest.raises(RecapError, match=message) as caught:
        export_video(crossing, tmp_path / name, **options)
    assert "\n" not in str(caught.value)
    assert names_in(tmp_path) == ["there.mp4"]


# --- the command ----------------------------------------------------------------------------------------------


def test_the_command(tmp_path: Path, renderer: RenderProcess) -> None:
    path = tmp_path / "out.mp4"
    arguments = ("--start", "24", "--duration", "0.5", "--size", "320x180", "--fps", "10", "--view", "top", "--no-overlay")
    done = run("video", SAMPLES / "crossing.log", path, *arguments)
    assert done.returncode == 0
    assert done.stderr.decode().startswith(f"wrote {path}: 5 frames, 0.5 s, 320x180, ")
    assert len(frames_of(path)) == 5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--view", "left"), "'left' is neither chase, top or driver nor the id of a recorded camera"),
        (("--speed", "0"), "'0' is not a number of more than 0."),
        (("--follow", "9" * 5000), "9' is neither an actor id nor hero."),
    ],
)
def test_errors_of_the_command(tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    assert message in error("video", SAMPLES / "crossing.log", tmp_path / "out.mp4", *arguments)


PLAYED = """
const [url, done] = arguments, video = document.createElement("video");
video.muted = true;
video.onerror = () => done({error: video.error.message});
video.onended = () => done({duration: video.duration, width: video.videoWidth, time: video.currentTime});
document.body.append(video);
video.src = url;
video.play().catch(error => done({error: String(error)}));
"""


def test_a_browser_plays_it(chromium: Chrome, crossing: Recording, tmp_path: Path, renderer: RenderProcess) -> None:
    path, page = tmp_path / "out.mp4", tmp_path / "page.html"
    export_video(crossing, path, renderer=renderer, start=24, duration=1, size=SMALL)
    page.write_text("<!doctype html><body></body>")
    chromium.get(page.as_uri())
    played = chromium.execute_async_script(PLAYED, path.as_uri())
    assert played == {"duration": pytest.approx(1, abs=0.02), "width": 320, "time": pytest.approx(1, abs=0.05)}, json.dumps(
        played
    )
