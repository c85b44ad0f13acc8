"""What drivers perceive: vehicles, walkers and props as obstacles, and which of them lie on the paths ahead."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.sim.actors.props import Prop
from carla_recap.sim.traffic.autopilot.drivers import NONE
from carla_recap.sim.traffic.autopilot.routes import shift_poses

if TYPE_CHECKING:
    from carla_recap.sim.episode import Episode
    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.sim.physics.walkers import Walkers
    from carla_recap.sim.traffic.autopilot.drivers import DrivenVehicles, Drivers
    from carla_recap.sim.traffic.autopilot.routes import AutopilotState
    from carla_recap.util.arrays import Booleans, Floats, Integers


UNCONTROLLED: Final = -2
"""Instead of a leader: an obstacle that moves on, but that no driver of the autopilot moves."""
_VEHICLES_AHEAD: Final = 1.0  # s for which the vehicles of others are expected to go straight on
_WALKERS_AHEAD: Final = 1.5  # s, the same for walkers
_ATTACHED: Final = np.inf  # m: the x of attached actors, which all others pass through
_AROUND_WALKERS: Final = 0.3  # m
_WALKING: Final = 0.1  # m/s
_PROPS_INTERVAL: Final = 1.0  # s between two looks for props
_SAMPLES: Final = np.linspace(0, 1, 28) ** 1.5  # of the path ahead of a vehicle; denser near it
_HEADROOM: Final = 4.0  # m above the road: higher obstacles are ignored
_CLEARANCE: Final = 0.2  # m above the road: lower obstacles pass between the wheels
_BUMPER: Final = 0.3  # m behind the front end, where the path ahead begins
_NEAREST: Final = 15.0  # m: the foresight of the driver of a standing vehicle
_FARTHEST: Final = 120.0  # m: the foresight of any driver
_FORESIGHT: Final = 1.5  # foresight as a multiple of the gap that a driver desires to a standing obstacle
_MARGIN: Final = 0.25  # m to each side of a vehicle
_LEAST_MARGIN: Final = 0.05  # m, what is left of that after some time of standing
_SQUEEZE: Final = 20.0  # s of standing until the margin has shrunk to that
_MOVING: Final = 2.0  # m/s: faster obstacles count as moving on


@dataclass(frozen=True)
class Obstacles:
    """Upright boxes, as arrays with a value for each.

    Attributes:
        x: X of the centre, in m.
        y: Y of the centre, in m.
        heading: The heading in radians.
        half_length: Half of the length, along the heading, in m.
        half_width: Half of the width in m.
        velocity_x: The velocity along x in m/s.
        velocity_y: The velocity along y in m/s.
        low: The z of the bottom, in m.
        high: The z of the top, in m.
    """

    x: Floats
    y: Floats
    heading: Floats
    half_length: Floats
    half_width: Floats
    velocity_x: Floats
    velocity_y: Floats
    low: Floats
    high: Floats

    def __len__(self) -> int:
        return len(self.x)

    def swept(self, seconds: Floats) -> Obstacles:
        """Return the boxes that contain these for some time, if they go straight on."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        half = (self.velocity_x * cos + self.velocity_y * sin) * seconds / 2
        return Obstacles(
            self.x + half * cos,
            self.y + half * sin,
            self.heading,
            self.half_length + np.abs(half),
            self.half_width,
            self.velocity_x,
            self.velocity_y,
            self.low,
            self.high,
        )


class ObstacleTracker:
    """Collects the obstacles of an episode."""

    def __init__(self, episode: Episode) -> None:
        self._episode = episode
        self._props = _props([])
        self._props_due = 0.0
        self._actors = 0

    def obstacles(self, driven: Booleans) -> Obstacles:
        """Return all obstacles: the vehicles, in their order, then walkers, then props.

        Those that the autopilot does not drive include the area that they will be in soon.
        """
        episode, elapsed = self._episode, self._episode.clock.elapsed
        if elapsed >= self._props_due or len(episode.actors) != self._actors:
            self._props_due, self._actors = elapsed + _PROPS_INTERVAL, len(episode.actors)
            self._props = _props([actor for actor in episode.actors.values() if isinstance(actor, Prop) and actor.body])
        seconds = np.where(driven, 0.0, _VEHICLES_AHEAD)
        parts = _vehicles(episode.vehicles).swept(seconds), _walkers(episode.walkers), self._props
        return Obstacles(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(Obstacles)))


def _vehicles(vehicles: Vehicles) -> Obstacles:
    return Obstacles(
        np.where(vehicles.carried, _ATTACHED, vehicles.position[:, 0]),
        vehicles.position[:, 1],
        np.radians(vehicles.rotation[:, 1]),
        vehicles.half_length,
        vehicles.half_width,
        vehicles.velocity[:, 0],
        vehicles.velocity[:, 1],
        *vehicles.heights(),
    )


def _walkers(walkers: Walkers) -> Obstacles:
    velocity_x, velocity_y = walkers.velocity[:, 0], walkers.velocity[:, 1]
    walking = np.hypot(velocity_x, velocity_y) > _WALKING
    return Obstacles(
        np.where(walkers.carried, _ATTACHED, walkers.position[:, 0]),
        walkers.position[:, 1],
        np.where(walking, np.arctan2(velocity_y, velocity_x), np.radians(walkers.rotation[:, 1])),
        walkers.half_length + _AROUND_WALKERS,
        walkers.half_width + _AROUND_WALKERS,
        velocity_x,
        velocity_y,
        *walkers.heights(),
    ).swept(np.full(len(walkers), _WALKERS_AHEAD))


def _props(props: list[Prop]) -> Obstacles:
    rows = []
    for prop in props:
        transform, box = prop.transform, prop.box
        centre = transform.transform(box.location)
        yaw, extent = np.radians(transform.rotation.yaw), box.extent
        rows.append((centre.x, centre.y, yaw, extent.x, extent.y, 0.0, 0.0, *prop.heights()))
    return Obstacles(*np.array(rows, np.float64).reshape(-1, len(fields(Obstacles))).T)


class Perception(NamedTuple):
    """What the drivers perceive, as arrays with a value for each.

    Attributes:
        free_distance: The distance from the front end to the nearest obstacle on the path, in m; infinity if there is none.
        leader: The driver of the vehicle that is that obstacle; `UNCONTROLLED` for another that moves on, else `NONE`.
        leader_speed: The speed of that obstacle along the path, in m/s.
        acceleration_limit: The greatest acceleration that all obstacles on the path allow, in m/s².
    """

    free_distance: Floats
    leader: Integers
    leader_speed: Floats
    acceleration_limit: Floats


def perceive(state: AutopilotState, obstacles: Obstacles) -> Perception:
    """Find the obstacles on the paths of the driven vehicles, and what they mean for their drivers."""
    cars, drivers, routes, network, _ = state
    horizon = np.minimum(_NEAREST + _FORESIGHT * drivers.desired_gap(cars.speed, cars.speed), _FARTHEST)
    distance = (cars.half_length - _BUMPER)[:, None] + horizon[:, None] * _SAMPLES
    index, share = network.points(*routes.locate(distance))
    paths = _Paths(
        distance,
        *shift_poses(drivers, routes.position, distance, network.poses((index, share))),
        network.height(index),
    )
    margin = np.maximum(_MARGIN - (_MARGIN - _LEAST_MARGIN) * drivers.standing_time / _SQUEEZE, _LEAST_MARGIN)
    hits = _find_hits(paths, cars.rows, obstacles, cars.half_width + margin)
    driver = np.full(len(obstacles), NONE)
    driver[cars.rows] = np.arange(len(cars.rows))
    return _summarize(cars, drivers, hits, driver)


def _summarize(cars: DrivenVehicles, drivers: Drivers, hits: _Hits, driver: Integers) -> Perception:
    """Return what hits mean for the drivers; `driver` is the driver of each obstacle, or `NONE`."""
    count, rows = len(cars.rows), hits.vehicle
    limit, free, leader_speed = np.full(count, np.inf), np.full(count, np.inf), np.zeros(count)
    leader = np.full(count, NONE)
    speed = cars.speed[rows]
    desired_gap = drivers.desired_gap(speed, speed - hits.speed, rows)
    np.minimum.at(limit, rows, drivers.following_acceleration(hits.gap, desired_gap, rows))
    farthest_first = np.lexsort((hits.gap, rows))[::-1]  # of several values for a row, the last one stays
    row = rows[farthest_first]
    free[row], leader_speed[row] = hits.gap[farthest_first], hits.speed[farthest_first]
    leader[row] = driver[hits.obstacle[farthest_first]]
    leader[(leader == NONE) & (leader_speed > _MOVING)] = UNCONTROLLED
    return Perception(free, leader, leader_speed, limit)


class _Paths(NamedTuple):
    """Samples of the paths ahead of vehicles, as arrays of (vehicles, samples).

    Attributes:
        distance: The distance from the origin of the vehicle along the path, in m.
        x: X in m.
        y: Y in m.
        heading: The heading of the path in radians.
        z: The z of the road in m.
    """

    distance: Floats
    x: Floats
    y: Floats
    heading: Floats
    z: Floats


class _Hits(NamedTuple):
    """Obstacles on the paths of vehicles, as arrays with a value for each pair, ordered by vehicle.

    Attributes:
        vehicle: The row of the vehicle's driver.
        obstacle: The index of the obstacle.
        gap: The distance from the front end to the obstacle along the path, in m; negative if they overlap.
        speed: The speed of the obstacle along the path, in m/s.
    """

    vehicle: Integers
    obstacle: Integers
    gap: Floats
    speed: Floats


def _find_hits(paths: _Paths, own: Integers, obstacles: Obstacles, room: Floats) -> _Hits:
    """Find the obstacles on paths, but the vehicles' `own`; `room` is the free width in m that each needs to each side."""
    vehicle, obstacle = _near(paths, obstacles, room)
    other = obstacle != own[vehicle]
    vehicle, obstacle = vehicle[other], obstacle[other]
    x, y = paths.x[vehicle] - obstacles.x[obstacle, None], paths.y[vehicle] - obstacles.y[obstacle, None]
    cos, sin = np.cos(obstacles.heading[obstacle])[:, None], np.sin(obstacles.heading[obstacle])[:, None]
    beyond = np.maximum(np.abs(x * cos + y * sin) - obstacles.half_length[obstacle, None], 0)
    beside = np.maximum(np.abs(y * cos - x * sin) - obstacles.half_width[obstacle, None], 0)
    inside = beyond * beyond + beside * beside < (room * room)[vehicle, None]
    sample = inside.argmax(axis=1)
    found = inside[np.arange(len(vehicle)), sample]
    vehicle, obstacle, sample = vehicle[found], obstacle[found], sample[found]
    heading = paths.heading[vehicle, sample]
    cos, sin = np.cos(heading), np.sin(heading)
    away_x, away_y = obstacles.x[obstacle] - paths.x[vehicle, sample], obstacles.y[obstacle] - paths.y[vehicle, sample]
    ahead = away_x * cos + away_y * sin
    angle = obstacles.heading[obstacle] - heading
    extent = obstacles.half_length[obstacle] * np.abs(np.cos(angle)) + obstacles.half_width[obstacle] * np.abs(np.sin(angle))
    distance = paths.distance[vehicle, sample]
    gap = distance + ahead - extent - (paths.distance[vehicle, 0] + _BUMPER)
    speed = obstacles.velocity_x[obstacle] * cos + obstacles.velocity_y[obstacle] * sin
    kept = distance + ahead > 0  # obstacles beside, but not farther ahead than the vehicle itself, have to give way
    road = paths.z[vehicle, sample]
    kept &= (obstacles.low[obstacle] < road + _HEADROOM) & (obstacles.high[obstacle] > road + _CLEARANCE)
    return _Hits(vehicle[kept], obstacle[kept], gap[kept], speed[kept])


def _near(paths: _Paths, obstacles: Obstacles, room: Floats) -> tuple[Integers, Integers]:
    """Find pairs of vehicles, ascending, and obstacles near their paths."""
    left, right, low, high = paths.x.min(axis=1), paths.x.max(axis=1), paths.y.min(axis=1), paths.y.max(axis=1)
    radius = np.hypot(obstacles.half_length, obstacles.half_width)
    most = float(radius.max(initial=0))
    order = np.argsort(obstacles.x, kind="stable")
    x = obstacles.x[order]
    begin = np.searchsorted(x, left - room - most)
    counts = np.searchsorted(x, right + room + most) - begin
    vehicle = np.repeat(np.arange(len(counts)), counts)
    obstacle = order[np.arange(counts.sum()) + np.repeat(begin - (np.cumsum(counts) - counts), counts)]
    near = radius[obstacle] + room[vehicle]
    y = obstacles.y[obstacle]
    close = (y > low[vehicle] - near) & (y < high[vehicle] + near)
    return vehicle[close], obstacle[close]
