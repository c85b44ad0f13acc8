"""The plane in which bodies push each other: pymunk's space. Its x and y are CARLA's, in m; its angles are yaws in radians.

Bodies know nothing of engines and tyres: they are told their velocities before each step, and where these are others after
it, contacts have changed them.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.errors import MissingExtra

try:
    import pymunk
    from pymunk.batch import ArbiterFields, BodyFields, Buffer, get_space_arbiters, get_space_bodies
except ModuleNotFoundError:
    raise MissingExtra("the simulator", "sim") from None

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

VEHICLE, WALKER, PROP, WALL = (1 << bit for bit in range(4))
_MEETS: Final = {  # walkers pass each other, and whatever stands at the roadside
    VEHICLE: VEHICLE | WALKER | PROP | WALL,
    WALKER: VEHICLE | PROP,
    PROP: VEHICLE | WALKER,
    WALL: VEHICLE,
}
_FRICTION: Final = 0.4  # metal on metal, about
_ELASTICITY: Final = 0.1  # cars hardly bounce
_WALL_RADIUS: Final = 0.1  # m
_SLEEPY: Final = 0.5  # s without motion until a body sleeps
# The setters themselves: by way of the attributes, it takes twice as long.
_SET_VELOCITY: Final[Callable[[pymunk.Body, tuple[float, float]], None]] = vars(pymunk.Body)["velocity"].fset
_SET_ANGULAR_VELOCITY: Final[Callable[[pymunk.Body, float], None]] = vars(pymunk.Body)["angular_velocity"].fset
_BODY: Final = (
    BodyFields.BODY_ID | BodyFields.POSITION | BodyFields.ANGLE | BodyFields.VELOCITY | BodyFields.ANGULAR_VELOCITY
)
_CONTACT: Final = ArbiterFields.BODY_A_ID | ArbiterFields.BODY_B_ID | ArbiterFields.TOTAL_IMPULSE | ArbiterFields.POINT_A_1


class Contact(NamedTuple):
    """Two bodies that pushed each other in a step.

    Attributes:
        a: The id of one body.
        b: The id of the other.
        impulse: What a got from b, in N s.
        point: Where, in m.
    """

    a: int
    b: int
    impulse: tuple[float, float]
    point: tuple[float, float]


class Plane:
    """The bodies, and the walls around them.

    Attributes:
        space: pymunk's.
        disturbed: Whether a body came or was put elsewhere since the last step.
    """

    def __init__(self) -> None:
        self.space = pymunk.Space()
        self.space.sleep_time_threshold = _SLEEPY
        self.disturbed = False
        self._bodies = Buffer()
        self._contacts = Buffer()
        self._ids = np.empty(0, np.uintp)
        self._order = np.empty(0, np.intp)
        self._state = np.empty((0, 6))

    def add_box(self, group: int, corners: Iterable[tuple[float, float]], mass: float | None) -> pymunk.Body:
        """A body of convex shape.

        Args:
            group: `VEHICLE` or `PROP`.
            corners: In the axes of the body.
            mass: In kg; None for one that nothing moves.
        """
        points = list(corners)
        body = (
            pymunk.Body(body_type=pymunk.Body.STATIC)
            if mass is None
            else pymunk.Body(mass, pymunk.moment_for_poly(mass, points))
        )
        return self._add(group, body, pymunk.Poly(body, points))

    def add_disc(self, group: int, radius: float, mass: float | None) -> pymunk.Body:
        """A round body that does not turn; see `add_box`."""
        body = pymunk.Body(body_type=pymunk.Body.STATIC) if mass is None else pymunk.Body(mass, math.inf)
        return self._add(group, body, pymunk.Circle(body, radius))

    def add_wall(self, points: Floats) -> None:
        """A line that vehicles do not pass: its corners, (n, 2) in m."""
        body = self.space.static_body
        for start, end in zip(points[:-1].tolist(), points[1:].tolist(), strict=True):
            self._add(WALL, body, pymunk.Segment(body, tuple(start), tuple(end), _WALL_RADIUS))

    def _add(self, group: int, body: pymunk.Body, shape: pymunk.Shape) -> pymunk.Body:
        shape.friction = _FRICTION
        shape.elasticity = _ELASTICITY
        shape.filter = pymunk.ShapeFilter(categories=group, mask=_MEETS[group])
        if body is self.space.static_body:
            self.space.add(shape)
        else:
            self.space.add(body, shape)
        return body

    def remove(self, body: pymunk.Body) -> None:
        """Take a body out."""
        self.space.remove(body, *body.shapes)

    def move(self, body: pymunk.Body, x: float, y: float, yaw: float) -> None:
        """Put a body elsewhere; yaw in radians."""
        body.position = x, y
        body.angle = yaw
        self.space.reindex_shapes_for_body(body)
        self.disturbed = True

    @staticmethod
    def tell(bodies: Iterable[pymunk.Body], motions: Floats) -> None:
        """Tell bodies how fast they are: x and y in m/s, and rad/s, a row for each; walkers do without the last."""
        for body, (x, y, *turning) in zip(bodies, motions.tolist(), strict=True):
            _SET_VELOCITY(body, (x, y))
            if turning:
                _SET_ANGULAR_VELOCITY(body, turning[0])

    def set_touching(self, body: pymunk.Body, group: int, touching: bool) -> None:
        """Say whether a body meets others at all."""
        mask = _MEETS[group] if touching else 0
        for shape in body.shapes:
            shape.filter = pymunk.ShapeFilter(categories=group if touching else 0, mask=mask)

    def overlapping(self, corners: Iterable[tuple[float, float]], x: float, y: float, yaw: float) -> list[int]:
        """The ids of the bodies that a convex shape at a place would overlap."""
        probe = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        probe.position = x, y
        probe.angle = yaw
        shape = pymunk.Poly(probe, list(corners))
        shape.filter = pymunk.ShapeFilter(mask=VEHICLE | WALKER | PROP)
        found = [info.shape for info in self.space.shape_query(shape)]
        return sorted({other.body.id for other in found if other is not None and other.body is not None})

    def step(self, seconds: float) -> list[Contact]:
        """Move all bodies, and take over how they move by then; returns who pushed whom."""
        self.space.step(seconds)
        self.disturbed = False
        self._read()
        self._contacts.clear()
        get_space_arbiters(self.space, _CONTACT, self._contacts)
        ids = np.frombuffer(self._contacts.int_buf(), np.uintp).reshape(-1, 2)
        if not len(ids):
            return []
        values = np.frombuffer(self._contacts.float_buf()).reshape(len(ids), -1)
        return [
            Contact(a, b, (value[0], value[1]), (value[2], value[3]))
            for (a, b), value in zip(ids.tolist(), values.tolist(), strict=True)
        ]

    def _read(self) -> None:
        """Take over how all bodies move by now."""
        self._bodies.clear()
        get_space_bodies(self.space, _BODY, self._bodies)
        ids = np.frombuffer(self._bodies.int_buf(), np.uintp)
        if not np.array_equal(ids, self._ids):
            self._ids = ids.copy()
            self._order = np.argsort(ids)
        self._state = np.frombuffer(self._bodies.float_buf()).reshape(len(ids), -1).copy()

    def states(self, ids: NDArray[np.uintp]) -> Floats:
        """How some bodies move, as the latest step left them: x, y, yaw, velocity x, y in m/s, rad/s, (n, 6)."""
        found = self._order[np.searchsorted(self._ids, ids, sorter=self._order)]
        states: Floats = self._state[found]
        return states
