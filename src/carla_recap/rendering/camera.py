"""Pinhole cameras, and the kinds of images that they take."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from math import radians, tan
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np

from carla_recap.errors import RecapError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.scene.instances import Instances
    from carla_recap.util.arrays import Floats

    Images = dict["ImageKind", NDArray[Any]]


Quality = Literal["low", "epic"]
"""The quality of RGB images: low has neither shadows nor grain of surfaces nor smooth edges, epic has them."""


def check_quality(quality: str) -> None:
    """Check a quality."""
    if quality not in get_args(Quality):
        raise RecapError(f"quality {quality!r:.200}; one of {', '.join(get_args(Quality))} was expected")


class ImageKind(StrEnum):
    """A kind of image: an array (height, width, channels), its first row at the top.

    All kinds but the last are of uint8, and their channels are blue, green, red, alpha, in the encodings of CARLA's sensors;
    alpha is 255. Optical flow is of float32, and its channels are x and y.
    """

    RGB = "rgb"
    DEPTH = "depth"
    SEMANTIC = "semantic_segmentation"
    INSTANCE = "instance_segmentation"
    NORMALS = "normals"
    FLOW = "optical_flow"


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera."""

    width: int  # the width of its images, in pixels
    height: int  # the height, in pixels
    fov: float  # the horizontal field of view, in degrees
    location: Floats  # the position in m, (3,), right-handed
    rotation: Floats  # a matrix, (3, 3), whose columns point forward, left and up

    @property
    def focal_length(self) -> float:
        """The distance of the image plane, in pixels."""
        return self.width / 2 / tan(radians(self.fov) / 2)

    def project(self, points: Floats) -> Floats:
        """Return the pixels of points: x to the right, y down, and the depth along the view axis in m, (n, 3)."""
        forward, left, up = ((np.asarray(points) - self.location) @ self.rotation).T
        with np.errstate(divide="ignore", invalid="ignore"):
            x = self.width / 2 - self.focal_length * left / forward
            y = self.height / 2 - self.focal_length * up / forward
        return np.stack((x, y, forward), axis=1)


class DrawnView(NamedTuple):
    """What a camera draws of a moment; see `carla_recap.rendering.renderer.Renderer.draw`."""

    camera: Camera
    kinds: tuple[ImageKind, ...] = (ImageKind.RGB,)
    previous: tuple[Camera, Instances | None] | None = None
    without: frozenset[int] = frozenset()
