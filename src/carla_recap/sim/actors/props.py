"""Props and sensors, which do not move by themselves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carla_recap.sim.episode import Actor
from carla_recap.sim.physics.plane import PROP

if TYPE_CHECKING:
    import pymunk


class Prop(Actor):
    """A static object.

    Attributes:
        body: Its body in the plane; None if it is attached to something, or has no size.
    """

    body: pymunk.Body | None = None

    def _move_body(self) -> None:
        if self.body is not None:
            place, yaw = self._transform.location, np.radians(self._transform.rotation.yaw).item()
            self.episode.plane.move(self.body, place.x, place.y, yaw)

    def set_collisions(self, enabled: bool = True) -> None:
        """Let it collide with others, or be passed through."""
        self.check()
        if self.body is not None:
            self.episode.plane.set_touching(self.body, PROP, enabled)

    def _remove_body(self) -> None:
        if self.body is not None:
            del self.episode.owners[self.body.id]
            self.episode.plane.remove(self.body)


class Sensor(Actor):
    """A sensor: a collision sensor has the collisions of its parent recorded, the others do nothing by themselves."""
