"""The world that is served: its time, its episodes, and those who are connected."""

from __future__ import annotations

import asyncio
import itertools
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol

from carla_recap.server.ackermann import Ackermann
from carla_recap.server.connections import Connections
from carla_recap.server.ghosts import Memory
from carla_recap.server.managers import Managers
from carla_recap.server.recordings import Recordings
from carla_recap.server.sensors import Sensors
from carla_recap.server.snapshot import Photographer, telling_of_map
from carla_recap.server.steadiness import Steadiness
from carla_recap.server.streams import Streams
from carla_recap.server.structs import EpisodeSettings
from carla_recap.server.table import CallError
from carla_recap.sim.errors import DeadActor

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.server.ghosts import Ghost
    from carla_recap.sim.actors.actors import Actor
    from carla_recap.sim.town.town import Town
    from carla_recap.sim.world import World


class Spectator(Protocol):
    """Who is sent snapshots.

    Attributes:
        stream: The number of the stream of these.
    """

    stream: int


class Host:
    """Serves a world.

    Args:
        world: The world; nobody else may tick it from now on.
        confined: Keep clients from recordings outside the folder of recordings.

    Attributes:
        world: The world.
        recordings: The recordings that clients may have.
        settings: As clients have set them.
        connections: All connections.
        streams: What is sent to subscribers.
        managers: The traffic managers of clients.
        sensors: What sends the data of sensors.
        ackermann: What drives vehicles that are told speeds and angles.
        steadiness: What keeps the velocities of vehicles.
        clients: Who is connected, by the numbers of their streams.
        on_settings: Who is told when the settings change.
        loading: Held while a map is loaded.
        sent_town: The map that a client has sent.
    """

    _photographer: Photographer
    _is_new: bool

    def __init__(self, world: World, *, confined: bool = False) -> None:
        self.world = world
        self.recordings = Recordings(world, confined=confined)
        self.settings = EpisodeSettings()
        self.connections = Connections()
        self.streams = Streams(self.connections, telling_of_map)
        self.managers = Managers()
        self.sensors = Sensors(world, self.streams, self.actor_or_ghost)
        self.ackermann = Ackermann(world)
        self.steadiness = Steadiness(world)
        self.clients: dict[int, Spectator] = {}
        self.on_settings: list[Callable[[], None]] = []
        self.loading = asyncio.Lock()
        self.sent_town: Town | None = None
        self._stream_numbers = itertools.count(1)
        self._frames_before = 0
        self._memory = Memory()
        self._begin()

    @property
    def frame(self) -> int:
        """The number of the latest frame: it never goes back, not even in a new episode."""
        return self._frames_before + self.world.frame

    @property
    def episode(self) -> int:
        """The number of the episode."""
        return self.world.episode

    def tick(self, delta: float | None = None) -> int:
        """Let time pass, and send everybody what sensors noticed, and then the snapshot; returns the frame."""
        before = self.world.frame
        self.world.tick(delta)
        self._remember()
        self.notice(before)
        self.sensors.send(self.frame)
        self.publish()
        return self.frame

    def begin_episode(self, town: Town, client: Spectator) -> None:
        """Begin a new episode, and send everybody its first snapshot.

        The client who wants it gets it in a stream of its own, which it asks for as soon as its call is answered; from the
        old one it would learn of the new episode at a time when it has none (see `Truce`).
        """
        frames = self.world.frame
        self.world.reload(town)
        self.notice(frames)
        self.streams.silence(client.stream)
        del self.clients[client.stream]
        client.stream = self.new_stream()
        self.clients[client.stream] = client
        self.publish()

    def new_stream(self) -> int:
        """A number for the stream of a client."""
        return next(self._stream_numbers)

    def apply_settings(self, settings: EpisodeSettings) -> None:
        """Take over settings.

        Raises:
            SimError: The length of a tick is not to be had.
        """
        delta = settings.fixed_delta_seconds or None
        mine = self.world.settings
        mine.fixed_delta_seconds = delta
        self.settings = replace(settings, fixed_delta_seconds=delta)
        mine.synchronous_mode = settings.synchronous_mode
        mine.no_rendering_mode = settings.no_rendering_mode
        mine.substepping = settings.substepping
        for listener in self.on_settings:
            listener()

    def publish(self) -> None:
        """Send the snapshot of the world as it is to everybody."""
        payload = self._photographer.take(self.episode, self.frame)
        if self._is_new:
            payload = telling_of_map(payload)
            self._is_new = False
        for stream in self.clients:
            self.streams.keep(stream, payload)

    def look_ahead(self) -> None:
        """Do some of the work of the next tick, while clients are busy with the latest one."""
        self._photographer.look_ahead()

    def publish_again(self, client: Spectator) -> None:
        """Send a client the snapshot of the world as it is, as a new frame."""
        self._frames_before += 1
        self.greet(client)

    def greet(self, client: Spectator) -> None:
        """Keep the latest snapshot ready for a client that is about to subscribe."""
        self.streams.keep(client.stream, self._photographer.take(self.episode, self.frame))

    def notice(self, frames: int) -> bool:
        """See whether a new episode has begun, after the given number of frames of the last one."""
        if self._seen == self.world.episode:
            return False
        self._frames_before += frames + 1
        self._begin()
        return True

    def actor(self, id: int) -> Actor:
        """An actor that is alive.

        Raises:
            DeadActor: It has been destroyed.
            CallError: There is none.
        """
        if id in self.world.actors:
            return self.world.actors[id]
        ghost = self._memory.find(id)
        if ghost is not None:
            raise DeadActor(f"actor {id} ({ghost.type_id}) has been destroyed")
        raise CallError(f"actor {id} not found")

    def actor_or_ghost(self, id: int) -> Actor | Ghost:
        """An actor, even one that has been destroyed.

        Raises:
            CallError: There has never been one, or many have been destroyed since.
        """
        return self._memory.find(id) or self.actor(id)

    def remember(self, actor: Actor) -> None:
        """Know an actor beyond its end."""
        self._memory.enter(actor)

    def _remember(self) -> None:
        for actor in self.world.events.spawned:
            self.remember(actor)
        for id in self.world.events.destroyed:
            self._memory.bury(id)

    def _begin(self) -> None:
        self._seen = self.world.episode
        self._is_new = True
        self._memory.bury_all()
        self._photographer = Photographer(self.world)
