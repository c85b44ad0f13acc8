"""Lane changes: which vehicles change lanes, and the path from beside a lane to its centre.

On that path, which is also taken when driving begins beside a lane, the lateral offset is a polynomial of the fifth degree
of the distance along the lane. It begins at the offset and in the direction of the vehicle, and ends on the centre and
along it, without curvature at either end.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.traffic.autopilot.drivers import NONE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.sim.traffic.autopilot.drivers import DrivenVehicles, Drivers
    from carla_recap.sim.traffic.autopilot.routes import LaneNetwork, Routes

    Flags = NDArray[np.bool_]
    Floats = NDArray[np.float64]

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


def start_transition(drivers: Drivers, row: int, position: float, speed: float, offset: float, slope: float) -> None:
    """Start the transition of a vehicle to the centre of its lane.

    Args:
        drivers: The drivers.
        row: The row of the vehicle's driver.
        position: The position of the vehicle along its route, in m.
        speed: The speed of the vehicle in m/s.
        offset: Its offset to the right of the lane's centre, in m.
        slope: The change of that offset per m along the lane.
    """
    length = max(_DURATION * speed, _LEAST_ASPECT * abs(offset), _LEAST_LENGTH)
    drivers.transition_start[row], drivers.transition_length[row] = position, length
    drivers.transition_offset[row], drivers.transition_slope[row] = offset, slope * length


def transition_progress(drivers: Drivers, position: Floats) -> Floats:
    """Return the share of the transitions that the vehicles have completed; from 1 on, a transition is over."""
    progress: Floats = (position - drivers.transition_start) / drivers.transition_length
    return progress


def lateral_offset(offset: Floats, slope: Floats, progress: Floats) -> Floats:
    """Return the offset of transitions to the right of the lane's centre, in m.

    Args:
        offset: The offset at the start, in m.
        slope: The slope at the start, as the change of the offset over the whole length, in m.
        progress: The share of the transition that is completed.
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
    """Shift poses on the centres of lanes to the paths of the vehicles in transition.

    Args:
        drivers: The drivers.
        position: The positions of the vehicles along their routes, (vehicles,).
        ahead: The distances from the vehicles to the poses, (vehicles, any).
        poses: X, y and heading of the poses, (vehicles, any) each; they are changed.

    Returns:
        The poses.
    """
    rows = np.flatnonzero(transition_progress(drivers, position) < 1)
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


def lane_changes(
    cars: DrivenVehicles,
    leader: tuple[Floats, Floats],
    drivers: Drivers,
    routes: Routes,
    network: LaneNetwork,
    vehicles: Vehicles,
    decision: int,
) -> Iterator[tuple[int, int]]:
    """Find the vehicles that change lanes now, to overtake.

    Args:
        cars: The driven vehicles.
        leader: The distances to the nearest obstacles on their paths in m, and the speeds of these in m/s.
        drivers: The drivers.
        routes: Their routes.
        network: The lanes.
        vehicles: All vehicles.
        decision: The number of the decision; at each, another part of the drivers considers it.

    Yields:
        The row of a driver, and the lane to change to.
    """
    lane = routes.lanes[:, 0]
    left, right = network.left[lane], network.right[lane]
    able: Flags = (np.arange(len(lane)) + decision) % _TURNS == 0
    able &= ((left != NONE) | (right != NONE)) & (transition_progress(drivers, routes.position) >= 1)
    able = able & (drivers.stop_line - routes.position - cars.half_length > _BEFORE_STOP_LINE)
    able = (
        able & np.isinf(drivers.junction_end) & (np.abs(drivers.lateral_offset) < _CENTRED) & _is_straight(routes, network)
    )
    distance, speed = leader
    slowed = (distance < _NEAR * drivers.desired_gap(cars.speed, cars.speed)) & (speed < _SLOW * network.limit[lane])
    for row in np.flatnonzero(able & slowed).tolist():
        for side, other in ((-1, int(left[row])), (1, int(right[row]))):
            if other != NONE and _has_room(cars, row, side, vehicles):
                yield row, other
                break


def _is_straight(routes: Routes, network: LaneNetwork) -> Flags:
    """Return for each route whether it is straight for some distance ahead."""
    ahead = np.broadcast_to(_PREVIEW, (len(routes), len(_PREVIEW)))
    curvature = np.abs(network.curvature(network.points(*routes.locate(ahead)))).max(axis=1)
    straight: Flags = curvature < _STRAIGHT
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
