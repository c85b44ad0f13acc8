"""Images as bytes: JPEG, WebP, PNG, H.264, and depth as whole millimetres."""

from __future__ import annotations

from fractions import Fraction
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import MissingExtra, RecapError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Image = NDArray[Any]

QUALITY: Final = 85
"""The quality of JPEGs, unless it is given: 41 dB, and 40 kB for an image of 800 x 600 pixels."""

_EXTRA: Final = "video"
_FASTEST_PNG: Final = 1  # the level of compression; higher ones take half as long again, and save a quarter
_WEBP_EFFORT: Final = 2  # of 0 to 6; the usual 4 takes half as long again, and saves a twentieth
_MILLIMETRES: Final = 1000.0
_PRESET: Final = "ultrafast"  # half the time of veryfast, for a fifth more bytes
_RATE_FACTOR: Final = "23"
_GROUP: Final = 1000  # frames between two key frames, at most; callers ask for them sooner
_TIME_BASE: Final = Fraction(1, 20)  # s; readers go by the times of messages
_BT_709: Final = 1  # in FFmpeg's tables of colour primaries, transfer functions and matrices
_LIMITED_RANGE: Final = 1


def bgrx(image: Image) -> Image:
    """Return an image of red, green, blue, (height, width, 3) of uint8, with the bytes blue, green, red and any.

    An image out of `sense` is a view of such an array, which is returned without a copy.
    """
    base, backwards = image.base, (4 * image.shape[1], 4, -1)
    if isinstance(base, np.ndarray) and base.shape == (*image.shape[:2], 4) and image.strides == backwards:
        return base
    found = np.full((*image.shape[:2], 4), 255, np.uint8)
    found[..., 2::-1] = image
    return found


def jpeg(image: Image, quality: int = QUALITY) -> bytes:
    """Return an image as JPEG.

    The image is red, green, blue, (height, width, 3) of uint8; the quality from 1 to 95.
    """
    try:
        from simplejpeg import encode_jpeg  # unlike Pillow, it lets other threads run
    except ImportError:
        raise MissingExtra("an image of a camera", _EXTRA) from None
    encoded: bytes = encode_jpeg(bgrx(image), quality, "BGRX", "420", fastdct=False)
    return encoded


def webp(image: Image, quality: int) -> bytes:
    """Return an image as WebP, which takes half of the bytes of a JPEG, and several times as long.

    The image is red, green, blue, (height, width, 3) of uint8; the quality from 1 to 100.
    """
    file = BytesIO()
    load_pillow().fromarray(np.ascontiguousarray(image)).save(file, "WEBP", quality=quality, method=_WEBP_EFFORT)
    return file.getvalue()


def png(image: Image) -> bytes:
    """Return an image as PNG.

    The image is grey, (height, width) of uint8 or uint16, or red, green, blue, (height, width, 3) of uint8.
    """
    file = BytesIO()
    load_pillow().fromarray(np.ascontiguousarray(image)).save(file, "PNG", compress_level=_FASTEST_PNG)
    return file.getvalue()


def millimetres(depth: Image) -> NDArray[np.uint16]:
    """Return depths in m as whole millimetres; 0 for what is farther than 65.535 m, and for the sky."""
    with np.errstate(invalid="ignore"):
        steps = np.rint(depth * np.float32(_MILLIMETRES))
        steps[~(steps <= np.iinfo(np.uint16).max)] = 0
    found: NDArray[np.uint16] = steps.astype(np.uint16)
    return found


class VideoStream:
    """A stream of images as H.264, one packet for each, in the format of Annex B, without B frames.

    Key frames have the parameters of the stream, so that each can be the first to be decoded.

    Args:
        width: The width of the images in pixels; an even number.
        height: The height; an even number.

    Raises:
        RecapError: A side is odd.
        MissingExtra: PyAV is not installed.
    """

    def __init__(self, width: int, height: int) -> None:
        if width % 2 or height % 2:
            raise RecapError(f"{width} x {height}: the sides of a video are even numbers")
        try:
            import av
        except ImportError:
            raise MissingExtra("a video of a camera", _EXTRA) from None
        context: Any = av.CodecContext.create("libx264", "w")
        context.width, context.height, context.pix_fmt = width, height, "yuv420p"
        context.time_base, context.framerate = _TIME_BASE, 1 / _TIME_BASE
        context.gop_size, context.max_b_frames, context.thread_count = _GROUP, 0, 1
        context.color_range = _LIMITED_RANGE
        context.color_primaries = context.color_trc = context.colorspace = _BT_709
        context.options = {"preset": _PRESET, "tune": "zerolatency", "crf": _RATE_FACTOR, "forced-idr": "1"}
        self._context = context
        self._count = 0

    def encode(self, image: Image, *, is_key: bool) -> bytes:
        """Return the packet of the next image.

        A key image can be decoded without those before.
        """
        from av import VideoFrame
        from av.video.frame import PictureType

        frame = VideoFrame.from_ndarray(bgrx(image), format="bgra")
        frame = frame.reformat(format="yuv420p", dst_colorspace=_BT_709, dst_color_range=_LIMITED_RANGE)
        frame.pict_type = PictureType.I if is_key else PictureType.NONE
        frame.pts, self._count = self._count, self._count + 1
        return b"".join(bytes(packet) for packet in self._context.encode(frame))


def load_pillow(feature: str = "an image of a camera", extra: str = _EXTRA) -> Any:
    """Return Pillow's module `Image`."""
    try:
        from PIL import Image
    except ImportError:
        raise MissingExtra(feature, extra) from None
    return Image
