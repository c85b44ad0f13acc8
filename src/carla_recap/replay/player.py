"""The player: the one clock by which recordings are shown, exported, cut and simulated anew."""

from __future__ import annotations

import math
from collections import defaultdict
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.batch import Batch
from carla_recap.model.frame import SAME_TIME
from carla_recap.recording import Recording
from carla_recap.replay.cursor import Cursor
from carla_recap.replay.follow import Follow, choose_followed, find_followed
from carla_recap.replay.motion import Motion
from carla_recap.replay.rows import Selection
from carla_recap.replay.scene import Scene, SceneBatch
from carla_recap.replay.state import ReplayState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.replay.rows import Ids

    Floats = NDArray[np.float64]
    Progress = Callable[[Iterable[Scene], "Player"], Iterable[Scene]]

FAST: Final = 2.0
"""From this time factor on nothing is interpolated, as in CARLA."""

_PRINTED: Final = 1e-5  # the end may be given as it is printed, with six digits


class Played(NamedTuple):
    """How much was played: the number of scenes, and the seconds of the recording that they span."""

    frames: int
    seconds: float


class Player:
    """Plays a recording: a scene for each tick of whoever shows it.

    The pose of an actor at a moment lies between those of the frame at or before it and of the next one: its location on
    the straight line, its angles each on the shortest way. (CARLA's own replay lags one frame behind that.) An actor that
    jumps, goes or is replaced until the next frame keeps its pose; so does everything in the last frame.

    Only the frame at a moment and the next one are held. Before the first frame, the first is shown.

    Args:
        source: The recording; it must stay open.
        start: Where to begin, in elapsed seconds; negative: so long before the end.
        duration: How many seconds of the recording to play; 0: all of the rest.
        time_factor: How many seconds of the recording pass in a second of a tick; from `FAST` on there is no interpolation.
        follow: Whom the camera follows: an id or "hero"; None: see `choose_followed`.
        ignore_hero: Leave out the actors with the role_name hero.
        ignore_spectator: Leave out the spectator.
        smooth: Interpolate; False: poses are those of the frame at or before the moment.

    Attributes:
        reader: That of the recording.
        total: Elapsed seconds of the last frame.
        start: Where it begins, in elapsed seconds.
        stop: Where it ends.
        smooth: See above; can be changed while playing.

    Raises:
        RecapError: The start lies outside the recording, there is no such actor to follow, or a number makes no sense.
        FormatError: The file contradicts its format.
    """

    def __init__(
        self,
        source: Recording | Reader,
        *,
        start: float = 0.0,
        duration: float = 0.0,
        time_factor: float = 1.0,
        follow: Follow | None = None,
        ignore_hero: bool = False,
        ignore_spectator: bool = True,
        smooth: bool = True,
    ) -> None:
        reader = source.reader if isinstance(source, Recording) else source
        self.reader = reader
        extent = reader.extent()
        if not extent.frames:
            raise RecapError(f"{reader.path}: the recording has no frames")
        self.total = extent.duration
        self.start = self._moment(start)
        if not 0 <= duration < math.inf:
            raise RecapError(f"a duration of {duration:g} s cannot be played; 0 is all of the rest")
        self.stop = min(self.start + duration, self.total) if duration else self.total
        self.time_factor = time_factor
        self.smooth = smooth
        self._ignore_hero = ignore_hero
        self._time = self.start
        self._begun = self._finished = False
        self._fresh = True
        self._cursor = Cursor(
            reader,
            lambda: ReplayState(reader.header.table, ignore_hero=ignore_hero, ignore_spectator=ignore_spectator),
        )
        self._motion = Motion()
        self._selections: defaultdict[str, Selection] = defaultdict(Selection)
        if follow is not None:
            self.followed = find_followed(reader, follow, ignore_hero=ignore_hero)

    @property
    def time(self) -> float:
        """The moment that is played, in elapsed seconds."""
        return self._time

    @property
    def finished(self) -> bool:
        """Whether the scene at the stop has been given."""
        return self._finished

    @property
    def time_factor(self) -> float:
        """Seconds of the recording per second of a tick; can be changed while playing, 0 holds it."""
        return self._time_factor

    @time_factor.setter
    def time_factor(self, factor: float) -> None:
        if not 0 <= factor < math.inf:
            raise RecapError(f"a time factor of {factor:g} cannot be played; it must be 0 or more")
        self._time_factor = factor

    @cached_property
    def followed(self) -> int | None:
        """Whom the camera follows; None where there is nobody. Chosen when first asked for, if nobody was named."""
        return choose_followed(self.reader, start=self.start, stop=self.stop, ignore_hero=self._ignore_hero)

    def tick(self, delta: float) -> Scene | None:
        """Let time go on, and see what there is then.

        The first tick goes on from the start; `tick(0)` shows the start itself. The last scene is that of the stop.

        Args:
            delta: Seconds, which the time factor stretches.

        Returns:
            The scene; None after the last one.

        Raises:
            RecapError: Time cannot go backwards; `at` can.
            FormatError: The file contradicts its format.
        """
        if not 0 <= delta < math.inf:
            raise RecapError(f"a tick of {delta:g} s cannot be played; it must be 0 or more")
        return self._play(self._time + delta * self.time_factor)

    def at(self, time: float) -> Scene:
        """Leap to a moment anywhere in the recording; ticks go on from there.

        Args:
            time: Elapsed seconds; negative: so long before the end.

        Raises:
            RecapError: The moment lies outside the recording.
            FormatError: The file contradicts its format.
        """
        self._time = self._moment(time)
        self._cursor.seek(self._time)
        self._begun = self._fresh = True
        self._finished = self._time >= self.stop - SAME_TIME
        return self._scene()

    def scenes(self, rate: float | None = None) -> Iterator[Scene]:
        """Play on to the stop.

        Args:
            rate: Scenes per second of ticks, which the time factor stretches; None: a scene for each frame of the
                recording, at its very time. Either way the first scene is that of now, the last one that of the stop.

        Raises:
            RecapError: That is no rate.
            FormatError: The file contradicts its format.
        """
        if rate is not None and not 0 < rate < math.inf:
            raise RecapError(f"{rate:g} scenes per second cannot be played")
        scene = self.tick(0.0)
        while scene is not None:
            yield scene
            if rate is not None:
                scene = self.tick(1 / rate)
            else:
                following = self._cursor.next
                scene = self._play(self.stop if following is None else following.elapsed)

    def batches(self, progress: Progress | None = None) -> Iterator[SceneBatch]:
        """Play on to the stop, as `scenes` without a rate, in batches of scenes with the same actors.

        A batch has events only in its first scene. The time of the player is that of the last scene of a batch.

        Args:
            progress: Is given all scenes and the player, and passes the scenes on.

        Raises:
            FormatError: The file contradicts its format.
        """
        if progress is None:
            yield from self._batches()
            return
        scenes = (scene for batch in self._batches() for scene in batch)
        for scene in progress(scenes, self):
            if scene.row == len(scene.batch) - 1:
                yield scene.batch

    def _batches(self) -> Iterator[SceneBatch]:
        cursor, scene = self._cursor, self.tick(0.0)
        while scene is not None:
            yield scene.batch
            while not self._finished and (found := cursor.advance_batch(self._time, self.stop - SAME_TIME)):
                frames, light_states = found
                self._time = float(frames.elapsed[-1])
                ids, poses = self._motion.read(frames.records("transforms"), cursor.state.hidden)
                yield self._batch(frames.elapsed, frames, ids, poses, light_states)
            scene = self._play(self.stop if cursor.next is None else cursor.next.elapsed)

    def _play(self, time: float) -> Scene | None:
        if self._finished:
            return None
        if not self._begun:
            self._cursor.seek(self.start)
            self._begun = True
        if not time < self.stop - SAME_TIME:
            time = self.stop
            self._finished = True
        self._time = time
        self._cursor.advance(time)
        return self._scene()

    def _scene(self) -> Scene:
        cursor = self._cursor
        state, frame, following = cursor.state, cursor.frame, cursor.next
        if self._time < frame.elapsed <= self._time + SAME_TIME:
            self._time = frame.elapsed
        time = self._time
        part = 0.0
        if following is not None and self.smooth and self._time_factor < FAST:
            length = following.elapsed - frame.elapsed
            part = (time - frame.elapsed) / length if length > 0 else 0.0
            part = part if 0 <= part <= 1 else 0.0
        ids, poses = self._motion.at(frame, following, state.hidden, part)
        return Scene(self._batch(np.array([time]), Batch.of(frame), ids, poses[None], state.light_states[None]))

    def _batch(self, time: Floats, frames: Batch, ids: Ids, poses: Floats, light_states: NDArray[np.void]) -> SceneBatch:
        state = self._cursor.state
        fresh, self._fresh = self._fresh, False
        return SceneBatch(
            time,
            frames,
            fresh,
            self._cursor.take_events(),
            ids,
            poses,
            state.actors,
            light_states,
            state.doors,
            state.weather,
            state.scene_lights,
            state.hidden,
            self._selections,
        )

    def _moment(self, time: float) -> float:
        """A time in elapsed seconds, of one that may count from the end."""
        if time < 0:
            return max(0.0, self.total + time)
        if time <= self.total:
            return time
        if time <= self.total * (1 + _PRINTED):
            return self.total
        raise RecapError(f"{self.reader.path}: nothing at {time:g} s; the recording ends at {self.total:g} s")
