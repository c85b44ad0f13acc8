"""What controllers are, and what scenarios, the recorder and the replayer ask of a world: small protocols.

They are what these depend on in place of `World`, which satisfies them all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import numpy as np

    from carla_recap.sim.actors.actor import Actor, Spectator
    from carla_recap.sim.actors.blueprints import Blueprint, BlueprintLibrary
    from carla_recap.sim.actors.lights import Signals, TrafficLight
    from carla_recap.sim.actors.registry import TickEvents
    from carla_recap.sim.geometry import Location, Transform
    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.sim.physics.walkers import Walkers
    from carla_recap.sim.town.town import Town
    from carla_recap.sim.weather import Weather


class Controller(Protocol):
    """Something that acts at the beginning of each tick."""

    def step(self, delta: float) -> None:
        """Act at the beginning of a tick of a length in s."""


class ActorView(Protocol):
    """The actors of a world, and its town."""

    @property
    def town(self) -> Town:
        """The town."""

    @property
    def actors(self) -> Mapping[int, Actor]:
        """All actors by id."""

    @property
    def vehicles(self) -> Vehicles:
        """All vehicles, as arrays."""

    @property
    def walkers(self) -> Walkers:
        """All walkers, as arrays."""

    @property
    def traffic_lights(self) -> list[TrafficLight]:
        """All traffic lights; light i is row i of `signals`."""

    @property
    def signals(self) -> Signals:
        """All traffic lights, as arrays."""

    @property
    def events(self) -> TickEvents:
        """The events of the latest tick."""

    @property
    def pending(self) -> TickEvents:
        """The events since the latest tick."""


class RecordedWorld(ActorView, Protocol):
    """What the recorder asks of a world.

    Attributes:
        parameters: What recordings say that the world is run with, as texts.
    """

    parameters: Mapping[str, str]

    @property
    def date(self) -> int:
        """The date of a recording that begins now, in Unix seconds."""

    @property
    def elapsed(self) -> float:
        """The simulated time of the episode, in s."""

    @property
    def delta(self) -> float:
        """The length of the latest tick, in s."""

    @property
    def weather(self) -> Weather:
        """The weather."""

    @property
    def replayed(self) -> Path | None:
        """The recording that is being replayed."""


class SnapshotWorld(ActorView, Protocol):
    """What the snapshots of a server ask of a world."""

    @property
    def spectator(self) -> Spectator:
        """The spectator."""

    @property
    def elapsed(self) -> float:
        """The simulated time of the episode, in s."""

    @property
    def delta(self) -> float:
        """The length of the latest tick, in s."""


class ReplayWorld(ActorView, Protocol):
    """What the replayer asks of a world.

    Attributes:
        weather: The weather.
        blueprints: The blueprint library.
        maps: The folder of maps, if one was given.
        recordings: The folder of recordings, if one was given.
    """

    weather: Weather
    blueprints: BlueprintLibrary
    maps: Path | str | None
    recordings: Path | str | None

    @property
    def spectator(self) -> Spectator:
        """The spectator."""

    def place(
        self,
        blueprint: Blueprint | str,
        transform: Transform,
        *,
        parent: Actor | None = None,
        wanted_id: int | None = None,
        **attributes: str,
    ) -> Actor:
        """Spawn an actor, even where others are, with an id that is wanted if it is free."""

    def reserve_ids(self, largest: int) -> None:
        """Keep the free ids up to one for actors for which they are wanted."""

    def destroy(self, actor: Actor) -> bool:
        """Destroy an actor."""

    def reload(self, town: Town | str | Path | None = None) -> None:
        """Begin a new episode."""

    def stop_recorder(self) -> None:
        """Complete the recording, if there is one."""


class SidewalkPlaces(Protocol):
    """Random places for walkers."""

    def random_place(self) -> Location:
        """Return a random place on a sidewalk."""


class ScenarioWorld(Protocol):
    """What traffic and scenarios ask of the world in which they are set up.

    Attributes:
        controllers: What acts at the beginning of each tick.
        random: The source of all randomness.
        blueprints: The blueprint library.
    """

    controllers: list[Controller]
    random: np.random.Generator
    blueprints: BlueprintLibrary

    @property
    def town(self) -> Town:
        """The town."""

    @property
    def elapsed(self) -> float:
        """The simulated time of the episode, in s."""

    @property
    def vehicles(self) -> Vehicles:
        """All vehicles, as arrays."""

    @property
    def pedestrians(self) -> SidewalkPlaces:
        """The pedestrian navigation."""

    def spawn(
        self, blueprint: Blueprint | str, transform: Transform, *, parent: Actor | None = None, **attributes: str
    ) -> Actor:
        """Spawn an actor."""

    def try_spawn(
        self, blueprint: Blueprint | str, transform: Transform, *, parent: Actor | None = None, **attributes: str
    ) -> Actor | None:
        """Spawn an actor if its place is free."""
