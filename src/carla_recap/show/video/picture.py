"""Pictures of a recording at a time."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.editing.convert import check_destination
from carla_recap.errors import RecapError
from carla_recap.model.frame import SAME_TIME
from carla_recap.replay import Player
from carla_recap.sensors.encoding import load_pillow
from carla_recap.show.video.encoding import check_size
from carla_recap.show.video.film import Film, followed_of, opened_renderer, overlay_options, recorded_size, submit
from carla_recap.show.video.video import SIZE
from carla_recap.util.files import WholeFile

if TYPE_CHECKING:
    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.recording import Recording
    from carla_recap.rendering.process import RenderProcess
    from carla_recap.replay import Follow
    from carla_recap.scene.falls import RecordedContacts
    from carla_recap.show.video.camera_paths import VideoView
    from carla_recap.show.video.encoding import Size
    from carla_recap.show.video.film import Town, VideoShot

_BEFORE: Final = 1.5  # s; the camera is as calm as if it had followed the actor for this time
_RATE: Final = 10.0  # scenes in a second of it
_PNG: Final = b"\x89PNG"
_JPEG: Final = b"\xff\xd8"
_FORMS: Final = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}


class PictureFile(bytes):
    """The content of a PNG or JPEG file, which a notebook shows as the picture."""

    def _repr_png_(self) -> bytes | None:
        return bytes(self) if self.startswith(_PNG) else None

    def _repr_jpeg_(self) -> bytes | None:
        return bytes(self) if self.startswith(_JPEG) else None


def snapshot(
    source: Recording,
    destination: Path | str,
    *,
    at: float,
    follow: Follow | None = None,
    view: VideoView = "chase",
    town: Town | None = None,
    size: Size | None = None,
    overlay: bool | None = None,
    incidents: IncidentOptions | None = None,
    force: bool = False,
) -> None:
    """Write a picture of a recording at a time.

    Args:
        source: The recording.
        destination: The .png or .jpg; it appears when it is complete.
        at: The time in elapsed seconds; a negative number is counted from the end.
        follow: The actor that the camera follows: an id or "hero"; None: see `choose_followed`, in the seconds before.
        view: The view; see `export_video`.
        town: The town, or a function that loads it; None: that of the recording's map if it is the built-in one or in the
            folder that CARLA_RECAP_MAPS names, else roads where vehicles have driven.
        size: Width and height in pixels; None: 1280 x 720, or of a recorded camera those of its images.
        overlay: Write the map, time, speed and more on it; None: unless the view is that of a recorded camera.
        incidents: Which incidents are shown; see `export_video`.
        force: Overwrite an existing file.

    Raises:
        RecapError: There is no such time, actor or camera, the destination cannot be written, or nothing can be drawn here.
        FormatError: The file contradicts its format.
        MissingExtra: An optional dependency is not installed.
    """
    path = Path(destination)
    form = _FORMS.get(path.suffix.lower())
    if form is None:
        raise RecapError(f"{path}: expected a name that ends in {', '.join(_FORMS)}, found {path.suffix or 'none of these'}")
    check_destination(source.reader.location, path, force=force)
    data = picture(
        source, at=at, follow=follow, view=view, town=town, size=size, overlay=overlay, incidents=incidents, form=form
    )
    with WholeFile(path, force=force) as file:
        file.write(data)


def picture(
    source: Recording,
    *,
    at: float,
    follow: Follow | None = None,
    view: VideoView = "chase",
    town: Town | None = None,
    size: Size | None = None,
    overlay: bool | None = None,
    incidents: IncidentOptions | None = None,
    renderer: RenderProcess | None = None,
    form: str = "PNG",
    contacts: RecordedContacts | None = None,
) -> PictureFile:
    """Return a picture of a recording at a time, a PNG or JPEG; for the other arguments and errors, see `snapshot`.

    Of many pictures of one town, what draws them is given as the renderer; else one is made and closed. Of many pictures of
    a recording, its contacts are given, so that they are read once.
    """
    Image = load_pillow("a picture", "cameras")  # noqa: N806
    follow = followed_of(source, view, follow)
    size = size or recorded_size(source, view) or SIZE
    check_size(size)
    whole = Player(source, start=at)
    if at < -whole.total - SAME_TIME:
        raise RecapError(f"{source.location}: nothing {-at:g} s before the end; the recording has {whole.total:g} s")
    time = whole.start
    start = max(0.0, time - _BEFORE)
    player = Player(source, start=start, duration=max(time - start, SAME_TIME), follow=follow)
    if follow is None and player.followed is None:
        player.followed = Player(source).followed
    with opened_renderer(renderer, town, source, start=start, stop=time, supersampling=2) as opened:
        shown = overlay_options(source, view, overlay, incidents)
        film = Film(source, player, view, size, shown=shown, contacts=contacts)
        *_, shot = (film.shot(scene) for scene in player.scenes(_RATE))
        if follow is not None:
            _check_followed(source, player.followed, shot)
        pixels = film.finished(submit(opened.result(), shot), shot)
    file = io.BytesIO()
    Image.fromarray(pixels[..., 2::-1]).save(file, form, quality=88, compress_level=4)
    return PictureFile(file.getvalue())


def _check_followed(source: Recording, followed: int | None, shot: VideoShot) -> None:
    """Check that an actor that is to be followed has a pose in a scene."""
    pose = None if followed is None else shot.scene.pose_of(followed)
    if pose is None:
        raise RecapError(
            f"{source.location}: actor {followed} is not present at {shot.scene.time:g} s, so it cannot be followed"
        )
    if not np.isfinite(pose).all():
        raise RecapError(f"{source.location}: the pose of actor {followed} at {shot.scene.time:g} s is not finite")
