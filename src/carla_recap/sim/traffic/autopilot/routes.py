"""The lanes of a town as drivers need them, the routes of the driven vehicles over them, and changes of the lane.

On the path from beside a lane to its centre, which is also taken when driving begins there, the lateral offset is a
polynomial of the fifth degree of the distance along the lane. It begins at the offset and in the direction of the vehicle,
and ends on the centre and along it, without curvature at either end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.sim.town.loading import main_lanes
from carla_recap.sim.traffic.autopilot.drivers import NONE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.sim.town.lanes import Lane
    from carla_recap.sim.town.loading import Town
    from carla_recap.sim.traffic.autopilot.drivers import DrivenVehicles, Drivers
    from carla_recap.util.arrays import Booleans, Floats, Integers

    Points = tuple[Integers, Floats]

CURVE_BRAKING: Final = 1.8  # m/s², before a curve or a lower limit
_CURVE_ACCELERATION: Final = 2.4  # m/s² sideways: what drivers of cars accept in town
_SMOOTHING: Final = 5.0  # m: the length over which the curvature is averaged
_STRAIGHT_SPEED: Final = 70.0  # m/s, where a lane is straight
_WRONG_WAY_COST: Final = 60.0  # m²: the cost of a lane in the opposite direction, when the nearest one is looked for
_MAX_LANES: Final = 24  # lanes of a route that are known at a time, the current one first
_LEAST_AHEAD: Final = 160.0  # m of a route that are known, if the number of lanes allows it
_AHEAD: Final = 200.0  # m to which a route is extended when it has become shorter than that
_DURATION: Final = 3.5  # s of a transition
_LEAST_ASPECT: Final = 3.0  # length of a transition, as a multiple of its lateral offset
_LEAST_LENGTH: Final = 6.0  # m of a transition
_SLOW: Final = 0.6  # of the speed limit: slower vehicles are overtaken
_NEAR: Final = 1.5  # distance of obstacles that are overtaken, as a multiple of the desired gap
_BEFORE_STOP_LINE: Final = 40.0  # m before a stop line, where no vehicle changes lanes
_STRAIGHT: Final = 1 / 150  # 1/m: the greatest curvature where vehicles change lanes
_PREVIEW: Final = (0.0, 15.0, 30.0)  # m ahead, where the curvature is looked at
_CENTRED: Final = 0.5  # m: vehicles with a greater lateral offset have not completed their transition
_TURNS: Final = 5  # decisions, at each of which another part of the drivers considers a lane change
_LANE_WIDTH: Final = 3.5  # m between the centres of adjacent lanes
_OCCUPIED: Final = 2.4  # m from the centre of a lane: nearer vehicles occupy it
_ROOM: Final = 3.0  # m before and behind, at equal speeds
_HEADWAY: Final = 0.8  # s before and behind, in addition
_FORESIGHT: Final = 3.0  # s for which a faster vehicle is taken to come nearer


class LaneNetwork:
    """The lanes of a town as arrays, with a row for each lane or each of its points.

    A position on a lane is given by two values: the index of the lane point at or before it, and the share of the distance
    to the next point; `points` finds them.

    Attributes:
        points: Returns the points for distances along lanes.
        limit: Returns the speed limits at distances along lanes, in m/s.
        curvature: The curvature at each point in 1/m, positive to the right.
        height: The z of each point, in m.
        length: The length of each lane in m.
        entry_limit: The speed limit at the beginning of each lane in m/s.
        entry_speed: The speed that the curves of each lane allow at its beginning, in m/s.
        junction: The junction that each lane belongs to, or `NONE`.
        left: At each point, the adjacent lane on the left that vehicles may change to there, or `NONE`.
        right: The same on the right.
        turn: The turn on each lane that drivers indicate: -1 left, 0 none, 1 right.
        successors: The lanes that follow each lane, without those that lead to a dead end, if there are others.
    """

    def __init__(self, town: Town) -> None:
        lanes = town.lanes
        index = self._index = town.index
        columns = index.points[:, 0], index.points[:, 1], index.heading
        self._columns = [(column.copy(), np.append(np.diff(column), 0.0)) for column in columns]
        curvature = [_curvature(lane) for lane in lanes]
        self.curvature: Floats = np.concatenate(curvature)
        self.height: Floats = index.points[:, 2]
        self.points, self.limit = index.steps, index.limit
        self._safe_speed = np.concatenate([_safe_speed(lane, bend) for lane, bend in zip(lanes, curvature, strict=True)])
        self.length = index.length
        self.entry_limit = index.limits[index.first]
        self.entry_speed = self._safe_speed[index.first]
        self.junction = np.array([NONE if lane.junction is None else lane.junction for lane in lanes], np.int64)
        self.left = np.concatenate([lane.left for lane in lanes])
        self.right = np.concatenate([lane.right for lane in lanes])
        self.turn = np.array([{"left": -1, "straight": 0, "right": 1}[lane.turn] for lane in lanes])
        self.successors = _successors(lanes)

    def poses(self, points: Points) -> tuple[Floats, Floats, Floats]:
        """Return x, y and heading of points."""
        index, share = points
        x, y, heading = (column[index] + share * change[index] for column, change in self._columns)
        return x, y, heading

    def safe_speed(self, points: Points) -> Floats:
        """Return the speed at points that the curves there and ahead on the same lane allow, in m/s."""
        index, share = points
        speed: Floats = self._safe_speed[index] + share * (self._safe_speed[index + 1] - self._safe_speed[index])
        return speed

    def nearest(self, x: float, y: float, z: float, heading: float) -> tuple[int, float]:
        """Return the nearest lane that leads about in the direction of a heading, and the distance along it in m.

        Unlike `LaneIndex.nearest_lane`, it regards the heading however far the lanes are.
        """
        index = self._index
        direction = _WRONG_WAY_COST * (1 - np.cos(index.heading - heading))
        cost = ((index.points - (x, y, z)) ** 2) @ (1.0, 1.0, 0.5) + direction
        point = int(cost.argmin())
        lane = int(index.lane_of[point])
        away = np.array((x, y)) - index.points[point, :2]
        along = away @ (np.cos(index.heading[point]), np.sin(index.heading[point]))
        s = (point - index.first[lane]) * index.spacing[lane] + along
        return lane, float(np.clip(s, 0, self.length[lane]))


def _curvature(lane: Lane) -> Floats:
    """Return the curvature at the points of a lane, averaged over some metres."""
    bend = np.gradient(lane.heading, lane.s)
    half = min(int(_SMOOTHING / 2 / (lane.length / (len(lane.s) - 1))), (len(bend) - 1) // 2)
    padded = np.pad(bend, half, mode="edge")
    smooth: Floats = np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), mode="valid")
    return smooth


def _safe_speed(lane: Lane, curvature: Floats) -> Floats:
    """Return the speeds from which vehicles can slow down for every curve on the rest of a lane."""
    squares = np.minimum(_CURVE_ACCELERATION / np.maximum(np.abs(curvature), 1e-6), _STRAIGHT_SPEED**2)
    reach = squares + 2 * CURVE_BRAKING * lane.s
    return np.sqrt(np.minimum.accumulate(reach[::-1])[::-1] - 2 * CURVE_BRAKING * lane.s)


def _successors(lanes: list[Lane]) -> list[tuple[int, ...]]:
    """Return the successors of each lane, without those that do not lead everywhere, if there are others."""
    main = set(main_lanes(lanes))
    return [tuple(other for other in lane.successors if other in main) or lane.successors for lane in lanes]


class Routes:
    """The routes of the driven vehicles; positions along a route count on from where it began, in m.

    Attributes:
        lanes: The lanes of the routes, the current one first, then `NONE`, (vehicles, most lanes).
        starts: The positions where these lanes begin, then infinity, (vehicles, most lanes).
        ends: The positions where the last of these lanes end, (vehicles,).
        dead_end: Whether no lane follows there, (vehicles,).
        position: The positions of the vehicles, (vehicles,).
        known: The number of lanes of the longest route.
    """

    def __init__(self, network: LaneNetwork, random: np.random.Generator) -> None:
        self._network = network
        self._random = random
        self.lanes: Integers = np.empty((0, _MAX_LANES), np.int64)
        self.starts: Floats = np.empty((0, _MAX_LANES))
        self.ends: Floats = np.empty(0)
        self.dead_end: NDArray[np.bool_] = np.empty(0, np.bool_)
        self.position: Floats = np.empty(0)
        self.known = 1

    def __len__(self) -> int:
        return len(self.position)

    def select(self, rows: Integers) -> None:
        """Keep the routes of some of the vehicles, in a new order."""
        for name in ("lanes", "starts", "ends", "dead_end", "position"):
            setattr(self, name, getattr(self, name)[rows])
        self._count()

    def add(self) -> None:
        """Add an empty route."""
        self.lanes = np.concatenate((self.lanes, np.full((1, _MAX_LANES), NONE)))
        self.starts = np.concatenate((self.starts, np.full((1, _MAX_LANES), np.inf)))
        self.ends = np.append(self.ends, 0.0)
        self.dead_end = np.append(self.dead_end, False)
        self.position = np.append(self.position, 0.0)

    def restart(self, row: int, lane: int, s: float) -> None:
        """Begin a new route at a distance along a lane; positions count on from the present one."""
        self.lanes[row], self.starts[row] = NONE, np.inf
        self.lanes[row, 0], self.starts[row, 0] = lane, self.position[row] - s
        self.ends[row] = self.starts[row, 0] + self._network.length[lane]
        self._extend(row)
        self._count()

    def advance(self, position: Floats) -> Integers:
        """Set the positions of the vehicles, and return the rows of the routes that were extended."""
        self.position = position
        passed = (position >= self.starts[:, 1]).nonzero()[0]
        for row in passed.tolist():
            while position[row] >= self.starts[row, 1]:
                self.lanes[row] = np.append(self.lanes[row, 1:], NONE)
                self.starts[row] = np.append(self.starts[row, 1:], np.inf)
        short: Integers = ((self.ends < position + _LEAST_AHEAD) & ~self.dead_end & (self.lanes[:, -1] == NONE)).nonzero()[0]
        for row in short.tolist():
            self._extend(row)
        if len(passed) or len(short):
            self._count()
        return short

    def locate(self, ahead: Floats) -> tuple[Integers, Floats]:
        """Return the lanes at distances ahead of vehicles, (vehicles, any), and the distances along them."""
        target = self.position[:, None] + ahead
        index = np.zeros(target.shape, np.int64) + np.arange(0, self.lanes.size, _MAX_LANES)[:, None]
        for start in range(1, self.known):
            begun = target >= self.starts[:, start, None]
            if not begun.any():
                break
            index += begun
        return self.lanes.take(index), target - self.starts.take(index)

    def _count(self) -> None:
        self.known = max(int(np.isfinite(self.starts).any(axis=0).sum()), 1)

    def _extend(self, row: int) -> None:
        lanes, starts, length = self.lanes[row], self.starts[row], self._network.length
        used = int((lanes != NONE).sum())
        end = self.ends[row]
        while used < _MAX_LANES and end < self.position[row] + _AHEAD:
            choices = self._network.successors[lanes[used - 1]]
            self.dead_end[row] = not choices
            if not choices:
                break
            choice = choices[0] if len(choices) == 1 else choices[int(self._random.integers(len(choices)))]
            lanes[used], starts[used] = choice, end
            end += length[choice]
            used += 1
        self.ends[row] = end


def start_transition(drivers: Drivers, row: int, position: float, speed: float, offset: float, slope: float) -> None:
    """Start the transition of a vehicle to the centre of its lane, from an offset to its right in m, with a slope per m."""
    length = max(_DURATION * speed, _LEAST_ASPECT * abs(offset), _LEAST_LENGTH)
    drivers.transition_start[row], drivers.transition_length[row] = position, length
    drivers.transition_offset[row], drivers.transition_slope[row] = offset, slope * length


def transition_progress(drivers: Drivers, position: Floats) -> Floats:
    """Return the share of the transitions that the vehicles have completed; from 1 on, a transition is over."""
    progress: Floats = (position - drivers.transition_start) / drivers.transition_length
    return progress


def lateral_offset(offset: Floats, slope: Floats, progress: Floats) -> Floats:
    """Return the offset of transitions to the right of the lane's centre, in m, by the share that is completed.

    The offset is that at the start in m, and the slope the change there over the whole length, in m.
    """
    x = np.minimum(np.maximum(progress, 0), 1)
    cube = x * x * x
    right: Floats = offset * (1 - cube * (10 - x * (15 - 6 * x))) + slope * (x - cube * (6 - x * (8 - 3 * x)))
    return right


def _lateral_slope(offset: Floats, slope: Floats, progress: Floats) -> Floats:
    """Return the slope of `lateral_offset`, in m over the whole length."""
    x = np.minimum(np.maximum(progress, 0), 1)
    square = x * x
    change: Floats = -30 * offset * square * (1 - x) ** 2 + slope * (1 - square * (18 - x * (32 - 15 * x)))
    return change


def shift_poses(
    drivers: Drivers, position: Floats, ahead: Floats, poses: tuple[Floats, Floats, Floats]
) -> tuple[Floats, Floats, Floats]:
    """Shift poses on the centres of lanes, (vehicles, any), to the paths of vehicles in transition; they are changed."""
    rows = (transition_progress(drivers, position) < 1).nonzero()[0]
    if len(rows):
        x, y, heading = poses
        columns = drivers.transition_length, drivers.transition_offset, drivers.transition_slope
        length, offset, slope = (column[rows, None] for column in columns)
        progress = (position[rows, None] + ahead[rows] - drivers.transition_start[rows, None]) / length
        right = lateral_offset(offset, slope, progress)
        x[rows] -= right * np.sin(heading[rows])
        y[rows] += right * np.cos(heading[rows])
        heading[rows] += np.arctan(_lateral_slope(offset, slope, progress) / length)
    return poses


class AutopilotState(NamedTuple):
    """The driven vehicles at the beginning of a step, with their drivers, routes and lanes; and all vehicles."""

    cars: DrivenVehicles
    drivers: Drivers
    routes: Routes
    network: LaneNetwork
    vehicles: Vehicles


def lane_changes(state: AutopilotState, leader: tuple[Floats, Floats], decision: int) -> Iterator[tuple[int, int]]:
    """Yield the rows of the drivers that change lanes now, to overtake, and the lanes to change to.

    The leader is the distances to the nearest obstacles on their paths in m, and the speeds of these in m/s. At each
    decision, which are numbered, another part of the drivers considers it.
    """
    cars, drivers, routes, network, vehicles = state
    lane = routes.lanes[:, 0]
    s = routes.position - routes.starts[:, 0]
    point = network.points(lane, s)[0]
    left, right = network.left[point], network.right[point]
    able: Booleans = (np.arange(len(lane)) + decision) % _TURNS == 0
    able &= ((left != NONE) | (right != NONE)) & (transition_progress(drivers, routes.position) >= 1)
    able &= drivers.stop_line - routes.position - cars.half_length > _BEFORE_STOP_LINE
    able &= np.isinf(drivers.junction_end) & (np.abs(drivers.lateral_offset) < _CENTRED)
    distance, speed = leader
    limit = network.limit(lane, s)
    slowed = (distance < _NEAR * drivers.desired_gap(cars.speed, cars.speed)) & (speed < _SLOW * limit)
    able &= slowed
    if able.any():
        able &= _is_straight(routes, network)
    for row in able.nonzero()[0].tolist():
        for side, other in ((-1, int(left[row])), (1, int(right[row]))):
            if other != NONE and _has_room(cars, row, side, vehicles):
                yield row, other
                break


def _is_straight(routes: Routes, network: LaneNetwork) -> Booleans:
    """Return for each route whether it is straight for some distance ahead."""
    ahead = np.broadcast_to(_PREVIEW, (len(routes), len(_PREVIEW)))
    curvature = np.abs(network.curvature[network.points(*routes.locate(ahead))[0]]).max(axis=1)
    straight: Booleans = curvature < _STRAIGHT
    return straight


def _has_room(cars: DrivenVehicles, row: int, side: int, vehicles: Vehicles) -> bool:
    """Return whether there is room on the lane to the left (-1) or right (1)."""
    x, y = vehicles.position[:, 0] - cars.x[row], vehicles.position[:, 1] - cars.y[row]
    ahead, right = x * cars.cos[row] + y * cars.sin[row], y * cars.cos[row] - x * cars.sin[row]
    own, room = cars.speed[row], vehicles.half_length + cars.half_length[row] + _ROOM
    before = room + _HEADWAY * own + _FORESIGHT * np.maximum(own - vehicles.speed, 0)
    after = room + _HEADWAY * vehicles.speed + _FORESIGHT * np.maximum(vehicles.speed - own, 0)
    blocking = (np.abs(right - side * _LANE_WIDTH) < _OCCUPIED) & (ahead < before) & (ahead > -after)
    blocking[cars.rows[row]] = False
    return not bool(blocking.any())
