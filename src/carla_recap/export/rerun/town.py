"""The town: the lines of the road map, and the traffic lights, each with a lamp and a lane of states."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.export import style
from carla_recap.export.rerun import paths
from carla_recap.export.rerun.stream import TimeColumns, screen_radii
from carla_recap.replay import Destroyed, right_handed
from carla_recap.replay.pose import LOCATION

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from carla_recap.export.rerun.stream import Stream, TimePoint
    from carla_recap.maps import RoadMap
    from carla_recap.replay import SceneBatch

_MARGIN: Final = 100.0  # m; the distance from the roads at which an actor is still in the town
_MAP_LINE: Final = (96, 102, 116)
_MAX_CHANGES: Final = 8192  # the number of changes of states that are held back


def is_elsewhere(roads: RoadMap, locations: NDArray[np.float64]) -> bool:
    """Return whether a map is of another town: all of some locations, (n, 3) in m, right-handed, are far from it."""
    lines = [line[:, :2] for name, _, _ in style.ROADS for line in getattr(roads, name) if len(line)]
    if not lines or not len(locations):
        return False
    points = np.concatenate(lines)
    low, high = np.nanmin(points, axis=0) - _MARGIN, np.nanmax(points, axis=0) + _MARGIN
    return not ((locations[:, :2] >= low) & (locations[:, :2] <= high)).all(axis=1).any()


def write_roads(stream: Stream, roads: RoadMap) -> None:
    """Write a road map, in the world and from above."""
    for name, color, width in style.ROADS:
        lines: Sequence[NDArray[np.floating]] = getattr(roads, name)
        if lines:
            stream.log_static(f"{paths.ROADS}/{name}", rr.LineStrips3D(lines, colors=[color], radii=[width / 2]))
    if roads.lane_borders:
        flat = [line[:, :2] * np.array((1, -1)) for line in roads.lane_borders]
        stream.log_static(paths.MAP_ROADS, rr.LineStrips2D(flat, colors=[_MAP_LINE], radii=screen_radii(0.6)))


class TrafficLightWriter:
    """Writes the lamps and the states of traffic lights, whenever they change.

    Args:
        stream: The stream.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._last: tuple[bytes, bytes] = (b"", b"")  # ids and states of the last scene
        self._states: dict[int, int] = {}
        self._changes: defaultdict[int, list[tuple[TimePoint, int]]] = defaultdict(list)
        self._count = 0

    def write(self, batch: SceneBatch, times: TimeColumns) -> None:
        """Write scenes."""
        for event in batch.events:
            if isinstance(event, Destroyed) and event.id in self._states:
                self._remove(event.id, times.point(0))
        ids, states = batch.light_states["id"][0], batch.light_states["state"]
        changed = np.zeros(states.shape, np.bool_)
        changed[1:] = states[1:] != states[:-1]
        changed[0] = self._last != (ids.tobytes(), states[0].tobytes())
        self._last = ids.tobytes(), states[-1].tobytes()
        if not changed.any():
            return
        for row, index in zip(*(found.tolist() for found in np.nonzero(changed)), strict=True):
            id, state = int(ids[index]), int(states[row, index])
            before = self._states.get(id)
            if before == state:
                continue
            if before is None:
                self._add(id, batch.pose_of(id, row), times.point(row))
            self._states[id] = state
            self._changes[id].append((times.point(row), state))
            self._count += 1
        if self._count >= _MAX_CHANGES:
            self.flush()

    def flush(self) -> None:
        """Write what is held back."""
        for id, changes in self._changes.items():
            times = TimeColumns.of_points(time for time, _ in changes)
            names, colors = zip(*(style.light(state) for _, state in changes), strict=True)
            self._stream.columns(paths.state(id), times, rr.StateChange.columns(state=names))
            self._stream.columns(paths.lamp(id), times, rr.Points3D.columns(colors=np.array(colors, np.uint8)))
        self._changes.clear()
        self._count = 0

    def _add(self, id: int, pose: NDArray[np.float64] | None, time: TimePoint) -> None:
        names, colors = zip(*style.LIGHTS, strict=True)
        self._stream.log_static(paths.state(id), rr.StateConfiguration(values=names, colors=colors))
        if pose is None:
            return
        foot = right_handed(pose)[LOCATION]
        top = foot + np.array((0, 0, style.LAMP_UP))
        self._stream.log(
            paths.lamp(id),
            time,
            rr.Points3D.from_fields(positions=[top], radii=[style.LAMP / 2]),
            rr.LineStrips3D([[foot, top]], colors=[style.POLE], radii=[style.POLE_WIDTH / 2]),
        )

    def _remove(self, id: int, time: TimePoint) -> None:
        self.flush()
        del self._states[id]
        self._stream.clear(paths.lamp(id), time)
        self._stream.clear(paths.state(id), time)
