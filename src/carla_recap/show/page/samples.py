"""Samples of a recording for the incident page: the poses of all actors at regular times, stored compactly."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.model.motion import possible_step
from carla_recap.model.presence import FAR
from carla_recap.replay.events import Destroyed
from carla_recap.replay.player import Player
from carla_recap.replay.pose import YAW, right_handed
from carla_recap.replay.selection import NO_IDS
from carla_recap.scene.follow import speeds_between, speeds_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.model.actors import ActorLife
    from carla_recap.queries.incidents import Incident
    from carla_recap.recording import Recording
    from carla_recap.replay.player import Progress
    from carla_recap.replay.scene import Scene

    Floats = NDArray[np.float64]

BLOCK: Final = 128  # samples that are handled together
STILL: Final = 0.01  # m
STILL_TURN: Final = 0.2  # degrees
ROW_BYTES: Final = 12  # of a sample of an actor in the page
ACTOR_BYTES: Final = 250  # of an actor in the page
_SAME_TIME: Final = 1e-4  # s
_COLUMNS: Final = (0, 1, YAW)
BUDGET: Final = 15_000_000
"""The most bytes of samples before compression; of a longer recording, a page has only the time around incidents."""

RATES: Final = (20.0, 10.0)  # samples per second of a whole recording


@dataclass(slots=True)
class SampledActor:
    """An actor from its spawn to its end; an id that is used again begins another one.

    Attributes:
        id: The actor id.
        since: Elapsed seconds at which it appeared.
        until: Elapsed seconds at which it disappeared; None: not within the samples.
        details: Its spawn and properties; None if its spawn is not recorded.
    """

    id: int
    since: float
    until: float | None = None
    details: ActorLife | None = None


@dataclass(slots=True)
class Track:
    """A part of an actor's path without a gap or a jump.

    Attributes:
        actor: The index of the actor in `SampledReplay.actors`.
        first: The index of its first sample.
        last: The index of its last sample.
        rows: x, y in m, yaw in degrees, right-handed, and the speed in m/s or NaN for each sample; a single row if the actor
            stands still.
    """

    actor: int
    first: int
    last: int
    rows: Floats

    @property
    def is_still(self) -> bool:
        """Whether the actor stands still, so that there is one row for all samples."""
        return len(self.rows) == 1


@dataclass
class SampledReplay:
    """The sampled paths of all actors.

    Attributes:
        times: The times of the samples, in elapsed seconds, ascending.
        spans: The intervals that the samples cover: first and last time, in seconds.
        actors: The actors.
        tracks: Their paths, those of an actor in order of time; the last sample of one may be the first of the next.
        lights: Each change of a traffic light: its index in `actors`, elapsed seconds, the state.
    """

    times: Floats
    spans: list[tuple[float, float]]
    actors: list[SampledActor]
    tracks: list[Track]
    lights: list[tuple[int, float, int]]

    def covers(self, time: float) -> bool:
        """Return whether the samples cover a time."""
        return any(start <= time <= stop for start, stop in self.spans)

    def poses(self, time: float) -> dict[int, Floats]:
        """Return the poses at a time by the indices of the actors: x, y, yaw, speed of the sample at or before it."""
        sample = int(np.searchsorted(self.times, time + _SAME_TIME, side="right")) - 1
        _, first, last = self._bounds
        poses = {}
        for index in np.flatnonzero((first <= sample) & (sample <= last)).tolist():
            track = self.tracks[index]
            until = self.actors[track.actor].until
            if until is None or until > time:
                poses[track.actor] = track.rows[0 if track.is_still else sample - track.first]
        return poses

    def ids(self, time: float) -> set[int]:
        """Return the ids of the actors that are present at a time."""
        return {self.actors[actor].id for actor in self.poses(time)}

    def light_states(self, time: float) -> dict[int, int]:
        """Return the states of the traffic lights at a time, by their indices in `actors`."""
        return {actor: state for actor, since, state in self.lights if since <= time + _SAME_TIME}

    @cached_property
    def _bounds(self) -> NDArray[np.int64]:
        """The actor, the first and the last sample of each track."""
        bounds = [(track.actor, track.first, track.last) for track in self.tracks]
        return np.array(bounds, np.int64).reshape(-1, 3).T


class Sampler:
    """Takes samples of scenes in order of time.

    Args:
        rate: The most samples per second.
    """

    def __init__(self, rate: float) -> None:
        self._times: list[float] = []
        self._spans: list[tuple[float, float]] = []
        self._sampled: list[SampledActor] = []
        self._tracks: list[Track] = []
        self._lights: list[tuple[int, float, int]] = []
        self._step = 1 / rate
        self._due = -math.inf
        self._rows = 0
        self._index: dict[int, int] = {}  # the index of the actor that has an id now
        self._known: dict[tuple[int, float], int] = {}  # the index of an actor by its id and the time of its spawn
        self._open: dict[int, Track] = {}  # the latest track of an actor
        self._parts: dict[int, list[Floats]] = {}  # the rows of the latest track of an actor
        self._actors: Mapping[int, ActorLife] = {}
        self._block: list[tuple[NDArray[np.intp], Floats]] = []
        self._begin = 0  # the first sample of the block
        self._ids = NO_IDS
        self._changed = False  # whether actors appeared or disappeared since the last sample
        self._columns = np.zeros(0, np.intp)  # the actors of the rows of a sample
        self._fixed = np.zeros((0, 4))  # the rows of actors without recorded poses
        self._before: Scene | None = None  # the scene before, if it belongs to the same interval
        self._latest: Scene | None = None  # the scene of the latest sample, until the next scene
        self._appeared = np.zeros(0, np.bool_)  # whether each of its ids is not in the scene before
        self._light_ids, self._light_states = b"", b""
        self._shown: dict[int, int] = {}  # the states of the traffic lights

    @property
    def size(self) -> int:
        """The size of the samples in the page, in bytes, roughly."""
        return self._rows * ROW_BYTES + len(self._sampled) * ACTOR_BYTES

    def begin(self) -> None:
        """Begin an interval that does not continue the one before."""
        self._flush(ended=True)
        self._due = -math.inf
        self._before = self._latest = None

    def add(self, scene: Scene, *, last: bool = False) -> None:
        """Add a scene, if a sample is due.

        Args:
            scene: The scene; all scenes of an interval must be given.
            last: Whether to take the sample in any case.
        """
        before, self._before = self._before, scene
        if scene.fresh:
            self._index.clear()
        for event in scene.events:
            if isinstance(event, Destroyed) and event.id in self._index:
                self._sampled[self._index.pop(event.id)].until = event.elapsed
        self._changed |= scene.fresh or len(scene.events) > 0 or scene.ids is not self._ids
        times = self._times
        if not math.isfinite(scene.time) or (times and scene.time <= times[-1]):
            return
        self._complete_speeds(scene)
        if scene.time < self._due - _SAME_TIME and not last:
            return
        self._due = scene.time + self._step
        if self._changed:
            self._update_actors(scene)
        if not self._block:
            self._begin = len(times)
            self._spans.append((scene.time, scene.time))
        times.append(scene.time)
        self._actors = scene.actors
        self._spans[-1] = (self._spans[-1][0], scene.time)
        poses = right_handed(scene.poses)[:, _COLUMNS]
        poses[scene.batch.away[scene.row]] = np.nan
        speeds = speeds_of(scene, before)
        self._latest = scene
        self._appeared = np.isin(scene.ids, NO_IDS if before is None else before.ids, invert=True)
        self._block.append((self._columns, np.concatenate((np.column_stack((poses, speeds)), self._fixed))))
        self._note_lights(scene)
        if len(self._block) > BLOCK:
            self._flush()

    def finish(self) -> SampledReplay:
        """Return the samples."""
        self._flush(ended=True)
        for actor in self._open:
            self._join(actor)
        return SampledReplay(np.array(self._times), self._spans, self._sampled, self._tracks, self._lights)

    def _complete_speeds(self, following: Scene) -> None:
        """Take unknown speeds of actors that appear in the latest sample from the step to the next scene."""
        scene, self._latest = self._latest, None
        if scene is None:
            return
        speeds = self._block[-1][1][: len(scene.ids), 3]
        unknown = np.isnan(speeds) & self._appeared
        if unknown.any():
            speeds[unknown] = speeds_between(scene, following)[unknown]

    def _update_actors(self, scene: Scene) -> None:
        """Find the actors of a scene."""
        for actor in scene.actors.values():
            self._sampled[self._index_of(actor.id, actor.spawned_at)].details = actor
        self._ids, self._changed = scene.ids, False
        columns = [self._index[id] if id in self._index else self._index_of(id, scene.time) for id in scene.ids.tolist()]
        moving, fixed = set(scene.ids.tolist()), []
        for actor in scene.actors.values():
            if actor.id not in moving and not actor.attached and actor.kind != "sensor":
                columns.append(self._index[actor.id])
                fixed.append(actor.spawn_pose)
        self._columns = np.array(columns, np.intp)
        self._fixed = np.zeros((len(fixed), 4))
        self._fixed[:, :3] = right_handed(np.array(fixed).reshape(-1, 6))[:, _COLUMNS]

    def _index_of(self, id: int, since: float) -> int:
        """Return the index of the actor with an id and the time of its spawn."""
        index = self._known.get((id, since))
        if index is None:
            index = self._known[id, since] = len(self._sampled)
            self._sampled.append(SampledActor(id, since))
        self._index[id] = index
        return index

    def _note_lights(self, scene: Scene) -> None:
        records = scene.light_states
        ids, states = records["id"].tobytes(), records["state"].tobytes()
        if ids == self._light_ids and states == self._light_states:
            return
        for id, state in zip(records["id"].tolist(), records["state"].tolist(), strict=True):
            actor = self._index.get(id)
            if actor is not None and self._shown.get(actor) != state:
                self._shown[actor] = state
                self._lights.append((actor, scene.time, state))
        self._light_ids, self._light_states = ids, states

    def _flush(self, *, ended: bool = False) -> None:
        """Add the block to the tracks; its last sample is the first of the next one, unless the interval has ended."""
        block = self._block
        if not block:
            return
        for actor in self._actors.values():
            self._sampled[self._known[actor.id, actor.spawned_at]].details = actor
        present = np.unique(np.concatenate([actors for actors, _ in block]))
        samples = np.full((len(block), len(present), 4), np.nan)
        held, columns = None, np.zeros(0, np.intp)
        for sample, (actors, rows) in zip(samples, block, strict=True):
            if actors is not held:
                held, columns = actors, np.searchsorted(present, actors)
            sample[columns] = rows
        times = np.array(self._times[self._begin : self._begin + len(block)])
        with np.errstate(invalid="ignore", over="ignore"):
            for column, first, last, still in _intervals(samples[..., :3], times):
                rows = samples[first : first + 1 if still else last + 1, column].copy()
                if still:
                    rows[0, 3] = samples[last, column, 3]
                self._append(Track(int(present[column]), self._begin + first, self._begin + last, rows))
        self._block = [] if ended else block[-1:]
        self._begin += len(block) - 1

    def _append(self, track: Track) -> None:
        """Add a track, or extend the one that it continues."""
        before = self._open.get(track.actor)
        if before is not None and before.last == track.first:
            if track.last == track.first:
                return
            if before.is_still and track.is_still and (before.rows[:, :3] == track.rows[:, :3]).all():
                before.last = track.last
                return
            if not before.is_still and not track.is_still:
                before.last = track.last
                self._parts[track.actor].append(track.rows[1:])
                self._rows += len(track.rows) - 1
                return
        self._join(track.actor)
        self._tracks.append(track)
        self._open[track.actor], self._parts[track.actor] = track, [track.rows]
        self._rows += len(track.rows) + 2

    def _join(self, actor: int) -> None:
        """Concatenate the rows of an actor's latest track."""
        if len(self._parts.get(actor, ())) > 1:
            self._open[actor].rows = np.concatenate(self._parts[actor])


def _intervals(samples: Floats, times: Floats) -> Iterator[tuple[int, int, int, bool]]:
    """Yield the uninterrupted paths in a block: the actor's column, the first and last sample, whether it stands still.

    Args:
        samples: x, y, yaw by sample and actor; NaN if the actor is absent.
        times: The times of the samples.
    """
    present = np.isfinite(samples).all(axis=2) & (np.abs(samples[:, :, :2]).max(axis=2) < FAR)
    distances = np.hypot(*np.moveaxis(np.diff(samples[:, :, :2], axis=0), 2, 0))
    joined = present[1:] & present[:-1] & (distances <= possible_step(np.diff(times))[:, None])
    for column in range(samples.shape[1]):
        if joined[:, column].all():
            bounds = [(0, len(times) - 1)] if present[0, column] else []
        else:
            ends = np.flatnonzero(~joined[:, column])
            bounds = list(zip([0, *(ends + 1).tolist()], [*ends.tolist(), len(times) - 1], strict=True))
        for first, last in bounds:
            if present[first, column]:
                spread = np.ptp(samples[first : last + 1, column], axis=0)
                yield column, first, last, bool((spread < (STILL, STILL, STILL_TURN)).all())


def sample(
    recording: Recording, found: Sequence[Incident], before: float, after: float, progress: Progress | None
) -> tuple[SampledReplay, bool]:
    """Return the samples of a recording, or if they are too large, those around its incidents; and whether it is all.

    Args:
        recording: The recording.
        found: The incidents.
        before: The seconds before each.
        after: The seconds after each.
        progress: Gets the scenes and their player, and yields the scenes.
    """
    for rate in RATES:
        player = Player(recording)
        sampler = Sampler(rate)
        scenes = progress(player.scenes(), player) if progress else player.scenes()
        for scene in scenes:
            sampler.add(scene, last=player.finished)
            if sampler.size > BUDGET:
                break
        else:
            return sampler.finish(), True
        if scene.time - player.start < RATES[-1] / RATES[0] * (player.stop - player.start):
            break  # it would be too large at half the rate, too
    player, sampler = Player(recording), Sampler(RATES[0])
    scenes = _around(player, _windows(found, before, after, player.total), sampler)
    for scene in progress(scenes, player) if progress else scenes:
        sampler.add(scene)
        if sampler.size > BUDGET:
            break
    return sampler.finish(), False


def _windows(found: Sequence[Incident], before: float, after: float, total: float) -> list[tuple[float, float]]:
    """Return the intervals around incidents; those that overlap are joined."""
    windows: list[tuple[float, float]] = []
    for start, stop in sorted((max(0.0, one.start - before), min(total, one.start + after)) for one in found):
        if windows and start <= windows[-1][1]:
            windows[-1] = (windows[-1][0], max(stop, windows[-1][1]))
        else:
            windows.append((start, stop))
    return windows


def _around(player: Player, windows: Sequence[tuple[float, float]], sampler: Sampler) -> Iterator[Scene]:
    for start, stop in windows:
        sampler.begin()
        yield player.at(start)
        for scene in player.scenes():
            if scene.time > stop:
                break
            yield scene
