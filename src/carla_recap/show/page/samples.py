"""Samples of a recording for the incident page: the poses of all actors at regular times, and measures of some."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.motion import possible_step
from carla_recap.queries.measures.definitions import NO_OTHER
from carla_recap.queries.measures.series import measures_in_parts
from carla_recap.replay.events import Destroyed
from carla_recap.replay.motion import SceneMotion
from carla_recap.replay.player import Player
from carla_recap.replay.pose import YAW
from carla_recap.replay.selection import find
from carla_recap.scene.ahead import NO_LIGHT, stop_points
from carla_recap.scene.description import SceneDescriber
from carla_recap.scene.falls import RecordedContacts
from carla_recap.scene.follow import FollowedActor

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.incidents import Incident
    from carla_recap.recording import Recording
    from carla_recap.replay.player import Progress
    from carla_recap.replay.scene import Scene, SceneBatch
    from carla_recap.scene.appearance import Look
    from carla_recap.scene.description import SceneDescription
    from carla_recap.util.arrays import Floats, Ids, Indices, Integers


BLOCK: Final = 128  # samples that are handled together
STILL: Final = 0.01  # m
STILL_TURN: Final = 0.2  # degrees
ROW_BYTES: Final = 12  # of a sample of an actor in the page
ACTOR_BYTES: Final = 250  # of an actor in the page
_SAME_TIME: Final = 1e-4  # s
_COLUMNS: Final = (0, 1, YAW)
_LAMPS: Final = 0xFF  # the bits of lamps that are seen from above: all but the one within, and beacons
OFF: Final = 3  # the state of a traffic light that is not recorded
Change: TypeAlias = tuple[int, float, int]
"""A change of a value: the index of an actor, the elapsed seconds, the value from then on."""
BUDGET: Final = 15_000_000
"""The most bytes of samples before compression; of a longer recording, a page has only the time around incidents."""

MEASURED_VALUES: Final = ("acceleration", "gap", "ttc", "throttle", "brake", "steer", "light", "distance")
RATES: Final = (20.0, 10.0)  # samples per second of a whole recording


@dataclass(slots=True)
class SampledActor:
    """An actor from its spawn to its end; an id that is used again begins another one."""

    actor: ActorLife  # its spawn and properties
    look: Look
    until: float | None = None  # elapsed seconds at which it disappeared; None: not within the samples

    @property
    def id(self) -> int:
        """The actor id."""
        return self.actor.id


@dataclass(slots=True)
class Track:
    """A part of an actor's path without a gap or a jump."""

    actor: int  # the index of the actor in `SampledReplay.actors`
    first: int  # the index of its first sample
    last: int  # the index of its last sample
    # x, y in m, yaw in degrees, right-handed, and the speed in m/s or NaN for each sample; a single row if the actor
    # stands still
    rows: Floats

    @property
    def is_still(self) -> bool:
        """Whether the actor stands still, so that there is one row for all samples."""
        return len(self.rows) == 1


@dataclass(frozen=True, eq=False)
class MeasuredActor:
    """What is plotted of an actor at each sample, beside its speed; NaN where it is unknown."""

    id: int  # the actor id
    leader: NDArray[np.int64]  # the id of the actor ahead, or `NO_OTHER`
    # by name: "acceleration" in m/s², "throttle", "brake" and "steer" as they are shown, the state of the "light"
    # ahead in CARLA's numbers and the "distance" to it in m, see `FollowedSeries`; the distance headway as "gap" in m,
    # and the time to collision as "ttc" in s, see `carla_recap.queries.measures`
    values: dict[str, Floats]


@dataclass
class SampledReplay:
    """The sampled paths of all actors."""

    times: Floats  # the times of the samples, in elapsed seconds, ascending
    spans: list[tuple[float, float]]  # the intervals that the samples cover: first and last time, in seconds
    actors: list[SampledActor]
    # their paths, those of an actor in order of time; the last sample of one may be the first of the next
    tracks: list[Track]
    lights: list[Change]  # each change of a traffic light: its index in `actors`, elapsed seconds, the state
    # each change of a walker that lies: its index in `actors`, elapsed seconds, the heading of its head in degrees,
    # right-handed; -1 from when on it does not lie
    lying: list[Change]
    # each change of a vehicle's lit lamps: its index in `actors`, elapsed seconds, the bits of CARLA's
    # VehicleLightState
    lamps: list[Change]
    # the elapsed seconds at which marks of collisions appear or disappear, and where all are from then on, (marks, 2)
    # in m, right-handed
    marks: list[tuple[float, Floats]]

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

    @cached_property
    def _bounds(self) -> NDArray[np.int64]:
        """The actor, the first and the last sample of each track."""
        bounds = [(track.actor, track.first, track.last) for track in self.tracks]
        return np.array(bounds, np.int64).reshape(-1, 3).T


class _Changes:
    """The changes of a value of each actor."""

    def __init__(self) -> None:
        self.rows: list[Change] = []
        self._now: dict[int, int] = {}

    def add(self, time: float, index: Mapping[int, int], ids: Ids, values: Integers, gone: int) -> None:
        """Add the values of actors at a time, given by their ids; any other actor has `gone`."""
        now = {index[id]: value for id, value in zip(ids.tolist(), values.tolist(), strict=True) if id in index}
        if now != self._now:
            self.rows += [(actor, time, value) for actor, value in now.items() if self._now.get(actor, gone) != value]
            self.rows += [(actor, time, gone) for actor, value in self._now.items() if actor not in now and value != gone]
            self._now = now


class Sampler:
    """Takes samples of scenes in order of time."""

    def __init__(self, rate: float) -> None:
        self._times: list[float] = []
        self._spans: list[tuple[float, float]] = []
        self._sampled: list[SampledActor] = []
        self._tracks: list[Track] = []
        self._lights, self._lying, self._lamps = _Changes(), _Changes(), _Changes()
        self._marks: list[tuple[float, Floats]] = []
        self._step = 1 / rate
        self._due = -math.inf
        self._rows = 0
        self._index: dict[int, int] = {}  # the index of the actor that has an id now
        self._known: dict[tuple[int, float], int] = {}  # the index of an actor by its id and the time of its spawn
        self._open: dict[int, Track] = {}  # the latest track of an actor
        self._parts: dict[int, list[Floats]] = {}  # the rows of the latest track of an actor
        self._describer = SceneDescriber(signs=True)
        self._description: SceneDescription | None = None
        self._block: list[tuple[NDArray[np.intp], Floats]] = []
        self._begin = 0  # the first sample of the block
        self._changed = False  # whether actors appeared or disappeared since the last sample
        self._columns = np.zeros(0, np.intp)  # the actors of the rows of a sample
        self._motion = SceneMotion()
        self._moving: tuple[SceneBatch, Floats] | None = None  # the latest batch, and the speeds in it

    @property
    def size(self) -> int:
        """The size of the samples in the page, in bytes, roughly."""
        return self._rows * ROW_BYTES + len(self._sampled) * ACTOR_BYTES

    def begin(self, player: Player, contacts: RecordedContacts) -> None:
        """Begin an interval that does not continue the one before."""
        self._flush(ended=True)
        self._due = -math.inf
        self._describer.recall(player, contacts)

    def add(self, scene: Scene, *, last: bool = False) -> None:
        """Add a scene, if a sample is due.

        All scenes of an interval must be given; with `last`, the sample is taken in any case.
        """
        if self._moving is None or self._moving[0] is not scene.batch:
            velocities = self._motion.velocities(scene.batch)
            self._moving = scene.batch, np.sqrt((velocities**2).sum(axis=2))
        if scene.fresh:
            self._index.clear()
        for event in scene.events:
            if isinstance(event, Destroyed) and event.id in self._index:
                self._sampled[self._index.pop(event.id)].until = event.elapsed
        before_these, self._description = self._description, self._describe(scene)
        self._changed |= scene.fresh or len(scene.events) > 0 or before_these is not self._description
        times = self._times
        if not math.isfinite(scene.time) or (times and scene.time <= times[-1]):
            return
        if scene.time < self._due - _SAME_TIME and not last:
            return
        self._due = scene.time + self._step
        if self._changed:
            self._update_actors(self._description)
        if not self._block:
            self._begin = len(times)
            self._spans.append((scene.time, scene.time))
        times.append(scene.time)
        self._spans[-1] = (self._spans[-1][0], scene.time)
        rows = np.full((len(self._columns), 4), np.nan)
        shown = self._description.shown[scene.row]
        rows[shown, :3] = self._description.poses[scene.row][shown][:, _COLUMNS]
        where, recorded = find(self._description.ids, scene.ids)
        rows[recorded, 3] = self._moving[1][scene.row][where[recorded]]
        self._block.append((self._columns, rows))
        self._add_changes(scene, self._description)
        if len(self._block) > BLOCK:
            self._flush()

    def finish(self) -> SampledReplay:
        """Return the samples."""
        self._flush(ended=True)
        for actor in self._open:
            self._join(actor)
        lights, lying, lamps = self._lights.rows, self._lying.rows, self._lamps.rows
        times, spans = np.array(self._times), self._spans
        return SampledReplay(times, spans, self._sampled, self._tracks, lights, lying, lamps, self._marks)

    def _describe(self, scene: Scene) -> SceneDescription:
        """Return the description of the batch of a scene."""
        described = self._description
        if described is not None and described.batch is scene.batch:
            return described
        return self._describer.describe(scene.batch)

    def _update_actors(self, description: SceneDescription) -> None:
        """Find the actors of some scenes."""
        self._changed = False
        actors = zip(description.ids.tolist(), description.actors.looks, strict=True)
        self._columns = np.array([self._index_of(description.lives[id], look) for id, look in actors], np.intp)

    def _index_of(self, actor: ActorLife, look: Look) -> int:
        """Return the index of an actor; one without a spawn is the same while no other actor has its id."""
        id, key = actor.id, (actor.id, actor.spawned_at)
        index = self._index.get(id) if not actor.type_id else None
        if index is None:
            index = self._known.setdefault(key, len(self._sampled))
        if index == len(self._sampled):
            self._sampled.append(SampledActor(actor, look))
        self._sampled[index].actor, self._sampled[index].look = actor, look
        self._index[id] = index
        return index

    def _add_changes(self, scene: Scene, description: SceneDescription) -> None:
        """Add the states of traffic lights, the walkers that lie, the lit lamps of vehicles and the marks in a scene."""
        lights, lying, flags = scene.light_states, description.lying_at(scene.row), description.flags[scene.row] & _LAMPS
        lit, ids = np.flatnonzero(flags), np.array(list(lying), np.uint32)
        self._lights.add(scene.time, self._index, lights["id"], lights["state"], OFF)
        self._lying.add(scene.time, self._index, ids, np.rint(list(lying.values())).astype(np.int64) % 360, -1)
        self._lamps.add(scene.time, self._index, description.vehicles[lit], flags[lit], 0)
        places = description.marks_at(scene.row)[:, :2]
        if not np.array_equal(places, self._marks[-1][1] if self._marks else np.zeros((0, 2))):
            self._marks.append((scene.time, places))

    def _flush(self, *, ended: bool = False) -> None:
        """Add the block to the tracks; its last sample is the first of the next one, unless the interval has ended."""
        block = self._block
        if not block:
            return
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
                    speeds = samples[first : last + 1, column, 3]
                    rows[0, 3] = np.append(np.nan, speeds[np.isfinite(speeds)])[-1]
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

    Samples are x, y, yaw by sample and actor; NaN if the actor is absent.
    """
    present = np.asarray(np.isfinite(samples).all(axis=2))
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
    """Return the samples of a recording, or if they are too large, those around its incidents; and whether it is all."""
    for rate in RATES:
        player = Player(recording)
        sampler = Sampler(rate)
        scenes = chain.from_iterable(player.batches())
        for scene in progress(scenes, player) if progress else scenes:
            sampler.add(scene, last=player.finished)
            if sampler.size > BUDGET:
                break
        else:
            return sampler.finish(), True
        if scene.time - player.start < RATES[-1] / RATES[0] * (player.stop - player.start):
            break  # it would be too large at half the rate, too
    player, sampler = Player(recording), Sampler(RATES[0])
    around = _around(recording, _windows(found, before, after, player.total), sampler)
    for scene in progress(around, player) if progress else around:
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


def _around(recording: Recording, windows: Sequence[tuple[float, float]], sampler: Sampler) -> Iterator[Scene]:
    contacts = RecordedContacts(recording.reader)
    for start, stop in windows:
        player = Player(recording, start=start, duration=max(stop - start, SAME_TIME))
        sampler.begin(player, contacts)
        yield from chain.from_iterable(player.batches())


def measure(recording: Recording, ids: Sequence[int], times: Floats) -> list[MeasuredActor]:
    """Return what is plotted of some actors at the times of samples, in elapsed seconds, ascending."""
    stops = stop_points(recording.reader)
    measured = [
        MeasuredActor(
            id, np.full(len(times), NO_OTHER, np.int64), {name: np.full(len(times), np.nan) for name in MEASURED_VALUES}
        )
        for id in ids
    ]
    for part in measures_in_parts(recording.reader, ids):
        for each in measured:
            series, values = part[each.id], each.values
            samples, rows = _samples_at(times, series.time)
            values["gap"][samples], values["ttc"][samples] = series.distance_headway[rows], series.time_to_collision[rows]
            each.leader[samples] = series.leader[rows]
    followed = [FollowedActor(each.id, stops) for each in measured]
    for batch in Player(recording).batches():
        samples, rows = _samples_at(times, batch.time)
        for each, actor in zip(measured, followed, strict=True):
            shown = actor.series(batch)
            found = {
                "acceleration": shown.acceleration,
                "throttle": shown.pedals[:, 0],
                "brake": shown.pedals[:, 1],
                "steer": shown.controls[:, 2],
                "light": np.where(shown.light == NO_LIGHT, np.nan, shown.light_state),
                "distance": shown.light_distance,
            }
            for name, values_of in found.items():
                each.values[name][samples] = values_of[rows]
    return measured


def _samples_at(times: Floats, moments: Floats) -> tuple[Indices, Indices]:
    """Return the samples that are of some moments, the last first, and which of these they are of."""
    samples = np.searchsorted(times, moments - SAME_TIME)
    rows = np.flatnonzero(np.abs(np.append(times, np.nan)[samples] - moments) <= _SAME_TIME)[::-1]
    return samples[rows], rows
