"""Videos of recordings: a part of a recording as an MP4 or GIF, by the software renderer or the cameras of a rig."""

from __future__ import annotations

import math
from collections import deque
from contextlib import closing
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, NamedTuple

import numpy as np

from carla_recap.editing.convert import check_destination
from carla_recap.errors import RecapError
from carla_recap.replay import Player
from carla_recap.replay.follow import HERO
from carla_recap.sensors.viewing import CameraChoice
from carla_recap.show.video.encoding import LARGEST, LONGEST, SMALLEST, check_video, create_video
from carla_recap.show.video.film import RATE, Film, followed_of, opened_renderer, overlay_options, recorded_size, submit

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
    from concurrent.futures import Future

    from numpy.typing import NDArray

    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.recording import Recording
    from carla_recap.rendering.camera import Images
    from carla_recap.rendering.process import RenderProcess
    from carla_recap.replay import Follow
    from carla_recap.sensors.rig import SensorRig
    from carla_recap.sensors.viewing import CameraMoment
    from carla_recap.show.video.camera_paths import VideoView
    from carla_recap.show.video.encoding import Picture, Size
    from carla_recap.show.video.film import Progress, Town, VideoShot

GIF_RATE: Final = 12.5
"""The frames per second of a GIF, unless they are given."""
SIZE: Final = (1280, 720)
GIF_SIZE: Final = (640, 360)
"""The size, unless it is given, or recorded with a camera."""
_AHEAD: Final = 3  # pictures that are drawn while another one is encoded
_SAMPLES: Final = 8  # pictures from which a GIF gets its palette


class VideoInfo(NamedTuple):
    """A video that was written."""

    frames: int
    seconds: float  # the duration
    size: tuple[int, int]  # the width and the height in pixels
    size_on_disk: int  # the size of the file in bytes


def export_video(
    source: Recording,
    destination: Path | str,
    *,
    view: VideoView = "chase",
    cameras: Sequence[str] | Literal["all"] = (),
    rig: SensorRig | None = None,
    follow: Follow | None = None,
    start: float = 0.0,
    duration: float = 0.0,
    speed: float = 1.0,
    size: Size | None = None,
    rate: float | None = None,
    smooth: bool = False,
    overlay: bool | None = None,
    incidents: IncidentOptions | None = None,
    town: Town | None = None,
    road_map: Path | str | None = None,
    renderer: RenderProcess | None = None,
    progress: Progress | None = None,
    force: bool = False,
) -> VideoInfo:
    """Write a video of a recording.

    Args:
        source: The recording.
        destination: The .mp4 (H.264) or .gif; it appears when it is complete.
        view: The view: "chase" from behind the followed actor, "top" from above, "driver" from its seat; or the id of a
            recorded camera, which has its recorded field of view.
        cameras: The ids of cameras of the rig, or without one, of the sensors whose data the recording has, which film
            instead of the view, several of them side by side; "all": all of them.
        rig: Sensors on the hero, or the followed actor if that is given, whose images are drawn; None: cameras show the
            images that the recording has of them, or if it has none, what they would have seen.
        follow: The followed actor: an id or "hero"; None: the hero, else the first to collide, else the one that goes
            farthest.
        start: The elapsed seconds to begin at; negative: before the end.
        duration: The seconds of the recording to show; 0: all of the rest.
        speed: The seconds of the recording in a second of the video.
        size: Width and height in pixels; None: 1280 x 720, of a GIF 640 x 360, of cameras those of their images.
        rate: The frames per second; None: 30, of a GIF 12.5.
        smooth: Draw smooth edges, which takes about twice as long.
        overlay: Write time, speed, controls, the light ahead and incidents on the pictures; None: unless the view is that of
            a recorded camera.
        incidents: Which incidents are shown; None: all kinds, those against the rules of the road if the map is found.
        town: The town, or a function that loads it; None: that of the recording's map if it is the built-in one or in the
            folder that CARLA_RECAP_MAPS names, else roads where vehicles have driven.
        road_map: The map of the town for cameras that are drawn, a file or a folder; None: looked for in the usual folders.
        renderer: What draws the pictures, for several videos of one town; None: one is made and closed.
        progress: Is given all scenes and the player, and passes the scenes on.
        force: Overwrite an existing file.

    Raises:
        RecapError: There is no such time, actor or camera, the destination cannot be written, or nothing can be drawn here.
        FormatError: The recording contradicts its format.
        MissingExtra: An optional dependency is not installed.
    """
    path, is_gif = Path(destination), Path(destination).suffix.lower() == ".gif"
    if not 0 < speed < math.inf:
        raise RecapError(f"a speed of {speed:g}: a number above 0 was expected")
    player = Player(source, start=start, duration=duration, follow=followed_of(source, view, follow))
    choice = CameraChoice(source, cameras, rig) if cameras or rig is not None else None
    grid = None if choice is None else CameraGrid({id: choice.size(id) for id in choice.ids}, size)
    size = grid.size if grid is not None else size or recorded_size(source, view) or (GIF_SIZE if is_gif else SIZE)
    rate = (GIF_RATE if is_gif else RATE) if rate is None else rate
    length = player.stop - player.start
    frames = max(1, round(min(length * rate / speed, LONGEST + 1))) if rate > 0 else 0
    check_video(path, size, rate, frames)
    check_destination(source.reader.location, path, force=force)

    shown = overlay_options(source, view, overlay, incidents)

    def film(rate: float, speed: float, frames: int) -> Film:
        part = Player(source, start=player.start, duration=length, follow=player.followed)
        return Film(source, part, view, size, speed=speed, rate=rate, frames=frames, shown=shown)

    if choice is not None and grid is not None:
        carrier = HERO if follow is None else follow
        scenes = choice.scenes(
            start=player.start,
            duration=length,
            rate=rate / speed,
            actor=carrier,
            road_map=road_map,
            progress=progress,
        )
        pictures = camera_pictures(scenes, grid, film(rate, speed, frames), frames)
        with closing(pictures), create_video(path, size, rate, force=force) as file:
            for picture in pictures:
                file.add(picture)
        return VideoInfo(frames, frames / rate, size, path.stat().st_size)
    span = {"start": player.start, "stop": player.stop}
    with opened_renderer(renderer, town, source, **span, supersampling=1 + smooth) as opened:
        main = film(rate, speed, frames)
        drawing = opened.result()
        samples = list(_pictures(film(_SAMPLES / length, 1.0, _SAMPLES), drawing)) if is_gif and length else []
        with create_video(path, size, rate, samples, force=force) as file:
            for picture in _pictures(main, drawing, progress):
                file.add(picture)
    return VideoInfo(frames, frames / rate, size, path.stat().st_size)


def _pictures(film: Film, renderer: RenderProcess, progress: Progress | None = None) -> Iterator[Picture]:
    """Yield the pictures of a film; some are drawn ahead."""
    waiting: deque[tuple[Future[list[Images]], VideoShot]] = deque()
    for shot in film.shots(progress):
        waiting.append((submit(renderer, shot), shot))
        if len(waiting) > _AHEAD:
            yield film.finished(*waiting.popleft())
    for images, shot in waiting:
        yield film.finished(images, shot)


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
