"""Video files: what decoders find in them, and what is left when they cannot be written."""

from __future__ import annotations

import sys
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("av", reason="the extra `video` is not installed")

import av
from PIL import Image

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.show.video.encoding import check_packages, check_video, create_video
from tests.samples import names_in
from tests.show.conftest import limited

COLORS = [(200, 40, 40), (40, 180, 60), (30, 60, 200), (128, 128, 128)]


def picture(color: tuple[int, int, int], size: tuple[int, int] = (320, 180)) -> Any:
    """Return a picture of one colour as blue, green, red, alpha."""
    pixels = np.empty((size[1], size[0], 4), np.uint8)
    pixels[...] = (*color[::-1], 255)
    return pixels


def write(path: Path, rate: float = 30.0, size: tuple[int, int] = (320, 180), frames: int = 8) -> Path:
    with create_video(path, size, rate, [picture(color, size) for color in COLORS]) as file:
        for index in range(frames):
            file.add(picture(COLORS[index * len(COLORS) // frames], size))
    return path


def test_an_mp4_has_the_frames_rate_and_colors(tmp_path: Path) -> None:
    path = write(tmp_path / "out.mp4", rate=25.0)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height, float(stream.average_rate)) == (320, 180, 25.0)
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert len(decoded) == 8
    for index, frame in enumerate(decoded):
        assert np.abs(frame.astype(int) - COLORS[index // 2]).max() <= 6
    assert names_in(tmp_path) == ["out.mp4"]


def test_the_index_of_an_mp4_is_at_its_front(tmp_path: Path) -> None:
    data = write(tmp_path / "out.mp4").read_bytes()
    assert -1 < data.find(b"moov") < data.find(b"mdat")


def test_a_gif_has_the_frames_durations_and_colors(tmp_path: Path) -> None:
    path = write(tmp_path / "out.gif", rate=12.0, frames=4)
    with Image.open(path) as image:
        assert (image.format, image.size, image.n_frames, image.info["loop"]) == ("GIF", (320, 180), 4, 0)
        delays = []
        for index, color in enumerate(COLORS):
            image.seek(index)
            delays.append(image.info["duration"])
            assert np.abs(np.array(image.convert("RGB").getpixel((9, 9))) - color).max() <= 4
    assert list(accumulate(delays)) == [80, 170, 250, 330]  # ms: 12 frames per second, rounded to hundredths of a second


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such limits")
@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_a_full_disk_is_an_error_of_one_line(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"out{suffix}"
    lines = (
        "from pathlib import Path",
        "import numpy as np",
        "from carla_recap.show.video.encoding import create_video",
        f"with create_video(Path({str(path)!r}), (320, 180), 30) as file:",
        "    for seed in range(60):",
        "        file.add(np.random.default_rng(seed).integers(0, 255, (180, 320, 4), np.uint8))",
    )
    assert limited("\n".join(lines), 100_000) == [f"RecapError: {path}: cannot be written: File too large"]
    assert names_in(tmp_path) == []


@pytest.mark.parametrize(
    ("name", "size", "rate", "frames", "message"),
    [
        ("out.avi", (320, 180), 30, 9, r"out\.avi: a video is written as \.mp4 or \.gif"),
        ("out.mp4", (321, 180), 30, 9, "321 x 180: the sides of an MP4 are even numbers, such as 320 x 180"),
        ("out.mp4", (32, 180), 30, 9, "32 x 180: the sides of a picture are from 64 to 4096 pixels"),
        ("out.mp4", (4098, 180), 30, 9, "4098 x 180: the sides of a picture are from 64 to 4096 pixels"),
        ("out.mp4", (320, 180), 0, 9, "0 frames per second: 0.1 to 240"),
        ("out.gif", (320, 180), 60, 9, "60 frames per second: 0.1 to 50"),
        ("out.mp4", (320, 180), float("nan"), 9, "nan frames per second"),
        ("out.mp4", (320, 180), 30, 1_000_001, "out.mp4: a video has 1,000,000 frames at most; a shorter duration"),
        ("out.gif", (1280, 720), 12.5, 2000, r"2,000 frames of 1280 x 720 are too many for a GIF, which can have 271"),
    ],
)
def test_what_cannot_be_written_is_refused(name: str, size: tuple[int, int], rate: float, frames: int, message: str) -> None:
    with pytest.raises(RecapError, match=message):
        check_video(Path(name), size, rate, frames)


@pytest.mark.parametrize(("suffix", "package"), [(".mp4", "av"), (".gif", "PIL.Image")])
def test_without_a_package_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch, suffix: str, package: str) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingExtra, match=rf"a video as \{suffix} needs an optional dependency: pip install '\.\[video\]'"):
        check_packages(suffix)
