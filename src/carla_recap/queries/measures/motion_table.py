"""The motion of all vehicles and walkers in some frames, as dense arrays, for measures."""

from __future__ import annotations

import warnings
from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.model.blueprints import box_of
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.lives import ROAD_USERS
from carla_recap.model.motion import LONGEST_STEP, MOTION, motion_of, place_in_metres
from carla_recap.model.presence import FAR, RoadHeights
from carla_recap.model.segment import SegmentBuffer, segments

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from carla_recap.model.batch import Batch
    from carla_recap.model.contacts import Contact
    from carla_recap.model.lives import ActorLife
    from carla_recap.util.arrays import Booleans, Floats, Ids, Indices, Integers


THROWN: Final = 5.0
"""The time after a contact with a vehicle in which an actor may be thrown, in s."""

_FRAMES: Final = 2048  # of a table, without its margins
_MAX_MARGIN: Final = 1 << 14  # frames before and after those of a table, at most: the longest margin at 1,000 Hz
_VALUES: Final = 1 << 20  # poses of a table, unless its margins have more
_RATE: Final = 20.0  # Hz of the moments in which crossings are looked for, however few frames there are
_CONTEXT: Final = 2.0  # s around a frame that its motion depends on
_AROUND_JUMP: Final = 0.5  # s before and after a jump in which an actor does not count


@dataclass(frozen=True, eq=False)
class MotionTable:
    """The motion of some consecutive frames; arrays have the shape (actors, frames), in right-handed axes.

    Places are NaN where an actor is absent, jumps, or is at no sensible place, such as far below the roads.
    """

    first: int  # of the frames that the table is for; those before are a margin
    last: int  # exclusive
    time: Floats  # elapsed seconds, (frames,)
    actors: tuple[ActorLife, ...]  # by ascending id; an id that is used again has several rows
    x: Floats  # the centre of the box in m
    y: Floats
    z: Floats
    yaw: Floats  # the heading in radians, counter-clockwise
    vx: Floats  # the velocity in m/s: as recorded, else derived from the positions
    vy: Floats
    length: Floats  # of the box in m, (actors,)
    width: Floats
    height: Floats
    offset: Floats  # the centre of the box in the axes of the actor in m, (actors, 3)
    contacts: tuple[Contact, ...] = ()

    @property
    def core(self) -> slice:
        """The frames that the table is for, without margins."""
        return slice(self.first, self.last)

    @cached_property
    def ids(self) -> Integers:
        """The ids of the actors, (actors,)."""
        return np.array([actor.id for actor in self.actors], np.int64)

    @cached_property
    def is_vehicle(self) -> Booleans:
        """Whether each is a vehicle, not a walker, (actors,)."""
        return np.array([actor.kind == "vehicle" for actor in self.actors], np.bool_)

    @cached_property
    def clock(self) -> Floats:
        """The times, each not before the one before it, (frames,)."""
        return _clock(self.time)

    @cached_property
    def speed(self) -> Floats:
        """The speed over the ground in m/s, (actors, frames)."""
        return np.hypot(self.vx, self.vy)

    @cached_property
    def along(self) -> Floats:
        """The velocity along the heading in m/s, below 0 in reverse, (actors, frames)."""
        return np.asarray(np.cos(self.yaw) * self.vx + np.sin(self.yaw) * self.vy)

    @cached_property
    def radius(self) -> Floats:
        """The radius of a circle around the box in m, (actors,)."""
        return np.hypot(self.length, self.width) / 2

    @cached_property
    def fastest(self) -> Floats:
        """The greatest speed in the frames that the table is for in m/s, (actors,)."""
        return np.asarray(np.fmax.reduce(self.speed[:, self.core], axis=1, initial=0.0))

    @cached_property
    def heading(self) -> Floats:
        """The heading in radians without steps of whole turns, (actors, frames)."""
        turns = -np.round(np.nan_to_num(np.diff(self.yaw, axis=1)) / (2 * np.pi))
        return np.asarray(self.yaw + 2 * np.pi * np.pad(np.cumsum(turns, axis=1), ((0, 0), (1, 0))))

    @cached_property
    def joined(self) -> Booleans:
        """Whether an actor is present in a frame and the next one without a break, (actors, frames - 1)."""
        with np.errstate(invalid="ignore"):  # of times that are infinite
            present, seconds = ~np.isnan(self.x), np.diff(self.time)
        return np.asarray(present[:, 1:] & present[:, :-1] & (seconds > 0) & (seconds <= LONGEST_STEP))

    @cached_property
    def path(self) -> tuple[Indices, Indices]:
        """The first and the last frame that an actor is present in without a break from each frame, (actors, frames)."""
        frame, ends = np.arange(len(self.time)), np.ones((len(self.ids), 1), np.bool_)
        begin = np.where(np.hstack((ends, ~self.joined)), frame, 0)
        end = np.where(np.hstack((~self.joined, ends)), frame, len(frame))
        return np.maximum.accumulate(begin, axis=1), np.minimum.accumulate(end[:, ::-1], axis=1)[:, ::-1]

    @cached_property
    def covered(self) -> Floats:
        """The distance covered until each frame in m, (actors, frames), which ascends from row to row, 1 m at a break."""
        steps = np.ones(self.x.shape)
        steps[:, 1:] = np.where(self.joined, np.hypot(np.diff(self.x), np.diff(self.y)), 1.0)
        return np.cumsum(steps).reshape(steps.shape)

    @cached_property
    def touching(self) -> tuple[tuple[int, int, slice], ...]:
        """The recorded contacts of two of the actors: their rows, and the frames."""
        found = []
        for contact in self.contacts:
            begin, end = np.searchsorted(self.clock, (contact.start - SAME_TIME, contact.stop + SAME_TIME)).tolist()
            ones, others = ([row for row, actor in enumerate(self.actors) if actor is life] for life in contact.actors)
            pairs = [(one, other) for one in ones for other in others if begin < end]
            found += [(one, other, slice(begin, end)) for one, other in pairs if self.free(one, other)]
        return tuple(found)

    def frames_of(self, actor: int, contact: slice) -> Indices:
        """Return the frames of a contact in which an actor is present; in none, the next one that it is, within 1 s."""
        present = contact.start + np.flatnonzero(~np.isnan(self.x[actor, contact.start :]))
        during = present[present < contact.stop]
        soon = self.clock[present] <= self.clock[contact.stop - 1] + LONGEST_STEP
        return np.asarray(during if len(during) else present[soon][:1])

    @cached_property
    def thrown(self) -> Booleans:
        """Whether an actor may be thrown: it touches a vehicle, or has done so in the 5 s before, (actors, frames)."""
        found = np.zeros(self.x.shape, np.bool_)
        for contact in self.contacts:
            during = (self.time >= contact.start - SAME_TIME) & (self.time <= contact.stop + THROWN)
            for one, other in (contact.actors, contact.actors[::-1]):
                if other is not None and other.kind == "vehicle":
                    found[[actor is one for actor in self.actors]] |= during
        return found

    @cached_property
    def _parents(self) -> Integers:
        """The ids of the actors that they are attached to; -1 without one, (actors,)."""
        return np.array([-1 if actor.parent is None else actor.parent for actor in self.actors], np.int64)

    def free(self, one: Indices | int, other: Indices | int) -> Booleans:
        """Return whether rows are pairs that count: not two walkers, and neither attached to the other."""
        parent, ids = self._parents, self.ids
        attached = (parent[one] == ids[other]) | (parent[other] == ids[one])
        return np.asarray((self.is_vehicle[one] | self.is_vehicle[other]) & (ids[one] != ids[other]) & ~attached)

    def locations(self, actor: Indices, frame: Indices) -> Floats:
        """Return the locations of actors in frames, not of the centres of their boxes: rows of x, y and z in m."""
        (x, y, z), yaw = self.offset[actor].T, self.yaw[actor, frame]
        cos, sin = np.cos(yaw), np.sin(yaw)
        return np.stack(
            (self.x[actor, frame] - cos * x + sin * y, self.y[actor, frame] - sin * x - cos * y, self.z[actor, frame] - z),
            axis=1,
        )

    def location(self, actor: int, frame: int) -> tuple[float, float, float]:
        """Return the location of an actor in a frame in m; see `locations`."""
        x, y, z = self.locations(np.array([actor]), np.array([frame]))[0].tolist()
        return x, y, z


class MotionCollector:
    """Collects the frames of a recording into tables of motion, which follow each other.

    Memory is bounded: a table has 2,048 frames, or fewer if there are very many actors, and the margins `before` and `after`
    them, in s. Tables are for frames from one time on and before another one, in elapsed seconds.

    Attributes:
        span: The times from which on and before which frames count, with the margins.
    """

    def __init__(
        self,
        actors: Iterable[ActorLife],
        contacts: Iterable[Contact] = (),
        *,
        before: float = 0.0,
        after: float = 0.0,
        start: float = -np.inf,
        stop: float = np.inf,
    ) -> None:
        actors, lives = list(actors), defaultdict(list)
        for actor in actors:
            lives[actor.id].append(actor)
        self._lives = {  # of each id, with the times from which and until which it is theirs
            id: list(zip(each, [-np.inf, *starts], [*starts, np.inf], strict=True))
            for id, each in lives.items()
            if any(actor.kind in ROAD_USERS for actor in each)
            for starts in [[actor.spawned_at - SAME_TIME for actor in each[1:]]]
        }
        self._known = np.array(list(self._lives), np.uint32)
        self._contacts = tuple(contacts)
        self._before, self._after = before + _CONTEXT, after + _CONTEXT
        self._part, self.span = (start - SAME_TIME, stop - SAME_TIME), (start - self._before, stop + self._after)
        self._heights = RoadHeights(actors)
        self._poses, self._velocities = SegmentBuffer(), SegmentBuffer()
        self._time = np.zeros(0)  # of the frames that these hold
        self._done = 0  # the number of them that have been in a table
        self._size = _FRAMES  # of the next table
        self._is_limited = False  # whether a margin was cut

    def add(self, batch: Batch) -> Iterator[MotionTable]:
        """Add frames that have at least their transforms and velocities, and yield the tables that are complete."""
        if batch.preamble:
            return
        most = 1  # records of a frame
        for buffer, name in zip((self._poses, self._velocities), MOTION, strict=True):
            records = batch.records(name)
            buffer.add(segments(records), len(records))
            most = max(most, records.shape[1])
        self._size = max(1, min(_FRAMES, _VALUES // most))
        self._time = np.concatenate((self._time, batch.elapsed))
        yield from self._tables()

    def finish(self) -> Iterator[MotionTable]:
        """Yield the last tables."""
        yield from self._tables(ended=True)

    def _tables(self, *, ended: bool = False) -> Iterator[MotionTable]:
        """Yield tables of the frames so far, as far as what follows them is known."""
        clock, done = _clock(self._time), self._done
        known = len(clock) if ended else int(np.searchsorted(clock, clock[-1] - self._after))
        ready = max(known, len(clock) - _MAX_MARGIN)
        size = max(self._size, len(clock) - ready)
        while self._done < ready and (ended or ready - self._done >= size):
            first, last = self._done, min(self._done + size, ready)
            while True:
                start = int(np.searchsorted(clock, clock[first] - self._before))
                stop = int(np.searchsorted(clock, clock[last - 1] + self._after, side="right"))
                if (last > known or first - start > _MAX_MARGIN) and not self._is_limited:
                    self._is_limited = True
                    text = f"more than {_MAX_MARGIN:,} frames are around {self._time[first]:g} s"
                    text = f"{text}; of what is before and after a moment, as many count"
                    warnings.warn(text, RecapWarning, stacklevel=2)
                start, stop = max(start, first - _MAX_MARGIN), min(stop, last + _MAX_MARGIN)
                margins = first - start + stop - last
                contacts = self._contacts_within(self._time[start:stop])
                touching = np.array([id for each in contacts for id in each.ids], np.uint32)  # also without poses then
                ids = np.intersect1d(np.append(self._poses.ids(start, stop), touching), self._known)
                moments = max(stop - start, (clock[stop - 1] - clock[start]) * _RATE)
                if last - first <= max(margins, 1) or len(ids) * moments <= _VALUES:
                    break
                last = first + (last - first + 1) // 2
            begin, end = first + np.searchsorted(clock[first:last], self._part)
            if begin < end:
                yield self._table(ids, contacts, start, int(begin), int(end), stop)
            self._done = last
        if done < self._done < len(clock):
            dropped = int(np.searchsorted(clock, clock[self._done] - self._before))
            dropped = max(dropped, self._done - _MAX_MARGIN)
            self._poses.drop(dropped)
            self._velocities.drop(dropped)
            self._time, self._done = self._time[dropped:], self._done - dropped

    def _contacts_within(self, time: Floats) -> tuple[Contact, ...]:
        """Return the contacts that matter at some times: who was hit before may still be thrown."""
        begin, end = np.fmin.reduce(time) - THROWN, np.fmax.reduce(time)
        return tuple(each for each in self._contacts if each.start <= end + SAME_TIME and each.stop >= begin - SAME_TIME)

    @np.errstate(invalid="ignore")  # of signalling NaN
    def _table(self, ids: Ids, contacts: tuple[Contact, ...], start: int, first: int, last: int, stop: int) -> MotionTable:
        time = self._time[start:stop]
        lives = [
            (row, actor, during)
            for row, id in enumerate(ids.tolist())
            for actor, begin, end in self._lives[id]
            if actor.kind in ROAD_USERS and (during := (time >= begin) & (time < end)).any()
        ]
        rows, actors = np.array([row for row, _, _ in lives], np.intp), tuple(actor for _, actor, _ in lives)
        alive = np.array([during for _, _, during in lives], np.bool_).reshape(-1, len(time))
        found = []
        for buffer, fields in ((self._poses, ("x", "y", "z", "yaw")), (self._velocities, "xyz")):
            recorded, known = buffer.dense(fields, ids, start, stop)
            values, there = recorded[:, rows].astype(np.float64), known[rows] & alive
            np.copyto(values, np.nan, where=~there)
            found.append((values, there))
        (pose, there), (velocity, _) = found
        boxes = [box_of(actor) for actor in actors]
        size = 2 * np.array([(box.extent_x, box.extent_y, box.extent_z) for box in boxes]).reshape(-1, 3)
        offset = np.array([(box.x, box.y, box.z) for box in boxes]).reshape(-1, 3)
        away = self._heights.away(ids[rows], pose[:3].T).T
        x, y, z, yaw, vx, vy = _motion(time, pose, velocity, there, away)
        cos, sin = np.cos(yaw), np.sin(yaw)
        return MotionTable(
            first=first - start,
            last=last - start,
            time=time,
            actors=actors,
            x=x + cos * offset[:, :1] - sin * offset[:, 1:2],
            y=y + sin * offset[:, :1] + cos * offset[:, 1:2],
            z=z + offset[:, 2:],
            yaw=yaw,
            vx=vx,
            vy=vy,
            length=size[:, 0],
            width=size[:, 1],
            height=size[:, 2],
            offset=offset,
            contacts=contacts,
        )


def _clock(time: Floats) -> Floats:
    return np.asarray(np.maximum.accumulate(np.where(np.isfinite(time), time, -np.inf)))


@np.errstate(all="ignore")
def _motion(time: Floats, pose: Floats, velocity: Floats, there: Booleans, away: Booleans) -> tuple[Floats, ...]:
    """Return positions in m, headings in radians and velocities in m/s, right-handed, of CARLA's own; NaN where unusable.

    Where actors are away, or at no sensible place, they are as absent.
    """
    places, motion = np.stack(place_in_metres(*pose[:3])), np.stack((velocity[0], -velocity[1], velocity[2]))
    yaw = np.deg2rad(np.remainder(-pose[3], 360.0))
    absent = away | ~((np.abs(places) < FAR).all(axis=0) & np.isfinite(yaw))
    np.copyto(places, np.nan, where=absent)
    rows = np.flatnonzero(there)  # from here on, the frames of one actor after the other
    actor, frame = np.divmod(rows, len(time))
    flat = places.reshape(3, -1).take(rows, axis=1)
    found, joined = motion_of(time[frame], flat, motion.reshape(3, -1).take(rows, axis=1), actor)
    motion.reshape(3, -1)[:, rows] = found
    torn = np.flatnonzero(~joined & (np.diff(actor) == 0))
    seconds, metres = time[frame[torn + 1]] - time[frame[torn]], np.abs(flat[:, torn + 1] - flat[:, torn]).sum(axis=0)
    torn = torn[(seconds > 0) & (seconds <= LONGEST_STEP) & np.isfinite(metres)]
    if len(torn):
        jumps = np.zeros((len(there), len(time) - 1), np.bool_)
        jumps[actor[torn], frame[torn]] = jumps[actor[torn], frame[torn + 1] - 1] = True
        absent |= _around(jumps, time)
    for values in (places, yaw, motion):
        np.copyto(values, np.nan, where=absent)
    return *places, yaw, *motion[:2]


def _around(jumps: Booleans, time: Floats) -> Booleans:
    """Return which frames are within 0.5 s of a jump between two frames."""
    count = np.pad(np.cumsum(jumps, axis=1), ((0, 0), (1, 0)))
    clock = _clock(time)
    frames = np.arange(len(time))
    first = np.minimum(np.searchsorted(clock, clock - _AROUND_JUMP), np.maximum(frames - 1, 0))
    last = np.maximum(np.searchsorted(clock, clock + _AROUND_JUMP, side="right") - 1, np.minimum(frames + 1, len(time) - 1))
    return np.asarray(count[:, last] > count[:, first])
