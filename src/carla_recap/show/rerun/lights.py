"""The traffic lights, each with a lamp and a lane of states; and the one ahead of the followed actor."""

from __future__ import annotations

from collections import defaultdict
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.model.records import ActorKind
from carla_recap.replay import Destroyed, right_handed
from carla_recap.replay.pose import LOCATION, rotations
from carla_recap.scene import style
from carla_recap.scene.ahead import NO_LIGHT
from carla_recap.scene.appearance import look_of
from carla_recap.scene.materials import MATERIALS, Material, palette
from carla_recap.scene.mesh import Mesh
from carla_recap.show.rerun import paths
from carla_recap.show.rerun.meshes import lamps_of, model_mesh, packed, unlit
from carla_recap.show.rerun.stream import TimeColumns

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.replay import SceneBatch
    from carla_recap.scene.follow import FollowedSeries
    from carla_recap.show.rerun.stream import Stream, TimePoint

OFF: Final = 3
"""The state of a traffic light of which no lamp is lit."""

_MATERIALS: Final = (Material.RED_LAMP, Material.YELLOW_LAMP, Material.GREEN_LAMP)  # by CARLA's states
_MAX_CHANGES: Final = 8192  # the number of changes of states that are held back
_NONE: Final = "none"
_NO_COLOR: Final = (38, 42, 50)
_RING: Final = 1.0  # m; the radius of the ring around the light ahead
_RING_WIDTH: Final = 0.12  # m
_ABOVE: Final = 1.7  # m; the height of the label above the lamp
_CORNERS: Final = 32
_LABEL: Final = (245, 246, 248)


class TrafficLightWriter:
    """Writes the lamps and the states of traffic lights, whenever they change.

    Args:
        stream: The stream.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._last: tuple[bytes, bytes] = (b"", b"")  # ids and states of the last scene
        self._states: dict[int, int] = {}
        self._lamps: dict[int, dict[int, NDArray[np.uint8]]] = {}  # the colours of the vertices in each state
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
            names = [style.light(state)[0] for _, state in changes]
            self._stream.columns(paths.state(id), times, rr.StateChange.columns(state=names))
            if id in self._lamps:
                colors = np.concatenate([self._lamps[id].get(state, self._lamps[id][OFF]) for _, state in changes])
                column = rr.Mesh3D.columns(vertex_colors=packed(colors))
                lengths = np.full(len(changes), len(colors) // len(changes))
                self._stream.columns(paths.lamp(id), times, [each.partition(lengths) for each in column])
        self._changes.clear()
        self._count = 0

    def _add(self, id: int, pose: NDArray[np.float64] | None, time: TimePoint) -> None:
        names, colors = zip(*style.LIGHTS, strict=True)
        self._stream.log_static(paths.state(id), rr.StateConfiguration(values=names, colors=colors))
        self._lamps.pop(id, None)
        if pose is None or not np.isfinite(pose).all():
            return
        lamps, self._lamps[id] = _lamps_at(pose)
        self._stream.log(paths.lamp(id), time, unlit(lamps))

    def _remove(self, id: int, time: TimePoint) -> None:
        self.flush()
        del self._states[id]
        self._stream.clear(paths.lamp(id), time)
        self._stream.clear(paths.state(id), time)


class LightAheadWriter:
    """Writes the light ahead of the followed actor: a ring around it with its name, and a lane of states.

    Args:
        stream: The stream.
    """

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._begun = False
        self._last: tuple[int, int] | None = None  # id and state
        self._changes: list[tuple[TimePoint, str]] = []
        self._colors: dict[str, style.Color] = {_NONE: _NO_COLOR}

    def write(self, batch: SceneBatch, times: TimeColumns, series: FollowedSeries) -> None:
        """Write scenes, given the series of the followed actor."""
        if not batch.light_states.shape[1] and self._last is None:
            return
        changed = np.ones(len(batch), np.bool_)
        changed[1:] = (np.diff(series.light) != 0) | (np.diff(series.light_state) != 0)
        for row in np.flatnonzero(changed).tolist():
            light = int(series.light[row])
            now = None if light == NO_LIGHT else (light, int(series.light_state[row]))
            if now != self._last or not self._begun:
                self._change(now, batch, row, right_handed(series.poses[row]), times.point(row))

    def flush(self) -> None:
        """Write what is held back."""
        if self._changes:
            times = TimeColumns.of_points(time for time, _ in self._changes)
            names = [name for _, name in self._changes]
            self._stream.columns(paths.LIGHT_AHEAD, times, rr.StateChange.columns(state=names))
        self._changes.clear()

    def _change(
        self, now: tuple[int, int] | None, batch: SceneBatch, row: int, pose: NDArray[np.float64], time: TimePoint
    ) -> None:
        before, self._last, self._begun = self._last, now, True
        text, color = _NONE, _NO_COLOR
        if now is not None:
            name, color = style.light(now[1])
            text = f"light {now[0]}: {name}"
        if text not in self._colors or not before:
            self._colors[text] = color
            values = list(self._colors)
            config = rr.StateConfiguration(values=values, colors=list(self._colors.values()))
            self._stream.log_static(paths.LIGHT_AHEAD, config)
        self._changes.append((time, text))
        light = None if now is None else batch.pose_of(now[0], row)
        if now is None or light is None or not np.isfinite(light).all():
            if before is not None:
                self._stream.clear(paths.AHEAD, time)
            return
        self._stream.log(paths.AHEAD, time, *_ring(lamp_of(light), pose, text, color))


def lamp_of(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the middle of the lamps of a traffic light in m, right-handed, from its pose in cm and degrees."""
    return np.asarray(_lamps_at(pose)[0].vertices.mean(axis=0), np.float64)


def _lamps_at(pose: NDArray[np.float64]) -> tuple[Mesh, dict[int, NDArray[np.uint8]]]:
    """Return the lamps of a traffic light in the world, and the colours of their vertices in each state."""
    lamps, colors = _lamps()
    moved = right_handed(pose)
    turn = rotations(moved).astype(np.float32)
    vertices = (lamps.vertices @ turn.T + moved[LOCATION]).astype(np.float32)
    return Mesh(vertices, lamps.normals @ turn.T, lamps.materials, lamps.triangles), colors


@cache
def _lamps() -> tuple[Mesh, dict[int, NDArray[np.uint8]]]:
    look = look_of("traffic.traffic_light", ActorKind.TRAFFIC_LIGHT, {})
    assert look is not None
    mesh = model_mesh(look)
    lamps = Mesh.concatenate([lamp for material in _MATERIALS if (lamp := lamps_of(mesh, material)) is not None])
    colors = {}
    for state in (*range(len(_MATERIALS)), OFF):
        shown = palette()
        for number, material in enumerate(_MATERIALS):
            glow = MATERIALS[material].glow
            if number == state and glow is not None:
                shown[material] = glow
        colors[state] = shown[lamps.materials]
    return lamps, colors


def _ring(
    center: NDArray[np.float64], seen_from: NDArray[np.float64], text: str, color: style.Color
) -> list[rr.AsComponents]:
    """Return an upright ring that faces a pose, and a label above it."""
    away = center[:2] - seen_from[:2]
    across = np.array((-away[1], away[0], 0.0)) / max(float(np.hypot(*away)), 1e-6)
    angles = np.linspace(0, 2 * np.pi, _CORNERS + 1)[:, None]
    points = center + _RING * (np.cos(angles) * across + np.sin(angles) * np.array((0, 0, 1.0)))
    return [
        rr.LineStrips3D([points], colors=[color], radii=[_RING_WIDTH / 2]),
        rr.Points3D([center + np.array((0, 0, _ABOVE))], colors=[_LABEL], radii=[0], labels=[text], show_labels=True),
    ]
