"""The plane in which bodies push each other: pymunk's space. Its x and y are CARLA's, in m; its angles are yaws in radians.

Bodies have no engines and tyres: their velocities are set before each step, and where these are different after it,
contacts have changed them. A body also has a height band, the range of z that it fills: bodies touch only where their bands
overlap, so that cars on a bridge and below it pass each other.
"""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.errors import MissingExtra

try:
    import pymunk
    from pymunk.batch import ArbiterFields, BodyFields, Buffer, get_space_arbiters, get_space_bodies, set_space_bodies
except ModuleNotFoundError:
    raise MissingExtra("the simulator", "sim") from None

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import NDArray

    from carla_recap.util.arrays import Floats

    Heights = tuple[float, float]
    """The lowest and the highest z of something, in m."""

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
_CLEARANCE: Final = 0.2  # m: bodies whose heights overlap by less pass over each other, as a car does over debris
_BELOW_WALL, _ABOVE_WALL = 1.0, 3.0  # m: how far a barrier reaches below and above its line
_UNBOUNDED: Final = (-math.inf, math.inf)
_MOTION: Final = BodyFields.BODY_ID | BodyFields.VELOCITY | BodyFields.ANGULAR_VELOCITY
_BODY: Final = _MOTION | BodyFields.POSITION | BodyFields.ANGLE
_CONTACT: Final = ArbiterFields.BODY_A_ID | ArbiterFields.BODY_B_ID | ArbiterFields.TOTAL_IMPULSE | ArbiterFields.POINT_A_1


class BodyContact(NamedTuple):
    """A contact of two bodies in a step, by their ids: the impulse that b gave to a in N s, and the point in m."""

    a: int
    b: int
    impulse: tuple[float, float]
    point: tuple[float, float]


class _Buffers(threading.local):
    """What pymunk reads into: the planes of a thread share it, since pymunk never frees it."""

    def __init__(self) -> None:
        self.bodies = Buffer()
        self.contacts = Buffer()


_buffers: Final = _Buffers()


class Plane:
    """The bodies of all actors, and the barriers of the town.

    Attributes:
        space: The space of pymunk.
        disturbed: Whether a body was added or moved since the last step.
    """

    def __init__(self) -> None:
        self.space = pymunk.Space()
        self.disturbed = False
        self._fixed_heights: dict[pymunk.Shape, Heights] = {}  # of barriers
        self._heights: dict[pymunk.Shape, Callable[[], Heights]] = {}
        self._known_heights: dict[pymunk.Shape, Heights] = {}  # of this step
        self.space.on_collision(None, None, pre_solve=self._check_heights)
        self._ids = np.empty(0, np.uintp)
        self._order = np.empty(0, np.intp)
        self._state = np.empty((0, 6))

    def add_box(self, group: int, corners: Iterable[tuple[float, float]], mass: float | None) -> pymunk.Body:
        """Add a body of convex shape, with corners in its axes in m and a mass in kg; one without a mass is static."""
        points = list(corners)
        body = (
            pymunk.Body(body_type=pymunk.Body.STATIC)
            if mass is None
            else pymunk.Body(mass, pymunk.moment_for_poly(mass, points))
        )
        return self._add(group, body, pymunk.Poly(body, points))

    def add_disc(self, group: int, radius: float, mass: float | None) -> pymunk.Body:
        """Add a round body that does not turn, and return it; see `add_box`."""
        body = pymunk.Body(body_type=pymunk.Body.STATIC) if mass is None else pymunk.Body(mass, math.inf)
        return self._add(group, body, pymunk.Circle(body, radius))

    def add_wall(self, points: Floats) -> None:
        """Add a barrier that vehicles do not pass: the points of its line, (n, 3) in m."""
        body = self.space.static_body
        for start, end in zip(points[:-1].tolist(), points[1:].tolist(), strict=True):
            segment = pymunk.Segment(body, tuple(start[:2]), tuple(end[:2]), _WALL_RADIUS)
            self._add(WALL, body, segment)
            band = min(start[2], end[2]) - _BELOW_WALL, max(start[2], end[2]) + _ABOVE_WALL
            self._fixed_heights[segment] = band

    def set_heights(self, body: pymunk.Body, heights: Callable[[], Heights]) -> None:
        """Set what returns the height band of a body; without it, a body touches others at any height."""
        for shape in body.shapes:
            self._heights[shape] = heights

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
        """Remove a body."""
        for shape in body.shapes:
            self._heights.pop(shape, None)
        self._known_heights.clear()
        self.space.remove(body, *body.shapes)

    def move(self, body: pymunk.Body, x: float, y: float, yaw: float) -> None:
        """Move a body to a position in m, with a yaw in radians."""
        body.position = x, y
        body.angle = yaw
        self.space.reindex_shapes_for_body(body)
        self.disturbed = True

    def set_velocities(self, ids: NDArray[np.uintp], motions: Floats) -> None:
        """Set the velocities of bodies by their ids: x and y in m/s and rad/s, a row for each; walkers have no third column.

        No body may sleep, since this would wake it while Chipmunk goes through its lists.
        """
        known = self._get(_MOTION)
        known[self._find(ids), : motions.shape[1]] = motions
        set_space_bodies(self.space, _MOTION, _buffers.bodies)

    def set_touching(self, body: pymunk.Body, group: int, touching: bool) -> None:
        """Switch the contacts of a body with others on or off."""
        mask = _MEETS[group] if touching else 0
        for shape in body.shapes:
            shape.filter = pymunk.ShapeFilter(categories=group if touching else 0, mask=mask)

    def overlapping(
        self, corners: Iterable[tuple[float, float]], x: float, y: float, yaw: float, heights: Heights = _UNBOUNDED
    ) -> list[int]:
        """Return the ids of the bodies that a convex shape of some height band would overlap."""
        probe = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        probe.position = x, y
        probe.angle = yaw
        shape = pymunk.Poly(probe, list(corners))
        shape.filter = pymunk.ShapeFilter(mask=VEHICLE | WALKER | PROP)
        found = [info.shape for info in self.space.shape_query(shape)]
        self._known_heights.clear()
        return sorted(
            {
                other.body.id
                for other in found
                if other is not None and other.body is not None and _overlap(heights, self._heights_of(other))
            }
        )

    def first_wall(
        self, start: tuple[float, float, float], end: tuple[float, float, float], radius: float
    ) -> tuple[int, float] | None:
        """Return the body of the first barrier or pole that a thick line meets, and the share of the line before it."""
        found = []
        for hit in self.space.segment_query(start[:2], end[:2], radius, pymunk.ShapeFilter(mask=WALL)):
            if hit.shape is not None and hit.shape.body is not None:
                z = start[2] + hit.alpha * (end[2] - start[2])
                lowest, highest = self._heights_of(hit.shape)
                if lowest - radius <= z <= highest + radius:
                    found.append((hit.alpha, hit.shape.body.id))
        alpha, body = min(found, default=(0.0, 0))
        return (body, alpha) if found else None

    def step(self, seconds: float) -> list[BodyContact]:
        """Move all bodies, read their states, and return their contacts."""
        self._known_heights.clear()
        self.space.step(seconds)
        self.disturbed = False
        self._state = self._get(_BODY).copy()
        _buffers.contacts.clear()
        get_space_arbiters(self.space, _CONTACT, _buffers.contacts)
        ids = np.frombuffer(_buffers.contacts.int_buf(), np.uintp).reshape(-1, 2)
        if not len(ids):
            return []
        values = np.frombuffer(_buffers.contacts.float_buf()).reshape(len(ids), -1)
        return [
            BodyContact(a, b, (value[0], value[1]), (value[2], value[3]))
            for (a, b), value in zip(ids.tolist(), values.tolist(), strict=True)
        ]

    def _check_heights(self, arbiter: pymunk.Arbiter, _space: pymunk.Space, _data: Any) -> None:
        """Let two bodies touch only where their height bands overlap."""
        one, other = arbiter.shapes
        arbiter.process_collision = _overlap(self._heights_of(one), self._heights_of(other))

    def _heights_of(self, shape: pymunk.Shape) -> Heights:
        band = self._known_heights.get(shape)
        if band is None:
            heights = self._heights.get(shape)
            band = self._fixed_heights.get(shape, _UNBOUNDED) if heights is None else heights()
            self._known_heights[shape] = band
        return band

    def _get(self, fields: BodyFields) -> Floats:
        """Return the buffer of some fields of all bodies, a row for each."""
        _buffers.bodies.clear()
        get_space_bodies(self.space, fields, _buffers.bodies)
        ids = np.frombuffer(_buffers.bodies.int_buf(), np.uintp)
        if not np.array_equal(ids, self._ids):
            self._ids = ids.copy()
            self._order = np.argsort(ids)
        return np.frombuffer(_buffers.bodies.float_buf()).reshape(len(ids), -1)

    def _find(self, ids: NDArray[np.uintp]) -> NDArray[np.intp]:
        """Return the rows of bodies in the latest buffer."""
        found: NDArray[np.intp] = self._order[np.searchsorted(self._ids, ids, sorter=self._order)]
        return found

    def states(self, ids: NDArray[np.uintp]) -> Floats:
        """Return the states of some bodies after the latest step: x, y, yaw, velocity x, y in m/s, rad/s, (n, 6)."""
        states: Floats = self._state[self._find(ids)]
        return states


def _overlap(one: Heights, other: Heights) -> bool:
    return min(one[1], other[1]) - max(one[0], other[0]) > _CLEARANCE
