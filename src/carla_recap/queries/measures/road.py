"""Driving in relation to the road: red lights, stop signs, the edge of the road, the direction of lanes, speed limits.

The definitions follow ScenarioRunner's criteria (`RunningRedLightTest`, `RunningStopTest`, `OffRoadTest`) and nuPlan's
metrics (driving direction, drivable area and speed limit compliance); docs/measures.md says where they differ.
"""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.blueprints import box_of
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.motion import MOTION, runs, steps_joined
from carla_recap.queries.measures.definitions import MeasureValues
from carla_recap.queries.measures.motion_table import MotionCollector
from carla_recap.queries.measures.road_signals import LightHistory, StopLines
from carla_recap.roads import network as roads

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.measures.motion_table import MotionTable
    from carla_recap.roads.network import LanePositions, RoadNetwork
    from carla_recap.util.arrays import Booleans, Floats

TYPES: Final = (*MOTION, "light_states")
"""The record types that are read."""

STOPPED: Final = 0.5
"""The speed below which a vehicle has stopped at a stop sign, in m/s."""
STOP_ZONE: Final = 8.0
"""How far before the stop line of a stop sign a vehicle may stop, in m from its front."""
BEFORE: Final = STOP_ZONE / STOPPED
"""The longest time from a stop before the stop line to the line, in s."""
OFF_ROAD: Final = 0.3
"""How far the centre of a vehicle has to be outside the road to have left it, in m."""
OFF_ROAD_TIME: Final = 0.5
"""How long it has to be there, in s."""
AGAINST: Final = 1.0
"""The speed against a lane from which on a vehicle drives the wrong way, in m/s: 1 m in 1 s."""
AGAINST_TIME: Final = 1.0
"""How long it has to drive so, in s."""
TOLERANCE: Final = 5 / 3.6
"""The speed above a limit that is tolerated, in m/s."""
SPEEDING_TIME: Final = 1.0
"""How long a vehicle has to drive faster than that, in s."""

_Key = tuple[int, float]  # of an actor

_SUMMED: Final = "wrong way"  # the kind of which the values add up
_INTERVAL: Final = 0.1  # s between the samples of the motion of a vehicle
_LONGEST: Final = 2.5  # s from one sample to the next
_STILL: Final = 0.02  # m; within a shorter way, the position in relation to the lanes is the same
_GAP: Final = 0.55  # s between runs that are one
_FACING: Final = math.cos(math.radians(120))  # between a vehicle that drives the wrong way and its lane
_LONGEST_HALF: Final = 8.0  # m of a vehicle
_KMH: Final = 3.6  # km/h in m/s
_CAR: Final = (0.0, 2.25)  # m: the centre of the box and half of the length of an unknown vehicle


class RoadEvent(NamedTuple):
    """A vehicle breaks a rule of the road; see `Incident`."""

    kind: str
    actor: ActorLife
    span: tuple[float, float]  # from when until when, in elapsed seconds
    place: tuple[float, float, float]  # at the start, in m, right-handed
    measure: str
    extreme: tuple[float, float]  # the most critical value, and when
    threshold: float
    text: str  # a sentence without subject and full stop


class RoadSearch:
    """Finds what vehicles do in relation to the road, in the batches of a recording, which are read for something else, too.

    Its spawns are read at once. `note` gets the vehicles, the measures of the road, and their values. What lasts begins at
    `start` at the earliest; frames from `BEFORE` on before it say whether vehicles were on the road, and stopped.
    """

    def __init__(
        self,
        source: Reader,
        network: RoadNetwork,
        actors: Iterable[ActorLife],
        note: Callable[[ActorLife, str, MeasureValues], None] = lambda *_: None,
        *,
        start: float = -math.inf,
    ) -> None:
        self._network, self._note, self._start = network, note, start - SAME_TIME
        self._motion = MotionCollector(actors, before=_LONGEST)
        self.lights = LightHistory(source, network)
        self._lines = StopLines(network)
        self._first_on_road: dict[_Key, float] = {}
        self._slow: dict[_Key, tuple[float, ...]] = {}  # where the front of each vehicle was when it last stood
        self._crossings: list[_Crossing] = []
        self._runs: dict[str, list[_Run]] = defaultdict(list)

    def add(self, batch: Batch) -> None:
        """Process the next frames; they have at least their transforms, velocities and states of lights."""
        self.lights.add(batch)
        for table in self._motion.add(batch):
            self.evaluate(table)

    def finish(self) -> list[RoadEvent]:
        """Return the events, in order of their start."""
        for table in self._motion.finish():
            self.evaluate(table)
        events = [*self._at_lines(), *self._left_road(), *self._wrong_way(), *self._speeding()]
        return sorted(events, key=lambda event: (event.span[0], event.kind, event.actor.key))

    @np.errstate(all="ignore")
    def evaluate(self, table: MotionTable) -> None:
        """Process the motion in the next frames, which has a margin of 2.5 s before them."""
        motion = _Motion(table)
        if not motion.is_new.any():
            return
        at = motion.lanes(self._network)
        on_road = np.flatnonzero(at.on_road)
        for row in on_road[np.unique(motion.row[on_road], return_index=True)[1]].tolist():
            self._first_on_road.setdefault(motion.actor(row).key, float(motion.time[row]))
        self._cross(motion)
        outside = np.where(np.isfinite(at.outside), at.outside, roads.REACH)
        self._add_runs("off road", motion, outside > OFF_ROAD, outside)
        self._measure("distance_off_road", motion, np.where(outside > 0, outside, np.nan))
        along = np.cos(motion.yaw - at.heading)
        progress = motion.dx * np.cos(at.heading) + motion.dy * np.sin(at.heading)
        kinds = np.append(self._network.lanes["kind"], roads.GAP)[at.lane]
        against = (progress < -AGAINST * motion.seconds) & (along < _FACING) & (at.beside <= 0)
        against &= ~at.in_junction & (kinds == roads.DRIVING)
        self._add_runs(_SUMMED, motion, against, -progress)
        over = motion.speed - at.limit
        offset = np.where((at.beside <= 0) & ~at.in_junction, np.abs(at.offset), np.nan)
        self._measure("lateral_offset", motion, offset)
        self._add_runs("speeding", motion, (over > TOLERANCE) & (at.beside <= 0), over, at.limit)
        self._measure("speed_over_limit", motion, np.where(at.beside <= 0, over, np.nan))

    def _add_runs(self, kind: str, motion: _Motion, flags: Booleans, values: Floats, limits: Floats | None = None) -> None:
        """Add the runs of samples that are flagged."""
        summed = kind == _SUMMED
        for first, last in runs(flags & motion.is_new & (motion.time >= self._start), motion.continues[1:]):
            part = values[first : last + 1]
            row = first + int(np.nanargmax(part)) if np.isfinite(part).any() else first
            run = _Run(
                motion.actor(first),
                float(motion.time[first]),
                float(motion.time[last]),
                tuple(motion.place[first].tolist()),
                float(np.nansum(part)) if summed else float(values[row]),
                float(motion.time[last if summed else row]),
                math.nan if limits is None else float(limits[row]),
                float(motion.time[first - 1]) if motion.continues[first] else math.nan,
            )
            self._runs[kind].append(run)

    def _measure(self, measure: str, motion: _Motion, values: Floats) -> None:
        """Note the values at samples, by vehicle."""
        for first, last in motion.spans():
            found = MeasureValues.of(motion.time[first:last], values[first:last])
            self._note(motion.actor(first), measure, found.only(motion.is_new[first:last]))

    def _cross(self, motion: _Motion) -> None:
        """Add the crossings of stop lines by the fronts and by the centres of vehicles."""
        direction = np.stack((np.cos(motion.yaw), np.sin(motion.yaw), np.zeros(len(motion.yaw))), axis=1)
        points = [motion.place + ahead[:, None] * direction for ahead in motion.ahead]
        rows = np.flatnonzero(motion.is_new & motion.continues & (motion.distance > 0))
        slow = np.flatnonzero((motion.speed < STOPPED) & motion.is_new)

        def stood(row: int) -> tuple[float, ...] | None:
            """Return where the front of a vehicle was when it last stood until a sample; None if it never did."""
            last = slow[np.searchsorted(slow, row, side="right") - 1] if len(slow) else -1
            if 0 <= last <= row and motion.row[last] == motion.row[row]:
                return tuple(points[0][last].tolist())
            return self._slow.get(motion.actor(row).key)

        for by_front, point in zip((True, False), points, strict=True):
            found = self._lines.crossed(point[rows - 1], point[rows], motion.yaw[rows])
            for index, line, share in zip(*(values.tolist() for values in found), strict=True):
                row = int(rows[index])
                time = float(motion.time[row] - (1 - share) * motion.seconds[row])
                place = stood(row - 1) if by_front and self._lines.is_stop[line] else None
                has_stopped = place is not None and self._lines.is_before(line, place, STOP_ZONE)
                speed, where = float(motion.speed[row]), tuple(motion.place[row].tolist())
                self._crossings.append(_Crossing(time, motion.actor(row), line, by_front, speed, where, has_stopped))
        for first, last in motion.spans():
            if (place := stood(last - 1)) is not None:
                self._slow[motion.actor(first).key] = place

    def _at_lines(self) -> Iterator[RoadEvent]:
        """Yield where vehicles cross stop lines, with the front and the centre, although they should not."""
        fronts: dict[tuple[_Key, int], _Crossing] = {}
        for crossing in sorted(self._crossings, key=lambda crossing: (crossing.time, not crossing.by_front)):
            signal = int(self._lines.signal[crossing.line])
            if crossing.by_front:
                fronts[crossing.actor.key, signal] = crossing
            front = None if crossing.by_front else fronts.pop((crossing.actor.key, signal), None)
            if front is None:
                continue
            kind, text, threshold = "red light", "", math.nan
            light = self.lights.red(signal, front.time, crossing.time, always=True)
            at = "" if math.isnan(front.speed) else f" at {front.speed * _KMH:.0f} km/h"
            if light is not None:
                text = f"runs a red light{at} (light {light})"
            elif self._lines.is_stop[front.line] and not front.has_stopped:
                kind, threshold = "stop sign", STOPPED
                text = f"passes a stop sign{at} without stopping"
            if text:
                span, extreme = (front.time, crossing.time), (front.speed, front.time)
                yield RoadEvent(kind, crossing.actor, span, front.position, "speed", extreme, threshold, text)

    def _left_road(self) -> Iterator[RoadEvent]:
        for run in _joined(self._runs["off road"]):
            if run.stop - run.start >= OFF_ROAD_TIME and run.start > self._first_on_road.get(run.actor.key, math.inf):
                far = f"{run.value:.1f} m" if run.value < roads.REACH else f"more than {roads.REACH:.0f} m"
                yield run.event("off road", "distance_off_road", OFF_ROAD, f"leaves the road by {far}")

    def _wrong_way(self) -> Iterator[RoadEvent]:
        for run in _joined(self._runs[_SUMMED], summed=True):
            self._note(run.actor, "distance_against_lane", MeasureValues.of(np.array([run.time]), np.array([run.value])))
            if run.stop - run.start >= AGAINST_TIME:
                text = f"drives {run.value:.0f} m against the direction of its lane"
                yield run.event("wrong way", "distance_against_lane", AGAINST * AGAINST_TIME, text)

    def _speeding(self) -> Iterator[RoadEvent]:
        for run in _joined(self._runs["speeding"]):
            if run.stop - run.start >= SPEEDING_TIME:
                speed = (run.limit + run.value) * _KMH
                text = f"drives {speed:.0f} km/h where {run.limit * _KMH:.0f} km/h are allowed"
                yield run.event("speeding", "speed_over_limit", TOLERANCE, text)


def _box(actor: ActorLife) -> tuple[float, float]:
    """Return how far the centre of the box of a vehicle is ahead of its location, and half of its length, in m."""
    box = box_of(actor)
    return (box.x, box.extent_x) if box.extent_x < _LONGEST_HALF else _CAR


class _Motion:
    """The motion of vehicles in a table, in each 0.1 s once: samples, one vehicle after the other, each in order of time.

    Of each, there is whether it is in the frames that the table is for, and continues from the one before, of the same life
    and without a jump; the time and the way from there, else NaN; the speed in m/s, NaN where it is unknown; and how far the
    front and the centre are ahead of the place, in m.
    """

    def __init__(self, table: MotionTable) -> None:
        self._actors = table.actors
        present = ~np.isnan(table.x) & table.is_vehicle[:, None] & np.isfinite(table.time)
        latest = np.maximum.accumulate(np.where(present, np.arange(len(table.time)), -1), axis=1)
        before = np.pad(latest[:, :-1], ((0, 0), (1, 0)), constant_values=-1)
        step = np.floor(table.time / _INTERVAL + SAME_TIME)
        actor, frame = np.nonzero(present & ((before < 0) | (step != step[before])))
        self.row, self.time, self.yaw = actor, table.time[frame], table.yaw[actor, frame]
        self.speed, self.place = table.speed[actor, frame], table.locations(actor, frame)
        self.is_new = (frame >= table.first) & (frame < table.last)
        boxes = np.array([_box(life) for life in table.actors]).reshape(-1, 2)[actor]
        self.ahead = boxes.sum(axis=1), boxes[:, 0]
        joined = steps_joined(self.time, self.place.T, self.speed, actor, longest=_LONGEST)
        self.continues = np.append(False, joined)[: len(actor)]
        steps = np.diff(self.place[:, :2], axis=0, prepend=np.nan).T
        self.seconds, self.dx, self.dy, self.distance = (
            np.where(self.continues, values, np.nan)
            for values in (np.diff(self.time, prepend=np.nan), *steps, np.hypot(*steps))
        )

    def actor(self, sample: int) -> ActorLife:
        """Return the vehicle of a sample."""
        return self._actors[int(self.row[sample])]

    def lanes(self, network: RoadNetwork) -> LanePositions:
        """Return the lanes of all samples."""
        way = np.floor(np.cumsum(np.nan_to_num(self.distance)) / _STILL)
        moved = ~self.continues | (np.diff(way, prepend=0.0) > 0)
        return network.lanes_at(self.place[moved], self.yaw[moved]).taken(np.cumsum(moved) - 1)

    def spans(self) -> Iterator[tuple[int, int]]:
        """Yield the first sample of each vehicle, and the one after its last."""
        edges = np.flatnonzero(np.diff(self.row) != 0) + 1
        yield from zip([0, *edges.tolist()], [*edges.tolist(), len(self.row)], strict=True)


class _Run(NamedTuple):
    """A vehicle does something for some time."""

    actor: ActorLife
    start: float  # in elapsed seconds
    stop: float
    position: tuple[float, float, float]  # where it begins
    value: float  # the greatest one, or the sum
    time: float  # when it is reached
    limit: float  # of the speed, at the greatest value
    before: float  # the time of the sample that it continues from; NaN without one

    def event(self, kind: str, measure: str, threshold: float, text: str) -> RoadEvent:
        """Return the event that this is."""
        span, extreme = (self.start, self.stop), (self.value, self.time)
        return RoadEvent(kind, self.actor, span, self.position, measure, extreme, threshold, text)


def _joined(runs: Iterable[_Run], *, summed: bool = False) -> list[_Run]:
    """Return runs, those of a vehicle joined that have a short time between them, or are one that was evaluated in parts."""
    joined: list[_Run] = []
    for run in sorted(runs, key=lambda run: (run.actor.key, run.start)):
        last = joined[-1] if joined else None
        if last is not None and last.actor is run.actor and (run.start - last.stop <= _GAP or run.before == last.stop):
            greater = max(last, run, key=lambda part: part.value)
            value = last.value + run.value if summed else greater.value
            time = run.time if summed else greater.time
            joined[-1] = last._replace(stop=run.stop, value=value, time=time, limit=greater.limit)
        else:
            joined.append(run)
    return joined


class _Crossing(NamedTuple):
    """A vehicle crosses a stop line."""

    time: float  # in elapsed seconds
    actor: ActorLife
    line: int
    by_front: bool  # else by its centre
    speed: float  # m/s
    position: tuple[float, float, float]
    has_stopped: bool  # before the line; of fronts at stop signs
