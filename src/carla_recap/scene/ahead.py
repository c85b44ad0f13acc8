"""The traffic light that an actor drives towards."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.replay.pose import LOCATION, YAW, right_handed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.frame import Frame
    from carla_recap.replay import SceneBatch
    from carla_recap.util.arrays import Floats, Indices

    StopPoints = Mapping[int, Floats]

NO_LIGHT: Final = -1

_REACH: Final = 60.0  # m; lights farther away are not ahead
_PASSED: Final = 2.0  # m behind the stop line up to which its light is still ahead
_WIDTH: Final = 2.2  # m from the middle of a lane to its edge, and a little more
_SPREAD: Final = 0.1  # m to the side for each metre ahead, because roads bend
_LEVEL: Final = 4.0  # m to the road of another level
_SLOPE: Final = 0.1  # of roads, at most
_CONE: Final = math.tan(math.radians(25))  # without stop lines: the same for the light itself
_FACING: Final = math.cos(math.radians(60))
_ACROSS: Final = math.radians(90)  # the heading of the lane, from that of its light
_EARLY: Final = 1.0  # s from the first spawns until their volumes are recorded


def stop_points(reader: Reader) -> dict[int, Floats]:
    """Return the points on the lanes at which traffic lights stop cars, if they are recorded: by id, (n, 3) in m.

    They are the centres of the trigger volumes at the start of a recording.
    """
    stops: dict[int, Floats] = {}
    for frame in reader.frames(("trigger_volumes",), sparse=True, stop=_EARLY):
        add_stop_points(stops, frame)
    return stops


def add_stop_points(stops: dict[int, Floats], frame: Frame) -> None:
    """Add those of a frame; see `stop_points`."""
    volumes = frame["trigger_volumes"]
    for id in np.unique(volumes["id"]).tolist() if len(volumes) else ():
        of_it = volumes[volumes["id"] == id]
        poses = np.zeros((len(of_it), 6))
        poses[:, LOCATION] = np.stack([of_it[axis] for axis in "xyz"], axis=1)
        stops[id] = right_handed(poses)[:, LOCATION]


class LightAheadFinder:
    """Finds the light ahead: the nearest one whose stop line is in front of the actor, on its lane.

    Of a light without a known stop line, its own location counts, if the light faces the actor. For the stops, see
    `stop_points`.
    """

    def __init__(self, stops: StopPoints) -> None:
        self._stops = stops
        self._ids = b""
        self._rows: Indices = np.zeros(0, np.intp)  # of the light of each point
        self._points: Floats = np.zeros((0, 3))
        self._headings: Floats = np.zeros(0)  # of the lanes before the lights, in radians
        self._is_stop: NDArray[np.bool_] = np.zeros(0, np.bool_)

    def find(self, batch: SceneBatch, poses: Floats) -> tuple[Indices, Floats]:
        """Return the position of the light ahead in `batch.light_states`, and how far ahead it is in m, for each scene.

        Without one, these are `NO_LIGHT` and NaN. The poses are in m and degrees, right-handed, (scenes, 6).
        """
        ids = batch.light_states["id"][0]
        if ids.tobytes() != self._ids:
            self._ids = ids.tobytes()
            self._locate(batch, ids.tolist())
        found, distance = np.full(len(poses), NO_LIGHT), np.full(len(poses), np.nan)
        known = np.flatnonzero(np.isfinite(poses).all(axis=1))
        if not len(known) or not len(self._points):
            return found, distance
        low, high = poses[known, :2].min(axis=0) - _REACH, poses[known, :2].max(axis=0) + _REACH
        near = np.flatnonzero(((self._points[:, :2] >= low) & (self._points[:, :2] <= high)).all(axis=1))
        if not len(near):
            return found, distance
        away = self._points[near] - poses[known, None, LOCATION]
        yaw = np.radians(poses[known, YAW, None])
        cos, sin = np.cos(yaw), np.sin(yaw)
        forward, aside = away[..., 0] * cos + away[..., 1] * sin, np.abs(away[..., 1] * cos - away[..., 0] * sin)
        is_stop = self._is_stop[near]
        turn = np.cos(yaw - self._headings[near])
        on_lane = (forward > -_PASSED) & (aside < _WIDTH + _SPREAD * np.abs(forward)) & (turn > -_FACING)
        facing = (forward > 0) & (aside < _WIDTH + _CONE * forward) & (turn > _FACING)
        level = np.abs(away[..., 2]) < _LEVEL + _SLOPE * np.abs(forward)
        forward[~(level & (forward < _REACH) & np.where(is_stop, on_lane, facing))] = np.inf
        best = forward.argmin(axis=1)
        least = forward[np.arange(len(known)), best]
        found_any = np.isfinite(least)
        found[known[found_any]] = self._rows[near[best[found_any]]]
        distance[known[found_any]] = least[found_any]
        return found, distance

    def _locate(self, batch: SceneBatch, ids: list[int]) -> None:
        rows, points, headings, is_stop = [], [], [], []
        for row, id in enumerate(ids):
            pose = batch.pose_of(id, 0)
            if pose is None:
                continue
            moved = right_handed(pose)
            heading = math.radians(moved[YAW]) + _ACROSS
            each = self._stops.get(id, moved[None, LOCATION])
            rows += [row] * len(each)
            points.append(each)
            headings += [heading] * len(each)
            is_stop += [id in self._stops] * len(each)
        finite = np.isfinite(np.concatenate(points)).all(axis=1) if points else np.zeros(0, np.bool_)
        self._rows, self._points = np.array(rows, np.intp)[finite], np.concatenate([np.zeros((0, 3)), *points])[finite]
        self._headings, self._is_stop = np.array(headings)[finite], np.array(is_stop, np.bool_)[finite]
