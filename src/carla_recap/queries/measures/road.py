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
from carla_recap.model.motion import motion_of, place_in_metres, runs
from carla_recap.model.presence import RoadHeights
from carla_recap.model.segment import last_of_each, segments
from carla_recap.queries.measures.definitions import MeasureValues
from carla_recap.queries.measures.road_signals import LightHistory, StopLines
from carla_recap.roads import network as roads

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.lives import ActorLife
    from carla_recap.roads.network import LanePositions, RoadNetwork
    from carla_recap.util.arrays import Booleans, Floats, Indices

TYPES: Final = ("transforms", "velocities", "light_states")
"""The record types that are read."""

STOPPED: Final = 0.5
"""The speed below which a vehicle has stopped at a stop sign, in m/s."""
STOP_ZONE: Final = 8.0
"""How far before the stop line of a stop sign a vehicle may stop, in m from its front."""
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

_INTERVAL: Final = 0.1  # s between the samples of the motion of a vehicle
_LONGEST: Final = 2.5  # s from one sample to the next
_STILL: Final = 0.02  # m; within a shorter way, the position in relation to the lanes is the same
_GAP: Final = 0.55  # s between runs that are one
_BLOCK: Final = 200_000  # samples that are evaluated together
_FACING: Final = math.cos(math.radians(120))  # between a vehicle that drives the wrong way and its lane
_LONGEST_HALF: Final = 8.0  # m of a vehicle
_KMH: Final = 3.6  # km/h in m/s
_CAR: Final = (0.0, 2.25)  # m: the centre of the box and half of the length of an unknown vehicle


class RoadEvent(NamedTuple):
    """A vehicle breaks a rule of the road; see `Incident`."""

    kind: str
    id: int  # of the vehicle
    span: tuple[float, float]  # from when until when, in elapsed seconds
    place: tuple[float, float, float]  # at the start, in m, right-handed
    measure: str
    extreme: tuple[float, float]  # the most critical value, and when
    threshold: float
    text: str  # a sentence without subject and full stop


class RoadSearch:
    """Finds what vehicles do in relation to the road, in the batches of a recording, which are read for something else, too.

    Its spawns are read at once. `note` gets the vehicles, the measures of the road, and their values.
    """

    def __init__(
        self,
        source: Reader,
        network: RoadNetwork,
        actors: Iterable[ActorLife],
        note: Callable[[int, str, MeasureValues], None] = lambda *_: None,
    ) -> None:
        self._network, self._note, actors = network, note, list(actors)
        self._heights = RoadHeights(actors)
        vehicles = {actor.id: actor for actor in actors if actor.kind == "vehicle"}
        self._vehicles = np.array(sorted(vehicles), np.int64)
        self._boxes = np.array([_box(vehicles[id]) for id in self._vehicles.tolist()]).reshape(-1, 2)
        self._lights = LightHistory(source, network)
        self._lines = StopLines(network)
        self._samples: list[NDArray[np.void]] = []
        self._count = 0
        self._next = np.full(len(self._vehicles), -math.inf)  # when the next sample of each vehicle is due
        self._spawned: dict[int, list[float]] = defaultdict(list)  # when actors appear, by vehicle
        for actor in actors:
            if actor.id in vehicles:
                self._spawned[int(np.searchsorted(self._vehicles, actor.id))].append(actor.spawned_at)
        self._held = np.zeros(0, _SAMPLE)  # the last two samples of each vehicle, of which the last one is evaluated next
        self._first_on_road: dict[int, float] = {}
        self._slow: dict[int, tuple[float, ...]] = {}  # where the front of each vehicle was when it last stood
        self._crossings: list[_Crossing] = []
        self._runs: dict[str, list[_Run]] = defaultdict(list)

    @np.errstate(invalid="ignore")  # of signalling NaN
    def add(self, batch: Batch) -> None:
        """Process the next frames; they have at least their transforms, velocities and states of lights."""
        if batch.preamble or not len(self._vehicles):
            return
        self._lights.add(batch)
        frame, vehicle, record = self._sampled(batch)
        if not len(frame):
            return
        transforms = batch.records("transforms")
        samples, chosen = np.zeros(len(frame), _SAMPLE), transforms[frame, record]
        samples["vehicle"], samples["time"] = vehicle, batch.elapsed[frame]
        samples["x"], samples["y"], samples["z"] = place_in_metres(*(chosen[axis].astype(np.float64) for axis in "xyz"))
        samples["yaw"] = np.radians(-chosen["yaw"].astype(np.float64))
        rows, row = np.unique(frame, return_inverse=True)
        samples["velocity"] = self._recorded_velocities(batch.records("velocities")[rows])[row, vehicle]
        finite = np.all([np.isfinite(samples[name]) for name in ("x", "y", "z", "yaw")], axis=0)
        self._samples.append(samples[finite & ~self._heights.away_in(transforms[rows])[row, record]])
        self._count += len(samples)
        if self._count >= _BLOCK:
            self._evaluate()

    def finish(self) -> list[RoadEvent]:
        """Return the events, in order of their start."""
        self._evaluate(ended=True)
        events = [*self._at_lines(), *self._left_road(), *self._wrong_way(), *self._speeding()]
        return sorted(events, key=lambda event: (event.span[0], event.kind, event.id))

    def _sampled(self, batch: Batch) -> tuple[Indices, Indices, Indices]:
        """Return the frame, the vehicle and the position of the record of each sample in a batch."""
        found = [(np.zeros(0, np.intp),) * 3]
        for segment in segments(batch.records("transforms")):
            segment = segment.only(last_of_each(segment.ids))
            segment = segment.only(np.isin(segment.ids, self._vehicles))
            vehicle = np.searchsorted(self._vehicles, segment.ids)
            dues = self._next[vehicle]
            for due in np.unique(dues).tolist():  # the same for most of them
                group, rows = np.flatnonzero(dues == due), []
                for row, time in enumerate(batch.elapsed[segment.frames].tolist(), segment.first):
                    if time >= due - SAME_TIME or time < due - 2 * _INTERVAL:
                        rows.append(row)
                        due = time + _INTERVAL
                self._next[vehicle[group]] = due
                those = np.tile(group, len(rows))
                found.append((np.repeat(np.array(rows, np.intp), len(group)), vehicle[those], segment.columns[those]))
        frame, vehicle, record = map(np.concatenate, zip(*found, strict=True))
        return frame, vehicle, record

    def _recorded_velocities(self, records: NDArray[np.void]) -> Floats:
        """Return the recorded velocities of all vehicles in frames, (frames, vehicles, 3); NaN where there is none."""
        found = np.full((len(records), len(self._vehicles), 3), np.nan)
        for segment in segments(records):
            segment = segment.only(last_of_each(segment.ids))
            segment = segment.only(np.isin(segment.ids, self._vehicles))
            vehicle = np.searchsorted(self._vehicles, segment.ids)
            found[segment.frames, vehicle] = np.stack([segment.field(axis) for axis in "xyz"], axis=2)
        return found

    @np.errstate(all="ignore")
    def _evaluate(self, *, ended: bool = False) -> None:
        """Evaluate the samples so far; until all are there, not the last one of each vehicle, whose next one is unknown."""
        samples = np.concatenate((self._held, *self._samples))
        self._samples, self._count = [], 0
        if not len(samples):
            return
        motion = _Motion(samples[np.argsort(samples["vehicle"], kind="stable")], self._spawned, ended=ended)
        motion.samples["done"] |= motion.is_new
        self._held = motion.samples[motion.is_last | np.append(motion.is_last[1:], False)]
        at = motion.lanes(self._network)
        on_road = np.flatnonzero(at.on_road)
        for row in on_road[np.unique(motion.vehicle[on_road], return_index=True)[1]].tolist():
            self._first_on_road.setdefault(int(self._vehicles[motion.vehicle[row]]), float(motion.time[row]))
        self._cross(motion)
        outside = np.where(np.isfinite(at.outside), at.outside, roads.REACH)
        self._add_runs("off road", motion, outside > OFF_ROAD, outside)
        self._measure("distance_off_road", motion, np.where(outside > 0, outside, np.nan))
        along = np.cos(motion.samples["yaw"] - at.heading)
        progress = motion.dx * np.cos(at.heading) + motion.dy * np.sin(at.heading)
        kinds = np.append(self._network.lanes["kind"], roads.GAP)[at.lane]
        against = (progress < -AGAINST * motion.seconds) & (along < _FACING) & (at.beside <= 0)
        against &= ~at.in_junction & (kinds == roads.DRIVING)
        self._add_runs("wrong way", motion, against, -progress, summed=True)
        over = motion.speed - at.limit
        offset = np.where((at.beside <= 0) & ~at.in_junction, np.abs(at.offset), np.nan)
        self._measure("lateral_offset", motion, offset)
        self._add_runs("speeding", motion, (over > TOLERANCE) & (at.beside <= 0), over, at.limit)
        self._measure("speed_over_limit", motion, np.where(at.beside <= 0, over, np.nan))

    def _add_runs(
        self,
        kind: str,
        motion: _Motion,
        flags: Booleans,
        values: Floats,
        limits: Floats | None = None,
        *,
        summed: bool = False,
    ) -> None:
        """Add the runs of samples that are flagged."""
        for first, last in runs(flags & motion.is_new, motion.continues[1:]):
            part = values[first : last + 1]
            row = first + int(np.nanargmax(part)) if np.isfinite(part).any() else first
            start = motion.samples[first]
            run = _Run(
                int(self._vehicles[start["vehicle"]]),
                float(start["time"]),
                float(motion.time[last]),
                (float(start["x"]), float(start["y"]), float(start["z"])),
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
            self._note(int(self._vehicles[motion.vehicle[first]]), measure, found.only(motion.is_new[first:last]))

    def _cross(self, motion: _Motion) -> None:
        """Add the crossings of stop lines by the fronts and by the centres of vehicles."""
        boxes = self._boxes[motion.vehicle]
        cos, sin = np.cos(motion.samples["yaw"]), np.sin(motion.samples["yaw"])
        position = np.stack([motion.samples[axis] for axis in "xyz"], axis=1)
        points = []
        for ahead in (boxes[:, 0] + boxes[:, 1], boxes[:, 0]):
            point = position.copy()
            point[:, 0] += ahead * cos
            point[:, 1] += ahead * sin
            points.append(point)
        rows = np.flatnonzero(motion.is_new & motion.continues & (motion.distance > 0))
        slow = np.flatnonzero((motion.speed < STOPPED) & motion.is_new)

        def stood(row: int) -> tuple[float, ...] | None:
            """Return where the front of a vehicle was when it last stood until a sample; None if it never did."""
            last = slow[np.searchsorted(slow, row, side="right") - 1] if len(slow) else -1
            if 0 <= last <= row and motion.vehicle[last] == motion.vehicle[row]:
                return tuple(points[0][last].tolist())
            return self._slow.get(int(motion.vehicle[row]))

        for by_front, point in zip((True, False), points, strict=True):
            found = self._lines.crossed(point[rows - 1], point[rows], motion.samples["yaw"][rows])
            for index, line, share in zip(*(values.tolist() for values in found), strict=True):
                row = int(rows[index])
                id = int(self._vehicles[motion.vehicle[row]])
                time = float(motion.time[row] - (1 - share) * motion.seconds[row])
                place = stood(row - 1) if by_front and self._lines.is_stop[line] else None
                has_stopped = place is not None and self._lines.is_before(line, place, STOP_ZONE)
                speed, where = float(motion.speed[row]), tuple(position[row].tolist())
                self._crossings.append(_Crossing(time, id, line, by_front, speed, where, has_stopped))
        for first, last in motion.spans():
            if (place := stood(last - 1)) is not None:
                self._slow[int(motion.vehicle[first])] = place

    def _at_lines(self) -> Iterator[RoadEvent]:
        """Yield where vehicles cross stop lines, with the front and the centre, although they should not."""
        fronts: dict[tuple[int, int], _Crossing] = {}
        for crossing in sorted(self._crossings, key=lambda crossing: (crossing.time, not crossing.by_front)):
            signal = int(self._lines.signal[crossing.line])
            if crossing.by_front:
                fronts[crossing.id, signal] = crossing
            front = None if crossing.by_front else fronts.pop((crossing.id, signal), None)
            if front is None:
                continue
            kind, text, threshold = "red light", "", math.nan
            light = self._lights.red(signal, front.time, crossing.time, always=True)
            at = "" if math.isnan(front.speed) else f" at {front.speed * _KMH:.0f} km/h"
            if light is not None:
                text = f"runs a red light{at} (light {light})"
            elif self._lines.is_stop[front.line] and not front.has_stopped:
                kind, threshold = "stop sign", STOPPED
                text = f"passes a stop sign{at} without stopping"
            if text:
                span, extreme = (front.time, crossing.time), (front.speed, front.time)
                yield RoadEvent(kind, crossing.id, span, front.position, "speed", extreme, threshold, text)

    def _left_road(self) -> Iterator[RoadEvent]:
        for run in _joined(self._runs["off road"]):
            if run.stop - run.start >= OFF_ROAD_TIME and run.start > self._first_on_road.get(run.id, math.inf):
                far = f"{run.value:.1f} m" if run.value < roads.REACH else f"more than {roads.REACH:.0f} m"
                yield run.event("off road", "distance_off_road", OFF_ROAD, f"leaves the road by {far}")

    def _wrong_way(self) -> Iterator[RoadEvent]:
        for run in _joined(self._runs["wrong way"], summed=True):
            self._note(run.id, "distance_against_lane", MeasureValues.of(np.array([run.start]), np.array([run.value])))
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


_SAMPLE: Final = np.dtype(
    [("vehicle", "i8"), *((name, "f8") for name in ("time", "x", "y", "z", "yaw")), ("velocity", "f8", 3), ("done", "?")]
)
"""The index of a vehicle, its pose in right-handed axes, in m and radians, its recorded velocity in m/s, or NaN, and whether
this was evaluated."""


class _Motion:
    """The motion of vehicles: samples, one vehicle after the other, each in order of time.

    Of each, there is whether it is evaluated now, is the last one of its vehicle, and continues from the one before, of the
    same life and without a jump; the time and the way from there, else NaN; the speed in m/s, NaN where it is unknown.
    """

    def __init__(self, samples: NDArray[np.void], spawned: Mapping[int, Sequence[float]], *, ended: bool) -> None:
        self.samples, self.vehicle, self.time = samples, samples["vehicle"], samples["time"]
        self.is_last = np.append(np.diff(self.vehicle) != 0, True)
        self.is_new = ~samples["done"] & (ended | ~self.is_last)
        life = 0 * self.vehicle
        for vehicle, times in spawned.items():
            rows = slice(*np.searchsorted(self.vehicle, (vehicle, vehicle + 1)).tolist())
            life[rows] = np.searchsorted(np.sort(times), self.time[rows] + SAME_TIME, side="right")
        places = np.stack([samples[axis] for axis in "xyz"])
        lives = self.vehicle * (life.max(initial=0) + 1) + life
        velocity, joined = motion_of(self.time, places, samples["velocity"].T, lives, longest=_LONGEST)
        self.speed, self.continues = np.hypot(*velocity[:2]), np.append(False, joined)[: len(samples)]
        seconds, dx, dy = (np.diff(samples[name], prepend=np.nan) for name in ("time", "x", "y"))
        self.seconds, self.dx, self.dy, self.distance = (
            np.where(self.continues, values, np.nan) for values in (seconds, dx, dy, np.hypot(dx, dy))
        )

    def lanes(self, network: RoadNetwork) -> LanePositions:
        """Return the lanes of all samples."""
        way = np.floor(np.cumsum(np.nan_to_num(self.distance)) / _STILL)
        moved = ~self.continues | (np.diff(way, prepend=0.0) > 0)
        taken = self.samples[moved]
        found = network.lanes_at(np.stack([taken[axis] for axis in "xyz"], axis=1), taken["yaw"])
        return found.taken(np.cumsum(moved) - 1)

    def spans(self) -> Iterator[tuple[int, int]]:
        """Yield the first sample of each vehicle, and the one after its last."""
        ends = np.flatnonzero(self.is_last) + 1
        yield from zip([0, *ends[:-1].tolist()], ends.tolist(), strict=True)


class _Run(NamedTuple):
    """A vehicle does something for some time."""

    id: int  # of the vehicle
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
        return RoadEvent(kind, self.id, span, self.position, measure, extreme, threshold, text)


def _joined(runs: Iterable[_Run], *, summed: bool = False) -> list[_Run]:
    """Return runs, those of a vehicle joined that have a short time between them, or are one that was evaluated in parts."""
    joined: list[_Run] = []
    for run in sorted(runs, key=lambda run: (run.id, run.start)):
        last = joined[-1] if joined else None
        if last is not None and last.id == run.id and (run.start - last.stop <= _GAP or run.before == last.stop):
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
    id: int  # of the vehicle
    line: int
    by_front: bool  # else by its centre
    speed: float  # m/s
    position: tuple[float, float, float]
    has_stopped: bool  # before the line; of fronts at stop signs
