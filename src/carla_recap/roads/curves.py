"""The reference lines of roads: lines, arcs, spirals and cubics by the distance along them; and cubic profiles.

Units are m and radians; axes are right-handed: x forward, y left.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import ArrayLike

    from carla_recap.util.arrays import Floats

    Coefficients = tuple[float, float, float, float]
    Rounding = Callable[[ArrayLike], Floats]

PARAMETERS: Final[dict[str, tuple[str, ...]]] = {
    "line": (),
    "arc": ("curvature",),
    "spiral": ("curvStart", "curvEnd"),
    "poly3": ("a", "b", "c", "d"),
    "paramPoly3": ("aU", "bU", "cU", "dU", "aV", "bV", "cV", "dV"),
}
"""The parameters of each kind of curve, as OpenDRIVE names them."""

_MAX_TURN: Final = 100.0  # radians of a curve
_MAX_SLOPE: Final = 10.0  # m that a term of a cubic may add for each m along it
_STRAIGHT: Final = 1e-9  # 1/m
_SPIRAL_STEP: Final = 0.5  # m
_SPIRAL_STEPS: Final = (8, 4_000)
_CUBIC_STEP: Final = {"poly3": 0.05, "paramPoly3": 0.5}  # m; CARLA's are 0.01 and 0.5
_CUBIC_STEPS: Final = 5  # at least


class Profile:
    """A piecewise cubic function of the distance along a road: the start and the coefficients of each piece."""

    def __init__(self, records: Iterable[tuple[float, Coefficients]]) -> None:
        ordered = sorted(records, key=lambda record: record[0])
        self.starts = np.array([start for start, _ in ordered])
        self._coefficients = np.array([coefficients for _, coefficients in ordered]).reshape(-1, 4)

    def __call__(self, stations: Floats) -> Floats:
        """Return the values at stations; 0 where there is no record."""
        a, b, c, d, along = self._pieces(stations)
        values: Floats = a + along * (b + along * (c + along * d))
        return values

    def slope(self, stations: Floats) -> Floats:
        """Return the derivatives at stations."""
        _, b, c, d, along = self._pieces(stations)
        slopes: Floats = b + along * (2 * c + along * 3 * d)
        return slopes

    def _pieces(self, stations: Floats) -> tuple[Floats, Floats, Floats, Floats, Floats]:
        """Return the coefficients at stations, and the distances from the starts of their pieces."""
        if not len(self.starts):
            return (*np.zeros((4, 1)), np.zeros(len(stations)))
        index = np.maximum(np.searchsorted(self.starts, stations, "right") - 1, 0)
        return (*self._coefficients[index].T, stations - self.starts[index])


@dataclass(frozen=True, eq=False)
class Curve:
    """A part of a reference line."""

    start: float  # the station at which it begins
    x: float
    y: float
    heading: float  # the direction of its axis u; v is to the left of it
    length: float
    kind: str  # the name of its OpenDRIVE element; a key of `PARAMETERS`
    parameters: tuple[float, ...]
    end: float  # the parameter at the end of a cubic

    def at(self, along: Floats, rounded: Rounding) -> tuple[Floats, Floats, Floats]:
        """Return x, y and heading at distances from the beginning, with rounded terms, as CARLA rounds them."""
        along = np.clip(along, 0.0, self.length)
        if self.kind == "arc" and abs(self.parameters[0]) >= _STRAIGHT:
            return self._on_arc(along, rounded)
        u, v, turn = _LOCAL[self.kind](self, along)
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        x, y = rounded(self.x) + rounded(u * cos - v * sin), rounded(self.y) + rounded(v * cos + u * sin)
        return x, y, self.heading + turn

    def is_drivable(self) -> bool:
        """Return whether the curve turns and bends no more than a road."""
        if self.kind in ("arc", "spiral"):
            return max(map(abs, self.parameters)) * self.length <= _MAX_TURN
        return all(
            abs(value) * self.end ** (power % 4) <= _MAX_SLOPE * (self.length + 1)
            for power, value in enumerate(self.parameters)
        )

    def _on_arc(self, along: Floats, rounded: Rounding) -> tuple[Floats, Floats, Floats]:
        (curvature,) = self.parameters
        radius, start, heading = 1 / curvature, self.heading + np.pi / 2, self.heading + along * curvature
        stop = heading + np.pi / 2
        x = rounded(self.x) + rounded(radius * np.cos(start)) - rounded(radius * np.cos(stop))
        y = rounded(self.y) + rounded(radius * np.sin(start)) - rounded(radius * np.sin(stop))
        return x, y, heading

    def _on_line(self, along: Floats) -> tuple[Floats, Floats, Floats]:
        return along, np.zeros(len(along)), np.zeros(len(along))

    def _on_spiral(self, along: Floats) -> tuple[Floats, Floats, Floats]:
        first, last = self.parameters
        change = (last - first) / max(self.length, 1e-9)
        grid, u, v = self._spiral_points
        return np.interp(along, grid, u), np.interp(along, grid, v), along * (first + along * change / 2)

    @cached_property
    def _spiral_points(self) -> Floats:
        """The distance along the spiral, u and v, (3, n), by Simpson's rule."""
        first, last = self.parameters
        low, high = _SPIRAL_STEPS
        steps = int(min(max(self.length / _SPIRAL_STEP, low), high))
        grid = np.linspace(0.0, self.length, 2 * steps + 1)
        turns = grid * (first + grid * (last - first) / max(self.length, 1e-9) / 2)
        directions = np.stack((np.cos(turns), np.sin(turns)))
        areas = (directions[:, :-2:2] + 4 * directions[:, 1::2] + directions[:, 2::2]) * (self.length / steps / 6)
        return np.concatenate((grid[None, ::2], np.cumsum(np.pad(areas, ((0, 0), (1, 0))), axis=1)))

    def _on_cubic(self, along: Floats) -> tuple[Floats, Floats, Floats]:
        """Interpolate between points; beyond the last one, the curve goes on straight."""
        points = self._cubic_points
        index = np.clip(np.searchsorted(points[0], along, "right") - 1, 0, points.shape[1] - 2)
        before, after = points[:, index], points[:, index + 1]
        share = (along - before[0]) / np.maximum(after[0] - before[0], 1e-12)
        _, u, v, ahead, left = before + share * (after - before)
        return u, v, np.arctan2(left, ahead)

    @cached_property
    def _cubic_points(self) -> Floats:
        """The distance along the cubic, u, v and their derivatives, (5, n), at equal steps of the parameter."""
        p = np.linspace(0.0, self.end, max(int(self.length / _CUBIC_STEP[self.kind]), _CUBIC_STEPS) + 1)
        factors = np.array((0.0, 1.0, 0.0, 0.0, *self.parameters)[-8:]).reshape(2, 4, 1)
        a, b, c, d = factors.swapaxes(0, 1)
        u, v = a + p * (b + p * (c + p * d))
        far = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(u), np.diff(v)))))
        return np.stack((far, u, v, *(b + p * (2 * c + p * 3 * d))))


_LOCAL: Final[dict[str, Callable[[Curve, Floats], tuple[Floats, Floats, Floats]]]] = {
    "line": Curve._on_line,
    "arc": Curve._on_line,
    "spiral": Curve._on_spiral,
    "poly3": Curve._on_cubic,
    "paramPoly3": Curve._on_cubic,
}


def single(values: ArrayLike) -> Floats:
    """Return values in single precision, as CARLA's."""
    rounded: Floats = np.asarray(values, np.float32)
    return rounded


def double(values: ArrayLike) -> Floats:
    """Return values in double precision."""
    return np.asarray(values, np.float64)
