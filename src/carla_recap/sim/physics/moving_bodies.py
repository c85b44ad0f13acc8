"""The part that vehicles and walkers share: their poses and velocities, and their bodies in the plane."""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.errors import MissingExtra
from carla_recap.model.motion import GRAVITY
from carla_recap.sim.columns import StructOfArrays, column
from carla_recap.util.arrays import Floats

try:
    import pymunk
except ModuleNotFoundError:
    raise MissingExtra("the simulator", "sim") from None

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.physics.plane import Plane

Height = Callable[[Floats, Floats, Floats], Floats]
"""Returns the height of the road at x and y of what stands there at z."""
_REACH: Final = 3.0  # m: actors that are farther from the road are not put on it


class MovingBodies(StructOfArrays):
    """Actors with bodies that move; row i of each array belongs to `actors[i]`.

    Attributes:
        actors: The vehicles or walkers, in the order of spawning; physics uses their `id` alone.
        bodies: Their bodies in the plane.
    """

    id: NDArray[np.int64] = column(np.int64(0))  # the ids of the actors
    body_id: NDArray[np.uintp] = column(np.uintp(0))  # the ids of the bodies
    position: Floats = column(np.zeros(3))  # the positions in m, (n, 3)
    rotation: Floats = column(np.zeros(3))  # pitch, yaw and roll in degrees, (n, 3)
    velocity: Floats = column(np.zeros(3))  # the velocities in m/s, (n, 3)
    angular_velocity: Floats = column(np.zeros(3))  # the rates of turn in degrees/s about x, y and z, (n, 3)
    acceleration: Floats = column(np.zeros(3))  # the accelerations in m/s², (n, 3)
    half_length: Floats = column(0.0)  # half of the length of the box in m
    half_width: Floats = column(0.0)  # half of the width of the box in m
    bottom: Floats = column(0.0)  # the height of the bottom of the box above the origin, in m
    top: Floats = column(0.0)  # the height of the top of the box above the origin, in m
    mass: Floats = column(1.0)  # the masses in kg
    moment: Floats = column(inf)  # the moments of inertia in kg m²; those of walkers are infinite
    simulated: NDArray[np.bool_] = column(True)  # whether forces move it; else it stays where it is placed
    unsettled: NDArray[np.bool_] = column(True)  # whether it was placed or falls, and is not on the ground yet
    weightless: NDArray[np.bool_] = column(False)  # whether there is no gravity for it: it keeps its height
    carried: NDArray[np.bool_] = column(False)  # whether it is attached to another actor and moves with it

    def __init__(self, plane: Plane, height: Height) -> None:
        super().__init__()
        self.plane = plane
        self.actors: list[Any] = []
        self.bodies: list[pymunk.Body] = []
        self._height = height
        self._rows: dict[int, int] = {}
        self._before = self.velocity

    @property
    def yaw(self) -> Floats:
        """The yaws in degrees, (n,), as a view."""
        return self.rotation[:, 1]

    def row(self, actor: int) -> int:
        """Return the row of an actor."""
        row = self._rows[actor]
        if row >= self.count or self.actors[row].id != actor:  # rows before it have been removed
            row = self._rows[actor] = np.flatnonzero(self.id == actor).item()
        return row

    def add(self, actor: Any, body: pymunk.Body, **values: Any) -> int:
        """Add an actor with values of its columns, and return its row."""
        row = self.append_row(id=actor.id, body_id=body.id, **values)
        self.actors.append(actor)
        self.bodies.append(body)
        self._rows[actor.id] = row
        self._move_body(row)
        return row

    def remove(self, actor: int) -> pymunk.Body:
        """Remove an actor, and return the body that it had."""
        row = self.row(actor)
        body = self.bodies[row]
        self.plane.remove(body)
        self.remove_row(row)
        del self.actors[row], self.bodies[row], self._rows[actor]
        return body

    def place(self, row: int, position: tuple[float, float, float], rotation: tuple[float, float, float]) -> None:
        """Move an actor to a position in m, with pitch, yaw and roll in degrees."""
        self.position[row] = position
        self.rotation[row] = rotation
        self.unsettled[row] = True
        self._move_body(row)

    def set_simulated(self, row: int, simulated: bool) -> None:
        """Let forces move an actor, or let it stay where it is placed."""
        body = self.bodies[row]
        if self.simulated[row] and not simulated:
            self.set_velocity(row, 0.0, 0.0, 0.0)
            self.angular_velocity[row] = 0.0
        self.simulated[row] = simulated
        self.acceleration[row], self.angular_velocity[row, :2] = 0.0, 0.0  # a replay may have set them
        if simulated:
            body.body_type = pymunk.Body.DYNAMIC
            body.mass, body.moment = self.mass[row].item(), self.moment[row].item()
        else:
            body.body_type = pymunk.Body.KINEMATIC
            body.velocity, body.angular_velocity = (0.0, 0.0), 0.0
            pymunk.Body.update_position(body, 0.0)  # clears what is left of pushing overlapping bodies apart

    def set_velocity(self, row: int, x: float, y: float, z: float) -> None:
        """Set the velocity of an actor in m/s."""
        self.velocity[row] = x, y, z

    def set_body_velocities(self, which: NDArray[np.bool_], motions: Floats) -> None:
        """Set the velocities of the bodies of some actors; see `Plane.set_velocities`."""
        if which.any():
            self.plane.set_velocities(self.body_id[which], motions[which])

    def heights(self) -> tuple[Floats, Floats]:
        """Return the z of the lowest and of the highest point of each actor in m, as if it stood upright, (n,) each."""
        z = self.position[:, 2]
        return z + self.bottom, z + self.top

    def _stand(self, rows: NDArray[np.intp], road: Floats, seconds: float) -> NDArray[np.bool_]:
        """Put actors on the road, where it is near, and return which are there; one far above falls, one far below stays.

        `road` is the z of their origins on the road, (rows,).
        """
        z = self.position[rows, 2]
        above = z - road
        weightless = self.weightless[rows]
        near: NDArray[np.bool_] = (np.abs(above) <= _REACH) & ~weightless
        if near.all():
            self.position[rows, 2] = road
            self.velocity[rows, 2] = np.where(self.unsettled[rows], 0.0, (road - z) / seconds)
            self.unsettled[rows] = False
            return near
        falls = (above > _REACH) & ~weightless
        speed = np.where(falls, self.velocity[rows, 2] - GRAVITY * seconds, 0.0)
        fallen = np.maximum(road, z + speed * seconds)
        self.position[rows, 2] = np.where(near, road, np.where(falls, fallen, z))
        self.velocity[rows, 2] = np.where(near & ~self.unsettled[rows], (road - z) / seconds, speed)
        self.unsettled[rows] = falls
        return near

    def _accelerate(self, seconds: float) -> None:
        """Set the accelerations of those that forces move, at the end of a tick; a replay sets those that it moves."""
        free = self.simulated
        self.acceleration[free] = (self.velocity[free] - self._before[free]) / seconds

    def _move_body(self, row: int) -> None:
        x, y, _ = self.position[row].tolist()
        self.plane.move(self.bodies[row], x, y, np.radians(self.rotation[row, 1]).item())
