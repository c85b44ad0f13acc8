"""The player, by which recordings are shown, exported, cut and simulated again, and scenes of a running recording."""

from __future__ import annotations

import math
import warnings
from copy import copy
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.model.batch import Batch
from carla_recap.model.frame import SAME_TIME
from carla_recap.model.records import UE4
from carla_recap.recording import Recording
from carla_recap.replay.cursor import Cursor
from carla_recap.replay.follow import Follow, choose_followed, find_followed
from carla_recap.replay.pose import Interpolator, poses_of
from carla_recap.replay.scene import Scene, SceneBatch
from carla_recap.replay.state import ReplayState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.frame import Frame
    from carla_recap.util.arrays import Floats

    Progress = Callable[[Iterable[Scene], "Player"], Iterable[Scene]]

FAST: Final = 2.0
"""From this time factor on nothing is interpolated, as in CARLA."""

_PRINTED: Final = 1e-5  # relative tolerance of times after the end, which is printed with six digits
ROUNDED: Final = 0.005
"""The seconds by which times in texts, which have two decimals, may be beside what they mean."""


class Played(NamedTuple):
    """The number of scenes that were played, and the duration of that part of the recording, in seconds."""

    frames: int
    seconds: float


class Player:
    """Plays a recording: a scene for each tick, or for each frame.

    Poses are interpolated between the frame at or before a moment and the next one: locations linearly, and each angle by
    the shortest rotation. (CARLA's own replay is one frame late.) An actor that jumps, disappears or is replaced until the
    next frame keeps its pose; so do all actors in the last frame. Before the first frame, the first one is shown.
    Frames whose clock is behind an earlier frame's count as at the time of that one.

    Args:
        source: The recording; it must stay open.
        start: The elapsed seconds to begin at; negative: before the end.
        duration: The seconds of the recording to play; 0: all of the rest.
        time_factor: The seconds of the recording that pass in a second of a tick; from 2 on, nothing is interpolated.
        follow: The actor that the camera follows: an id or "hero"; None: the hero, else the first vehicle or walker to
            collide, else the one that moves farthest.
        ignore_hero: Leave out the actors with the role_name hero.
        ignore_spectator: Leave out the spectator.
        smooth: Interpolate; False: poses are those of the frame at or before the moment.

    Attributes:
        reader: The reader of the recording.
        total: The elapsed seconds of the last frame.
        start: The elapsed seconds of the first scene.
        stop: The elapsed seconds of the last scene.
        smooth: See above; can be changed while playing.

    Raises:
        RecapError: The start lies outside the recording, the actor to follow does not exist, or a number is invalid.
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
            raise RecapError(f"{reader.location}: the recording has no frames")
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
        self._interpolator = Interpolator()
        if follow is not None:
            self.followed = find_followed(reader, follow, ignore_hero=ignore_hero)

    @property
    def time(self) -> float:
        """The current moment, in elapsed seconds."""
        return self._time

    def observe(self, observer: Callable[[Batch], object]) -> None:
        """Have a function called with each batch of frames that is read from now on to play the recording.

        A jump reads some again; a bit more is read than is played.
        """
        self._cursor.observer = observer

    @property
    def finished(self) -> bool:
        """Whether the scene at the stop has been returned."""
        return self._finished

    @property
    def time_factor(self) -> float:
        """Seconds of the recording per second of a tick; can be changed while playing, 0 pauses it."""
        return self._time_factor

    @time_factor.setter
    def time_factor(self, factor: float) -> None:
        if not 0 <= factor < math.inf:
            raise RecapError(f"a time factor of {factor:g} cannot be played; it must be 0 or more")
        self._time_factor = factor

    @cached_property
    def followed(self) -> int | None:
        """The actor that the camera follows, if any; it is chosen on first use, unless it was given."""
        return choose_followed(self.reader, start=self.start, stop=self.stop, ignore_hero=self._ignore_hero)

    def tick(self, delta: float) -> Scene | None:
        """Advance the time, and return the scene.

        The first tick advances from the start; `tick(0)` shows the start itself. The last scene is that of the stop.

        Args:
            delta: Seconds, which are multiplied by the time factor.

        Returns:
            The scene; None after the last one.

        Raises:
            RecapError: The time is negative or infinite; `at` can go back.
            FormatError: The file contradicts its format.
        """
        if not 0 <= delta < math.inf:
            raise RecapError(f"a tick of {delta:g} s cannot be played; it must be 0 or more")
        return self._play(self._time + delta * self.time_factor)

    def at(self, time: float) -> Scene:
        """Seek to a moment of the recording, and return the scene; ticks advance from there.

        Args:
            time: Elapsed seconds; negative: before the end.

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
            rate: Scenes per second of ticks, which are multiplied by the time factor; None: a scene for each frame of the
                recording, at its time. Either way the first scene is the current one, and the last one that of the stop.

        Raises:
            RecapError: The rate is not positive.
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

    def lead(self, seconds: float) -> Iterator[SceneBatch]:
        """Yield the scenes of the last seconds before the start, in batches; the player begins at its start nevertheless.

        It must not have begun, and all of the scenes have to be taken, which saves it from seeking again.

        Args:
            seconds: How many seconds, as far as the recording has them.
        """
        before = copy(self)
        before.start = before._time = max(self.start - seconds, 0.0)
        before.stop = self.start
        if before.start < before.stop:
            yield from before._batches()

    def _batches(self) -> Iterator[SceneBatch]:
        cursor, scene = self._cursor, self.tick(0.0)
        while scene is not None:
            yield scene.batch
            while not self._finished and (found := cursor.advance_batch(self._time, self.stop - SAME_TIME)):
                frames, latest = found
                self._time = float(frames.elapsed[-1])
                yield self._batch(frames.elapsed, frames, poses_of(latest["transforms"]), latest["light_states"])
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
        if self._finished and (self._cursor.behind or (time >= self.total and self._cursor.next is not None)):
            message = "the clock goes back; frames behind an earlier one are not shown, as in CARLA's replays"
            warnings.warn(f"{self.reader.location}: {message}", RecapWarning, stacklevel=2)
        return self._scene()

    def _scene(self) -> Scene:
        cursor = self._cursor
        state, frame, following = cursor.state, cursor.frame, cursor.next
        if self._time < frame.elapsed <= self._time + SAME_TIME:
            self._time = frame.elapsed
        time = self._time
        part = 0.0
        if following is not None and self.smooth and self._time_factor < FAST:
            length = following.elapsed - cursor.time
            part = (time - cursor.time) / length if length > 0 else 0.0
            part = part if 0 <= part <= 1 else 0.0
        poses, lights = self._interpolator.at(frame, following, state, part), state.latest["light_states"].records
        return Scene(self._batch(np.array([time]), Batch.of(frame), poses[None], lights[None]))

    def _batch(self, time: Floats, frames: Batch, poses: Floats, light_states: NDArray[np.void]) -> SceneBatch:
        fresh, self._fresh = self._fresh, False
        events = self._cursor.take_events()
        state, following = self._cursor.state, self._cursor.next
        return SceneBatch(state, time, frames, poses, light_states, events, fresh=fresh, following=following)

    def _moment(self, time: float) -> float:
        """Return a time in elapsed seconds, which is given from the end if it is negative."""
        if time < 0:
            return max(0.0, self.total + time)
        if time <= self.total:
            return time
        if time <= self.total * (1 + _PRINTED) + ROUNDED:
            return self.total
        raise RecapError(f"{self.reader.location}: nothing at {time:g} s; the recording ends at {self.total:g} s")


class LiveScenes:
    """Turns the frames of a recording that is still being made into scenes, from the first one on."""

    def __init__(self) -> None:
        self._state = ReplayState(UE4, ignore_hero=False, ignore_spectator=True)
        self._fresh = True

    def scene(self, frame: Frame) -> Scene:
        """Return the scene of the next frame."""
        state = self._state
        events = tuple(state.apply(frame))
        poses, lights = (latest.records[None] for latest in state.latest.values())
        fresh, self._fresh = self._fresh, False
        return Scene(
            SceneBatch(state, np.array([frame.elapsed]), Batch.of(frame), poses_of(poses), lights, events, fresh=fresh)
        )
