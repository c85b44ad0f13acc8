"""What drivers perceive: vehicles, walkers and props as obstacles, and which of them lie on the paths ahead."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

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
_LONG: Final = 8.0  # m²: the room, in m of width by curvature, that a vehicle needs to count as long
_LANE: Final = 1.9  # m: half of the width of a lane
_BESIDE: Final = 2.0  # m along a path: nearer samples of two paths are beside each other
_SLOW: Final = 0.5  # m/s: the least speed at which a vehicle is taken to reach a bend
_MOVING: Final = 2.0  # m/s: faster obstacles count as moving on


class Obstacles(NamedTuple):
    """Upright boxes, as arrays with a value for each: centre, heading in radians, size, velocity in m/s, range of z."""

    x: Floats
    y: Floats
    heading: Floats
    half_length: Floats
    half_width: Floats
    velocity_x: Floats
    velocity_y: Floats
    low: Floats
    high: Floats

    def swept(self, seconds: Floats) -> Obstacles:
        """Return the boxes that contain these for some time, if they go straight on."""
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        half = (self.velocity_x * cos + self.velocity_y * sin) * seconds / 2
        x, y, half_length = self.x + half * cos, self.y + half * sin, self.half_length + np.abs(half)
        return self._replace(x=x, y=y, half_length=half_length)


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
        vehicles = _vehicles(episode.vehicles)
        if not driven.all():
            vehicles = vehicles.swept(np.where(driven, 0.0, _VEHICLES_AHEAD))
        return Obstacles(*map(np.concatenate, zip(vehicles, _walkers(episode.walkers), self._props, strict=True)))


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
    return Obstacles(*np.array(rows, np.float64).reshape(-1, len(Obstacles._fields)).T)


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
        network.height[index],
    )
    margin = np.maximum(_MARGIN - (_MARGIN - _LEAST_MARGIN) * drivers.standing_time / _SQUEEZE, _LEAST_MARGIN)
    hits = _find_hits(paths, cars.rows, obstacles, cars.half_width + margin)
    both: Any = map(np.concatenate, zip(hits, _find_meetings(state, paths, index), strict=True))
    hits = _Hits(*both)
    driver = np.full(len(obstacles.x), NONE)
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
    """Samples of the paths ahead of vehicles, (vehicles, samples): distances from their origins, places and headings."""

    distance: Floats
    x: Floats
    y: Floats
    heading: Floats
    z: Floats


class _Hits(NamedTuple):
    """Obstacles, by index, on the paths of vehicles, by the rows of their drivers, as arrays with a value for each pair.

    The gap is the distance from the front end to the obstacle along the path, in m; negative if they overlap. The speed is
    that of the obstacle along the path, in m/s.
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


def _find_meetings(state: AutopilotState, paths: _Paths, index: Integers) -> _Hits:
    """Find where long vehicles have to wait before a bend, by the paths of all and the lane points there.

    Two of them that meet there need more room than their lanes have. The one that would be there later waits for the other.
    """
    cars, drivers = state.cars, state.drivers
    sweep = (cars.wheelbase / 2 + cars.half_length) ** 2 / 4  # room to each side by curvature; see `controls.set_steering`
    long = (sweep > _LONG).nonzero()[0]
    room = cars.half_width[long, None] + np.abs(state.network.curvature[index[long]]) * sweep[long, None]
    barred = np.where(drivers.has_reservation[long], np.inf, drivers.stop_line[long] - state.routes.position[long])
    room[paths.distance[long] > barred[:, None]] = 0.0
    bent = (room.max(axis=1) > _LANE).nonzero()[0]
    if len(bent) < 2:
        return _Hits(*np.empty((4, 0), np.int64))
    paths = _Paths(*(values[long] for values in paths))
    one, other = bent[np.array(np.triu_indices(len(bent), 1))]
    reach = paths.distance[:, -1] + room.max(axis=1) + _BESIDE
    apart = np.hypot(paths.x[one, 0] - paths.x[other, 0], paths.y[one, 0] - paths.y[other, 0])
    one, other = one[apart < reach[one] + reach[other]], other[apart < reach[one] + reach[other]]
    _, x, y, turn, z = (values[other, None] - values[one, :, None] for values in paths)
    cos, sin = np.cos(paths.heading[one])[:, :, None], np.sin(paths.heading[one])[:, :, None]
    own, theirs = room[one, :, None], room[other, None]
    tight = (np.abs(y * cos - x * sin) < own + theirs) & (np.abs(x * cos + y * sin) < _BESIDE)
    tight &= (np.cos(turn) < 0) & (np.abs(z) < _HEADROOM) & (own > _LANE) & (theirs > 0)
    found = tight.any(axis=(1, 2))
    one, other, tight = one[found], other[found], tight[found]
    begin = paths.distance[one, tight.any(axis=2).argmax(axis=1)], paths.distance[other, tight.any(axis=1).argmax(axis=1)]
    rows, pair = long[np.array((one, other))], np.arange(len(one))
    gap = np.array(begin) - cars.half_length[rows]
    late = (gap / np.maximum(cars.speed[rows], _SLOW)).argmax(axis=0)
    waits, goes = rows[late, pair], rows[1 - late, pair]
    return _Hits(waits, cars.rows[goes], gap[late, pair] - cars.half_length[goes], np.zeros(len(pair)))


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
