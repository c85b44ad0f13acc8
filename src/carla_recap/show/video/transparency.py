"""Actors that are made see-through, so that nothing hides the followed one, nor it what is ahead."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.scene.opacity import SeenBoxes, is_flat, is_near, wanted_opacities

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.rendering.camera import Camera
    from carla_recap.scene.instances import Instances

_FADE: Final = 0.25  # s; the time constant of a change of opacity


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
        if own is None or not np.isfinite(instances.locations[own]).all():
            return {}
        seen = ~is_flat(instances.half_extents.astype(np.float64)) & is_near(instances.locations, camera.location)
        seen[own] = False
        others = np.flatnonzero(seen)
        opacity, other_opacity = wanted_opacities(
            camera.location[None],
            camera.rotation[None],
            _boxes(instances, np.array([own])),
            _boxes(instances, others),
            np.zeros(len(others), np.intp),
        )
        rows, values = np.append(own, others), np.append(opacity, other_opacity)
        return {int(instances.ids[rows[index]]): float(values[index]) for index in np.flatnonzero(values < 1)}


def _boxes(instances: Instances, rows: NDArray[np.intp]) -> SeenBoxes:
    rotations, half_extents = (column[rows].astype(np.float64) for column in (instances.rotations, instances.half_extents))
    return SeenBoxes(instances.locations[rows], rotations, half_extents)


def _index(instances: Instances, id: int | None) -> int | None:
    """Return the index of an actor among instances; None if it is not among them."""
    if id is None:
        return None
    index = int(np.searchsorted(instances.ids, id))
    return index if index < len(instances) and instances.ids[index] == id else None
