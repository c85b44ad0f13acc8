"""The world that is served: its time, its episodes, and those who are connected."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from carla_recap.server.calls.table import CallError
from carla_recap.server.managers import Managers
from carla_recap.server.snapshot import Photographer
from carla_recap.server.streams import Streams
from carla_recap.server.structs import EpisodeSettings
from carla_recap.sim.errors import DeadActor

if TYPE_CHECKING:
    from collections.abc import Callable

    from carla_recap.server.client import Client
    from carla_recap.sim.actors import Actor
    from carla_recap.sim.world import World

_MOST_KNOWN: Final = 100_000
"""Actors that are remembered after their end, for clients that still ask for them."""


class Host:
    """Serves a world.

    Args:
        world: The world; nobody else may tick it from now on.

    Attributes:
        world: The world.
        settings: As clients have set them.
        streams: What is sent to subscribers.
        managers: The traffic managers of clients.
        clients: Who is connected, by number.
        on_settings: Who is told when the settings change.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self.settings = EpisodeSettings()
        self.streams = Streams()
        self.managers = Managers()
        self.clients: dict[int, Client] = {}
        self.on_settings: list[Callable[[], None]] = []
        self._frames_before = 0
        self._known: OrderedDict[int, Actor] = OrderedDict()
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
        """Let time pass, and send everybody the snapshot; returns the frame."""
        before = self.world.frame
        self.world.tick(delta)
        self._remember()
        self.notice(before)
        self.publish()
        return self.frame

    def apply_settings(self, settings: EpisodeSettings) -> None:
        """Take over settings.

        Raises:
            CallError: The length of a tick is not to be had.
        """
        delta = settings.fixed_delta_seconds
        if delta is not None and not 0 <= delta < float("inf"):
            raise CallError(f"fixed_delta_seconds of {delta:g}: expected more than 0 s")
        self.settings = replace(settings, fixed_delta_seconds=delta or None)
        mine = self.world.settings
        mine.synchronous_mode = settings.synchronous_mode
        mine.no_rendering_mode = settings.no_rendering_mode
        mine.fixed_delta_seconds = delta or None
        mine.substepping = settings.substepping
        for listener in self.on_settings:
            listener()

    def publish(self, *, besides: Client | None = None) -> None:
        """Send the snapshot of the world as it is to everybody, but for one perhaps."""
        payload = self._photographer.take(self.episode, self.frame)
        for client in self.clients.values():
            if client is not besides:
                self.streams.keep(client.stream, payload)

    def greet(self, client: Client) -> None:
        """Keep the latest snapshot ready for a client that is about to subscribe."""
        self.streams.keep(client.stream, self._photographer.take(self.episode, self.frame))

    def notice(self, frames: int) -> bool:
        """See whether a new episode has begun, after the given number of frames of the last one."""
        if self._seen == self.world.episode:
            return False
        self._frames_before += frames
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
        if id in self._known:
            raise DeadActor(f"actor {id} ({self._known[id].type_id}) has been destroyed")
        raise CallError(f"actor {id} not found")

    def actor_or_ghost(self, id: int) -> Actor:
        """An actor, even one that has been destroyed.

        Raises:
            CallError: There has never been one.
        """
        return self._known[id] if id in self._known else self.actor(id)

    def _remember(self) -> None:
        for actor in self.world.events.spawned:
            self._known[actor.id] = actor
        while len(self._known) > _MOST_KNOWN:
            self._known.popitem(last=False)

    def _begin(self) -> None:
        self._seen = self.world.episode
        self._photographer = Photographer(self.world)
