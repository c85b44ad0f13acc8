"""All walkers as a struct of arrays: their controls, and whether a car has thrown them down."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.columns import column
from carla_recap.sim.physics.moving_bodies import MovingBodies
from carla_recap.sim.physics.plane import WALKER

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.physics.moving_bodies import Height
    from carla_recap.sim.physics.plane import Plane
    from carla_recap.util.arrays import Floats

_STILL: Final = 0.01  # m/s
_SLIDING: Final = 5.0  # m/s²: so fast a fallen walker comes to rest
_FLAT: Final = 90.0  # degrees: the pitch of one that lies on its back
FALL: Final = 1.5  # m/s: a push that changes the velocity by more throws a walker down


class Walkers(MovingBodies):
    """The walkers; row i of each array belongs to `actors[i]`."""

    direction: Floats = column(np.array((1.0, 0.0, 0.0)))  # the direction of the control, of length 1, (n, 3)
    speed: Floats = column(0.0)  # the speed of the control in m/s
    jump: NDArray[np.bool_] = column(False)  # the jump flag of the control
    fallen: NDArray[np.bool_] = column(False)  # whether a vehicle has thrown it down; it does not get up
    half_height: Floats = column(0.9)
    """The height of its origin above the ground, in m: half of the box's, or of its depth where it lies."""
    slide: Floats = column(np.zeros(2))  # the velocity of its body, in m/s, (n, 2)
    destination: Floats = column(np.full(3, np.nan))
    """Where it walks by itself, in m, (n, 3); NaN where its control says where it walks."""

    def __init__(self, plane: Plane, height: Height) -> None:
        super().__init__(plane, height)
        self._moved = np.empty(0, np.bool_)
        self._walking = np.empty(0, np.bool_)

    @property
    def has_destination(self) -> NDArray[np.bool_]:
        """Whether each walks by itself, (n,)."""
        return ~np.isnan(self.destination[:, 0])

    def begin_tick(self, seconds: float) -> bool:
        """See `Vehicles.begin_tick`."""
        self._before = self.velocity.copy()
        self._walking = self.simulated & ~self.fallen & (self.speed > _STILL)
        moving = self._walking | self.slide.any(axis=1) & self.simulated
        self._moved = moving | self.unsettled & self.simulated
        return bool(moving.any())

    def write_velocities(self, seconds: float) -> None:
        """See `Vehicles.write_velocities`."""
        walking = self._walking & ~self.fallen
        speed = np.hypot(*self.slide.T)
        slower = np.maximum(speed - _SLIDING * seconds, 0) / np.maximum(speed, _STILL)
        slower[~self.fallen] = 0
        velocities = np.where(walking[:, None], self.direction[:, :2] * self.speed[:, None], self.slide * slower[:, None])
        self.set_body_velocities(self._moved, velocities)
        self.slide = velocities

    def read_bodies(self) -> None:
        """See `Vehicles.read_bodies`."""
        states = self.plane.states(self.body_id)
        moving = self.simulated
        self.position[moving, :2] = states[moving, :2]
        self.slide[moving] = states[moving, 3:5]
        self._moved |= self.slide.any(axis=1)

    def place(self, row: int, position: tuple[float, float, float], rotation: tuple[float, float, float]) -> None:
        """See `MovingBodies.place`; one that lies goes on lying."""
        lying = (self.rotation[row, 0].item(), rotation[1], 0.0)
        super().place(row, position, lying if self.fallen[row] else rotation)

    def set_velocity(self, row: int, x: float, y: float, z: float) -> None:
        """See `MovingBodies.set_velocity`."""
        super().set_velocity(row, x, y, z)
        self.slide[row] = x, y

    def fall(self, row: int, push: tuple[float, float] = (0.0, 0.0)) -> None:
        """Throw a walker down: it slides, lies, and touches no others; on its face if the push came from behind."""
        if self.fallen[row]:
            return
        yaw = math.radians(self.rotation[row, 1])
        from_behind = math.cos(yaw) * push[0] + math.sin(yaw) * push[1] > 0
        depth = self.half_length[row]
        self.fallen[row] = True
        self.rotation[row] = (-_FLAT if from_behind else _FLAT), self.rotation[row, 1], 0.0
        self.position[row, 2] -= self.half_height[row] - depth
        self.half_height[row], self.bottom[row], self.top[row] = depth, -depth, depth
        self.unsettled[row] = True
        self.plane.set_touching(self.bodies[row], WALKER, False)

    def end_tick(self, seconds: float) -> None:
        """See `Vehicles.end_tick`."""
        moved = self._moved
        if not moved.any():
            self.acceleration[self.simulated] = 0
            return
        walking = self._walking
        rows = np.flatnonzero(moved)
        x, y, z = self.position[rows].T
        half_height = self.half_height[rows]
        near = self._stand(rows, self._height(x, y, z - half_height) + half_height, seconds)
        self.velocity[rows[near], 2] = 0.0
        self.rotation[walking, 1] = np.degrees(np.arctan2(self.direction[walking, 1], self.direction[walking, 0]))
        self.velocity[moved, :2] = self.slide[moved]
        self._accelerate(seconds)
