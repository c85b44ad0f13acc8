"""Walkers that lie on the ground after a vehicle has knocked them down, although their recorded poses are upright."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from carla_recap.scene.appearance import look_of_present
from carla_recap.scene.collisions import FallenWalkers
from carla_recap.show.rerun import paths

if TYPE_CHECKING:
    from carla_recap.replay import SceneBatch
    from carla_recap.show.rerun.stream import Stream, TimeColumns


class FallenWriter:
    """Lays down the models of walkers; the transforms of their entities stay those that are recorded.

    Args:
        stream: The stream.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._walkers = FallenWalkers()

    def write(self, batch: SceneBatch, times: TimeColumns) -> None:
        """Write scenes."""
        for row, id, fall in self._walkers.changes(batch):
            look = look_of_present(batch.actors[id]) if id in batch.actors else None
            if look is None:
                continue
            offset, matrix = np.zeros(3), np.eye(3)
            if fall is not None:
                matrix = fall.matrix
                offset = fall.offset - matrix @ look.center
            self._stream.log(paths.actor(id), times.point(row), rr.InstancePoses3D(translations=[offset], mat3x3=[matrix]))
