"""Cameras: nothing is rendered, but scripts that wait for images get blank ones of the size that they asked for."""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import TYPE_CHECKING, Final

from carla_recap.server.attributes import LARGEST_SIDE
from carla_recap.server.sensors.feed import number

if TYPE_CHECKING:
    from carla_recap.server.sensors.feed import Feed, FeedContext, MakeFeed
    from carla_recap.sim.actors.actor import Actor

_SIDES: Final = ("image_size_x", "image_size_y")
# width, height, field of view in degrees
_HEADER: Final = struct.Struct("<IIf")

# The bytes of each pixel: blue, green, red, alpha
_GREY: Final = bytes((128, 128, 128, 255))
_FARTHEST: Final = bytes((255, 255, 255, 255))  # depth is red + 256 green + 65536 blue; all set are 1,000 m
_UNLABELLED: Final = bytes((0, 0, 0, 255))
_STILL: Final = struct.pack("<2f", 0.0, 0.0)  # of optical flow: along x and y


def _camera(pixel: bytes) -> MakeFeed:
    """Return what makes the feeds of cameras whose images are of one colour."""

    def make(sensor: Actor, context: FeedContext) -> Feed:
        width, height = (_side(sensor, key) for key in _SIDES)
        image = (_image(width, height, number(sensor, "fov"), pixel),)
        return lambda: image

    return make


def _side(sensor: Actor, key: str) -> int:
    return int(min(max(number(sensor, key), 1), LARGEST_SIDE))


@lru_cache(maxsize=4)
def _image(width: int, height: int, fov: float, pixel: bytes) -> bytes:
    return _HEADER.pack(width, height, fov) + pixel * (width * height)


grey = _camera(_GREY)
depth = _camera(_FARTHEST)
unlabelled = _camera(_UNLABELLED)
flow = _camera(_STILL)
events = _camera(b"")
