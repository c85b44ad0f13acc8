"""Near misses: encounters of two actors that nearly end in a collision.

An encounter is one if the time to collision falls to 1.5 s or less, and the speed at which they approach then takes a
deceleration of 3.4 m/s² or more to lose; or if a vehicle arrives less than 1 s after the other has left, where their paths
cross.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.queries.measures.boxes import Boxes, overlaps
from carla_recap.queries.measures.encroachment import encroachments, path_of, refined
from carla_recap.queries.measures.motion_blocks import MARGIN, TYPES, MotionCollector
from carla_recap.queries.measures.pairs import PairFrames, near_pairs

if TYPE_CHECKING:
    from carla_recap.model.batch import Batch
    from carla_recap.model.contacts import Contacts
    from carla_recap.model.lives import ActorLives
    from carla_recap.queries.measures.motion_blocks import MotionBlock
    from carla_recap.queries.measures.over_time import SeriesCollector
    from carla_recap.util.arrays import Floats, Indices


__all__ = ["TYPES", "NearMiss", "NearMissDetector"]

TIME_TO_COLLISION: Final = 1.5
"""The greatest time to collision of a near miss, in s."""
POST_ENCROACHMENT_TIME: Final = 1.0
"""The greatest post-encroachment time of a near miss, in s."""
LONGEST: Final = 60.0
"""The longest such times that can be asked for, in s: the reach of pairs that are compared grows with them."""
DECELERATION: Final = 3.4
"""The least deceleration that a near miss by its time to collision requires, in m/s²."""

_SLOWEST: Final = 2.0  # m/s of relative speed
_CROSSING_SPEED: Final = 3.0  # m/s of a vehicle that arrives where another actor was
_FEWEST: Final = 3  # frames
_ENCOUNTER: Final = 3.0  # s; critical moments of a pair with less time between them are one encounter
_UNTIL_CONTACT: Final = 3.0  # s after a critical moment; if the pair collides by then, it is a collision
_AFTER_CONTACT: Final = 5.0  # s after a contact in which the pair has no near miss
_AHEAD: Final = 2.0  # s in which both have to meet on their paths
_STEP: Final = 0.1  # s
_BEND: Final = 3.0  # m of a path by which its bend is determined
_BEND_FRAMES: Final = 128  # of these, at most
_SHARPEST: Final = 0.3  # radians per m
_BESIDE: Final = 0.3  # m between paths that still meet
_MOST_RUNS: Final = 2000  # that are examined in a block


@dataclass(frozen=True, slots=True)
class NearMiss:
    """An encounter of two actors that nearly ends in a collision.

    Attributes:
        id1: The actor that approaches, or that arrives second where paths cross.
        id2: The other actor.
        start: The beginning of the critical time, in elapsed seconds.
        stop: Its end, or the most critical moment if that is later.
        time: The most critical moment.
        time_to_collision: The least time to collision in s until it is longer than that of near misses; inf unless it is
            critical.
        post_encroachment_time: The post-encroachment time in s; inf unless it is critical.
        speed: The speed of the first actor at the most critical moment, in m/s.
        x, y, z: The location of the first actor at that moment, in m, right-handed.
    """

    id1: int
    id2: int
    start: float
    stop: float
    time: float
    time_to_collision: float
    post_encroachment_time: float
    speed: float
    x: float
    y: float
    z: float


@dataclass(slots=True)
class _Critical:
    """A run of critical frames of a pair on a collision course.

    Attributes:
        first, last: Its first and its last frame in the recording.
        miss: The near miss that it is, at its most critical moment.
        until: The last frame up to which the time to collision has remained short.
    """

    first: int
    last: int
    miss: NearMiss
    until: int


class NearMissDetector:
    """Finds near misses in the frames of a recording.

    Args:
        actors: The actors.
        contacts: When they touch: near misses that end in a collision are none, nor is what follows a collision.
        ids: The actors of interest, one of which a near miss must have; None for all.
        series: Gets the motion, too.
        time_to_collision: The greatest time to collision of a near miss, in s.
        post_encroachment_time: The greatest post-encroachment time of a near miss, in s.
    """

    def __init__(
        self,
        actors: ActorLives,
        contacts: Contacts,
        ids: frozenset[int] | None = None,
        *,
        series: SeriesCollector | None = None,
        time_to_collision: float = TIME_TO_COLLISION,
        post_encroachment_time: float = POST_ENCROACHMENT_TIME,
    ) -> None:
        self._contacts, self._ids, self._series = contacts, ids, series
        self._longest, self._soonest = time_to_collision, post_encroachment_time
        self._motion = MotionCollector(actors)
        self._approaches: dict[tuple[int, int], list[_Critical]] = defaultdict(list)
        self._crossings: dict[tuple[int, int], list[NearMiss]] = defaultdict(list)
        self._open: list[_Critical] = []  # approaches whose time to collision may still be short

    def batch(self, batch: Batch) -> None:
        """Process the frames of a batch, which have at least their transforms and velocities.

        Raises:
            FormatError: A packet contradicts its layout.
        """
        for block in self._motion.add(batch):
            self.add(block)

    def finish(self) -> list[NearMiss]:
        """Return the near misses in all frames, by start."""
        for block in self._motion.finish():
            self.add(block)
        found: list[NearMiss] = []
        for pair in {**self._approaches, **self._crossings}:
            critical = [run.miss for run in _lasting(self._approaches.get(pair, []))]
            critical += self._crossings.get(pair, [])
            found += _encounters([miss for miss in critical if not self._collides(miss)])
        return sorted(found, key=lambda miss: (miss.start, miss.id1, miss.id2))

    def _collides(self, miss: NearMiss) -> bool:
        """Return whether a critical time ends in a collision, or follows one."""
        return any(
            contact.start - _UNTIL_CONTACT <= miss.stop and miss.start <= contact.stop + _AFTER_CONTACT
            for contact in self._contacts.of(miss.id1, miss.id2)
        )

    def add(self, block: MotionBlock) -> None:
        """Process a block of motion."""
        if self._series is not None:
            self._series.add(block)
        subjects = np.ones(len(block.ids), np.bool_) if self._ids is None else np.isin(block.ids, list(self._ids))
        if not subjects.any() or len(block.ids) < 2:
            return
        with np.errstate(invalid="ignore"):
            fastest = np.nan_to_num(np.fmax.reduce(block.speed, axis=1))
        radius = np.hypot(block.length, block.width) / 2
        reach = radius + fastest * max(self._longest, self._soonest)
        runs = 0
        for start, one, other in near_pairs(block, subjects, reach):
            pairs = one, other
            moves = (fastest[one] >= _SLOWEST) | (fastest[other] >= _SLOWEST)
            one, other = one[moves], other[moves]
            if len(one) and runs < _MOST_RUNS:
                runs += self._add_approaches(block, start, one, other)
                self._add_crossings(block, start, one, other)
            self._follow(block, start, *pairs)

    def _add_approaches(self, block: MotionBlock, start: int, one: Indices, other: Indices) -> int:
        """Add the runs of frames of pairs on a collision course, and return their number."""
        pairs = PairFrames.of(block, start, one, other)
        speed = np.hypot(pairs.vx, pairs.vy)
        kept = (speed >= _SLOWEST) & (pairs.distance - pairs.around() <= speed * self._longest)
        pairs, speed = pairs.take(kept), speed[kept]
        times = pairs.time_to_collision(self._longest)
        with np.errstate(divide="ignore"):
            kept = (times <= self._longest) & (speed / (2 * times) >= DECELERATION)
        pairs, times = pairs.take(kept), times[kept]
        order = np.lexsort((pairs.frame, pairs.other, pairs.one))
        pairs, times = pairs.take(order), times[order]
        is_new = (np.diff(pairs.frame) != 1) | (np.diff(pairs.one) != 0) | (np.diff(pairs.other) != 0)
        edges = [0, *(np.flatnonzero(is_new) + 1).tolist(), len(times)] if len(times) else []
        for begin, stop in pairwise(edges):
            least = begin + int(times[begin:stop].argmin())
            self._add_run(block, pairs, begin, stop, least, float(times[least]))
        return max(len(edges) - 1, 0)

    def _add_run(self, block: MotionBlock, pairs: PairFrames, begin: int, stop: int, least: int, time: float) -> None:
        one, other, frame = int(pairs.one[least]), int(pairs.other[least]), int(pairs.frame[least])
        if not paths_meet(block, one, other, frame):
            return
        if block.speed[other, frame] > block.speed[one, frame]:
            one, other = other, one
        first, last = int(pairs.frame[begin]), int(pairs.frame[stop - 1])
        miss = NearMiss(
            int(block.ids[one]),
            int(block.ids[other]),
            float(block.time[first]),
            float(block.time[last]),
            float(block.time[frame]),
            time,
            math.inf,
            float(block.speed[one, frame]),
            *block.location(one, frame),
        )
        key = min(miss.id1, miss.id2), max(miss.id1, miss.id2)
        run = _Critical(block.index + first, block.index + last, miss, block.index + last)
        self._approaches[key].append(run)
        self._open.append(run)

    def _follow(self, block: MotionBlock, start: int, one: Indices, other: Indices) -> None:
        """Look for the least time to collision of approaches after the critical frames, as long as it is short."""
        self._open = [run for run in self._open if run.until >= block.index + start - 1]
        for run in self._open:
            rows = [np.flatnonzero(block.ids == id) for id in (run.miss.id1, run.miss.id2)]
            if not all(map(len, rows)):
                continue
            first, second = (int(row[0]) for row in rows)
            if not (((one == first) & (other == second)) | ((one == second) & (other == first))).any():
                continue
            pairs = PairFrames.of(block, start, *rows)
            later = np.flatnonzero(pairs.frame > run.until - block.index)
            times = pairs.take(later).time_to_collision(self._longest)
            follows = pairs.frame[later] == run.until - block.index + 1 + np.arange(len(later))
            ends = np.append(~(follows & (times <= self._longest)), True)
            length = int(ends.argmax())
            if not length:
                continue
            run.until += length
            least = int(times[:length].argmin())
            frame = int(pairs.frame[later[least]])
            if times[least] < run.miss.time_to_collision and paths_meet(block, first, second, frame):
                time = float(block.time[frame])
                x, y, z = block.location(first, frame)
                run.miss = replace(
                    run.miss,
                    stop=max(run.miss.stop, time),
                    time=time,
                    time_to_collision=float(times[least]),
                    speed=float(block.speed[first, frame]),
                    x=x,
                    y=y,
                    z=z,
                )

    def _add_crossings(self, block: MotionBlock, start: int, one: Indices, other: Indices) -> None:
        """Add the least post-encroachment times of pairs."""
        found = encroachments(block, start, one, other, self._soonest)
        if not len(found.time):
            return
        arrives = block.is_vehicle[found.second] & (block.speed[found.second, found.arrived] >= _CROSSING_SPEED)
        fast = np.flatnonzero(arrives)
        order = fast[np.lexsort((found.time[fast], found.second[fast], found.first[fast]))]
        first, second = found.first[order], found.second[order]
        is_new = np.append(True, (np.diff(first) != 0) | (np.diff(second) != 0))[: len(order)]
        for index in order[is_new].tolist():
            leaving, arriving = int(found.first[index]), int(found.second[index])
            left, arrived = int(found.left[index]), int(found.arrived[index])
            time = refined(
                path_of(block, leaving, left),
                path_of(block, arriving, arrived),
                float(block.time[arrived]),
                float(found.time[index]),
            )
            miss = NearMiss(
                int(block.ids[arriving]),
                int(block.ids[leaving]),
                float(block.time[left]),
                float(block.time[arrived]),
                float(block.time[arrived]),
                math.inf,
                time,
                float(block.speed[arriving, arrived]),
                *block.location(arriving, arrived),
            )
            self._crossings[min(miss.id1, miss.id2), max(miss.id1, miss.id2)].append(miss)


def _lasting(runs: list[_Critical]) -> list[_Critical]:
    """Return the runs of at least three frames; those that continue each other are one."""
    joined: list[_Critical] = []
    for run in runs:
        before = joined[-1] if joined else None
        if before is not None and run.first <= before.last + 1:
            joined[-1] = _Critical(before.first, run.last, _joined(before.miss, run.miss), run.until)
        else:
            joined.append(run)
    return [run for run in joined if run.last - run.first + 1 >= _FEWEST]


def _encounters(critical: list[NearMiss]) -> list[NearMiss]:
    """Return one near miss for each encounter of a pair."""
    found: list[NearMiss] = []
    for miss in sorted(critical, key=lambda miss: miss.start):
        if found and miss.start - found[-1].stop <= _ENCOUNTER:
            found[-1] = _joined(found[-1], miss)
        else:
            found.append(miss)
    return found


def _joined(one: NearMiss, other: NearMiss) -> NearMiss:
    """Return two critical times of a pair as one, with what is most critical; of crossings, the most critical one."""
    if one.time_to_collision == other.time_to_collision == math.inf:
        return min(one, other, key=lambda miss: miss.post_encroachment_time)
    worst = min(one, other, key=lambda miss: (miss.time_to_collision, miss.post_encroachment_time))
    return NearMiss(
        worst.id1,
        worst.id2,
        min(one.start, other.start),
        max(one.stop, other.stop),
        worst.time,
        worst.time_to_collision,
        min(one.post_encroachment_time, other.post_encroachment_time),
        worst.speed,
        worst.x,
        worst.y,
        worst.z,
    )


def paths_meet(block: MotionBlock, one: int, other: int, frame: int, seconds: float = _AHEAD) -> bool:
    """Return whether two actors touch, or pass at less than 0.3 m, if they keep their speed on the paths that they take.

    So the other lane of a bend, and what is parked beside it, is no obstacle, though a straight line leads there.

    Args:
        block: The motion.
        one: The row of an actor.
        other: That of the other one.
        frame: The frame from which on they keep their speed.
        seconds: The time in which they have to meet.
    """
    ahead = np.linspace(0.0, seconds, round(seconds / _STEP) + 1)
    boxes = [
        Boxes(*_path_ahead(block, actor, frame, ahead), block.length[actor], block.width[actor] + wider)
        for actor, wider in ((one, 2 * _BESIDE), (other, 0.0))
    ]
    return bool(overlaps(*boxes).any())


def _path_ahead(block: MotionBlock, actor: int, frame: int, ahead: Floats) -> tuple[Floats, Floats, Floats]:
    """Return where an actor comes with its speed on the path that it takes from a frame on, and then as that path bends."""
    stop = int(np.searchsorted(block.time, block.time[frame] + MARGIN, side="right"))
    rows = np.arange(frame, max(stop, frame + 1))
    rows = rows[np.cumsum(np.isnan(block.x[actor, rows])) == 0]
    x, y, yaw = block.x[actor, rows], block.y[actor, rows], np.unwrap(block.yaw[actor, rows])
    covered = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
    wanted = float(block.speed[actor, frame]) * ahead
    beyond = np.maximum(wanted - covered[-1], 0.0)
    x, y, yaw = (np.interp(wanted, covered, values) for values in (x, y, yaw))
    if beyond[-1] > 0:
        yaw = yaw + _bend(block, actor, int(rows[-1])) * beyond
        steps = np.diff(beyond, prepend=0.0)
        x, y = x + np.cumsum(steps * np.cos(yaw)), y + np.cumsum(steps * np.sin(yaw))
    return x, y, yaw


def _bend(block: MotionBlock, actor: int, frame: int) -> float:
    """Return by how much the path of an actor turns before a frame, in radians per m; 0 if it is unknown."""
    rows = np.arange(frame, max(frame - _BEND_FRAMES, -1), -1)
    rows = rows[np.cumsum(np.isnan(block.x[actor, rows])) == 0]
    x, y, yaw = block.x[actor, rows], block.y[actor, rows], np.unwrap(block.yaw[actor, rows])
    covered = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
    before = min(int(np.searchsorted(covered, _BEND)), len(covered) - 1)
    if covered[before] < _BEND / 3:
        return 0.0
    return float(np.clip((yaw[0] - yaw[before]) / covered[before], -_SHARPEST, _SHARPEST))
