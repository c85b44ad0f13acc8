"""All walkers as a struct of arrays: where they are told to walk, and whether a car has thrown them down."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np

from carla_recap.sim.physics.movers import Movers
from carla_recap.sim.physics.plane import WALKER

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.physics.movers import Floats, Height
    from carla_recap.sim.physics.plane import Plane

_STILL: Final = 0.01  # m/s
_SLIDING: Final = 5.0  # m/s²: so fast a fallen walker comes to rest
_FLAT: Final = 90.0  # degrees: the pitch of one that lies on its back
FALL: Final = 1.5  # m/s: a push that changes the velocity by more throws a walker down


class Walkers(Movers):
    """The walkers; row i of each array belongs to `actors[i]`.

    Attributes:
        direction: Where each is told to walk, of length 1, (n, 3).
        speed: How fast each is told to walk, in m/s.
        jump: Whether each is told to jump.
        fallen: Whether a vehicle has thrown it down; it does not get up.
        half_height: The height of its origin above the ground, in m: half of the box's, or of its depth where it lies.
        drift: The velocity of its body, in m/s, (n, 2).
    """

    COLUMNS: ClassVar[dict[str, Any]] = {
        **Movers.COLUMNS,
        "direction": np.array((1.0, 0.0, 0.0)),
        "speed": 0.0,
        "jump": False,
        "fallen": False,
        "half_height": 0.9,
        "drift": np.zeros(2),
    }
    direction: Floats
    speed: Floats
    jump: NDArray[np.bool_]
    fallen: NDArray[np.bool_]
    half_height: Floats
    drift: Floats

    def __init__(self, plane: Plane, height: Height) -> None:
        super().__init__(plane, height)
        self._moved = np.empty(0, np.bool_)
        self._walking = np.empty(0, np.bool_)

    def begin(self, seconds: float) -> bool:
        """See `Movers.begin`."""
        self._before = self.velocity.copy()
        self._walking = self.simulated & ~self.fallen & (self.speed > _STILL)
        moving = self._walking | self.drift.any(axis=1) & self.simulated
        self._moved = moving | self.unsettled & self.simulated
        return bool(moving.any())

    def push(self, seconds: float) -> None:
        """See `Movers.push`."""
        walking = self._walking & ~self.fallen
        drift = np.hypot(*self.drift.T)
        slower = np.maximum(drift - _SLIDING * seconds, 0) / np.maximum(drift, _STILL)
        slower[~self.fallen] = 0
        told = np.where(walking[:, None], self.direction[:, :2] * self.speed[:, None], self.drift * slower[:, None])
        self.tell(self._moved, told)
        self.drift = told

    def pull(self) -> None:
        """See `Movers.pull`."""
        states = self.plane.states(self.body_id)
        moving = self.simulated
        self.position[moving, :2] = states[moving, :2]
        self.drift[moving] = states[moving, 3:5]
        self._moved |= self.drift.any(axis=1)

    def set_velocity(self, row: int, x: float, y: float, z: float) -> None:
        """See `Movers.set_velocity`."""
        super().set_velocity(row, x, y, z)
        self.drift[row] = x, y

    def _moment(self, row: int) -> float:
        return math.inf

    def fall(self, row: int, push: tuple[float, float] = (0.0, 0.0)) -> None:
        """Throw a walker down: it slides, lies, and touches no others.

        Args:
            row: Its row.
            push: The direction of the push: it falls on its face if that came from behind, else on its back.
        """
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

    def end(self, seconds: float) -> None:
        """See `Movers.end`."""
        moved = self._moved
        if not moved.any():
            self.acceleration[:] = 0
            return
        walking = self._walking
        rows = np.flatnonzero(moved)
        x, y, z = self.position[rows].T
        half_height = self.half_height[rows]
        near = self._stand(rows, self._height(x, y, z - half_height) + half_height, seconds)
        self.velocity[rows[near], 2] = 0.0
        self.rotation[walking, 1] = np.degrees(np.arctan2(self.direction[walking, 1], self.direction[walking, 0]))
        self.velocity[moved, :2] = self.drift[moved]
        self.acceleration = (self.velocity - self._before) / seconds
