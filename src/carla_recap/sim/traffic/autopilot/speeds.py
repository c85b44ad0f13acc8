"""How drivers would like to accelerate: for speed limits, curves, what is ahead, and where they have to stop."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.traffic.autopilot.drift import share
from carla_recap.sim.traffic.autopilot.following import HARDEST, STANDING_GAP, behind, towards, wanted_gap
from carla_recap.sim.traffic.autopilot.junctions import BEFORE_LINE
from carla_recap.sim.traffic.autopilot.network import CURVE_BRAKING

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.traffic.autopilot.cars import Cars
    from carla_recap.sim.traffic.autopilot.drivers import Drivers
    from carla_recap.sim.traffic.autopilot.network import Network
    from carla_recap.sim.traffic.autopilot.routes import Routes
    from carla_recap.sim.traffic.autopilot.view import View

    Floats = NDArray[np.float64]

_FORESIGHT: Final = 0.6  # s: for so long ahead a driver minds the speed that is safe
_WALK: Final = 3.0  # m/s: the speed of those who find back to the road
_OVER: Final = -0.5  # m: who is farther than that over where it has to stop, stops at once
_GIVING_UP: Final = -3.0  # m/s²: the braking of those who have no road


def wishes(cars: Cars, view: View, drivers: Drivers, routes: Routes, network: Network) -> Floats:
    """The acceleration that every driver would like to have, in m/s²."""
    wanted = _wanted_speed(cars, drivers, routes, network)
    wish = np.minimum(towards(cars.speed, wanted, drivers), view.limit)
    stop = np.minimum(np.where(drivers.permitted, np.inf, drivers.line), np.where(routes.dead, routes.ends, np.inf))
    gap = stop - routes.along - cars.half_length - BEFORE_LINE
    stopping = behind(gap + STANDING_GAP, wanted_gap(cars.speed, cars.speed, drivers), drivers.acceleration)
    wish = np.minimum(wish, np.where(gap < _OVER, HARDEST, stopping))
    return np.where(drivers.lost, _GIVING_UP, wish)


def _wanted_speed(cars: Cars, drivers: Drivers, routes: Routes, network: Network) -> Floats:
    """What limits and curves allow, here and for what lies ahead, in m/s."""
    soon = _FORESIGHT * cars.speed
    lanes = routes.lanes[:, : routes.known]
    limit = network.limit[lanes] * drivers.eagerness[:, None]
    entry = np.minimum(limit, network.entry_speed[lanes])
    entry[:, 0] = limit[:, 0]
    to_begin = np.maximum(routes.starts[:, : routes.known] - (routes.along + soon)[:, None], 0)
    ahead: Floats = np.sqrt((entry * entry + 2 * CURVE_BRAKING * to_begin).min(axis=1))
    lane, s = routes.locate(soon[:, None])
    wanted: Floats = np.minimum(ahead, network.safe_speed(network.spot(lane[:, 0], s[:, 0])))
    searching = drivers.cautious & (share(drivers, routes.along) < 1)
    return np.minimum(wanted, np.where(searching, _WALK, np.inf))
