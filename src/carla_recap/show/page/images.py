"""What a camera saw, for the incident page: of the images that a recording has stored, fewer and smaller ones."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.queries.sensors import has_images, sensors
from carla_recap.sensors.encoding import load_pillow, webp
from carla_recap.util.text import first_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from carla_recap.queries.sensors import RecordedSensor
    from carla_recap.recording import Recording

RATE: Final = 10.0
"""The most images per second."""
LARGEST: Final = 480
"""The longer side of the images in pixels, at most."""
BUDGET: Final = 4_000_000
"""The most bytes of the images of a recording; of a longer one, there are fewer images per second."""

_QUALITY: Final = 60
_SHORTEST: Final = 1.0  # s that an image is shown, at most, where none follows


class PageImages(NamedTuple):
    """The images of a camera."""

    camera: str  # the id of the camera
    size: tuple[int, int]  # the width and the height of the first image in pixels
    times: list[float]  # the times of the images in elapsed seconds, ascending
    images: list[bytes]  # the images as WebP

    @property
    def longest(self) -> float:
        """The seconds for which an image is shown where none follows: twice the usual time between two, or more."""
        return max(_SHORTEST, 2 * float(np.median(np.diff(self.times)))) if len(self.times) > 1 else _SHORTEST


def camera_of(recording: Recording, camera: str | None) -> str | None:
    """Return the camera to show: the given one, or the one that looks ahead the most; None if there are no images."""
    found = [sensor for sensor in sensors(recording.reader) if has_images(sensor)]
    if camera is None:
        return min(found, key=_angle).id if found else None
    if camera not in (ids := [sensor.id for sensor in found]):
        has = f"it has those of {first_of(ids):.500}" if ids else "'carla-recap sense' writes a recording that has some"
        raise RecapError(f"{recording.location}: has no images of a camera {camera!r:.200}; {has}")
    return camera


def _angle(sensor: RecordedSensor) -> float:
    """Return the angle between the axis of a camera and straight ahead, in radians; the largest one if it is not known."""
    try:
        yaw, pitch = (math.radians(float(sensor.spec.get(name, 0.0))) for name in ("yaw", "pitch"))
        return math.acos(math.cos(yaw) * math.cos(pitch))
    except (TypeError, ValueError, OverflowError):  # of a recording by another program; infinity has no cosine
        return math.pi


def page_images(recording: Recording, camera: str, spans: Iterable[tuple[float, float]]) -> PageImages | None:
    """Return the images of a camera in the intervals that a page shows, in elapsed seconds; None if there are none."""
    from carla_recap.sensors.decoding import StoredImages

    size, step = (0, 0), 1 / RATE
    times: list[float] = []
    images: list[bytes] = []
    for start, stop in spans:
        stored, time = StoredImages(recording.reader, camera, start, stop), start
        while True:
            image = stored.at(time)
            if image is not None and stored.time is not None and (not times or stored.time > times[-1]):
                shown = _smaller(image)
                size = size if times else (shown.shape[1], shown.shape[0])
                times.append(stored.time)
                images.append(webp(shown, _QUALITY))
            while len(images) > 1 and sum(map(len, images)) > BUDGET:
                times, images, step = times[::2], images[::2], 2 * step
            if stored.next_time is None or stored.next_time > stop:
                break
            time = max(time + step, stored.next_time)
    return PageImages(camera, size, times, images) if images else None


def _smaller(image: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Return an image whose sides are at most `LARGEST`."""
    picture = load_pillow().fromarray(image)
    picture.thumbnail((LARGEST, LARGEST))
    return np.asarray(picture)
