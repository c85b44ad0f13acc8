"""Those who drive: what they are like, and what they are at."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from carla_recap.sim.columns import Columns
from carla_recap.sim.traffic.autopilot.network import NONE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Flags = NDArray[np.bool_]
    Integers = NDArray[np.int64]


class Drivers(Columns):
    """One driver for each vehicle that the autopilot drives; distances are along its route.

    Attributes:
        id: The vehicle.
        eagerness: The share of the speed limit that the driver drives.
        headway: The time that the driver keeps to what is ahead, in s.
        acceleration: What the driver accelerates with at most, in m/s².
        comfort: The geometric mean of that and of what the driver likes to brake with.
        wish: The acceleration that was last asked for.
        stood: For how long the vehicle has stood, in s.
        lost: Whether there is no lane to drive on.
        cautious: Whether the vehicle has to find back to the road.
        beside: How far to the right of the middle of its lane the vehicle is, in m.
        drift_from: Where the way back to the middle of the lane begins.
        drift_length: How long it is.
        offset: How far to the right of the middle it begins, in m.
        slope: See `drift.aside`.
        line: Where to stop at the next gate; infinity where there is none.
        light: The signal that is in force there, or `NONE`.
        must_stop: Whether there is a stop sign, and the vehicle has not stopped yet.
        permitted: Whether the gate may be passed.
        since: When the vehicle first asked for it, in s; infinity as long as it has not.
        clear_at: What the rear end has to have passed to be out of a junction; infinity when it is in none.
    """

    COLUMNS: ClassVar[dict[str, Any]] = {
        "id": np.int64(0),
        "eagerness": 1.0,
        "headway": 1.5,
        "acceleration": 2.0,
        "comfort": 2.0,
        "wish": 0.0,
        "stood": 0.0,
        "lost": False,
        "cautious": False,
        "beside": 0.0,
        "drift_from": 0.0,
        "drift_length": 1.0,
        "offset": 0.0,
        "slope": 0.0,
        "line": np.inf,
        "light": np.int64(NONE),
        "must_stop": False,
        "permitted": False,
        "since": np.inf,
        "clear_at": np.inf,
    }
    id: Integers
    eagerness: Floats
    headway: Floats
    acceleration: Floats
    comfort: Floats
    wish: Floats
    stood: Floats
    lost: Flags
    cautious: Flags
    beside: Floats
    drift_from: Floats
    drift_length: Floats
    offset: Floats
    slope: Floats
    line: Floats
    light: Integers
    must_stop: Flags
    permitted: Flags
    since: Floats
    clear_at: Floats

    def add(self, id: int, random: np.random.Generator) -> None:
        """Add a driver of a random character, for a vehicle."""
        acceleration, braking = random.uniform(1.6, 2.4), random.uniform(2.5, 3.5)
        self.append_row(
            id=id,
            eagerness=random.uniform(0.85, 1.05),
            headway=random.uniform(1.1, 1.8),
            acceleration=acceleration,
            comfort=(acceleration * braking) ** 0.5,
        )

    def choose(self, rows: Integers) -> None:
        """Go on with some of the drivers, in a new order."""
        for name in self.COLUMNS:
            setattr(self, name, getattr(self, name)[rows])
        self.count = len(rows)
