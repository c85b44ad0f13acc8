"""Events and traffic lights: the log, lanes of states, and in the world the marks of collisions and of the light ahead."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.model.records import ActorKind
from carla_recap.queries.kinds import KINDS
from carla_recap.replay import Destroyed, right_handed
from carla_recap.replay.events import Collided
from carla_recap.replay.pose import LOCATION, rotations
from carla_recap.scene import style
from carla_recap.scene.ahead import NO_LIGHT
from carla_recap.scene.appearance import look_of
from carla_recap.scene.captions import EventText, Level, incident_lines
from carla_recap.scene.marks import MARK_RADIUS
from carla_recap.scene.materials import SIGNAL_LAMPS
from carla_recap.scene.state_lanes import NO_COLOR, NONE, incident_lanes, verdict_lanes
from carla_recap.show.rerun import entities
from carla_recap.show.rerun.meshes import circle, model_mesh

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from carla_recap.queries.incidents import Incident
    from carla_recap.queries.verdicts import Verdict
    from carla_recap.scene.captions import Line
    from carla_recap.scene.description import SceneDescription
    from carla_recap.scene.follow import FollowedRecords
    from carla_recap.scene.materials import Color
    from carla_recap.scene.state_lanes import StateLane
    from carla_recap.show.rerun.stream import Stream, TimeColumns, TimePoint
    from carla_recap.util.arrays import Floats


_LEVELS: Final = {
    Level.DEBUG: rr.TextLogLevel.DEBUG,
    Level.INFO: rr.TextLogLevel.INFO,
    Level.WARNING: rr.TextLogLevel.WARN,
    Level.ERROR: rr.TextLogLevel.ERROR,
}

_MARK_ABOVE: Final = 0.02  # m; of the lines of a mark above its location
_CROSS: Final = (0.35, 0.8)  # the ends of the four lines of a mark, as shares of its radius
_DIAGONALS: Final = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) / np.sqrt(2)
_MARK_WIDTH: Final = 0.1  # m; of the lines of a mark
_MARK_CORNERS: Final = 24

_COLLISION: Final = KINDS["collision"].singular  # in a live view
_RING: Final = 1.0  # m; the radius of the ring around the light ahead
_RING_WIDTH: Final = 0.12  # m
_RING_CORNERS: Final = 32
_ABOVE: Final = 1.7  # m; the height of the label above the lamps
_LABEL: Final = (245, 246, 248)


class EventWriter:
    """Writes the log and the collisions; of a live view, the lane of collisions, too."""

    def __init__(self, stream: Stream, *, live: bool = False) -> None:
        self._stream = stream
        self._live = live
        self._text = EventText()
        self._collides = False

    def write(self, description: SceneDescription, times: TimeColumns) -> None:
        """Write scenes."""
        for line in self._text.lines(description.batch.scene(0)):
            self._stream.hold(entities.EVENTS, _log_columns, times.point(0), line)
        if self._live:
            collides = any(isinstance(event, Collided) for event in description.batch.events)
            self._set_collides(collides, times.point(0))
            if len(description) > 1:
                self._set_collides(False, times.point(1))
        for row, locations in description.marks:
            self._mark(locations, times.point(row))

    def write_incidents(self, found: Iterable[Incident], verdicts: Iterable[Verdict], clock: TimeColumns) -> None:
        """Write what happens during the scenes of some times: lines of incidents, lanes of their kinds and of verdicts."""
        found = list(found)
        for row, line in incident_lines(found, clock.seconds):
            self._stream.hold(entities.EVENTS, _log_columns, clock.point(row), line)
        for lane in incident_lanes(found, clock.seconds):
            self._write_lane(f"{entities.INCIDENTS}/{lane.name}", lane, clock)
        for lane in verdict_lanes(verdicts, clock.seconds):
            self._write_lane(entities.verdict(lane.name), lane, clock)

    def _write_lane(self, path: str, lane: StateLane, clock: TimeColumns) -> None:
        colors = {text: lane.color for _, text in lane.states} | dict([lane.calm])
        self._stream.log_static(path, rr.StateConfiguration(values=[*colors], colors=[*colors.values()]))
        for row, text in lane.states:
            self._stream.hold(path, _state_columns, clock.point(row), text)

    def _set_collides(self, collides: bool, time: TimePoint) -> None:
        if collides != self._collides:
            self._collides = collides
            path, colors = f"{entities.INCIDENTS}/{_COLLISION}", [style.COLLISION, NO_COLOR]
            self._stream.log_static(path, rr.StateConfiguration(values=[_COLLISION, NONE], colors=colors))
            self._stream.hold(path, _state_columns, time, _COLLISION if collides else NONE)

    def _mark(self, locations: Floats, time: TimePoint) -> None:
        """Show marks: each one is a ring on the ground with a cross in it, which hide nothing."""
        if not len(locations):
            self._stream.clear(entities.COLLISIONS, time)
            return
        strips = [location + line for location in locations for line in _mark_lines()]
        lines = rr.LineStrips3D(strips, colors=[style.COLLISION], radii=[_MARK_WIDTH / 2])
        self._stream.log(entities.COLLISIONS, time, lines)


def _log_columns(lines: Sequence[Line]) -> Iterable[rr.ComponentColumn]:
    return rr.TextLog.columns(text=[line.text for line in lines], level=[_LEVELS[line.level] for line in lines])


def _state_columns(names: Sequence[str]) -> Iterable[rr.ComponentColumn]:
    return rr.StateChange.columns(state=names)


@cache
def _mark_lines() -> list[Floats]:
    """Return the lines of a mark, from its location."""
    flat = [_closed(circle(_MARK_CORNERS))]
    flat += [np.outer(_CROSS, corner) for corner in _DIAGONALS]
    return [MARK_RADIUS * np.pad(line, ((0, 0), (0, 1))) + (0, 0, _MARK_ABOVE) for line in flat]


def _closed(corners: Floats) -> Floats:
    """Return the corners of a line that ends where it begins."""
    return np.concatenate((corners, corners[:1]))


class TrafficLightWriter:
    """Writes the states of traffic lights whenever they change, each as a lane; their lamps are those of actors."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._last: tuple[bytes, bytes] = (b"", b"")  # ids and states of the last scene
        self._states: dict[int, int] = {}

    def write(self, description: SceneDescription, times: TimeColumns) -> None:
        """Write scenes."""
        batch = description.batch
        for event in batch.events:
            if isinstance(event, Destroyed) and event.id in self._states:
                del self._states[event.id]
                self._stream.clear(entities.state(event.id), times.point(0))
        ids, states = batch.light_states["id"][0], batch.light_states["state"]
        changed = np.zeros(states.shape, np.bool_)
        changed[1:] = states[1:] != states[:-1]
        changed[0] = self._last != (ids.tobytes(), states[0].tobytes())
        self._last = ids.tobytes(), states[-1].tobytes()
        for row, index in zip(*(found.tolist() for found in np.nonzero(changed)), strict=True):
            self._change(int(ids[index]), int(states[row, index]), times.point(row))

    def _change(self, id: int, state: int, time: TimePoint) -> None:
        before = self._states.get(id)
        if before == state:
            return
        if before is None:
            names, colors = zip(*style.LIGHTS, strict=True)
            self._stream.log_static(entities.state(id), rr.StateConfiguration(values=names, colors=colors))
        self._states[id] = state
        self._stream.hold(entities.state(id), _state_columns, time, style.light(state)[0])


class LightAheadWriter:
    """Writes the light ahead of the followed actor: a ring around it with its name, and a lane of states."""

    def __init__(self, stream: Stream) -> None:
        self._stream = stream
        self._begun = False
        self._last: tuple[int, int] | None = None  # id and state
        self._colors: dict[str, Color] = {NONE: NO_COLOR}

    def write(self, description: SceneDescription, times: TimeColumns, followed: FollowedRecords) -> None:
        """Write scenes, given what is recorded of the followed actor."""
        if not description.batch.light_states.shape[1] and self._last is None:
            return
        changed = np.ones(len(description), np.bool_)
        changed[1:] = (np.diff(followed.light) != 0) | (np.diff(followed.light_state) != 0)
        for row in np.flatnonzero(changed).tolist():
            light = int(followed.light[row])
            now = None if light == NO_LIGHT else (light, int(followed.light_state[row]))
            if now != self._last or not self._begun:
                pose = None if now is None else description.pose_of(light, row)
                self._change(now, pose, right_handed(followed.poses[row]), times.point(row))

    def _change(self, now: tuple[int, int] | None, pose: Floats | None, seen_from: Floats, time: TimePoint) -> None:
        """Note which light is ahead, with its state, and show it, given the poses of the light and of the actor."""
        before, self._last, self._begun = self._last, now, True
        text, color = NONE, NO_COLOR
        if now is not None:
            name, color = style.light(now[1])
            text = f"light {now[0]}: {name}"
        if text not in self._colors or not before:
            self._colors[text] = color
            values, colors = list(self._colors), list(self._colors.values())
            self._stream.log_static(entities.LIGHT_AHEAD, rr.StateConfiguration(values=values, colors=colors))
        self._stream.hold(entities.LIGHT_AHEAD, _state_columns, time, text)
        if pose is not None:
            lamps = pose[LOCATION] + rotations(pose) @ _middle_of_lamps()
            self._stream.log(entities.AHEAD, time, *_ring(lamps, seen_from, text, color))
        elif before is not None:
            self._stream.clear(entities.AHEAD, time)


@cache
def _middle_of_lamps() -> Floats:
    """Return the middle of the lamps of a traffic light, in its own axes, in m."""
    look = look_of("traffic.traffic_light", ActorKind.TRAFFIC_LIGHT, {})
    assert look is not None
    mesh = model_mesh(look)
    return np.asarray(mesh.vertices[np.isin(mesh.materials, SIGNAL_LAMPS)].mean(axis=0), np.float64)


def _ring(center: Floats, seen_from: Floats, text: str, color: Color) -> list[rr.AsComponents]:
    """Return an upright ring that faces a pose, and a label above it."""
    away = center[:2] - seen_from[:2]
    across = np.array((-away[1], away[0], 0.0)) / max(float(np.hypot(*away)), 1e-6)
    points = center + _RING * _closed(circle(_RING_CORNERS)) @ np.stack((across, (0, 0, 1.0)))
    return [
        rr.LineStrips3D([points], colors=[color], radii=[_RING_WIDTH / 2]),
        rr.Points3D([center + np.array((0, 0, _ABOVE))], colors=[_LABEL], radii=[0], labels=[text], show_labels=True),
    ]
