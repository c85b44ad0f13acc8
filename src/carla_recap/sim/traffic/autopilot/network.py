"""The lanes as a driver sees them: how fast they can be driven, where they lead to, which of them cross."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.sim.town.town import main_lanes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.sim.town.lanes import Lane
    from carla_recap.sim.town.town import Town

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

NONE: Final = -1
CURVE_ACCELERATION: Final = 2.4  # m/s², to the side; what drivers of cars take in town
CURVE_BRAKING: Final = 1.8  # m/s², before a curve or a lower limit
_SMOOTHING: Final = 5.0  # m: the length over which the curvature is averaged
_FASTEST: Final = 70.0  # m/s, where a lane is straight
_AGAINST: Final = 60.0  # m²: what it costs a vehicle to be put on a lane against its direction


class Network:
    """What drivers need to know of a town's lanes, in arrays with a row for each lane or each of its points.

    Attributes:
        length: Of each lane, in m.
        limit: The speed limit of each lane, in m/s.
        entry_speed: How fast one may be where a lane begins, for the sake of its curves, in m/s.
        junction: The junction that each lane lies in, or `NONE`.
        left: The lane to change to on the left, or `NONE`.
        right: The same on the right.
        turn: What a driver indicates there: -1 left, 0 nothing, 1 right.
        onward: The lanes that follow each lane and do not lead to a dead end, if there are such.
    """

    def __init__(self, town: Town) -> None:
        lanes = town.lanes
        self._count = np.array([len(lane.points) for lane in lanes])
        self._first = np.cumsum(self._count) - self._count
        self._lane_of = np.repeat(np.arange(len(lanes)), self._count)
        self._points = np.concatenate([lane.points for lane in lanes])
        self._heading = np.concatenate([lane.heading for lane in lanes])
        self._columns = self._points[:, 0].copy(), self._points[:, 1].copy(), self._heading
        curvature = [_curvature(lane) for lane in lanes]
        self._curvature = np.concatenate(curvature)
        self._safe_speed = np.concatenate([_safe_speed(lane, bend) for lane, bend in zip(lanes, curvature, strict=True)])
        self.length = np.array([lane.length for lane in lanes])
        self._spacing = self.length / (self._count - 1)
        self.limit = np.array([lane.speed_limit for lane in lanes])
        self.entry_speed = self._safe_speed[self._first]
        self.junction = _optional([lane.junction for lane in lanes])
        self.left = _optional([lane.left for lane in lanes])
        self.right = _optional([lane.right for lane in lanes])
        self.turn = np.array([{"left": -1, "straight": 0, "right": 1}[lane.turn] for lane in lanes])
        self.onward = _onward(lanes)

    def spot(self, lane: Integers, s: Floats) -> tuple[Integers, Floats]:
        """The point at or before some distances along lanes, and the share of the way to the next point."""
        steps = np.minimum(np.maximum(s / self._spacing[lane], 0), self._count[lane] - 1.0)
        whole = np.minimum(steps.astype(np.int64), self._count[lane] - 2)
        return self._first[lane] + whole, steps - whole

    def places(self, spot: tuple[Integers, Floats]) -> tuple[Floats, Floats, Floats]:
        """X, y and heading of some spots."""
        point, share = spot
        x, y, heading = (column[point] + share * (column[point + 1] - column[point]) for column in self._columns)
        return x, y, heading

    def height(self, point: Integers) -> Floats:
        """Return the z of some points of lanes."""
        height: Floats = self._points[point, 2]
        return height

    def bend(self, spot: tuple[Integers, Floats]) -> Floats:
        """The curvature at some spots in 1/m, positive to the right."""
        bend: Floats = self._curvature[spot[0]]
        return bend

    def safe_speed(self, spot: tuple[Integers, Floats]) -> Floats:
        """How fast one may be at some spots, for the sake of the curves there and ahead on the same lane."""
        point, share = spot
        speed: Floats = self._safe_speed[point] + share * (self._safe_speed[point + 1] - self._safe_speed[point])
        return speed

    def nearest(self, x: float, y: float, z: float, heading: float) -> tuple[int, float]:
        """The lane nearest to a place, among those that lead about there where one heads: lane and distance along it."""
        cost = ((self._points - (x, y, z)) ** 2) @ (1.0, 1.0, 0.5) + _AGAINST * (1 - np.cos(self._heading - heading))
        point = int(cost.argmin())
        lane = int(self._lane_of[point])
        away = np.array((x, y)) - self._points[point, :2]
        along = away @ (np.cos(self._heading[point]), np.sin(self._heading[point]))
        s = (point - self._first[lane]) * self._spacing[lane] + along
        return lane, float(np.clip(s, 0, self.length[lane]))


def _optional(values: list[int | None]) -> Integers:
    return np.array([NONE if value is None else value for value in values], np.int64)


def _curvature(lane: Lane) -> Floats:
    """The curvature at the points of a lane, averaged over some metres."""
    bend = np.gradient(lane.heading, lane.s)
    half = min(int(_SMOOTHING / 2 / (lane.length / (len(lane.s) - 1))), (len(bend) - 1) // 2)
    padded = np.pad(bend, half, mode="edge")
    smooth: Floats = np.convolve(padded, np.full(2 * half + 1, 1 / (2 * half + 1)), mode="valid")
    return smooth


def _safe_speed(lane: Lane, bend: Floats) -> Floats:
    """The speeds from which one can slow down for every curve that the lane still has."""
    squares = np.minimum(CURVE_ACCELERATION / np.maximum(np.abs(bend), 1e-6), _FASTEST**2)
    reach = squares + 2 * CURVE_BRAKING * lane.s
    return np.sqrt(np.minimum.accumulate(reach[::-1])[::-1] - 2 * CURVE_BRAKING * lane.s)


def _onward(lanes: list[Lane]) -> list[tuple[int, ...]]:
    """The successors of each lane, less those from which one does not come to everywhere again, if there are others."""
    main = set(main_lanes(lanes))
    return [tuple(other for other in lane.successors if other in main) or lane.successors for lane in lanes]
