"""Write `crossing.log`, 53 seconds at a crossing: `python samples/make_crossing.py [DESTINATION]`.

All data are invented, without a simulator. Each actor follows a polyline with rounded corners, at speeds that are given for
some times and interpolated between them. Collisions are recorded while the boxes of two actors overlap. The scene is in
metres and seconds, in CARLA's axes (x forward, y right), with the crossing at the origin; a point is the complex number
x + y j. The records are in CARLA's units.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import count, permutations
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap import ActorKind, Attribute, Spawn, create_recording

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    Points = NDArray[np.complex128]

DATE: Final = 1_767_261_600  # 2026-01-01 10:00:00 UTC
RATE: Final = 10  # frames per second
FRAMES: Final = 53 * RATE + 1
STAYS: Final = 60.0  # s, after the last frame
FINE: Final = 10  # steps per frame in which speeds are integrated

BLUEPRINTS: Final = {  # index in the blueprint library; half of length, width and height
    "vehicle.audi.a2": (8, 1.853, 0.895, 0.777),
    "vehicle.bh.crossbike": (11, 0.744, 0.430, 0.893),
    "vehicle.mercedes.sprinter": (22, 2.958, 0.994, 1.280),
    "vehicle.nissan.micra": (26, 1.817, 0.923, 0.751),
    "vehicle.tesla.model3": (31, 2.396, 1.082, 0.744),
    "vehicle.toyota.prius": (33, 2.257, 1.003, 0.762),
    "walker.pedestrian.0004": (74, 0.188, 0.188, 0.930),
    "walker.pedestrian.0015": (85, 0.188, 0.188, 0.930),
    "static.prop.barrel": (118, 0.283, 0.283, 0.447),
    "static.prop.busstop": (131, 1.905, 0.965, 1.360),
    "sensor.other.collision": (160, 0.0, 0.0, 0.0),
}
KINDS: Final = {
    "vehicle": ActorKind.VEHICLE,
    "walker": ActorKind.WALKER,
    "traffic": ActorKind.TRAFFIC_LIGHT,
    "sensor": ActorKind.SENSOR,
}
STRING: Final = 3  # type of an attribute
POSITION, LOW_BEAM, BRAKE, RIGHT, LEFT = 1 << 0, 1 << 1, 1 << 3, 1 << 4, 1 << 5  # vehicle lights
GREEN, YELLOW, RED = 10, 3, 17  # seconds of a traffic light

LANE: Final = 1.75  # m from the middle of the road to the middle of a lane
PROPS: Final = {10: ("static.prop.busstop", -24 + 6.5j, -90.0), 11: ("static.prop.barrel", 33 - 4.2j, 0.0)}
SIGNALS: Final = {
    20: (1, 2),
    21: (-1, 2),
    22: (1j, 17),
    23: (-1j, 17),
}  # the direction of the traffic; begin of the first green
CYCLE: Final = [  # for each frame from green on: seconds in the state, state
    (tick / RATE, state) for state, time in ((2, GREEN), (1, YELLOW), (0, RED)) for tick in range(time * RATE)
]


def poses(position: Any, yaw: Any, height: float = 0.0, pitch: float = 0.0) -> NDArray[np.float64]:
    """Return locations and rotations in CARLA's units; angles in degrees."""
    yaw = 180 - (180 - yaw) % 360
    return exact(100 * np.real(position), 100 * np.imag(position), 100 * height, 0, pitch, yaw)


def exact(*columns: Any) -> NDArray[np.float64]:
    """Return columns as rows, rounded so that they are equal on all machines."""
    return np.round(np.stack(np.broadcast_arrays(*columns), axis=-1), 3) + 0.0


def rounded(reach: float, *corners: complex) -> Points:
    """Return a polyline whose corners are curves that begin and end at a distance from the corner."""
    steps = np.linspace(0, 1, 100)
    pieces = [np.array(corners[:1])]
    for before, corner, after in zip(corners, corners[1:], corners[2:], strict=False):
        start = corner + reach * (before - corner) / abs(before - corner)
        end = corner + reach * (after - corner) / abs(after - corner)
        pieces.append((1 - steps) ** 2 * start + 2 * steps * (1 - steps) * corner + steps**2 * end)
    return np.concatenate([*pieces, corners[-1:]])


@dataclass(eq=False)
class Mover:
    """A moving actor; its arrays have a row for each frame of the recording."""

    id: int
    type_id: str
    path: Points
    speeds: tuple[tuple[float, float], ...]  # (time, speed); the actor exists from the first time to the last
    role_name: str = "autopilot"
    blinks: tuple[float, int] = (STAYS, 0)  # time, lights that blink from then on
    sensor: int | None = None  # id of a collision sensor, attached half a second after the actor appears

    def __post_init__(self) -> None:
        self.begin, self.end = self.speeds[0][0], self.speeds[-1][0]
        _, length, width, height = BLUEPRINTS[self.type_id]
        times, speeds = np.transpose(self.speeds)
        fine = np.interp(np.arange((FRAMES - 1) * FINE + 1) / (RATE * FINE), times, speeds, left=0)
        distance = np.append(0, np.cumsum(fine[1:] + fine[:-1]) / (2 * RATE * FINE))[::FINE]
        speed = fine[::FINE]
        milestones = np.cumsum(np.abs(np.diff(self.path, prepend=self.path[0])))
        position, back, front = (np.interp(distance + shift, milestones, self.path) for shift in (0, -0.5, 0.5))
        yaw = np.unwrap(np.angle(front - back))
        turn = np.gradient(yaw) * RATE
        ahead = np.exp(1j * yaw)
        corners = length * np.array([1, 1, -1, -1]) + width * np.array([-1j, 1j, 1j, -1j])

        effort = np.diff(speed, append=speed[-1]) * RATE + 0.04 * speed  # acceleration and drag
        passive = (effort == 0) | (effort > 4)  # standing, or pushed by another actor
        brake = np.where(effort < 0, np.minimum(-effort / 8, 1), 0.4 * passive)
        throttle = np.where(brake > 0, 0, effort / 4)
        steer = np.arctan(1.2 * length * turn / np.maximum(speed, 1)) / np.deg2rad(70)
        gear = 1 + np.searchsorted((4.5, 8.5, 12.0), speed)
        blinking = np.arange(FRAMES) >= self.blinks[0] * RATE

        self.position, self.yaw, self.speed = position, yaw, speed
        self.box = position[:, None] + ahead[:, None] * corners
        # A vehicle's origin is on the ground, a walker's in the middle of the body.
        self.poses = poses(position, np.rad2deg(yaw), height if self.type_id.startswith("walker.") else 0)
        self.velocities = exact(speed * ahead.real, speed * ahead.imag, 0, 0, 0, np.rad2deg(turn))
        self.controls = exact(steer, throttle, brake, blinking & (speed == 0), gear)
        self.lights = POSITION | LOW_BEAM | BRAKE * (brake > 0) | self.blinks[1] * blinking


# fmt: off
# Turns into the main road, brakes too late, and hits the car that waits at the red light.
HERO: Final = Mover(
    100, "vehicle.tesla.model3", rounded(10, -150 + 60.235j, -150 + LANE * 1j, 60 + LANE * 1j),
    ((0, 0), (1, 0), (5, 8), (7.5, 8), (9.5, 4.5), (13, 4.5), (18, 13), (23.4, 13), (24.6, 3.4), (24.7, 1.8),
     (25.4, 0), (STAYS, 0)), role_name="hero", blinks=(26, LEFT | RIGHT), sensor=120)
WAITING: Final = Mover(
    101, "vehicle.audi.a2", rounded(10, -162.45 + LANE * 1j, 60 + LANE * 1j),
    ((0, 10), (13, 10), (17, 0), (24.6, 0), (24.7, 2.2), (25.6, 0), (STAYS, 0)), blinks=(26.5, LEFT | RIGHT))
# Breaks down before the crossing.
VAN: Final = Mover(
    102, "vehicle.mercedes.sprinter", rounded(10, 142 - LANE * 1j, -60 - LANE * 1j),
    ((0, 10), (6, 10), (14, 0), (STAYS, 0)), blinks=(7, LEFT | RIGHT))
# Cross traffic waits for green; then one car drives straight on, the other one turns right.
NORTHBOUND: Final = Mover(
    103, "vehicle.nissan.micra", rounded(10, LANE + 93.4j, LANE - 90j),
    ((0, 9), (7, 9), (11, 0), (17.8, 0), (22.3, 10), (27, 10)))
SOUTHBOUND: Final = Mover(
    104, "vehicle.toyota.prius", rounded(8, -LANE - 60.9j, -LANE - LANE * 1j, -60 - LANE * 1j),
    ((30, 0), (34, 8), (36, 8), (40, 0), (47.8, 0), (49.8, 4), (52.8, 4), (STAYS, 14)), blinks=(36, RIGHT))
# The cyclist has green; the first pedestrian crosses at red.
CYCLIST: Final = Mover(
    105, "vehicle.bh.crossbike", rounded(2, -2.9 - 43.4j, -2.9 + 60j),
    ((10, 0), (13, 5.5), (19.8, 5.5), (20.8, 1), (21, 0), (26, 0), (29, 5), (36, 5)), sensor=121)
PEDESTRIANS: Final = (
    Mover(110, "walker.pedestrian.0004", rounded(1, -5.5 + 25j, -5.5 + 6.5j, 5.5 + 6.5j, 5.5 + 30j),
          ((6, 0), (6.5, 1.4), (20.9, 1.4), (21.3, 0.9), (23, 0.9), (23.5, 1.4), (40, 1.4)), "pedestrian"),
    Mover(111, "walker.pedestrian.0015", rounded(1, -28 + 5j, -6.5 + 5j, -6.5 - 5j, -40 - 5j),
          ((1, 0), (1.5, 1.3), (38, 1.3)), "pedestrian"),
)
# fmt: on
# The spectator follows the hero.
CAMERA: Final = poses(HERO.position - 10 * np.exp(1j * HERO.yaw), np.rad2deg(HERO.yaw), 5, -25)
VEHICLES: Final = (HERO, WAITING, VAN, NORTHBOUND, SOUTHBOUND, CYCLIST)
MOVERS: Final = VEHICLES + PEDESTRIANS


def existing_actors(frame: int) -> Iterator[Spawn]:
    """Yield the actors of a frame, as records of a spawn in that frame."""

    def spawn(id: int, type_id: str, pose: NDArray[np.float64], role_name: str = "") -> Spawn:
        kind = KINDS.get(type_id.partition(".")[0], ActorKind.OTHER)
        attributes = [Attribute(STRING, "role_name", role_name)] if role_name else []
        x, y, z, roll, pitch, yaw = pose.tolist()
        uid = int(BLUEPRINTS[type_id][0]) if type_id in BLUEPRINTS else 0
        return Spawn(id, kind, x, y, z, roll, pitch, yaw, uid, type_id, attributes)

    yield spawn(1, "spectator", CAMERA[frame])
    for id, (type_id, position, yaw) in PROPS.items():
        yield spawn(id, type_id, poses(position, yaw))
    for id, (direction, _) in SIGNALS.items():
        yield spawn(id, "traffic.traffic_light", poses(direction * (-9 + 4.5j), np.angle(direction * 1j, deg=True)))
    for mover in MOVERS:
        if mover.begin <= frame / RATE < mover.end:
            yield spawn(mover.id, mover.type_id, mover.poses[frame], mover.role_name)
            if mover.sensor and frame / RATE >= mover.begin + 0.5:
                yield spawn(mover.sensor, "sensor.other.collision", poses(0, 0))


def overlap(a: Points, b: Points) -> bool:
    """Return whether two boxes overlap: no line along a side of one separates them."""
    for side in (a[1] - a[0], a[2] - a[1], b[1] - b[0], b[2] - b[1]):
        x, y = (a * side.conjugate()).real, (b * side.conjugate()).real
        if x.max() <= y.min() or y.max() <= x.min():
            return False
    return True


def box(actor: Spawn) -> tuple[float, ...]:
    """Return the bounding box in cm; the origin of a vehicle is on the ground, that of a walker in its middle."""
    _, length, width, height = BLUEPRINTS[actor.type_id]
    middle = 0 if actor.kind == ActorKind.WALKER else height
    return (actor.id, 0, 0, *exact(100 * middle, 100 * length, 100 * width, 100 * height))


def make(path: Path) -> None:
    """Write the recording."""
    numbers = count()
    present: dict[int, Spawn] = {}
    with create_recording(path, map_name="Crossing", date=DATE, additional_data=True) as recording:
        for frame in range(FRAMES):
            before, present = present, {actor.id: actor for actor in existing_actors(frame)}
            new = {id: actor for id, actor in present.items() if id not in before}
            movers = [mover for mover in MOVERS if mover.id in present]
            vehicles = [mover for mover in VEHICLES if mover.id in present]
            records: dict[str, Any] = {
                "visual_time": frame / RATE,
                "spawned": new.values(),
                "destroyed": [(id,) for id in before if id not in present],
                "parented": [(m.sensor, m.id) for m in movers if m.sensor in new],
                "collisions": [
                    (next(numbers), a.id, b.id, a is HERO, b is HERO)
                    for a, b in permutations(movers, 2)
                    if a.sensor in present and overlap(a.box[frame], b.box[frame])
                ],
                "transforms": [
                    (a.id, a.x, a.y, a.z, a.roll, a.pitch, a.yaw)
                    for a in present.values()
                    if a.kind in (ActorKind.OTHER, ActorKind.VEHICLE, ActorKind.WALKER)
                ],
                "light_states": [
                    (id, False, *CYCLE[(frame - green * RATE) % len(CYCLE)]) for id, (_, green) in SIGNALS.items()
                ],
                "vehicle_controls": [(m.id, *m.controls[frame]) for m in vehicles],
                "walker_controls": [(m.id, 100 * m.speed[frame]) for m in movers if m not in VEHICLES],
                "vehicle_lights": [(m.id, m.lights[frame]) for m in vehicles if m is not CYCLIST],
                "bikers": [(m.id, 100 * m.speed[frame], 0) for m in movers if m is CYCLIST],
                "velocities": [(m.id, *m.velocities[frame]) for m in movers],
                "bounding_boxes": [box(a) for a in new.values() if a.type_id in BLUEPRINTS],
                "platform_time": 1.25 * frame / RATE,
            }
            if frame == 0:
                records["light_times"] = [(id, GREEN, YELLOW, RED) for id in SIGNALS]
            recording.add_frame(frame / RATE, **records)


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("crossing.log"))
