"""A world: a town, the actors in it, and the ticks that move them."""

from __future__ import annotations

import time
import warnings
from math import ceil
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Protocol, Self

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.sim.actors import spawning
from carla_recap.sim.actors.lights import traffic_lights
from carla_recap.sim.actors.stepping import ActorMotion
from carla_recap.sim.blueprints import standard_library
from carla_recap.sim.episode import ActorIds, Episode, transforms
from carla_recap.sim.errors import SimError
from carla_recap.sim.recording.recorder import WorldRecorder
from carla_recap.sim.replaying.replayer import Replayer, find_recording, finished
from carla_recap.sim.settings import Clock, Settings, Weather
from carla_recap.sim.town.loading import Town, load_town
from carla_recap.sim.traffic.traffic import Traffic
from carla_recap.sim.validation import expect_seconds

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from carla_recap.replay.follow import Follow
    from carla_recap.sim.blueprints import Blueprint
    from carla_recap.sim.episode import Actor, TickEvents
    from carla_recap.sim.geometry import Transform
    from carla_recap.sim.replaying.replayer import Replay

_DELTA: Final = 0.05  # s: the default length of a tick
_ROUNDING: Final = 1e-6


class Controller(Protocol):
    """Something that acts at the beginning of each tick."""

    def step(self, delta: float) -> None:
        """Act at the beginning of a tick of a length in s."""


class World:
    """A town, its actors, and what moves them.

    Args:
        town: The town, or its name or file, as of `load_town`; by default the built-in one.
        seed: The seed of all randomness: the same seed and steps make the same world, in any process.
        fixed_delta_seconds: The length of a tick; None for ticks of a length that the caller chooses.
        date: The date of recordings in Unix seconds; by default SOURCE_DATE_EPOCH, else the current time.
        recordings: The folder of recordings whose names are no paths; see `recorder.recordings_folder`.
        maps: The folder of the maps that are loaded by name; by default that of CARLA_RECAP_MAPS.
        parameters: What the world is run with, such as a speed that is varied, for its recordings as MCAP.

    Attributes:
        blueprints: The blueprint library.
        settings: The settings of the simulation.
        random: The source of all randomness.
        episode: The state of the world, of which the next attributes are parts: `reload` begins the next one.
        town: The town.
        actors: All actors by id, in the order of spawning.
        vehicles: All vehicles, as arrays.
        walkers: All walkers, as arrays.
        signals: All traffic lights, as arrays.
        traffic_lights: All traffic lights; light i is row i of `signals`.
        spectator: The spectator.
        controllers: What acts at the beginning of each tick, after the traffic and before a replay.
        listeners: What is called at the end of each tick.
        recordings: The folder of recordings, if one was given.
        maps: The folder of maps, if one was given.
        recorder: The recorder.
        replayer: The replayer.
        on_error: Called with what raises in a tick (a controller, trigger or listener) and the error; else the tick raises.

    Raises:
        SimError: The seed is negative, or the length of a tick out of range.
        RecapError: There is no such town.
    """

    def __init__(
        self,
        town: Town | str | Path | None = None,
        *,
        seed: int = 0,
        fixed_delta_seconds: float | None = _DELTA,
        date: int | None = None,
        recordings: Path | str | None = None,
        maps: Path | str | None = None,
        parameters: Mapping[str, object] | None = None,
    ) -> None:
        if seed < 0:
            raise SimError(f"seed: expected 0 or a larger whole number, found {seed}")
        self.blueprints = standard_library()
        self.settings = Settings(fixed_delta_seconds=fixed_delta_seconds)
        self.random = np.random.default_rng(seed)
        self.on_error: Callable[[object, Exception], None] | None = None
        self.recordings = recordings
        self.maps = None if maps is None else Path(maps)
        self._ids = ActorIds()
        self._begin(1, self._load("" if town is None else town), fixed_delta_seconds or _DELTA)
        texts = {name: str(value) for name, value in (parameters or {}).items()}
        self.recorder = WorldRecorder(self.episode, recordings, date, texts)
        self.replayer = Replayer(self.episode, self.maps)
        self.controllers: list[Controller] = []
        self.listeners: list[Callable[[], None]] = [self.recorder]  # what other listeners do belongs to the next tick

    def _begin(self, number: int, town: Town, delta: float) -> None:
        """Begin an episode."""
        episode = Episode(number, town, Clock(delta=delta), self.settings, self.random, self.blueprints, self._ids)
        spawning.add_signs(episode)
        self.episode, self.town, self.spectator = episode, town, episode.spectator
        self.vehicles, self.walkers, self.signals = episode.vehicles, episode.walkers, episode.signals
        self.actors: Mapping[int, Actor] = MappingProxyType(episode.actors)
        self.traffic_lights = traffic_lights(episode)
        self._traffic, self._motion = Traffic(episode), ActorMotion(episode)

    def _load(self, town: Town | str | Path) -> Town:
        return town if isinstance(town, Town) else load_town(town, self.maps)

    # --- the state of the episode -------------------------------------------------------------------------------------

    @property
    def frame(self) -> int:
        """The number of ticks in this episode."""
        return self.episode.clock.frame

    @property
    def elapsed(self) -> float:
        """The simulated time of this episode, in s."""
        return self.episode.clock.elapsed

    @property
    def delta(self) -> float:
        """The length of the latest tick, in s."""
        return self.episode.clock.delta

    @property
    def weather(self) -> Weather:
        """The weather; set it to change it, see `Episode.weather`."""
        return self.episode.weather

    @weather.setter
    def weather(self, weather: Weather) -> None:
        self.episode.weather = weather

    @property
    def events(self) -> TickEvents:
        """The events of the latest tick, and between it and the one before."""
        return self.episode.events

    def spawn(
        self, blueprint: Blueprint | str, transform: Transform, *, parent: Actor | None = None, **attributes: str
    ) -> Actor:
        """Spawn an actor of a blueprint, or of its name, with attributes that differ from its own: `role_name="hero"`.

        The transform is that in the world; relative to the parent that it is attached to, if there is one.

        Raises:
            SpawnError: There is no such blueprint or attribute, or the place is occupied.
            SimError: The place is too far away for a recording, or an attribute is too long for one.
            DeadActor: The parent has been destroyed.
        """
        return spawning.spawn(self.episode, blueprint, transform, parent, attributes)

    def try_spawn(
        self, blueprint: Blueprint | str, transform: Transform, *, parent: Actor | None = None, **attributes: str
    ) -> Actor | None:
        """Spawn an actor if its place is free; see `spawn`."""
        return spawning.try_spawn(self.episode, blueprint, transform, parent, attributes)

    def place(
        self,
        blueprint: Blueprint | str,
        transform: Transform,
        *,
        parent: Actor | None = None,
        wanted_id: int | None = None,
        **attributes: str,
    ) -> Actor:
        """Spawn an actor, even where others are; see `spawn`, and for `wanted_id` `spawning.place`."""
        return spawning.place(self.episode, blueprint, transform, parent, attributes, wanted_id)

    # --- the recorder and the replayer --------------------------------------------------------------------------------

    def start_recorder(self, name: Path | str, additional_data: bool = False, *, force: bool = True) -> Path:
        """Begin a recording, which replaces an older one of that name, as in CARLA; see `WorldRecorder.start`.

        The first frame is the end of the next tick; between `replay_file` and the next tick, it is the start of the replay.
        """
        return self.recorder.start(name, additional_data, force=force, now=self.replayer.shows_start)

    def stop_recorder(self) -> None:
        """Complete the recording, if there is one."""
        self.recorder.stop()

    def replay_file(
        self,
        name: Path | str,
        start: float = 0.0,
        duration: float = 0.0,
        follow: Follow | None = None,
        replay_sensors: bool = False,
        offset: Transform | None = None,
        *,
        keep_town: bool = False,
    ) -> Replay:
        """Replay a recording, whose suffix may be missing; see `Replayer.open`, and `Replayer.begin` for the last options.

        A running recorder stops with a warning, as in CARLA: to record the replay, start one between this call and the next
        tick.
        """
        if self.recorder.path is not None:
            reason = "a replay begins, which stops the recorder; start it after replay_file to record the replay"
            warnings.warn(f"{self.recorder.path}: ends here: {reason}", RecapWarning, stacklevel=2)
        self.stop_replayer()
        self.stop_recorder()
        opened = self.replayer.open(find_recording(name, self.recordings), start, duration, follow)
        return finished(self.replayer.begin(opened, self.reload, replay_sensors, offset, keep_town=keep_town))

    def stop_replayer(self, keep_actors: bool = False) -> None:
        """End the replay, if there is one; see `Replayer.stop`."""
        self.replayer.stop(keep_actors)

    def close(self) -> None:
        """Complete the recording and end the replay, if there are any."""
        self.stop_recorder()
        self.stop_replayer(keep_actors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- time ---------------------------------------------------------------------------------------------------------

    def tick(self, delta: float | None = None) -> int:
        """Simulate a tick: controllers act, lights change, actors move, and listeners are called; return its number, from 1.

        Its length in s is by default that of the settings; `SimError`: it is not above 0, or more than 10 s.
        """
        if delta is None:
            delta = self.settings.fixed_delta_seconds or _DELTA
        expect_seconds("a tick", delta)
        episode = self.episode
        delta = episode.clock.delta = float(delta)
        for controller in (self._traffic, *self.controllers, self.replayer):  # replayed actors have the recorded controls
            self._act(controller, controller.step, delta)
        episode.signals.step(delta)
        collisions = self._motion.advance(delta)
        for trigger, place in zip(episode.triggers, transforms(episode.triggers), strict=True):
            self._act(trigger, trigger.update, place)
        episode.end_tick(collisions)
        for listener in tuple(self.listeners):
            self._act(listener, listener)
        return self.frame

    def _act(self, actor: object, act: Callable[..., None], *arguments: Any) -> None:
        """Let a controller, trigger or listener act; see `on_error`."""
        try:
            act(*arguments)
        except Exception as error:
            if self.on_error is None:
                raise
            self.on_error(actor, error)

    def run(self, seconds: float) -> None:
        """Tick for some simulated time in s; `SimError`: it is negative or infinite."""
        if not 0 <= seconds < np.inf:
            raise SimError(f"run: expected 0 s or more, found {seconds:g} s")
        for _ in range(ceil(seconds / (self.settings.fixed_delta_seconds or _DELTA) - _ROUNDING)):
            self.tick()

    def run_realtime(self, seconds: float, factor: float = 1.0) -> None:
        """Tick in real time for some simulated time in s, which passes faster by a factor; ticks that are late follow.

        `SimError`: The time is negative, or the factor not above 0.
        """
        if not (seconds >= 0 and factor > 0):
            expected = "0 s or more, and a factor above 0"
            raise SimError(f"run_realtime: {expected} were expected, found {seconds:g} s and {factor:g}")
        begin, start = time.monotonic(), self.elapsed
        while (passed := self.elapsed - start) < seconds - _ROUNDING:
            time.sleep(max(0.0, begin + passed / factor - time.monotonic()))
            self.tick()

    def reload(self, town: Town | str | Path | None = None) -> None:
        """Begin a new episode, at time 0 and without the present actors, in a town, by default the same.

        `RecapError`: There is no such town; the episode goes on.
        """
        town = self.town if town is None else self._load(town)
        self.close()
        self.episode.close()
        self._begin(self.episode.number + 1, town, self.delta)
        self.recorder.episode = self.episode
        self.replayer.enter(self.episode)
