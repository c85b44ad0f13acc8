"""A world: a town, the actors in it, and the ticks that move them."""

from __future__ import annotations

import os
import time
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol, Self

import numpy as np

from carla_recap.sim.actors.blueprints import standard_library
from carla_recap.sim.actors.events import TickEvents
from carla_recap.sim.actors.registry import ActorRegistry
from carla_recap.sim.errors import SimError
from carla_recap.sim.physics.collisions import Collisions
from carla_recap.sim.settings import Settings
from carla_recap.sim.town.town import Town, load_town
from carla_recap.sim.traffic.lights import Signals
from carla_recap.sim.validation import expect_numbers, expect_seconds
from carla_recap.sim.weather import Weather

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from carla_recap.replay.follow import Follow
    from carla_recap.sim.actors.actors import Actor, Spectator, TrafficLight
    from carla_recap.sim.actors.blueprints import Blueprint
    from carla_recap.sim.geometry import Transform
    from carla_recap.sim.physics.plane import Plane
    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.sim.physics.walkers import Walkers
    from carla_recap.sim.recording.recorder import Recorder
    from carla_recap.sim.replaying.replayer import Replay, Replayer
    from carla_recap.sim.traffic.autopilot import Autopilot
    from carla_recap.sim.traffic.pedestrians import PedestrianNavigation

_STRIDE: Final = 1.0  # m: nothing moves farther in a step
_DELTA: Final = 0.05  # s, where nobody says how long a tick is
_ROUNDING: Final = 1e-6


class Controller(Protocol):
    """Something that acts at the beginning of each tick."""

    def step(self, delta: float) -> None:
        """Act for a tick of so many seconds."""


class World:
    """A town and its actors.

    Args:
        town: The town, or its name or file; see `load_town`. The built-in one unless told otherwise.
        seed: Of everything random in it: the same seed and steps make the same world, in any process.
        fixed_delta_seconds: The length of a tick; None for ticks as long as the caller says.
        date: In Unix seconds, for recordings; else SOURCE_DATE_EPOCH, else now.
        recordings: The folder of recordings that have a name and no place; see `recorder.recordings_folder`.
        maps: The folder of maps, for towns that are named; else CARLA_RECAP_MAPS says it.

    Attributes:
        town: The town.
        blueprints: What can be spawned.
        settings: How it runs.
        episode: Which episode this is, from 1: `reload` begins the next one.
        frame: The number of ticks so far in this episode.
        elapsed: The time they took, in s.
        delta: How long the latest one was, in s.
        signals: All traffic lights, as arrays.
        random: Where all that is random comes from.
        controllers: Who acts at the beginning of each tick.
        listeners: Who is called at the end of each tick.
        events: What happened in the latest tick, and since the one before.
        recordings: The folder of recordings, if it was told.
        maps: The folder of maps, if it was told.

    Raises:
        SimError: The seed is negative, or there are no ticks of that length.
        RecapError: There is no such town.
    """

    town: Town
    signals: Signals
    events: TickEvents

    def __init__(
        self,
        town: Town | str | Path | None = None,
        *,
        seed: int = 0,
        fixed_delta_seconds: float | None = _DELTA,
        date: int | None = None,
        recordings: Path | str | None = None,
        maps: Path | str | None = None,
    ) -> None:
        self.blueprints = standard_library()
        self.settings = Settings(fixed_delta_seconds=fixed_delta_seconds)
        self.random = _random(seed)
        self._date = date
        self.controllers: list[Controller] = []
        self.listeners: list[Callable[[], None]] = []
        self.delta = fixed_delta_seconds or _DELTA
        self.recordings = recordings
        self.maps = maps
        self._recorder: Recorder | None = None
        self._replayer: Replayer | None = None
        self.episode = 0
        self._begin(self._loaded("" if town is None else town), 1)

    def _begin(self, town: Town, first: int) -> None:
        """Start an episode, whose first actor gets the id `first`."""
        self.town = town
        self.episode += 1
        self.frame = 0
        self.elapsed = 0.0
        self._weather = Weather()
        self.signals = Signals(town)
        self.events = TickEvents()
        self._registry = ActorRegistry(self, town, first)
        self._collisions = Collisions(self)
        self._autopilot: Autopilot | None = None
        self._pedestrians: PedestrianNavigation | None = None

    @property
    def weather(self) -> Weather:
        """The weather; set it to change it.

        Raises:
            SimError: A number is too large for a recording, when it is set.
        """
        return self._weather

    @weather.setter
    def weather(self, weather: Weather) -> None:
        expect_numbers("the weather", weather)
        self._weather = weather

    @property
    def date(self) -> int:
        """The date of a recording that begins now, in Unix seconds."""
        return int(os.environ.get("SOURCE_DATE_EPOCH", time.time())) if self._date is None else self._date

    # --- who is there -------------------------------------------------------------------------------------------------

    @property
    def actors(self) -> Mapping[int, Actor]:
        """All actors by id, in the order in which they came."""
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
    def traffic_lights(self) -> list[TrafficLight]:
        """All traffic lights; light i is row i of `signals`."""
        return self._registry.traffic_lights

    @property
    def spectator(self) -> Spectator:
        """Who looks at the world."""
        return self._registry.spectator

    @property
    def plane(self) -> Plane:
        """The bodies of the actors."""
        return self._registry.plane

    @property
    def pending(self) -> TickEvents:
        """What has happened since the latest tick; `events` tells it at the end of the next one."""
        return self._registry.pending

    def spawn(
        self, blueprint: Blueprint | str, transform: Transform, *, parent: Actor | None = None, **attributes: str
    ) -> Actor:
        """Let an actor appear.

        Args:
            blueprint: What, or its name.
            transform: Where in the world; relative to the parent, if there is one.
            parent: What it is attached to.
            **attributes: What of its blueprint's attributes is otherwise, such as `role_name="hero"`.

        Raises:
            SpawnError: There is no such blueprint or attribute, or the place is occupied.
            SimError: The place is too far away for a recording, or an attribute is too long for one.
            DeadActor: The parent has been destroyed.
        """
        return self._registry.place_where_free(self._blueprint(blueprint, attributes), transform, parent, attributes)

    def try_spawn(
        self, blueprint: Blueprint | str, transform: Transform, *, parent: Actor | None = None, **attributes: str
    ) -> Actor | None:
        """Let an actor appear if its place is free; see `spawn`.

        Raises:
            SpawnError: There is no such blueprint or attribute.
            SimError: As of `spawn`.
            DeadActor: The parent has been destroyed.
        """
        blueprint = self._blueprint(blueprint, attributes)
        if parent is None and any(self._registry.occupants(blueprint, transform)):
            return None
        return self._registry.place(blueprint, transform, parent, attributes)

    def place(
        self, blueprint: Blueprint | str, transform: Transform, *, parent: Actor | None = None, **attributes: str
    ) -> Actor:
        """Let an actor appear, even where others are; see `spawn`."""
        return self._registry.place(self._blueprint(blueprint, attributes), transform, parent, attributes)

    def destroy(self, actor: Actor) -> bool:
        """Take an actor, and what is attached to it, out of the world.

        Returns:
            False if it was destroyed before.

        Raises:
            SimError: It belongs to the town.
        """
        return self._registry.destroy(actor)

    def owner(self, body: int) -> Actor | None:
        """Whose a body of the plane is; None for a barrier."""
        return self._registry.owner(body)

    def height(self, x: float, y: float) -> float:
        """How high the road near a place is, in m."""
        return float(self.town.height(np.array([x]), np.array([y]))[0])

    # --- who acts in it -----------------------------------------------------------------------------------------------

    @property
    def autopilot(self) -> Autopilot:
        """Who drives the vehicles whose autopilot is on; made when first asked for."""
        if self._autopilot is None:
            from carla_recap.sim.traffic.autopilot import Autopilot

            self._autopilot = Autopilot(self)
            self.controllers.append(self._autopilot)
        return self._autopilot

    @property
    def pedestrians(self) -> PedestrianNavigation:
        """Who leads the walkers that have destinations; made when first asked for."""
        if self._pedestrians is None:
            from carla_recap.sim.traffic.pedestrians import PedestrianNavigation

            self._pedestrians = PedestrianNavigation(self)
            self.controllers.append(self._pedestrians)
        return self._pedestrians

    @property
    def recorder(self) -> Recorder:
        """The recorder; made when first asked for."""
        if self._recorder is None:
            from carla_recap.sim.recording.recorder import Recorder

            self._recorder = Recorder(self, self.recordings)
            self.listeners.insert(0, self._recorder)  # what other listeners do belongs to the next tick
        return self._recorder

    @property
    def replayer(self) -> Replayer:
        """The replayer; made when first asked for."""
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
        """Begin a recording, which takes the place of an older one of that name, as with CARLA; see `Recorder.start`."""
        return self.recorder.start(name, additional_data, force=force)

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
        """Re-enact a recording; see `Replayer.start`."""
        return self.replayer.start(name, start, duration, follow, replay_sensors, offset, keep_town=keep_town)

    def stop_replayer(self, keep_actors: bool = False) -> None:
        """End the replay, if there is one; see `Replayer.stop`."""
        if self._replayer is not None:
            self._replayer.stop(keep_actors)

    def set_replayer_time_factor(self, factor: float) -> None:
        """How many seconds of a recording pass in a second of this world."""
        self.replayer.time_factor = factor

    def set_replayer_ignore_hero(self, ignore: bool) -> None:
        """Whether the next replays leave the hero out."""
        self.replayer.ignore_hero = ignore

    def set_replayer_ignore_spectator(self, ignore: bool) -> None:
        """Whether the next replays leave the spectator out."""
        self.replayer.ignore_spectator = ignore

    def close(self) -> None:
        """Complete what is being recorded, and end a replay."""
        self.stop_recorder()
        self.stop_replayer(keep_actors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- time ---------------------------------------------------------------------------------------------------------

    def tick(self, delta: float | None = None) -> int:
        """Let time pass: controllers act, lights change, everything moves, and listeners are told.

        Args:
            delta: For how long, in s; by default as the settings say.

        Returns:
            The number of the tick, from 1.

        Raises:
            SimError: The time is not above 0, or more than 10 s.
        """
        if delta is None:
            delta = self.settings.fixed_delta_seconds or _DELTA
        expect_seconds("a tick", delta)
        delta = self.delta = float(delta)
        for controller in tuple(self.controllers):
            controller.step(delta)
        self.signals.step(delta)
        self._move(delta)
        self.frame += 1
        self.elapsed += delta
        self.events = self._registry.take_events()
        self.events.collisions = self._collisions.take()
        for listener in tuple(self.listeners):
            listener()
        return self.frame

    def run(self, seconds: float) -> None:
        """Tick for so much simulated time.

        Raises:
            SimError: It is negative, or endless.
        """
        if not 0 <= seconds < np.inf:
            raise SimError(f"run: 0 s or more was expected, found {seconds:g} s")
        for _ in range(ceil(seconds / (self.settings.fixed_delta_seconds or _DELTA) - _ROUNDING)):
            self.tick()

    def run_realtime(self, seconds: float, factor: float = 1.0) -> None:
        """Tick as fast as the clock on the wall does.

        Args:
            seconds: For how long, in simulated time.
            factor: How much faster than the clock; ticks that come late are not skipped.

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
        """Begin a new episode: the actors of the last one are gone, and time begins anew.

        Args:
            town: The town, or its name or file; by default the same.

        Raises:
            RecapError: There is no such town; the episode goes on.
        """
        town = self.town if town is None else self._loaded(town)
        self.stop_recorder()
        self.stop_replayer(keep_actors=True)
        self._registry.disperse()
        mine = (self._autopilot, self._pedestrians)
        self.controllers = [controller for controller in self.controllers if controller not in mine]
        self._begin(town, self._registry.next_id)

    def _move(self, delta: float) -> None:
        movers = [group for group in (self.vehicles, self.walkers) if len(group)]
        moving = [group.begin(delta) for group in movers]
        if any(moving) or self.plane.disturbed:
            steps = self._steps(delta)
            for _ in range(steps):
                for group in movers:
                    group.push(delta / steps)
                self._collisions.add(self.plane.step(delta / steps))
                for group in movers:
                    group.pull()
        for group in movers:
            group.end(delta)
        self._registry.carry()

    def _steps(self, delta: float) -> int:
        """In how many steps a tick is simulated: in more, where something is fast."""
        settings = self.settings
        if not settings.substepping:
            return 1
        fastest: float = max(
            np.abs(speeds).max(initial=0).item() for speeds in (self.vehicles.speed, self.vehicles.sideways)
        )
        wanted = max(delta / settings.max_substep_delta_time, fastest * delta / _STRIDE)
        return min(max(ceil(wanted - _ROUNDING), 1), max(1, settings.max_substeps))

    def _blueprint(self, blueprint: Blueprint | str, attributes: Mapping[str, str]) -> Blueprint:
        found = self.blueprints.get(blueprint) if isinstance(blueprint, str) else blueprint
        found.expect(attributes)
        return found

    def _loaded(self, town: Town | str | Path) -> Town:
        return town if isinstance(town, Town) else load_town(town, None if self.maps is None else Path(self.maps))


def _random(seed: int) -> np.random.Generator:
    if seed < 0:
        raise SimError(f"seed: 0 or a larger whole number was expected, found {seed}")
    return np.random.default_rng(seed)
