"""Author `crossing.log`, 54 seconds at a crossing with traffic lights: `python samples/make_crossing.py [DESTINATION]`.

Everything is made up: no simulator had a part in it. Each actor follows a polyline, rounded at its corners, at speeds
that are given for a few moments and go straight between them. Collisions are not staged: they are recorded where the
boxes of two actors overlap. The scene is in metres and seconds, in CARLA's axes (x forward, y right) with the crossing
at the origin, a point being the complex number x + y j; records are in CARLA's units. A second run gives the same bytes.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap import ActorKind, Attribute, Spawn, create_recording

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Reals = NDArray[np.float64]
    Points = NDArray[np.complex128]

DATE: Final = 1_767_261_600  # 2026-01-01 10:00 UTC
RATE: Final = 10  # frames per second
FRAMES: Final = 54 * RATE + 1
END: Final = 60.0  # later than the last frame: whoever has a speed then stays
FINE: Final = 100  # steps per second in which speeds add up to ways

BLUEPRINTS: Final = {  # index in the blueprint library, half extents
    "vehicle.tesla.model3": (31, (2.396, 1.082, 0.744)),
    "vehicle.audi.a2": (8, (1.853, 0.895, 0.777)),
    "vehicle.mercedes.sprinter": (22, (2.958, 0.994, 1.280)),
    "vehicle.nissan.micra": (26, (1.817, 0.923, 0.751)),
    "vehicle.toyota.prius": (33, (2.257, 1.003, 0.762)),
    "vehicle.bh.crossbike": (11, (0.744, 0.430, 0.893)),
    "walker.pedestrian.0004": (74, (0.188, 0.188, 0.930)),
    "walker.pedestrian.0015": (85, (0.188, 0.188, 0.930)),
    "static.prop.busstop": (131, (1.905, 0.965, 1.360)),
    "static.prop.barrel": (118, (0.283, 0.283, 0.447)),
    "sensor.other.collision": (160, (0.0, 0.0, 0.0)),
}
RED, YELLOW, GREEN = range(3)
GREEN_TIME, YELLOW_TIME, RED_TIME = 10, 3, 17
POSITION, LOW_BEAM, BRAKE, RIGHT, LEFT = 1 << 0, 1 << 1, 1 << 3, 1 << 4, 1 << 5  # vehicle lights
HAZARD: Final = RIGHT | LEFT
BOOL, INT, STRING = 0, 1, 3  # types of attributes

SPECTATOR: Final = 1
PROPS: Final = {10: ("static.prop.busstop", -24 + 6.5j, -90.0), 11: ("static.prop.barrel", 33 - 4.2j, 0.0)}
SIGNALS: Final = {20: (1 + 0j, 2), 21: (-1 + 0j, 2), 22: (1j, 17), 23: (-1j, 17)}  # for whom; when it goes green
HERO, LEAD, VAN, TURNING, STRAIGHT, BICYCLE, WALKER_WEST, WALKER_SOUTH = 100, 101, 102, 103, 104, 105, 110, 111
SENSORS: Final = {200: (HERO, 0.5), 201: (BICYCLE, 10.0)}  # parent; when it is attached


def rounded(reach: float, *corners: complex) -> Points:
    """A polyline whose corners are Bézier curves that begin and end at a distance from the corner."""
    steps = np.linspace(0, 1, 100)
    pieces = [np.array(corners[:1])]
    for before, corner, after in zip(corners, corners[1:], corners[2:], strict=False):
        start = corner + reach * (before - corner) / abs(before - corner)
        end = corner + reach * (after - corner) / abs(after - corner)
        pieces.append((1 - steps) ** 2 * start + 2 * steps * (1 - steps) * corner + steps**2 * end)
    return np.concatenate([*pieces, corners[-1:]])


@dataclass(frozen=True)
class Mover:
    """Somebody who moves, from the first moment of `speeds` to the last one; values per frame of the whole recording.

    Attributes:
        id: The actor.
        type_id: Its blueprint.
        path: Where it goes.
        speeds: Pairs of a moment and the speed then.
        role_name: Its role.
        blinks: Since when it blinks, and which lights.
    """

    id: int
    type_id: str
    path: Points
    speeds: tuple[tuple[float, float], ...]
    role_name: str = "autopilot"
    blinks: tuple[float, int] = (END, 0)

    @property
    def kind(self) -> ActorKind:
        """Vehicle or walker."""
        return ActorKind.VEHICLE if self.type_id.startswith("vehicle.") else ActorKind.WALKER

    @property
    def half(self) -> tuple[float, float, float]:
        """The half extents of its box."""
        return BLUEPRINTS[self.type_id][1]

    def is_there(self, time: float) -> bool:
        """Whether it exists."""
        return self.speeds[0][0] <= time < self.speeds[-1][0]

    @cached_property
    def speed(self) -> Reals:
        """Its speed."""
        return self._fine_speed[::FINE // RATE]

    @cached_property
    def place(self) -> Points:
        """Where it is."""
        return self._along(self._way)

    @cached_property
    def heading(self) -> Reals:
        """Where it looks, in radians: along the path, from half a metre behind to half a metre ahead."""
        return np.unwrap(np.angle(self._along(self._way + 0.5) - self._along(self._way - 0.5)))

    @cached_property
    def turn_rate(self) -> Reals:
        """How fast it turns, in radians per second."""
        return np.gradient(self.heading) * RATE

    @cached_property
    def acceleration(self) -> Reals:
        """Change of speed until the next frame."""
        return np.diff(self.speed, append=self.speed[-1]) * RATE

    @cached_property
    def box(self) -> Points:
        """The corners of its box, four per frame."""
        x, y, _ = self.half
        corners = np.array([x + y * 1j, x - y * 1j, -x - y * 1j, -x + y * 1j])
        return self.place[:, None] + np.exp(1j * self.heading)[:, None] * corners

    @cached_property
    def _fine_speed(self) -> Reals:
        times, speeds = np.transpose(self.speeds)
        return np.interp(np.arange((FRAMES - 1) * FINE // RATE + 1) / FINE, times, speeds, left=0.0)

    @cached_property
    def _way(self) -> Reals:
        steps = (self._fine_speed[1:] + self._fine_speed[:-1]) / 2 / FINE
        return np.concatenate([[0.0], np.cumsum(steps)])[::FINE // RATE]

    def _along(self, way: Reals) -> Points:
        lengths = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(self.path)))])
        return np.interp(way, lengths, self.path)

    def spawn(self, frame: int) -> Spawn:
        """Its appearance."""
        wheels = 2 if self.id == BICYCLE else 4
        more = [Attribute(INT, "number_of_wheels", str(wheels))] if self.kind is ActorKind.VEHICLE else []
        attributes = [*more, Attribute(STRING, "role_name", self.role_name)]
        return spawn(self.id, self.kind, self.type_id, self.transform(frame), attributes)

    def transform(self, frame: int) -> tuple[float, ...]:
        """Its place and angles in CARLA's units; a vehicle's place is on the ground, a walker's in the middle."""
        height = self.half[2] if self.kind is ActorKind.WALKER else 0.0
        return pose(self.place[frame], height, np.rad2deg(self.heading[frame]))

    def velocity(self, frame: int) -> tuple[float, ...]:
        """Its velocity in m/s, and how it turns in degrees per second."""
        velocity = self.speed[frame] * np.exp(1j * self.heading[frame])
        return (*exact(velocity.real, velocity.imag, 0, 0, 0, np.rad2deg(self.turn_rate[frame])),)

    def control(self, frame: int) -> tuple[float, ...]:
        """What its driver does: steer, throttle, brake, hand brake, gear."""
        speed, acceleration = self.speed[frame], self.acceleration[frame]
        curvature = self.turn_rate[frame] / max(speed, 1.0)
        steer = np.arctan(1.2 * self.half[0] * curvature) / np.deg2rad(70)
        pull = acceleration + 0.04 * speed  # against the drag, too
        pushed = acceleration > 4  # by another car: no engine does that
        if pushed or acceleration < -0.3 or (speed == 0 and acceleration == 0):
            throttle, brake = 0.0, 0.5 if acceleration >= 0 else -acceleration / 8
        else:
            throttle, brake = max(pull, 0.0) / 5, 0.0
        parked = speed == 0 and frame / RATE >= self.blinks[0]
        gear = 1 + np.searchsorted((4.5, 8.5, 12.5), speed)
        return (*exact(steer, min(throttle, 1.0), min(brake, 1.0)), parked, gear)

    def lights(self, frame: int) -> int:
        """Which lights are on."""
        if self.id == BICYCLE:
            return 0
        since, blinker = self.blinks
        brake = BRAKE if self.control(frame)[2] > 0 else 0
        return POSITION | LOW_BEAM | brake | (blinker if frame / RATE >= since else 0)


CAST: Final = (
    # Turns into the main road, comes up too fast, brakes late, and runs into the car that waits at the red light.
    Mover(
        HERO, "vehicle.tesla.model3", rounded(10, -150 + 60j, -150 + 1.75j, 60 + 1.75j),
        ((0, 0), (1, 0), (5, 8), (7.5, 8), (9.5, 4.5), (13, 4.5), (18, 13), (23.4, 13), (24.6, 3.4), (24.7, 1.9), (25.4, 0), (END, 0)),
        "hero", (26, HAZARD),
    ),
    Mover(
        LEAD, "vehicle.audi.a2", rounded(10, -162.45 + 1.75j, 60 + 1.75j),
        ((0, 10), (13, 10), (17, 0), (24.6, 0), (24.7, 2.2), (25.5, 0), (END, 0)), blinks=(26.5, HAZARD),
    ),
    # Breaks down before the crossing.
    Mover(
        VAN, "vehicle.mercedes.sprinter", rounded(10, 142 - 1.75j, -60 - 1.75j),
        ((0, 10), (6, 10), (14, 0), (END, 0)), blinks=(7, HAZARD),
    ),
    # Cross traffic.
    Mover(
        STRAIGHT, "vehicle.nissan.micra", rounded(10, 1.75 + 93.4j, 1.75 - 90j),
        ((0, 9), (7, 9), (11, 0), (17.8, 0), (22.3, 10), (27, 10)),
    ),
    Mover(
        TURNING, "vehicle.toyota.prius", rounded(8, -1.75 - 60.9j, -1.75 - 1.75j, -60 - 1.75j),
        ((30, 0), (34, 8), (36, 8), (40, 0), (47.8, 0), (49.8, 4), (52.8, 4), (END, 14)), blinks=(36, RIGHT),
    ),
    # A cyclist who has green, and a pedestrian who has not.
    Mover(
        BICYCLE, "vehicle.bh.crossbike", rounded(2, -2.9 - 45j, -2.9 + 60j),
        ((10, 0), (13, 5.5), (19.8, 5.5), (20.8, 1), (21, 0), (26, 0), (29, 5), (36, 5)),
    ),
    Mover(
        WALKER_SOUTH, "walker.pedestrian.0004", rounded(1, -5.5 + 25j, -5.5 + 6.5j, 5.5 + 6.5j, 5.5 + 30j),
        ((3, 0), (3.5, 1.4), (20.9, 1.4), (21.3, 0.6), (23, 0.6), (23.5, 1.4), (40, 1.4)),
    ),
    Mover(
        WALKER_WEST, "walker.pedestrian.0015", rounded(1, -28 + 5j, -6.5 + 5j, -6.5 - 5j, -40 - 5j),
        ((1, 0), (1.5, 1.3), (38, 1.3)),
    ),
)  # fmt: skip
MOVERS: Final = {mover.id: mover for mover in CAST}
BOXES: Final = {mover.id: mover.box for mover in CAST}


def exact(*values: float) -> list[float]:
    """Numbers rounded, so that no machine's arithmetic shows."""
    return [round(float(value), 4) + 0.0 for value in values]


def pose(place: complex, height: float, yaw: float, pitch: float = 0.0) -> tuple[float, ...]:
    """A transform in CARLA's units, from metres and degrees."""
    place *= 100
    return (*exact(place.real, place.imag, 100 * height, 0, pitch, (yaw + 180) % 360 - 180),)
