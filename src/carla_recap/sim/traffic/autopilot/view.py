"""What drivers know of the way before them: how far it is free, and what that allows them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.sim.traffic.autopilot.drift import bend_aside
from carla_recap.sim.traffic.autopilot.following import behind, wanted_gap
from carla_recap.sim.traffic.autopilot.network import NONE
from carla_recap.sim.traffic.autopilot.sight import Ways, distances, look

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.traffic.autopilot.cars import Cars
    from carla_recap.sim.traffic.autopilot.drivers import Drivers
    from carla_recap.sim.traffic.autopilot.network import Network
    from carla_recap.sim.traffic.autopilot.routes import Routes
    from carla_recap.sim.traffic.autopilot.sight import Boxes, Hits

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

MOVING: Final = -2
"""Instead of a leader: something that no driver of the autopilot moves, but that moves on."""
_NEAREST: Final = 15.0  # m: how far the driver of a standing vehicle looks ahead
_FARTHEST: Final = 120.0  # m: how far any driver does
_FORESIGHT: Final = 1.5  # so many times the gap that a driver wants to what stands
_MARGIN: Final = 0.25  # m: to each side of a vehicle on its way
_LEAST_MARGIN: Final = 0.05  # m: what is left of that after a while of standing
_SQUEEZE: Final = 20.0  # s: how long that takes
_GOING: Final = 2.0  # m/s


class View(NamedTuple):
    """What the drivers see; arrays with a value for each.

    Attributes:
        free: How far the way is free from the front end on, in m; infinity where nothing is seen.
        leader: The driver of the vehicle that ends that; `NONE` where it is something else, `MOVING` if that goes on.
        pace: How fast that moves along the way, in m/s.
        limit: The greatest acceleration that all that is ahead allows, in m/s².
    """

    free: Floats
    leader: Integers
    pace: Floats
    limit: Floats


def see(cars: Cars, drivers: Drivers, routes: Routes, network: Network, boxes: Boxes) -> View:
    """Look along the ways ahead.

    Args:
        cars: The vehicles.
        drivers: Their drivers.
        routes: Their routes.
        network: The lanes.
        boxes: All that there is, the vehicles of the world first.
    """
    horizon = np.minimum(_NEAREST + _FORESIGHT * wanted_gap(cars.speed, cars.speed, drivers), _FARTHEST)
    distance = distances(cars.half_length, horizon)
    point, share = network.spot(*routes.locate(distance))
    ways = Ways(distance, *bend_aside(drivers, routes.along, distance, network.places((point, share))))
    margin = np.maximum(_MARGIN - (_MARGIN - _LEAST_MARGIN) * drivers.stood / _SQUEEZE, _LEAST_MARGIN)
    hits = look(ways, cars.rows, boxes, cars.half_width + margin)
    hits = hits.at_height(network.height(point[hits.vehicle, hits.place]), boxes)
    driver = np.full(len(boxes), NONE)
    driver[cars.rows] = np.arange(len(cars.rows))
    return _sum_up(cars, drivers, hits, driver)


def _sum_up(cars: Cars, drivers: Drivers, hits: Hits, driver: Integers) -> View:
    """What all that is on the ways means; `driver` is that of each box, or `NONE`."""
    count, who = len(cars.rows), hits.vehicle
    limit, free, pace, leader = np.full(count, np.inf), np.full(count, np.inf), np.zeros(count), np.full(count, NONE)
    speed = cars.speed[who]
    wanted = wanted_gap(speed, speed - hits.speed, drivers, who)
    np.minimum.at(limit, who, behind(hits.gap, wanted, drivers.acceleration[who]))
    far_first = np.lexsort((hits.gap, who))[::-1]  # of several values for a place, the last one stays
    row = who[far_first]
    free[row], pace[row], leader[row] = hits.gap[far_first], hits.speed[far_first], driver[hits.box[far_first]]
    leader[(leader == NONE) & (pace > _GOING)] = MOVING
    return View(free, leader, pace, limit)
