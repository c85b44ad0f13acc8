"""Actors that are made see-through, so that nothing hides the followed one, nor it what is ahead."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.rendering.camera import Camera
    from carla_recap.scene.instances import Instances

    Floats = NDArray[np.float64]

_FADE: Final = 0.25  # s; the time constant of a change of opacity
_SEE_THROUGH: Final = 0.4
_IN_THE_WAY: Final = 0.25  # the opacity of an actor between the camera and the followed one
_HIDDEN: Final = 0.6  # the part of an actor's box that is hidden, from which on the followed actor is made see-through
_REACH: Final = 60.0  # m; actors farther away are small
_FLAT: Final = 0.3  # m; lower boxes, such as debris that is driven over, hide nothing and need not be seen
_CORNERS: Final = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)


class Transparency:
    """Makes actors see-through that hide the followed one, and the followed one where it hides an actor."""

    def __init__(self) -> None:
        self._opacity: dict[int, float] = {}
        self._time = -math.inf

    def apply(self, camera: Camera, instances: Instances, followed: int | None, seconds: float) -> Instances:
        """Return instances with their opacities for a camera.

        Args:
            camera: The camera.
            instances: The instances.
            followed: The followed actor.
            seconds: The seconds of the video since the last picture.
        """
        wanted = self._wanted(camera, instances, followed)
        share = -math.expm1(-seconds / _FADE)
        for id in {*self._opacity, *wanted}:
            now, goal = self._opacity.get(id, 1.0), wanted.get(id, 1.0)
            self._opacity[id] = now + share * (goal - now)
        self._opacity = {id: value for id, value in self._opacity.items() if id in wanted or value < 0.99}
        changed = [(index, value) for id, value in self._opacity.items() if (index := _index(instances, id)) is not None]
        if not changed:
            return instances
        opacity = instances.opacity.copy()
        for index, value in changed:
            opacity[index] = min(opacity[index], value)
        columns = {name: column for name, column in vars(instances).items() if name != "opacity"}
        return type(instances)(**columns, opacity=opacity)

    def _wanted(self, camera: Camera, instances: Instances, followed: int | None) -> dict[int, float]:
        """Return the opacities of the actors that should be see-through."""
        own = _index(instances, followed)
        if own is None:
            return {}
        with np.errstate(invalid="ignore", over="ignore"):
            offsets = instances.locations - camera.location
            high = (2 * instances.half_extents[:, 2] >= _FLAT) | (instances.ids == followed)
            near = np.flatnonzero(((offsets**2).sum(axis=1) < _REACH**2) & high)
        if own not in near:
            return {}
        boxes = (instances.half_extents[near, None] * _CORNERS) @ np.swapaxes(instances.rotations[near], 1, 2)
        points = camera.project((boxes + instances.locations[near, None]).reshape(-1, 3)).reshape(len(near), 8, 3)
        depth = points[..., 2].min(axis=1)
        lower, upper = points[..., :2].min(axis=1), points[..., :2].max(axis=1)
        row = int(np.flatnonzero(near == own)[0])
        if not depth[row] > 0:
            return {}
        size = np.minimum(upper, upper[row]) - np.maximum(lower, lower[row])
        common = np.where((size > 0).all(axis=1), size.prod(axis=1), 0.0)
        wanted: dict[int, float] = {}
        for index in np.flatnonzero((common > 0) | (depth <= 0)).tolist():
            id = int(instances.ids[near[index]])
            if index == row:
                continue
            if depth[index] > depth[row] and common[index] > _HIDDEN * (upper[index] - lower[index]).prod():
                wanted[int(instances.ids[own])] = _SEE_THROUGH
            elif depth[index] < depth[row] and _is_between(points[index], common[index], (upper - lower)[row].prod()):
                wanted[id] = _IN_THE_WAY
        return wanted


def _is_between(points: Floats, common: float, area: float) -> bool:
    """Return whether a box that is nearer than the followed actor hides it, or has the camera inside.

    Args:
        points: The corners of the box as pixels and depths.
        common: The pixels that both boxes cover.
        area: The pixels that the box of the followed actor covers.
    """
    depths = points[:, 2]
    return bool((depths > 0).any()) if depths.min() <= 0 else common > 0.25 * area


def _index(instances: Instances, id: int | None) -> int | None:
    """Return the index of an actor among instances; None if it is not among them."""
    if id is None:
        return None
    index = int(np.searchsorted(instances.ids, id))
    return index if index < len(instances) and instances.ids[index] == id else None
