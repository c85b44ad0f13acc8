"""The lidars and radars of a rig in a process of their own: others need not wait while rays are cast."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Final, NamedTuple

from carla_recap.errors import RecapWarning
from carla_recap.rendering.process import DRAWING
from carla_recap.scene.models import own_models
from carla_recap.util.child import new_child

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from carla_recap.scene.instances import Instances
    from carla_recap.scene.mesh import Mesh
    from carla_recap.scene.models import Model
    from carla_recap.sensors.rig import SensorSpec
    from carla_recap.util.arrays import Floats, Ids

    Points = dict[str, NDArray[np.void]]

MOMENTS_AHEAD: Final = 3
"""The number of moments that are drawn, and whose rays are cast, while the one before them is used, at most."""
MAX_STEP: Final = 10.0
"""The longest time between two samples for which rays are cast, in s."""
RAYS: Final = ("carla_recap.sensors.ray_sensors", "casts rays", MOMENTS_AHEAD + 1)
"""The arguments of the `Child` that casts rays."""
RAY_KINDS: Final = {"lidar", "semantic_lidar", "radar"}
"""The kinds of sensors that cast rays."""


def processes_for(rig: Iterable[SensorSpec]) -> list[tuple[str, str, int]]:
    """Return the arguments of each `Child` that a rig needs."""
    kinds = {spec.kind for spec in rig}
    return [DRAWING] * ("camera" in kinds) + [RAYS] * (not kinds.isdisjoint(RAY_KINDS))


class RaySetup(NamedTuple):
    """The first request to the process: what the rays meet, and the sensors."""

    tiles: Sequence[Mesh]
    models: Sequence[Model]  # of users, behind those of this package
    specs: Sequence[SensorSpec]


class RayMoment(NamedTuple):
    """What rays are cast in, and for which sensors."""

    due: Sequence[tuple[str, Floats]]  # the ids of sensors, and their poses in m and degrees, right-handed
    step: float  # the seconds since the moment before
    instances: Instances  # what is seen of the actors
    ids: Ids  # of actors, ascending
    velocities: Floats | None  # of these in m/s, right-handed, (ids, 3); None without a radar
    velocity: Floats | None  # that of the carrier; None without a radar


class RayProcess:
    """The process that casts rays, for a town and sensors; `wait` has to be called before moments begin."""

    def __init__(self, tiles: Sequence[Mesh], specs: Sequence[SensorSpec]) -> None:
        self._child = new_child(*RAYS)
        self._child.send(RaySetup(tiles, own_models(), specs))

    @property
    def pid(self) -> int:
        """The id of the process."""
        return self._child.process.pid

    def wait(self) -> None:
        """Wait until the process can cast rays.

        Raises:
            MissingExtra: Embree is not installed.
            ChildEnded: The process has ended.
        """
        self._child.receive()

    def begin(self, moment: RayMoment) -> None:
        """Have the rays of a moment cast."""
        self._child.send(moment)

    def points(self) -> Points:
        """Return what sensors measure by their ids, at the first moment that was begun and not asked for.

        Warns:
            RecapWarning: A sensor casts fewer rays than it should.
        """
        found, said = self._child.receive()
        for text in said:
            warnings.warn(text, RecapWarning, stacklevel=2)
        return {id: points.copy() for id, points in found.items()}

    def close(self) -> None:
        """End the process."""
        self._child.close()
