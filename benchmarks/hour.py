"""A synthetic hour of traffic as a CARLA log: 150 actors with transforms, 20 frames a second, 72,000 frames.

It has the packets of CARLA 0.9.13 in CARLA's order, empty ones included, with additional data but without velocities. The
low bits of moving actors are random: zstd compresses the transforms of a moving car to 0.8, as in recordings of CARLA.
Actors that do not move repeat their transforms exactly, as in CARLA. More than half of the actors move at any time.
"""

from __future__ import annotations

import zlib
from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.formats.carla_log import LogWriter
from carla_recap.model.frame import LAST_FRAME_DURATION, Frame, Header, Packet
from carla_recap.model.records import NO_ACTOR, UE4, ActorKind, Attribute, Spawn

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

RATE: Final = 20
FRAMES: Final = 3600 * RATE
TICK: Final = float(np.float32(1 / RATE))
DIRECTORY: Final = Path("build/bench")

# The actors with transforms, in the order of their records.
PROPS: Final = 39
VEHICLES: Final = 50
PARKED: Final = 5
WALKERS: Final = 60
ACTORS: Final = 1 + PROPS + VEHICLES + WALKERS  # the first is the spectator
HERO: Final = 1 + PROPS
FIRST_WALKER: Final = HERO + VEHICLES

LIGHTS: Final = 36
GREEN, YELLOW, RED = 10, 3, 2  # seconds, as in CARLA's towns

TURNOVER: Final = 20 * RATE  # frames until an actor is replaced by another one
REFIT: Final = 60 * RATE  # frames until the hero gets a new collision sensor
COLLISION: Final = 30 * RATE  # frames between two collisions
COLLISION_LENGTH: Final = 12  # frames, at most

ORDER: Final = (
    "spawned",
    "destroyed",
    "parented",
    "collisions",
    "transforms",
    "light_states",
    "vehicle_controls",
    "walker_controls",
    "vehicle_lights",
    "bounding_boxes",
    "trigger_volumes",
    "platform_time",
    "frame_end",
)
ONLY_WITH_RECORDS: Final = {"trigger_volumes"}

CAR: Final = {"generation": "1", "number_of_wheels": "4", "sticky_control": "true", "object_type": ""}
PEDESTRIAN: Final = {"generation": "1", "is_invincible": "true", "role_name": "pedestrian", "speed": "1.4"}
CARS: Final = ("audi.tt", "ford.mustang", "lincoln.mkz_2017", "nissan.micra", "tesla.model3", "volkswagen.t2")
MESHES: Final = ("Garden/SM_PlasticChair.SM_PlasticChair", "Bin/SM_Bin.SM_Bin")
SPECTATOR: Final = (542.5, 4236.7, 490.9, 0.0, 0.0, -131.8)


class Hour:
    """The traffic of the whole recording, as arrays and events; `frames` makes frames of it."""

    def __init__(self, count: int, seed: int) -> None:
        self.count = count
        self._rng = np.random.default_rng(seed)
        self._next_id = 1
        self._events: defaultdict[int, defaultdict[str, list[Any]]] = defaultdict(lambda: defaultdict(list))
        self._state = {
            name: np.zeros((count, size), UE4.named(name).dtype)
            for name, size in {
                "transforms": ACTORS,
                "light_states": LIGHTS,
                "vehicle_controls": VEHICLES,
                "walker_controls": WALKERS,
                "vehicle_lights": VEHICLES,
                "platform_time": 1,
            }.items()
        }
        self._poses = self._state["transforms"]
        id = self._new_id()
        self._poses[:, 0] = np.array((id, *SPECTATOR), self._poses.dtype)
        self._spawn(0, id, ActorKind.OTHER, "spectator", SPECTATOR)
        self._events[0]["bounding_boxes"].append((id, *[np.nan] * 3, *[-np.inf] * 3))
        self._plan_lights()
        self._plan_props()
        turnovers = self._plan_turnovers()
        for slot in range(HERO, ACTORS):
            self._plan_mover(slot, [index for index, which in turnovers if which == slot])
        for index, slot in [(0, slot) for slot in range(HERO, ACTORS)] + turnovers:
            self._replace(index, slot)
        self._plan_sensors()
        self._plan_collisions()
        self._state["platform_time"]["seconds"][:, 0] = np.cumsum(self._rng.gamma(40, TICK / 40, count))
        for name in ("vehicle_controls", "vehicle_lights"):
            self._state[name]["id"] = self._poses["id"][:, HERO:FIRST_WALKER]
        self._state["walker_controls"]["id"] = self._poses["id"][:, FIRST_WALKER:]

    def frames(self) -> Iterator[Frame]:
        types = [UE4.named(name) for name in ORDER]
        empty = {type.name: Packet(type.id, type, None, type.records([])) for type in types}
        elapsed = 0.0
        for index in range(self.count):
            events: dict[str, list[Any]] = self._events.get(index, {})
            packets = []
            for type in types:
                if type.name in self._state:
                    packets.append(Packet(type.id, type, None, self._state[type.name][index]))
                elif type.name in events:
                    packets.append(Packet(type.id, type, None, type.records(events[type.name])))
                elif type.name not in ONLY_WITH_RECORDS:
                    packets.append(empty[type.name])
            yield Frame(index, index + 1, elapsed, TICK if index + 1 < self.count else LAST_FRAME_DURATION, packets)
            elapsed += TICK

    def _new_id(self) -> int:
        self._next_id += 1
        return self._next_id - 1

    def _spawn(
        self, index: int, id: int, kind: ActorKind, type_id: str, pose: Iterable[float], uid: int = 0, **attributes: str
    ) -> None:
        held = [Attribute(_code(value), key, value) for key, value in attributes.items()]
        self._events[index]["spawned"].append(Spawn(id, kind, *pose, uid, type_id, held))

    def _plan_lights(self) -> None:
        """Plan the traffic lights, in groups of three: one is green or yellow, the others are red."""
        clock = np.arange(self.count)[:, None] * TICK + 0.167
        turn = GREEN + YELLOW + RED
        inside = np.where(clock // turn % 3 == np.arange(LIGHTS) % 3, clock % turn, GREEN + YELLOW)
        lights = self._state["light_states"]
        lights["state"] = np.select([inside < GREEN, inside < GREEN + YELLOW], [2, 1], 0)
        lights["elapsed"] = inside - np.choose(lights["state"], [GREEN + YELLOW, GREEN, 0])
        for light in range(LIGHTS):
            id = self._new_id()
            lights["id"][:, light] = id
            x, y = self._rng.uniform(-30_000, 30_000, 2)
            pose = (x, y, 10.3, 0, 0, 90 * (light % 4))
            self._spawn(0, id, ActorKind.TRAFFIC_LIGHT, "traffic.traffic_light", pose)
            self._events[0]["trigger_volumes"].append((id, x, y, 120, 300, 90, 100))

    def _plan_props(self) -> None:
        for slot in range(1, HERO):
            id = self._new_id()
            x, y, yaw = self._rng.uniform((-30_000, -30_000, -180), (30_000, 30_000, 180))
            pose = (x, y, 7.99, *self._rng.normal(0, 1e-4, 2), yaw)
            self._poses[:, slot] = np.array((id, *pose), self._poses.dtype)
            mesh = f"/Game/Carla/Static/Dynamic/{MESHES[slot % len(MESHES)]}"
            self._spawn(0, id, ActorKind.OTHER, "static.prop.mesh", pose, 195, mesh_path=mesh, mass="0.5")
            self._events[0]["bounding_boxes"].append((id, 0, 0, 63.57, 36.52, 37.52, 63.57))

    def _plan_turnovers(self) -> list[tuple[int, int]]:
        """Return the frames and slots in which a new actor replaces another; the hero and parked cars stay."""
        times = range(TURNOVER, self.count, TURNOVER)
        return [(index, int(self._rng.integers(HERO + 1, ACTORS - PARKED))) for index in times]

    def _plan_mover(self, slot: int, jumps: list[int]) -> None:
        """Plan an actor that moves along a closed curve, with stops; each jump moves it to another position on the curve."""
        rng, count = self._rng, self.count
        car = slot < FIRST_WALKER
        speed = stop_and_go(rng, count, car=car)
        if FIRST_WALKER - PARKED <= slot < FIRST_WALKER:
            speed[:] = 0
        distance = np.cumsum(speed * TICK)
        for index in jumps:
            distance[index:] += rng.uniform(0, 1e5)
        x, y, yaw = closed_curve(rng, distance, rng.uniform(6_000, 25_000) if car else rng.uniform(2_000, 6_000))
        pose = self._poses[:, slot]
        pose["x"], pose["y"], pose["yaw"] = x, y, np.degrees(yaw)
        hills = 40 * np.sin(x / 9_000) * np.sin(y / 7_000)
        moving = speed > 0
        if car:
            last_moved = np.maximum.accumulate(np.where(moving, np.arange(count), 0))
            shake = rng.normal(0, (0.1, 0.2, 0.1), (count, 3))[last_moved]
            pose["z"], pose["roll"], pose["pitch"] = hills + shake[:, 0], shake[:, 1], shake[:, 2]
            self._plan_controls(slot - HERO, speed, yaw, moving)
        else:
            pose["z"] = hills + 93
            self._state["walker_controls"]["speed"][:, slot - FIRST_WALKER] = np.where(moving, speed.max(), 0)

    def _plan_controls(self, car: int, speed: Floats, yaw: Floats, moving: NDArray[np.bool_]) -> None:
        force = np.gradient(speed) / 20 + np.where(moving, self._rng.normal(0.3, 0.05, len(speed)), -1)
        turn = np.gradient(np.unwrap(yaw)) * 5
        control = self._state["vehicle_controls"][:, car]
        control["throttle"] = np.clip(force, 0, 1)
        control["brake"] = np.clip(-force, 0, 1)
        control["steer"] = np.clip(np.where(moving, turn + self._rng.normal(0, 0.005, len(speed)), 0), -1, 1)
        control["gear"] = np.where(moving, 1 + speed // 400, 0)
        lights = self._state["vehicle_lights"][:, car]
        lights["flags"] = (force < 0) * 8 + (turn > 0.2) * 16 + (turn < -0.2) * 32

    def _replace(self, index: int, slot: int) -> None:
        """Put a new actor in a slot; the previous one, if any, is destroyed."""
        if index:
            self._events[index]["destroyed"].append((self._poses["id"][index, slot],))
        id = self._new_id()
        self._poses["id"][index:, slot] = id
        pose = self._poses[index, slot].item()[1:]
        if slot < FIRST_WALKER:
            type_id, color = f"vehicle.{CARS[slot % len(CARS)]}", ",".join(map(str, self._rng.integers(0, 256, 3)))
            role = "hero" if slot == HERO else "autopilot"
            self._spawn(index, id, ActorKind.VEHICLE, type_id, pose, 26, **CAR, color=color, role_name=role)
            self._events[index]["bounding_boxes"].append((id, 2.2, 0, 72.4, 245.1, 106.1, 75.5))
        else:
            type_id, gender = f"walker.pedestrian.{1 + slot % 29:04}", "female" if slot % 2 else "male"
            self._spawn(index, id, ActorKind.WALKER, type_id, pose, 5, age="adult", gender=gender, **PEDESTRIAN)
            self._events[index]["bounding_boxes"].append((id, 0, 0, 0, 18.8, 18.8, 93))

    def _plan_sensors(self) -> None:
        """Plan the collision sensors of the hero, one after another."""
        id = 0
        for index in range(0, self.count, REFIT):
            if index:
                self._events[index]["destroyed"].append((id,))
            id = self._new_id()
            self._spawn(index, id, ActorKind.SENSOR, "sensor.other.collision", [0.0] * 6, 40, role_name="front")
            if index:  # CARLA records no parents of actors that exist when the recording begins
                self._events[index]["parented"].append((id, self._poses["id"][index, HERO]))

    def _plan_collisions(self) -> None:
        """Plan collisions of several frames, recorded in each of them, and for both vehicles if there are two."""
        rng = self._rng
        contacts: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
        for start in range(COLLISION, self.count, COLLISION):
            actor1 = HERO if rng.random() < 0.5 else int(rng.integers(HERO, FIRST_WALKER))
            actor2 = int(rng.choice([-1, *range(1, actor1), *range(actor1 + 1, ACTORS)]))
            for index in range(start, min(start + int(rng.integers(1, COLLISION_LENGTH)), self.count)):
                contacts[index].append((actor1, actor2))
                if HERO <= actor2 < FIRST_WALKER:
                    contacts[index].append((actor2, actor1))
        number = 0
        for index, pairs in contacts.items():
            for pair in pairs:
                ids = (NO_ACTOR if actor < 0 else self._poses["id"][index, actor] for actor in pair)
                self._events[index]["collisions"].append((number, *ids, *(actor == HERO for actor in pair)))
                number += 1


def _code(value: str) -> int:
    """Return CARLA's code of a type of attribute: 0 bool, 1 int, 2 float, 3 string, 4 colour."""
    if value in ("true", "false"):
        return 0
    if value.count(",") == 2:
        return 4
    return 1 if value.isdigit() else 2 if value.replace(".", "", 1).isdigit() else 3


def stop_and_go(rng: np.random.Generator, count: int, *, car: bool) -> Floats:
    """Return the speed in each frame in cm/s: `go` seconds at a `cruise` speed, `halt` seconds of rest, ramps of 3 s."""
    cruise, go, halt = ((500, 1400), (30, 150), (10, 60)) if car else ((90, 180), (30, 200), (5, 30))
    ramp = 3 * RATE
    legs = int((count + ramp) / RATE / (go[0] + halt[0])) + 2
    seconds = np.column_stack((rng.uniform(*go, legs), rng.uniform(*halt, legs)))
    speeds = np.column_stack((rng.uniform(*cruise, legs), np.zeros(legs)))
    steps = np.repeat(speeds.ravel(), np.ceil(seconds.ravel() * RATE).astype(int))
    steps = np.roll(steps, rng.integers(len(steps)))
    return np.convolve(steps[: count + ramp - 1], np.full(ramp, 1 / ramp), "valid")


def closed_curve(rng: np.random.Generator, distance: Floats, radius: float) -> tuple[Floats, Floats, Floats]:
    """Return x, y (cm) and heading after distances (cm) along a random closed curve of about a radius (cm)."""
    orders = np.arange(6)
    weights = radius * 0.4 / np.maximum(orders, 1) ** 2 * np.exp(2j * np.pi * rng.random(6))
    weights[0] = complex(*rng.uniform(-20_000, 20_000, 2))
    weights[1] = radius
    grid = np.linspace(0, 2 * np.pi, 4096)
    slopes = np.abs(np.polynomial.polynomial.polyval(np.exp(1j * grid), weights * orders))
    lengths = np.concatenate(([0], np.cumsum((slopes[1:] + slopes[:-1]) / 2) * grid[1]))
    turned = np.exp(1j * np.interp((distance + rng.uniform(0, 1e5)) % lengths[-1], lengths, grid))
    place = np.polynomial.polynomial.polyval(turned, weights)
    heading = np.angle(1j * np.polynomial.polynomial.polyval(turned, weights * orders))
    return place.real, place.imag, heading


def make(path: Path, count: int = FRAMES, seed: int = 1) -> None:
    """Write the log; the same count and seed give the same bytes."""
    with LogWriter(path, Header("Town05", 1_700_000_000)) as log:
        for frame in Hour(count, seed).frames():
            log.write(frame)


def cached(count: int = FRAMES) -> Path:
    """Return the log, which is made again if this module has changed."""
    path = DIRECTORY / f"hour-{count}-{zlib.crc32(Path(__file__).read_bytes()):08x}.log"
    if not path.exists():
        DIRECTORY.mkdir(parents=True, exist_ok=True)
        for stale in DIRECTORY.glob(f"hour-{count}-*"):
            stale.unlink()
        make(path, count)
    return path
