"""The twin of `RoadNetwork.lanes_at`: a point is compared with every piece of the roads."""

from __future__ import annotations

from typing import Any

import numpy as np

from carla_recap.roads.network import BOTH_WAYS, DRIVING, REACH, RoadNetwork

_LEVELS = 3.0  # m
_AGAINST = 1.5  # m
_INSIDE = 1e-3  # m


def lane_position(roads: RoadNetwork, point: Any, heading: float | None = None) -> dict[str, Any]:
    """Return the lanes of least cost for a point, how far it is beside each and outside all, and if a junction has it."""
    pieces, lanes = roads.pieces, roads.lanes[roads.pieces["lane"]]
    lateral, away, turn = _beside(pieces, point)
    outside = away.min(initial=np.inf)
    cost = away + 1e-3 * np.abs(lateral)
    if heading is not None:
        cost += _AGAINST / 2 * (1 - np.cos(heading - turn))
    cost[~np.isin(lanes["kind"], (DRIVING, BOTH_WAYS)) | (away > REACH)] = np.inf
    best = np.isfinite(cost) & (cost <= cost.min(initial=np.inf) + 1e-6)
    return {
        "lanes": set(pieces["lane"][best].tolist()),
        "beside": away[best].tolist(),
        "outside": outside if outside <= REACH else np.inf,
        "in_junction": bool((lanes["junction"][away == 0] >= 0).any()),
    }


def _beside(pieces: Any, point: Any) -> tuple[Any, Any, Any]:
    """Return how far a point is to the left of the middle of each piece, how far outside it, and where the piece leads."""
    x, y = (point[axis] - pieces[name] for axis, name in enumerate(("x0", "y0")))
    ahead_x, ahead_y = pieces["x1"] - pieces["x0"], pieces["y1"] - pieces["y0"]
    length = np.maximum(np.hypot(ahead_x, ahead_y), 1e-9)
    after = x * pieces["left_y0"] - y * pieces["left_x0"]  # the line at the start
    before = (y - ahead_y) * pieces["left_x1"] - (x - ahead_x) * pieces["left_y1"]  # the line at the end
    between = (after >= 0) & (before >= 0)
    share = np.where(between, after / np.maximum(after + before, 1e-9), after > before)
    lateral = ((y - share * ahead_y) * ahead_x - (x - share * ahead_x) * ahead_y) / length
    half = pieces["half0"] + share * (pieces["half1"] - pieces["half0"])
    away = np.hypot(np.maximum(np.maximum(-after, -before), 0.0), np.maximum(np.abs(lateral) - half, 0.0))
    if len(point) > 2:
        away[np.abs(point[2] - pieces["z0"] - share * (pieces["z1"] - pieces["z0"])) > _LEVELS] = np.inf
    return lateral, np.where(away <= _INSIDE, 0.0, away), np.arctan2(ahead_y, ahead_x)
