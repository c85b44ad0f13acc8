"""A camera for the renderer: what is in its view, and the uniform block of its image."""

from __future__ import annotations

from dataclasses import replace
from math import exp, radians, tan
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.rendering import shaders

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.rendering.camera import Camera
    from carla_recap.rendering.sky import Sky
    from carla_recap.scene.instances import Instances


NEAR: Final = 0.1
"""The distance of the nearest surface that is drawn, in m, along the view axis."""
FAR: Final = 5000.0
"""The distance of the farthest surface that is drawn, in m, along the view axis."""
_FOG_HEIGHT: Final = 60.0  # m, in which the density of fog falls to a third
_PERIOD: Final = 64.0  # m after which the grain of surfaces repeats


class CameraView:
    """A camera and the light at a moment, given the origin of the ground in m, and the camera of the previous image.

    `shadow_length` is the length of shadows, as a part of the height of what they are of; 0 where there are none.
    """

    def __init__(self, camera: Camera, sky: Sky, ground: NDArray[np.float64], before: Camera | None) -> None:
        self.camera = camera
        self._before = before or camera
        self.sky, self._ground = sky, ground
        self._light = sky.light()
        rise = max(self._light.sun[2], shaders.LEAST_SUN)
        self.shadow_length = float(np.hypot(*self._light.sun[:2]) / rise) if self._light.shade < 1 else 0.0
        rows = np.array([_projection(camera)[index] for index in (0, 1, 3)]) @ _axes(camera)
        self._planes = np.array((rows[2] + rows[0], rows[2] - rows[0], rows[2] + rows[1], rows[2] - rows[1], rows[2]))
        self._planes /= np.linalg.norm(self._planes, axis=1, keepdims=True)

    def sees_spheres(self, offsets: NDArray[np.float64], radii: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which spheres are in view; false for those that are not finite."""
        seen: NDArray[np.bool_] = (offsets @ self._planes.T >= -radii[:, None]).all(axis=1)
        return seen

    def sees_boxes(self, bounds: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which boxes are in view."""
        centres, halves = bounds.mean(axis=1) - self.camera.location, (bounds[:, 1] - bounds[:, 0]) / 2
        seen: NDArray[np.bool_] = (centres @ self._planes.T + halves @ np.abs(self._planes).T >= 0).all(axis=1)
        return seen

    def previous_poses(self, seen: Instances, table: NDArray[np.void], previous: Instances | None) -> NDArray[np.void]:
        """Return where instances were, relative to the previous camera; those of no earlier pose have not moved."""
        found = np.zeros(len(seen), shaders.PREVIOUS)
        locations, rotations = seen.locations, table["rotation"]
        if previous is not None and len(previous):
            index = np.minimum(np.searchsorted(previous.ids, seen.ids), len(previous) - 1)
            known = previous.ids[index] == seen.ids
            known &= np.isfinite(previous.locations[index]).all(axis=1)
            known &= np.isfinite(previous.rotations[index]).all(axis=(1, 2))
            locations = np.where(known[:, None], previous.locations[index], locations)
            before = np.swapaxes(previous.rotations[index], 1, 2).reshape(-1, 9)
            rotations = np.where(known[:, None], before, rotations)
        found["previous_location"] = locations - self._before.location
        found["previous_rotation"] = rotations
        return found

    def block(self, width: int, height: int) -> NDArray[np.void]:
        """Return the uniform block of an image that is drawn with some width and height."""
        camera, light = self.camera, self._light
        block = np.zeros((), shaders.FRAME)
        block["clip"] = _clip(camera).T
        block["previous_clip"] = _clip(self._before).T
        block["origin"][:3] = self._ground - camera.location
        block["previous_origin"][:3] = self._ground - self._before.location
        forward, left, up = camera.rotation.T
        across = tan(radians(camera.fov) / 2)
        block["forward"][:3] = forward
        block["right"][:3] = -left * across
        block["up"][:3] = up * across * camera.height / camera.width
        block["size"][:3] = width, height, camera.focal_length * height / camera.height
        block["sun"] = (*light.sun, light.shade)
        block["sunlight"] = (*light.sunlight, light.disc)
        block["skylight"] = (*light.skylight, self.sky.wetness)
        block["groundlight"][:3] = light.groundlight
        block["zenith"] = (*light.zenith, self.sky.cloudiness)
        block["haze"][:3] = light.haze
        block["cloud_color"][:3] = light.clouds
        altitude = max(float(camera.location[2] - self._ground[2]), 0.0) / _FOG_HEIGHT
        # the mean density from the camera to the ground
        thinning = (1 - exp(-altitude)) / altitude if altitude > 1e-3 else 1.0
        block["fog"][:2] = self.sky.density * thinning, self.sky.fog_distance
        block["world"][:2] = np.mod(camera.location[:2], _PERIOD)
        return block


def valid_camera(camera: Camera) -> Camera:
    """Return a camera that can be drawn; one of numbers that are not finite is at the origin, and points forward."""
    if not 0.01 <= camera.fov <= 179:
        fov = float(np.clip(camera.fov, 0.01, 179)) if np.isfinite(camera.fov) else 90.0
        camera = replace(camera, fov=fov)
    if not (np.isfinite(camera.location).all() and np.isfinite(camera.rotation).all()):
        camera = replace(camera, location=np.zeros(3), rotation=np.eye(3))
    return camera


def _axes(camera: Camera) -> NDArray[np.float64]:
    """Return the rows right, up and backwards of a camera."""
    forward, left, up = np.asarray(camera.rotation, np.float64).T
    return np.array((-left, up, -forward))


def _projection(camera: Camera) -> NDArray[np.float64]:
    """Return the rows of clip coordinates x, y, z, w of right, up, backwards; y points down, for rows from the top."""
    across = tan(radians(camera.fov) / 2)
    rows = np.zeros((4, 3))
    rows[0, 0] = 1 / across
    rows[1, 1] = -camera.width / camera.height / across
    rows[2, 2] = -(FAR + NEAR) / (FAR - NEAR)
    rows[3, 2] = -1
    return rows


def _clip(camera: Camera) -> NDArray[np.float64]:
    """Return the matrix from positions relative to a camera to clip coordinates."""
    matrix = np.zeros((4, 4))
    matrix[:, :3] = _projection(camera) @ _axes(camera)
    matrix[2, 3] = -2 * FAR * NEAR / (FAR - NEAR)
    return matrix
