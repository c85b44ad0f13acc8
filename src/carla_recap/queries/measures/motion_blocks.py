"""The motion of all vehicles and walkers, as arrays of some frames at once, for measures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.model.blueprints import box_of
from carla_recap.model.kinematics import LONGEST_STEP, place_in_metres, possible_step
from carla_recap.model.lives import ROAD_USERS
from carla_recap.model.presence import FAR, RoadHeights
from carla_recap.model.segment import SegmentBuffer, segments

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.model.batch import Batch
    from carla_recap.model.lives import ActorLife, ActorLives
    from carla_recap.util.arrays import Booleans, Floats

    Ids = NDArray[np.integer[Any]]

TYPES: Final = ("transforms", "velocities")
"""The record types that motion is computed from."""
MARGIN: Final = 3.0
"""The time before and after the frames of a block that it has, too, in s."""

_FRAMES: Final = 1024  # of a block, without its margins
_STEP: Final = 64  # frames after which blocks are tried again
_MARGIN_FRAMES: Final = 512  # of a margin, at most
_VALUES: Final = 1 << 20  # poses of a block, at most, where it has several frames
_FASTEST: Final = 150.0  # m/s; velocities above it do not count
_AROUND_JUMP: Final = 0.5  # s before and after a jump in which an actor does not count


@dataclass(frozen=True, eq=False)
class MotionBlock:
    """The motion of some consecutive frames; arrays have the shape (actors, frames), in right-handed axes.

    Attributes:
        index: The index of the first frame in the recording.
        first, last: The frames that the block is for, `last` exclusive; those before and after are margins.
        time: Elapsed seconds, (frames,).
        ids: The ids of the actors, ascending, (actors,).
        actors: Their actors.
        is_vehicle: Whether each is a vehicle, not a walker, (actors,).
        x, y, z: The centre of the box in m; NaN where the actor is absent, jumps, or is at no sensible place,
            such as far below the roads.
        yaw: The heading in radians, counter-clockwise.
        vx, vy: The velocity in m/s: as recorded, else derived from the positions.
        length, width, height: The size of the box in m, (actors,).
        offset: The centre of the box in the axes of the actor in m, (actors, 3).
    """

    index: int
    first: int
    last: int
    time: Floats
    ids: Ids
    actors: tuple[ActorLife, ...]
    is_vehicle: Booleans
    x: Floats
    y: Floats
    z: Floats
    yaw: Floats
    vx: Floats
    vy: Floats
    length: Floats
    width: Floats
    height: Floats
    offset: Floats

    @property
    def core(self) -> slice:
        """The frames that the block is for, without margins."""
        return slice(self.first, self.last)

    @cached_property
    def speed(self) -> Floats:
        """The speed over the ground in m/s, (actors, frames)."""
        return np.hypot(self.vx, self.vy)

    def location(self, actor: int, frame: int) -> tuple[float, float, float]:
        """Return the location of an actor, not of the centre of its box, in m."""
        x, y, z = self.offset[actor].tolist()
        yaw = self.yaw[actor, frame]
        cos, sin = np.cos(yaw), np.sin(yaw)
        return (
            float(self.x[actor, frame] - cos * x + sin * y),
            float(self.y[actor, frame] - sin * x - cos * y),
            float(self.z[actor, frame] - z),
        )


class MotionCollector:
    """Collects the frames of a recording into blocks of motion.

    The blocks follow each other; each has margins of 3 s, so that what is before and after its frames is known. Memory is
    bounded: a block has 1,024 frames, or fewer if there are very many actors.

    Args:
        actors: The actors of the recording.
    """

    def __init__(self, actors: ActorLives) -> None:
        self._actors = actors
        self._known = np.array(sorted(actors.ids(*ROAD_USERS)), np.uint32)
        self._heights = RoadHeights(list(actors))
        self._poses, self._velocities = SegmentBuffer(), SegmentBuffer()
        self._time = np.zeros(0)  # of the frames that these hold
        self._index = 0  # of the first of them in the recording
        self._done = 0  # the number of them that have been in a block
        self._listed = 0  # the number of actors in the latest frame
        self._size = _FRAMES  # of the next block
        self._due = _FRAMES + _STEP  # the number of frames that have not been in a block from which on blocks are made

    def add(self, batch: Batch) -> Iterator[MotionBlock]:
        """Add frames that have at least their transforms and velocities, and yield the blocks that are complete.

        Raises:
            FormatError: A packet contradicts its layout.
        """
        if batch.preamble:
            return
        transforms, velocities = (batch.records(name) for name in TYPES)
        actors = transforms.shape[1]
        step = max(1, min(_FRAMES, _VALUES // max(actors, 1)))
        for start in range(0, len(batch), step):
            frames = slice(start, start + step)
            if not len(self._time):
                self._index = batch.index + start
            self._add(self._velocities, velocities[frames])
            self._listed = self._add(self._poses, transforms[frames])
            self._time = np.concatenate((self._time, batch.elapsed[frames]))
            waiting = len(self._time) - self._done
            if waiting >= self._due or waiting * actors >= 2 * _VALUES:
                yield from self._blocks(whole=waiting * actors < 2 * _VALUES)
                self._due = max(_FRAMES, len(self._time) - self._done) + _STEP

    def finish(self) -> Iterator[MotionBlock]:
        """Yield the last blocks."""
        yield from self._blocks(ended=True)

    def _add(self, buffer: SegmentBuffer, records: NDArray[np.void]) -> int:
        """Add the records of some frames, and return the number of actors in the last one."""
        found = [segment.only(np.isin(segment.ids, self._known)) for segment in segments(records)]
        buffer.add(found, len(records))
        return len(found[-1].ids)

    def _blocks(self, *, whole: bool = False, ended: bool = False) -> Iterator[MotionBlock]:
        """Yield blocks of the frames so far; the last ones stay as margins of the next.

        Args:
            whole: Whether to yield blocks of full size alone.
            ended: Whether these are the last frames.
        """
        time, until = self._time, len(self._time)
        if not until:
            return
        if not ended:
            until -= min(_margin(time[::-1], -1), max(1, _VALUES // max(self._listed, 1)))
        first = self._done
        while first < until and not (whole and until - first < self._size):
            full = size = min(self._size, until - first)
            while True:
                last = first + size
                start, stop = first - _margin(time[:first][::-1], -1), last + _margin(time[last:], 1)
                ids = self._poses.ids(start, stop)
                if size == 1 or len(ids) * (stop - start) <= _VALUES:
                    break
                size = max(size // 2, 1)
            if len(ids) * (stop - start) > _VALUES:
                start, stop = first, last
                ids = self._poses.ids(start, stop)
            self._size = min(2 * self._size, _FRAMES) if size == full else size
            yield self._block(ids, start, first, last, stop)
            first = last
        dropped = first - _margin(time[:first][::-1], -1)
        self._poses.drop(dropped)
        self._velocities.drop(dropped)
        self._time, self._index, self._done = time[dropped:], self._index + dropped, first - dropped

    @np.errstate(invalid="ignore")  # of signalling NaN
    def _block(self, ids: Ids, start: int, first: int, last: int, stop: int) -> MotionBlock:
        time = self._time[start:stop]
        middle = float(time[(first + last) // 2 - start])
        found = [self._actors.at(id, middle) for id in ids.tolist()]
        kept = [actor is not None and actor.kind in ROAD_USERS for actor in found]
        ids, actors = ids[kept], tuple(actor for actor in found if actor is not None and actor.kind in ROAD_USERS)
        pose, velocity = (
            np.where(known, values, np.nan).astype(np.float64)
            for values, known in (
                self._poses.dense(("x", "y", "z", "yaw"), ids, start, stop),
                self._velocities.dense(("x", "y"), ids, start, stop),
            )
        )
        boxes = [box_of(actor) for actor in actors]
        size = 2 * np.array([(box.extent_x, box.extent_y, box.extent_z) for box in boxes]).reshape(-1, 3)
        offset = np.array([(box.x, box.y, box.z) for box in boxes]).reshape(-1, 3)
        away = self._heights.away(ids, pose[:3].T).T
        x, y, z, yaw, vx, vy = _motion(time, pose, velocity, away)
        cos, sin = np.cos(yaw), np.sin(yaw)
        return MotionBlock(
            index=self._index + start,
            first=first - start,
            last=last - start,
            time=time,
            ids=ids.astype(np.int64),
            actors=actors,
            is_vehicle=np.array([actor.kind == "vehicle" for actor in actors], np.bool_),
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
        )


def _margin(time: Floats, direction: int) -> int:
    """Return the number of the first frames that are within 3 s of the first one."""
    time = time[: _MARGIN_FRAMES + 1]
    if not len(time):
        return 0
    with np.errstate(all="ignore"):
        beyond = ~(direction * (time - time[0]) <= MARGIN)
    return min(int(beyond.argmax()) if beyond.any() else len(time), _MARGIN_FRAMES)


@np.errstate(all="ignore")
def _motion(time: Floats, pose: Floats, velocity: Floats, away: Booleans) -> tuple[Floats, ...]:
    """Return positions in m, headings in radians and velocities in m/s, right-handed, of CARLA's own; NaN where unusable.

    Where actors are away, they are as absent.
    """
    x, y, z = place_in_metres(*pose[:3])
    yaw = np.deg2rad(np.remainder(-pose[3], 360.0))
    vx, vy = velocity[0], -velocity[1]
    absent = away | ~((np.abs(x) < FAR) & (np.abs(y) < FAR) & (np.abs(z) < FAR) & np.isfinite(yaw))
    unknown = ~(np.hypot(vx, vy) < _FASTEST)
    vx[unknown] = vy[unknown] = np.nan
    if len(time) > 1:
        seconds = np.diff(time)
        dx, dy = np.diff(x), np.diff(y)
        distance = np.hypot(dx, dy)
        speed = np.hypot(vx, vy)
        speed = np.fmax(speed[:, 1:], speed[:, :-1])
        ordered = (seconds > 0) & (seconds <= LONGEST_STEP)
        jumps = (distance > possible_step(seconds, speed, least=0.0)) & ordered
        if jumps.any():
            absent |= _around(jumps, time)
        if unknown.any():
            joined = ordered & ~jumps & ~absent[:, 1:] & ~absent[:, :-1]
            for values, steps in ((vx, dx), (vy, dy)):
                values[unknown] = _slopes(np.where(joined, steps, 0.0), np.where(joined, seconds, 0.0))[unknown]
    for values in (x, y, z, yaw, vx, vy):
        values[absent] = np.nan
    return x, y, z, yaw, vx, vy


def _around(jumps: Booleans, time: Floats) -> Booleans:
    """Return which frames are within 0.5 s of a jump between two frames."""
    count = np.pad(np.cumsum(jumps, axis=1), ((0, 0), (1, 0)))
    clock = np.maximum.accumulate(np.where(np.isnan(time), -np.inf, time))
    frames = np.arange(len(time))
    first = np.minimum(np.searchsorted(clock, clock - _AROUND_JUMP), np.maximum(frames - 1, 0))
    last = np.maximum(np.searchsorted(clock, clock + _AROUND_JUMP, side="right") - 1, np.minimum(frames + 1, len(time) - 1))
    return np.asarray(count[:, last] > count[:, first])


def _slopes(steps: Floats, seconds: Floats) -> Floats:
    """Return the slope between the neighbours of each frame; NaN without one that it is joined with."""
    padding = ((0, 0), (1, 1))
    steps, seconds = np.pad(steps, padding), np.pad(seconds, padding)
    return np.asarray((steps[:, 1:] + steps[:, :-1]) / (seconds[:, 1:] + seconds[:, :-1]))
