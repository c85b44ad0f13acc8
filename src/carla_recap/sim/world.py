"""A world: a town, the actors in it, and the ticks that move them."""

from __future__ import annotations

import time
import warnings
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from carla_recap.errors import RecapWarning
from carla_recap.sim.actors.actor import transforms
from carla_recap.sim.actors.blueprints import standard_library
from carla_recap.sim.actors.registry import ActorIds, ActorRegistry
from carla_recap.sim.actors.stepping import ActorMotion
from carla_recap.sim.errors import SimError, SpawnError
from carla_recap.sim.settings import Clock, Settings, Weather, source_date
from carla_recap.sim.town.loading import Town, load_town
from carla_recap.sim.traffic.controllers import Traffic
from carla_recap.sim.validation import expect_numbers, expect_seconds

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from carla_recap.replay.follow import Follow
    from carla_recap.sim.actors.actor import Actor, Spectator
    from carla_recap.sim.actors.blueprints import Blueprint
    from carla_recap.sim.actors.lights import Signals, TrafficLight
    from carla_recap.sim.actors.registry import TickEvents
    from carla_recap.sim.geometry import Transform
    from carla_recap.sim.physics.plane import Plane
    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.sim.physics.walkers import Walkers
    from carla_recap.sim.recording.recorder import WorldRecorder
    from carla_recap.sim.replaying.replayer import Replay, Replayer
    from carla_recap.sim.traffic.autopilot import Autopilot
    from carla_recap.sim.traffic.controllers import Controller
    from carla_recap.sim.traffic.pedestrians import PedestrianNavigation

_DELTA: Final = 0.05  # s: the default length of a tick
_ROUNDING: Final = 1e-6


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
        episode: The number of the episode, from 1: `reload` begins the next one.
        random: The source of all randomness.
        controllers: What acts at the beginning of each tick.
        listeners: What is called at the end of each tick.
        recordings: The folder of recordings, if one was given.
        maps: The folder of maps, if one was given.
        parameters: What recordings as MCAP say that the world is run with, as texts.
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
            raise SimError(f"seed: 0 or a larger whole number was expected, found {seed}")
        self.blueprints = standard_library()
        self.settings = Settings(fixed_delta_seconds=fixed_delta_seconds)
        self.random = np.random.default_rng(seed)
        self._date = date
        self.controllers: list[Controller] = []
        self.listeners: list[Callable[[], None]] = []
        self.on_error: Callable[[object, Exception], None] | None = None
        self.recordings = recordings
        self.maps = maps
        self.parameters: Mapping[str, str] = {name: str(value) for name, value in (parameters or {}).items()}
        self._recorder: WorldRecorder | None = None
        self._replayer: Replayer | None = None
        self.episode = 0
        self._ids = ActorIds()
        self._begin(self._load("" if town is None else town), Clock(delta=fixed_delta_seconds or _DELTA))

    def _begin(self, town: Town, clock: Clock) -> None:
        """Begin an episode."""
        self.episode += 1
        self._weather = Weather()
        self._registry = ActorRegistry(town, clock, self.settings, self.blueprints, self._ids)
        self._traffic = self._registry.traffic = Traffic(self._registry, self.random, self.controllers)
        self._motion = ActorMotion(self._registry)

    @property
    def town(self) -> Town:
        """The town."""
        return self._registry.town

    @property
    def frame(self) -> int:
        """The number of ticks in this episode."""
        return self._registry.clock.frame

    @property
    def elapsed(self) -> float:
        """The simulated time of this episode, in s."""
        return self._registry.clock.elapsed

    @property
    def delta(self) -> float:
        """The length of the latest tick, in s."""
        return self._registry.clock.delta

    @property
    def weather(self) -> Weather:
        """The weather; set it to change it.

        Raises:
            SimError: When it is set: it is no `Weather`, or a number is too large for a recording.
        """
        return self._weather

    @weather.setter
    def weather(self, weather: Weather) -> None:
        if not isinstance(weather, Weather):
            raise SimError(f"the weather: a Weather was expected, such as PRESETS['HardRainNoon'], not {weather!r:.60}")
        expect_numbers("the weather", weather)
        self._weather = weather

    @property
    def date(self) -> int:
        """The date of a recording that begins now, in Unix seconds."""
        return source_date(time.time()) if self._date is None else self._date

    # --- actors -------------------------------------------------------------------------------------------------------

    @property
    def actors(self) -> Mapping[int, Actor]:
        """All actors by id, in the order of spawning."""
        return self._registry.actors

    @property
    def vehicles(self) -> Vehicles:
        """All vehicles, as arrays."""
        return self._registry.vehicles

    @property
    def walkers(self) -> Walkers:
        """All walkers, as arrays."""
        return self._registry.walkers

    @property
    def signals(self) -> Signals:
        """All traffic lights, as arrays."""
        return self._registry.signals

    @property
    def traffic_lights(self) -> list[TrafficLight]:
        """All traffic lights; light i is row i of `signals`."""
        return self._registry.traffic_lights

    @property
    def spectator(self) -> Spectator:
        """The spectator."""
        return self._registry.spectator

    @property
    def plane(self) -> Plane:
        """The bodies of the actors."""
        return self._registry.plane

    @property
    def events(self) -> TickEvents:
        """The events of the latest tick, and between it and the one before."""
        return self._registry.events

    @property
    def pending(self) -> TickEvents:
        """The events since the latest tick, which the next one will add to `events`."""
        return self._registry.pending

    def spawn(
        self, blueprint: Blueprint | str, transform: Transform, *, parent: Actor | None = None, **attributes: str
    ) -> Actor:
        """Spawn an actor.

        Args:
            blueprint: The blueprint, or its name.
            transform: The transform in the world; relative to the parent, if there is one.
            parent: The actor that it is attached to.
            **attributes: Attributes that differ from those of the blueprint, such as `role_name="hero"`.

        Raises:
            SpawnError: There is no such blueprint or attribute, or the place is occupied.
            SimError: The place is too far away for a recording, or an attribute is too long for one.
            DeadActor: The parent has been destroyed.
        """
        blueprint = self.blueprints.resolve(blueprint, attributes)
        if parent is None and (other := self._registry.occupant(blueprint, transform)) is not None:
            location = transform.location
            where = f"({location.x:.1f}, {location.y:.1f}, {location.z:.1f})"
            raise SpawnError(f"{blueprint.id} cannot be spawned at {where}: {other!r} is there")
        return self._registry.place(blueprint, transform, parent, attributes)

    def try_spawn(
        self, blueprint: Blueprint | str, transform: Transform, *, parent: Actor | None = None, **attributes: str
    ) -> Actor | None:
        """Spawn an actor if its place is free; see `spawn`.

        Raises:
            SpawnError: There is no such blueprint or attribute.
            SimError: See `spawn`.
            DeadActor: The parent has been destroyed.
        """
        blueprint = self.blueprints.resolve(blueprint, attributes)
        if parent is None and self._registry.occupant(blueprint, transform) is not None:
            return None
        return self._registry.place(blueprint, transform, parent, attributes)

    def place(
        self,
        blueprint: Blueprint | str,
        transform: Transform,
        *,
        parent: Actor | None = None,
        wanted_id: int | None = None,
        **attributes: str,
    ) -> Actor:
        """Spawn an actor, even where others are; see `spawn`.

        Args:
            blueprint: See `spawn`.
            transform: See `spawn`.
            parent: See `spawn`.
            wanted_id: The id that it gets if no actor has, or had, it; else it gets the next one.
            **attributes: See `spawn`.
        """
        return self._registry.place(blueprint, transform, parent, attributes, wanted_id)

    def reserve_ids(self, largest: int) -> None:
        """Keep the free ids up to one for actors for which `place` wants them; other actors get larger ids."""
        self._ids.reserve(largest)

    def destroy(self, actor: Actor) -> bool:
        """Destroy an actor and what is attached to it.

        Returns:
            False if it had been destroyed before.

        Raises:
            SimError: It belongs to the town.
        """
        return self._registry.destroy(actor)

    def owner(self, body: int) -> Actor | None:
        """Return the actor that a body of the plane belongs to; None for a barrier."""
        return self._registry.owner(body)

    # --- controllers, the recorder and the replayer -------------------------------------------------------------------

    @property
    def autopilot(self) -> Autopilot:
        """The autopilot, which drives the vehicles that have it switched on; made when first used."""
        return self._traffic.autopilot

    @property
    def pedestrians(self) -> PedestrianNavigation:
        """The navigation of the walkers that have destinations; made when first used."""
        return self._traffic.pedestrians

    @property
    def recorder(self) -> WorldRecorder:
        """The recorder; made when first used."""
        if self._recorder is None:
            from carla_recap.sim.recording.recorder import WorldRecorder

            self._recorder = WorldRecorder(self, self.recordings)
            self.listeners.insert(0, self._recorder)  # what other listeners do belongs to the next tick
        return self._recorder

    @property
    def replayer(self) -> Replayer:
        """The replayer; made when first used."""
        if self._replayer is None:
            from carla_recap.sim.replaying.replayer import Replayer

            self._replayer = Replayer(self)
            self.controllers.append(self._replayer)
        return self._replayer

    @property
    def replayed(self) -> Path | None:
        """The recording that is being replayed."""
        return None if self._replayer is None else self._replayer.path

    def start_recorder(self, name: Path | str, additional_data: bool = False, *, force: bool = True) -> Path:
        """Begin a recording, which replaces an older one of that name, as in CARLA; see `WorldRecorder.start`.

        The first frame is the end of the next tick; between `replay_file` and the next tick, it is the start of the replay.
        """
        now = self._replayer is not None and self._replayer.shows_start
        return self.recorder.start(name, additional_data, force=force, now=now)

    def stop_recorder(self) -> None:
        """Complete the recording, if there is one."""
        if self._recorder is not None:
            self._recorder.stop()

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
        """Replay a recording; see `Replayer.start`.

        A running recorder stops, as in CARLA. To record the replay, start the recorder between this call and the next tick.

        Warns:
            RecapWarning: A recorder was running; see `Replayer.start` for others.
        """
        recorded = None if self._recorder is None else self._recorder.path
        if recorded is not None:
            reason = "a replay begins, which stops the recorder; start it after replay_file to record the replay"
            warnings.warn(f"{recorded}: ends here: {reason}", RecapWarning, stacklevel=2)
        return self.replayer.start(name, start, duration, follow, replay_sensors, offset, keep_town=keep_town)

    def stop_replayer(self, keep_actors: bool = False) -> None:
        """End the replay, if there is one; see `Replayer.stop`."""
        if self._replayer is not None:
            self._replayer.stop(keep_actors)

    def set_replayer_time_factor(self, factor: float) -> None:
        """Set the time of a recording that is replayed per simulated time."""
        self.replayer.time_factor = factor

    def set_replayer_ignore_hero(self, ignore: bool) -> None:
        """Set whether the next replays leave the hero out."""
        self.replayer.ignore_hero = ignore

    def set_replayer_ignore_spectator(self, ignore: bool) -> None:
        """Set whether the next replays leave the spectator out."""
        self.replayer.ignore_spectator = ignore

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
        """Simulate a tick: controllers act, lights change, actors move, and listeners are called.

        Args:
            delta: The length of the tick in s; by default that of the settings.

        Returns:
            The number of the tick, from 1.

        Raises:
            SimError: The length is not above 0, or more than 10 s.
        """
        if delta is None:
            delta = self.settings.fixed_delta_seconds or _DELTA
        expect_seconds("a tick", delta)
        delta = self._registry.clock.delta = float(delta)
        for controller in tuple(self.controllers):
            self._act(controller, controller.step, delta)
        self.signals.step(delta)
        collisions = self._motion.advance(delta)
        for trigger, place in zip(triggers := self._registry.triggers, transforms(triggers), strict=True):
            self._act(trigger, trigger.update, self._registry.vehicles, place)
        self._registry.clock.advance()
        self._registry.end_tick(collisions)
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
        """Tick for some simulated time.

        Raises:
            SimError: The time is negative or infinite.
        """
        if not 0 <= seconds < np.inf:
            raise SimError(f"run: 0 s or more was expected, found {seconds:g} s")
        for _ in range(ceil(seconds / (self.settings.fixed_delta_seconds or _DELTA) - _ROUNDING)):
            self.tick()

    def run_realtime(self, seconds: float, factor: float = 1.0) -> None:
        """Tick in real time.

        Args:
            seconds: The simulated time.
            factor: The simulated time per real time; ticks that are late are not skipped.

        Raises:
            SimError: The time is negative, or the factor not above 0.
        """
        if not (seconds >= 0 and factor > 0):
            expected = "0 s or more, and a factor above 0"
            raise SimError(f"run_realtime: {expected} were expected, found {seconds:g} s and {factor:g}")
        begin, start = time.monotonic(), self.elapsed
        while (passed := self.elapsed - start) < seconds - _ROUNDING:
            time.sleep(max(0.0, begin + passed / factor - time.monotonic()))
            self.tick()

    def reload(self, town: Town | str | Path | None = None) -> None:
        """Begin a new episode, without the actors of the present one, at time 0.

        Args:
            town: The town, or its name or file; by default the same.

        Raises:
            RecapError: There is no such town; the episode goes on.
        """
        town = self.town if town is None else self._load(town)
        self.stop_recorder()
        self.stop_replayer(keep_actors=True)
        self._registry.close()
        self._traffic.end()
        self._begin(town, Clock(delta=self.delta))

    def _load(self, town: Town | str | Path) -> Town:
        return town if isinstance(town, Town) else load_town(town, None if self.maps is None else Path(self.maps))
