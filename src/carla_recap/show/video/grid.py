"""Videos by the cameras of a rig: one, or several side by side, each with its name."""

from __future__ import annotations

import math
from itertools import islice
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.show.video.encoding import LARGEST, SMALLEST

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Mapping

    from numpy.typing import NDArray

    from carla_recap.sensors.viewing import CameraMoment
    from carla_recap.show.video.encoding import Picture, Size
    from carla_recap.show.video.film import Film

_NAME: Final = 14  # the height of a name as a part of that of an image, 1 / n
_SMALLEST_NAME: Final = 12  # pixels
_BACKGROUND: Final = (14, 17, 22)


class ImagePlace(NamedTuple):
    """The place of a camera's image in a picture: left, top, width and height, in pixels."""

    left: int
    top: int
    width: int
    height: int


class CameraGrid:
    """Where the images of cameras are in a picture: rows from left to right, as many columns as rows or one more.

    Without a size, the picture has that of the largest images side by side, as far as a video can have it.
    """

    def __init__(self, sizes: Mapping[str, Size], size: Size | None = None) -> None:
        columns = math.ceil(math.sqrt(len(sizes)))
        rows = math.ceil(len(sizes) / columns)
        if size is None:
            width, height = (max(sides) for sides in zip(*sizes.values(), strict=True))
            factor = min(1.0, LARGEST / (columns * width), LARGEST / (rows * height))
            size = _even(columns * width * factor), _even(rows * height * factor)
        self.size = size
        width, height = size[0] // columns, size[1] // rows
        self._places: dict[str, ImagePlace] = {}
        for index, (id, (own_width, own_height)) in enumerate(sizes.items()):
            factor = min(width / own_width, height / own_height)
            shown = max(1, round(own_width * factor)), max(1, round(own_height * factor))
            left = index % columns * width + (width - shown[0]) // 2
            top = index // columns * height + (height - shown[1]) // 2
            self._places[id] = ImagePlace(left, top, *shown)

    def __len__(self) -> int:
        return len(self._places)

    def picture(self, images: Mapping[str, NDArray[np.uint8]], *, names: bool) -> Picture:
        """Return the images of cameras, red, green, blue, as one picture: blue, green, red, alpha."""
        from PIL import Image, ImageDraw, ImageFont

        canvas = Image.new("RGB", self.size, _BACKGROUND)
        draw = ImageDraw.Draw(canvas)
        for id, place in self._places.items():
            if id in images:
                image: Any = Image.fromarray(np.ascontiguousarray(images[id]))
                if image.size != (place.width, place.height):
                    image = image.resize((place.width, place.height), Image.Resampling.BILINEAR, reducing_gap=2.0)
                canvas.paste(image, (place.left, place.top))
            if names:
                font = ImageFont.load_default(max(_SMALLEST_NAME, place.height // _NAME))
                margin = place.height // 40
                corner = place.left + place.width - margin, place.top + place.height - margin
                draw.text(corner, id, (255, 255, 255), font, anchor="rs", stroke_width=2, stroke_fill=(0, 0, 0))
        picture = np.full((*canvas.size[::-1], 4), 255, np.uint8)
        picture[..., 2::-1] = np.asarray(canvas)
        return picture


def camera_pictures(scenes: Iterable[CameraMoment], grid: CameraGrid, film: Film, frames: int) -> Generator[Picture]:
    """Yield the pictures of a video.

    With fewer scenes than pictures, the last one stays.
    """
    count, picture = 0, None
    for count, (scene, images) in enumerate(islice(scenes, frames), 1):
        picture = film.written(grid.picture(images, names=len(grid) > 1), scene, count - 1)
        yield picture
    if picture is not None:
        yield from (picture for _ in range(frames - count))


def _even(side: float) -> int:
    return max(SMALLEST, int(side)) & ~1
