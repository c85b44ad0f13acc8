"""Video files: H.264 in MP4 by PyAV, and GIF by Pillow; a file appears when it is complete."""

from __future__ import annotations

from contextlib import suppress
from fractions import Fraction
from importlib import import_module
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.util.files import AtomicFile

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    Picture = NDArray[np.uint8]
    Size = tuple[int, int]

EXTRA: Final = "video"
SUFFIXES: Final = (".mp4", ".gif")
SMALLEST: Final = 64
LARGEST: Final = 4096
"""The limits of the width and the height of a video or picture, in pixels."""
SLOWEST: Final = 0.1
"""The smallest number of frames per second."""
FASTEST: Final = 240.0
FASTEST_GIF: Final = 50.0
"""The largest numbers of frames per second; browsers slow down a GIF that is faster."""
LONGEST: Final = 1_000_000
"""The largest number of frames: more than nine hours of the usual rate."""
LARGEST_GIF: Final = 250_000_000
"""The limit of the pixels of all frames of a GIF, which are kept in memory."""

_QUALITY: Final = "20"  # x264's constant rate factor; 18 is hardly distinguishable from the source
_PRESET: Final = "veryfast"
_DENOMINATOR: Final = 1001  # of rates such as 30000/1001
_BT_709: Final = 1  # in FFmpeg's tables of colour primaries, transfer functions and matrices
_LIMITED_RANGE: Final = 1
_GIF_COLORS: Final = 200  # of the palette, besides the accents
_ACCENTS: Final = (
    *((255, 255, 255), (170, 172, 175), (110, 112, 116), (86, 90, 96), (62, 65, 70), (14, 17, 22), (0, 0, 0)),
    *((235, 64, 52), (150, 45, 40), (245, 166, 66), (245, 200, 40), (70, 210, 110), (120, 186, 255), (150, 170, 255)),
)
"""Colours of what is written on pictures, of which there are few pixels."""


def check_video(path: Path, size: Size, rate: float, frames: int) -> None:
    """Check that a video of a suffix, size and rate can be written, and that what it needs is installed."""
    suffix, (width, height) = path.suffix.lower(), size
    if suffix not in SUFFIXES:
        raise RecapError(f"{path}: a video is written as {' or '.join(SUFFIXES)}")
    check_size(size)
    if suffix == ".mp4" and (width % 2 or height % 2):
        raise RecapError(f"{width} x {height}: the sides of an MP4 are even numbers, such as {width & ~1} x {height & ~1}")
    fastest = FASTEST_GIF if suffix == ".gif" else FASTEST
    if not SLOWEST <= rate <= fastest:
        raise RecapError(f"{rate:g} frames per second: {SLOWEST:g} to {fastest:g} were expected of {suffix}")
    if frames > LONGEST:
        raise RecapError(
            f"{path}: a video has {LONGEST:,} frames at most; "
            "a shorter duration, fewer frames per second or a higher speed helps"
        )
    if suffix == ".gif" and frames * width * height > LARGEST_GIF:
        most = LARGEST_GIF // (width * height)
        raise RecapError(
            f"{path}: {frames:,} frames of {width} x {height} are too many for a GIF, which can have {most:,}; "
            "a shorter duration, a smaller size, fewer frames per second or an .mp4 helps"
        )
    check_packages(suffix)


def check_size(size: Size) -> None:
    """Check the size of a video or picture, in pixels."""
    width, height = size
    if not (SMALLEST <= width <= LARGEST and SMALLEST <= height <= LARGEST):
        raise RecapError(f"{width} x {height}: the sides of a picture are from {SMALLEST} to {LARGEST} pixels")


def create_video(path: Path, size: Size, rate: float, samples: Sequence[Picture] = (), *, force: bool = True) -> _Mp4 | _Gif:
    """Create a video as `check_video` permits it, an .mp4 or .gif; for `force`, see `AtomicFile`.

    A GIF gets its palette from pictures of the video, by default from the first one.
    """
    is_gif = path.suffix.lower() == ".gif"
    return _Gif(path, rate, samples, force=force) if is_gif else _Mp4(path, size, rate, force=force)


def check_packages(suffix: str) -> None:
    """Check that what a video of a suffix needs is installed."""
    try:
        for package in ("PIL.Image", *(("av",) if suffix == ".mp4" else ())):
            import_module(package)
    except ImportError:
        raise MissingExtra(f"a video as {suffix}", EXTRA) from None


class _Mp4(AtomicFile):
    """An MP4 with H.264, its index at the front, so that it plays while it is still loaded."""

    def __init__(self, path: Path, size: Size, rate: float, *, force: bool) -> None:
        super().__init__(path, force=force)
        self._size = size
        self._rate = Fraction(rate).limit_denominator(_DENOMINATOR)
        self._begin(self._open)

    def add(self, picture: Picture) -> None:
        import av

        self._check_open()
        self._is_unused = False
        try:
            frame = av.VideoFrame.from_ndarray(picture, format="bgra")
            frame = frame.reformat(format="yuv420p", dst_colorspace=_BT_709, dst_color_range=_LIMITED_RANGE)
            self._container.mux(self._stream.encode(frame))
        except OSError as error:
            raise self._unwritable(error) from None

    def abandon(self) -> Path:
        with suppress(OSError, AttributeError):  # it may not have been opened
            self._container.close()
        return super().abandon()

    def _open(self) -> None:
        """Let PyAV open the file by its name: to move the index to the front, it opens it a second time."""
        import av

        path = str(self._partial.absolute())
        self._container: Any = av.open(path, "w", format="mp4", options={"movflags": "faststart"})
        stream: Any = self._container.add_stream("libx264", rate=self._rate)
        stream.width, stream.height = self._size
        stream.pix_fmt = "yuv420p"
        stream.options = {"preset": _PRESET, "crf": _QUALITY}
        context = stream.codec_context
        context.color_range = _LIMITED_RANGE
        context.color_primaries = context.color_trc = context.colorspace = _BT_709
        self._stream = stream

    def _finish(self) -> None:
        self._container.mux(self._stream.encode())
        self._container.close()


class _Gif(AtomicFile):
    """A GIF that repeats, with one palette for all frames."""

    def __init__(self, path: Path, rate: float, samples: Sequence[Picture], *, force: bool) -> None:
        super().__init__(path, force=force)
        self._rate = rate
        self._palette: Any = _palette(samples) if samples else None
        self._frames: list[Any] = []
        self._begin(lambda: None)

    def add(self, picture: Picture) -> None:
        from PIL import Image

        self._check_open()
        self._is_unused = False
        self._palette = self._palette or _palette([picture])
        self._frames.append(_image(picture).quantize(palette=self._palette, dither=Image.Dither.NONE))

    def _finish(self) -> None:
        ends = [round(100 * count / self._rate) for count in range(len(self._frames) + 1)]
        delays = [10 * (stop - start) for start, stop in pairwise(ends)]
        first, *others = self._frames
        first.save(self._file, format="GIF", save_all=True, append_images=others, duration=delays, loop=0)
        self._file.flush()


def _image(picture: Picture) -> Any:
    from PIL import Image

    return Image.fromarray(picture[..., 2::-1])


def _palette(pictures: Sequence[Picture]) -> Any:
    """Return an image whose palette suits pictures, and what is drawn on them."""
    from PIL import Image

    images = [_image(picture) for picture in pictures]
    width, height = images[0].size
    sample = Image.new("RGB", (width, height * len(images)))
    for index, image in enumerate(images):
        sample.paste(image, (0, height * index))
    found = sample.quantize(_GIF_COLORS, method=Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE).getpalette()
    palette = Image.new("P", (1, 1))
    palette.putpalette([*(found or [])[: 3 * _GIF_COLORS], *chain.from_iterable(_ACCENTS)])
    return palette
