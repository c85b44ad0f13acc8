"""Where everybody is at the moments that a page can show: samples of a replay, without what repeats itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.records import CM, ActorKind
from carla_recap.replay.events import Destroyed
from carla_recap.replay.motion import JUMP, TOP_SPEED
from carla_recap.replay.pose import YAW, right_handed
from carla_recap.replay.rows import NO_IDS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from carla_recap.replay.events import Present
    from carla_recap.replay.scene import Scene

    Floats = NDArray[np.float64]

BLOCK: Final = 128  # samples that are looked at together
FAR: Final = 1e6  # m; nobody is farther out
STILL: Final = 0.01  # m
STILL_TURN: Final = 0.2  # degrees
ROW_BYTES: Final = 10  # of a sample of an actor, as a page holds it
ACTOR_BYTES: Final = 250
_SAME_TIME: Final = 1e-4  # s
_COLUMNS: Final = (0, 1, YAW)


@dataclass(slots=True)
class Life:
    """An actor from its spawn to its end; an id that is given out again begins another one.

    Attributes:
        id: The actor id.
        since: Elapsed seconds at which it appeared.
        until: Elapsed seconds at which it disappeared; None: not within what was sampled.
        actor: What is known of it; None for one whose spawn is not recorded.
    """

    id: int
    since: float
    until: float | None = None
    actor: Present | None = None


@dataclass(slots=True)
class Track:
    """A stretch of an actor's way without a gap or a jump.

    Attributes:
        life: The place of the actor in `Tracks.lives`.
        first: The sample with which it begins.
        last: The sample with which it ends.
        rows: x, y in m and yaw in degrees, right-handed, for each sample; one row only of an actor that stands still.
    """

    life: int
    first: int
    last: int
    rows: Floats

    @property
    def is_still(self) -> bool:
        """Whether one row stands for all samples."""
        return len(self.rows) == 1


@dataclass
class Tracks:
    """Everybody's ways.

    Attributes:
        times: The samples, in elapsed seconds, ascending.
        spans: The stretches of time that the samples cover, from first to last, in seconds.
        lives: The actors.
        tracks: Their ways, those of one actor in order of time; a sample that ends one may begin the next.
        lights: Each change of a traffic light: its place in `lives`, elapsed seconds, the state.
    """

    times: Floats
    spans: list[tuple[float, float]]
    lives: list[Life]
    tracks: list[Track]
    lights: list[tuple[int, float, int]]

    def covers(self, time: float) -> bool:
        """Whether a moment was sampled."""
        return any(start <= time <= stop for start, stop in self.spans)

    def poses(self, time: float) -> dict[int, Floats]:
        """Where the actors are at a moment: the place in `lives` → x, y, yaw of the sample at or before it."""
        sample = int(np.searchsorted(self.times, time + _SAME_TIME, side="right")) - 1
        _, first, last = self._bounds
        poses = {}
        for place in np.flatnonzero((first <= sample) & (sample <= last)).tolist():
            track = self.tracks[place]
            until = self.lives[track.life].until
            if until is None or until > time:
                poses[track.life] = track.rows[0 if track.is_still else sample - track.first]
        return poses

    def ids(self, time: float) -> set[int]:
        """Who is there at a moment."""
        return {self.lives[life].id for life in self.poses(time)}

    def ways(self, life: int, start: float, stop: float) -> list[Floats]:
        """The ways of an actor within a time, as x, y."""
        begin, end = np.searchsorted(self.times, (start, stop)).tolist()
        lives, first, last = self._bounds
        ways = []
        for place in np.flatnonzero((lives == life) & (first < end) & (last > begin)).tolist():
            track = self.tracks[place]
            if not track.is_still:
                ways.append(track.rows[max(begin - track.first, 0) : end - track.first + 1, :2])
        return ways

    def light_states(self, time: float) -> dict[int, int]:
        """What the traffic lights show at a moment, by their places in `lives`."""
        return {life: state for life, since, state in self.lights if since <= time + _SAME_TIME}

    @cached_property
    def _bounds(self) -> NDArray[np.int64]:
        """Of each track the life, the first sample and the last."""
        bounds = [(track.life, track.first, track.last) for track in self.tracks]
        return np.array(bounds, np.int64).reshape(-1, 3).T


class Sampler:
    """Takes samples of scenes, one after the other.

    Args:
        rate: At most so many samples per second.
    """

    def __init__(self, rate: float) -> None:
        self._times: list[float] = []
        self._spans: list[tuple[float, float]] = []
        self._lives: list[Life] = []
        self._tracks: list[Track] = []
        self._lights: list[tuple[int, float, int]] = []
        self._step = 1 / rate
        self._due = -math.inf
        self._rows = 0
        self._place: dict[int, int] = {}  # id → the place of its life
        self._known: dict[tuple[int, float], int] = {}
        self._open: dict[int, Track] = {}  # the latest track of a life
        self._parts: dict[int, list[Floats]] = {}  # the rows of the latest track of a life
        self._actors: Mapping[int, Present] = {}
        self._block: list[tuple[NDArray[np.intp], Floats]] = []
        self._begin = 0  # the sample with which the block begins
        self._ids = NO_IDS
        self._changed = False  # whether somebody came or went since the last sample
        self._columns = np.zeros(0, np.intp)  # the lives of the rows of a sample
        self._fixed = np.zeros((0, 3))  # where those are that have no recorded pose
        self._light_ids, self._light_states = b"", b""
        self._shown: dict[int, int] = {}  # what the traffic lights show

    @property
    def size(self) -> int:
        """How many bytes all of it takes, about."""
        return self._rows * ROW_BYTES + len(self._lives) * ACTOR_BYTES

    def begin(self) -> None:
        """A stretch of time begins, which does not go on from the one before."""
        self._flush(ended=True)
        self._due = -math.inf

    def add(self, scene: Scene, *, last: bool = False) -> None:
        """Take a scene, if it is time for a sample.

        Args:
            scene: The scene; each of a stretch must be given.
            last: Whether to take it in any case.
        """
        if scene.fresh:
            self._place.clear()
        for event in scene.events:
            if isinstance(event, Destroyed) and event.id in self._place:
                self._lives[self._place.pop(event.id)].until = event.elapsed
        self._changed |= scene.fresh or len(scene.events) > 0 or scene.ids is not self._ids
        times = self._times
        if not math.isfinite(scene.time) or (times and scene.time <= times[-1]):
            return
        if scene.time < self._due - _SAME_TIME and not last:
            return
        self._due = scene.time + self._step
        if self._changed:
            self._meet(scene)
        if not self._block:
            self._begin = len(times)
            self._spans.append((scene.time, scene.time))
        times.append(scene.time)
        self._actors = scene.actors
        self._spans[-1] = (self._spans[-1][0], scene.time)
        poses = right_handed(scene.poses)[:, _COLUMNS]
        self._block.append((self._columns, np.concatenate((poses, self._fixed))))
        self._note_lights(scene)
        if len(self._block) > BLOCK:
            self._flush()

    def finish(self) -> Tracks:
        """What was sampled."""
        self._flush(ended=True)
        for life in self._open:
            self._join(life)
        return Tracks(np.array(self._times), self._spans, self._lives, self._tracks, self._lights)

    def _meet(self, scene: Scene) -> None:
        """Learn who is there."""
        for actor in scene.actors.values():
            self._lives[self._life(actor.id, actor.since)].actor = actor
        self._ids, self._changed = scene.ids, False
        lives = [self._place[id] if id in self._place else self._life(id, scene.time) for id in scene.ids.tolist()]
        moving, fixed = set(scene.ids.tolist()), []
        for actor in scene.actors.values():
            if actor.id not in moving and not actor.attached and actor.kind != ActorKind.SENSOR:
                lives.append(self._place[actor.id])
                fixed.append(actor.spawn_pose)
        self._columns = np.array(lives, np.intp)
        self._fixed = right_handed(np.array(fixed).reshape(-1, 6))[:, _COLUMNS]

    def _life(self, id: int, since: float) -> int:
        place = self._known.get((id, since))
        if place is None:
            place = self._known[id, since] = len(self._lives)
            self._lives.append(Life(id, since))
        self._place[id] = place
        return place

    def _note_lights(self, scene: Scene) -> None:
        records = scene.light_states
        ids, states = records["id"].tobytes(), records["state"].tobytes()
        if ids == self._light_ids and states == self._light_states:
            return
        for id, state in zip(records["id"].tolist(), records["state"].tolist(), strict=True):
            life = self._place.get(id)
            if life is not None and self._shown.get(life) != state:
                self._shown[life] = state
                self._lights.append((life, scene.time, state))
        self._light_ids, self._light_states = ids, states

    def _flush(self, *, ended: bool = False) -> None:
        """Put the block to the tracks; its last sample begins the next one, unless the stretch has ended."""
        block = self._block
        if not block:
            return
        for actor in self._actors.values():
            self._lives[self._known[actor.id, actor.since]].actor = actor
        present = np.unique(np.concatenate([lives for lives, _ in block]))
        samples = np.full((len(block), len(present), 3), np.nan)
        held, columns = None, np.zeros(0, np.intp)
        for sample, (lives, rows) in zip(samples, block, strict=True):
            if lives is not held:
                held, columns = lives, np.searchsorted(present, lives)
            sample[columns] = rows
        times = np.array(self._times[self._begin : self._begin + len(block)])
        with np.errstate(invalid="ignore", over="ignore"):
            for column, first, last, still in _stretches(samples, times):
                rows = samples[first : first + 1 if still else last + 1, column]
                self._append(Track(int(present[column]), self._begin + first, self._begin + last, rows.copy()))
        self._block = [] if ended else block[-1:]
        self._begin += len(block) - 1

    def _append(self, track: Track) -> None:
        """Add a track; one that goes on from the one before becomes a part of it."""
        before = self._open.get(track.life)
        if before is not None and before.last == track.first:
            if track.last == track.first:
                return
            if before.is_still and track.is_still and (before.rows == track.rows).all():
                before.last = track.last
                return
            if not before.is_still and not track.is_still:
                before.last = track.last
                self._parts[track.life].append(track.rows[1:])
                self._rows += len(track.rows) - 1
                return
        self._join(track.life)
        self._tracks.append(track)
        self._open[track.life], self._parts[track.life] = track, [track.rows]
        self._rows += len(track.rows) + 2

    def _join(self, life: int) -> None:
        """Put the rows of an actor's latest track together."""
        if len(self._parts.get(life, ())) > 1:
            self._open[life].rows = np.concatenate(self._parts[life])


def _stretches(samples: Floats, times: Floats) -> Iterator[tuple[int, int, int, bool]]:
    """The stretches within a block: the actor's column, its first and last sample, whether it stands still.

    Args:
        samples: By sample and actor: x, y, yaw; NaN where the actor is not there.
        times: Of the samples.
    """
    there = np.isfinite(samples).all(axis=2) & (np.abs(samples[:, :, :2]).max(axis=2) < FAR)
    ways = np.hypot(*np.moveaxis(np.diff(samples[:, :, :2], axis=0), 2, 0))
    possible = np.maximum(JUMP, TOP_SPEED * np.diff(times)) * CM
    joined = there[1:] & there[:-1] & (ways <= possible[:, None])
    for column in range(samples.shape[1]):
        if joined[:, column].all():
            bounds = [(0, len(times) - 1)] if there[0, column] else []
        else:
            ends = np.flatnonzero(~joined[:, column])
            bounds = list(zip([0, *(ends + 1).tolist()], [*ends.tolist(), len(times) - 1], strict=True))
        for first, last in bounds:
            if there[first, column]:
                spread = np.ptp(samples[first : last + 1, column], axis=0)
                yield column, first, last, bool((spread < (STILL, STILL, STILL_TURN)).all())
