"""Lane changes: round what is slow or stands ahead, where there is a lane beside, and room on it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.traffic.autopilot import drift
from carla_recap.sim.traffic.autopilot.following import wanted_gap
from carla_recap.sim.traffic.autopilot.network import NONE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.sim.traffic.autopilot.cars import Cars
    from carla_recap.sim.traffic.autopilot.drivers import Drivers
    from carla_recap.sim.traffic.autopilot.network import Network
    from carla_recap.sim.traffic.autopilot.routes import Routes
    from carla_recap.sim.traffic.autopilot.view import View

    Flags = NDArray[np.bool_]

_SLOW: Final = 0.6  # of the speed limit: who is slower is overtaken
_NEAR: Final = 1.5  # so many times the gap that one wants to what stands
_BEFORE_GATE: Final = 40.0  # m: nearer to a line or a junction nobody changes lanes
_STRAIGHT: Final = 1 / 150  # 1/m: where the way bends more, nobody changes lanes
_WAY: Final = (0.0, 15.0, 30.0)  # m ahead, where that is looked at
_CENTRED: Final = 0.5  # m: who is farther from the middle is still busy
_TURNS: Final = 5  # looks, at each of which another part of the drivers thinks about it
_WIDTH: Final = 3.5  # m: from the middle of a lane to that of the next one
_BESIDE: Final = 2.4  # m: who is less far from the middle of the other lane is on it
_ROOM: Final = 3.0  # m: before and behind, at equal speeds
_HEADWAY: Final = 0.8  # s: before and behind, besides
_FORESIGHT: Final = 3.0  # s: for so long somebody faster comes nearer


def lane_changes(
    cars: Cars, view: View, drivers: Drivers, routes: Routes, network: Network, vehicles: Vehicles, look: int
) -> Iterator[tuple[int, int]]:
    """Who changes now to which lane.

    Args:
        cars: The vehicles.
        view: What their drivers see.
        drivers: The drivers.
        routes: Their routes.
        network: The lanes.
        vehicles: All vehicles.
        look: The number of the look.
    """
    lane = routes.lanes[:, 0]
    left, right = network.left[lane], network.right[lane]
    able: Flags = (np.arange(len(lane)) + look) % _TURNS == 0
    able &= ((left != NONE) | (right != NONE)) & (drift.share(drivers, routes.along) >= 1)
    able = able & (drivers.line - routes.along - cars.half_length > _BEFORE_GATE) & np.isinf(drivers.clear_at)
    able = able & (np.abs(drivers.beside) < _CENTRED) & _is_straight(routes, network)
    slowed = view.free < _NEAR * wanted_gap(cars.speed, cars.speed, drivers)
    for row in np.flatnonzero(able & slowed & (view.pace < _SLOW * network.limit[lane])).tolist():
        for side, other in ((-1, int(left[row])), (1, int(right[row]))):
            if other != NONE and _has_room(cars, row, side, vehicles):
                yield row, other
                break


def _is_straight(routes: Routes, network: Network) -> Flags:
    """Whether the ways go straight on for a while."""
    ahead = np.broadcast_to(_WAY, (len(routes), len(_WAY)))
    bend = np.abs(network.bend(network.spot(*routes.locate(ahead)))).max(axis=1)
    straight: Flags = bend < _STRAIGHT
    return straight


def _has_room(cars: Cars, row: int, side: int, vehicles: Vehicles) -> bool:
    """Whether nobody is in the way on the lane to the left (-1) or right (1)."""
    x, y = vehicles.position[:, 0] - cars.x[row], vehicles.position[:, 1] - cars.y[row]
    ahead, right = x * cars.cos[row] + y * cars.sin[row], y * cars.cos[row] - x * cars.sin[row]
    own, room = cars.speed[row], vehicles.half_length + cars.half_length[row] + _ROOM
    before = room + _HEADWAY * own + _FORESIGHT * np.maximum(own - vehicles.speed, 0)
    after = room + _HEADWAY * vehicles.speed + _FORESIGHT * np.maximum(vehicles.speed - own, 0)
    blocking = (np.abs(right - side * _WIDTH) < _BESIDE) & (ahead < before) & (ahead > -after)
    blocking[cars.rows[row]] = False
    return not bool(blocking.any())
