"""Props and sensors, which do not move by themselves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from carla_recap.sim.episode import Actor
from carla_recap.sim.physics.plane import PROP
from carla_recap.sim.validation import expect_transform

if TYPE_CHECKING:
    import pymunk

    from carla_recap.sim.geometry import Transform


class Prop(Actor):
    """A static object.

    Attributes:
        body: Its body in the plane; None if it is attached to something, or has no size.
    """

    body: pymunk.Body | None = None

    @property
    def transform(self) -> Transform:
        """A copy of its transform in the world. Setting it moves the prop; an attached one, relative to its parent."""
        return super().transform

    @transform.setter
    def transform(self, value: Transform) -> None:
        self.check()
        expect_transform("the transform", value, of=self)
        self._transform = value.copy()
        if self.body is not None:
            x, y = value.location.x, value.location.y
            self.episode.plane.move(self.body, x, y, np.radians(value.rotation.yaw).item())

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
