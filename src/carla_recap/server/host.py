"""The served world: its time, its episodes, and what clients get of it; and the clients."""

from __future__ import annotations

import asyncio
import logging
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Any, Final, TypeVar

from carla_recap.server.actor_records import ActorCache, encoded_definitions
from carla_recap.server.controllers import AckermannController, ConstantVelocity, Takeover
from carla_recap.server.maps import Maps
from carla_recap.server.navmesh import prepare_navigation
from carla_recap.server.protocol.clients import release_of
from carla_recap.server.protocol.releases import DEFAULT
from carla_recap.server.recordings import Recordings
from carla_recap.server.rpc.connection import ConnectionPool
from carla_recap.server.rpc.registry import CallError
from carla_recap.server.rpc.structs import EpisodeSettings
from carla_recap.server.sensors import Sensors
from carla_recap.server.snapshots import SnapshotEncoder, for_release, with_map_changed
from carla_recap.server.streams import SnapshotStreams, Streams
from carla_recap.server.traffic_manager import TrafficManagerCycle, TrafficManagerRegistry
from carla_recap.sim.errors import DeadActor

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from carla_recap.rendering.camera import Quality
    from carla_recap.server.actor_records import DestroyedActor
    from carla_recap.server.protocol.clients import Address
    from carla_recap.server.protocol.releases import Release
    from carla_recap.server.rpc.connection import ClientConnection
    from carla_recap.server.traffic_manager import TrafficManagerPause
    from carla_recap.sim.episode import Actor
    from carla_recap.sim.town.loading import Town
    from carla_recap.sim.world import World


T = TypeVar("T")

_LOG: Final = logging.getLogger(__name__)
_SLICE: Final = 0.01  # s for which steps keep other clients waiting; a call may come behind two of them
_MAX_LOGGED: Final = 100  # errors that are not logged again


class Host:
    """Serves a world, which from now on only the host ticks.

    With `confined`, recordings outside the folder of recordings are refused; with `stand_in`, the built-in town is served
    under the name of a map that is missing. Without a release, each client has its own, where it can be found, else the
    default.

    Attributes:
        settings: The settings that clients have made.
        batches: What is being done in steps, between calls of other clients.
        on_settings: Callbacks for a change of the settings.
        lookups: Where the releases of clients are looked up, one after the other: many at once would slow down ticks.
    """

    _encoder: SnapshotEncoder
    _is_new: bool

    def __init__(
        self,
        world: World,
        *,
        confined: bool = False,
        stand_in: bool = False,
        quality: Quality = "epic",
        release: Release | None = None,
    ) -> None:
        self.world = world
        self.release = release
        self.quality = quality
        self.maps = Maps(world.town, world.maps, stand_in=stand_in)
        self.recordings = Recordings(world, confined=confined)
        self.settings = EpisodeSettings()
        self.connections = ConnectionPool()
        self.streams = Streams(self.connections, with_map_changed)
        self.snapshots = SnapshotStreams(self.streams, for_release)
        self.traffic_managers = TrafficManagerRegistry()
        self.sensors = Sensors(world, self.streams, self.known_actor, quality)
        self.ackermann = AckermannController()
        self.constant_velocity = ConstantVelocity()
        self.takeover = Takeover(world)
        world.controllers.append(self.ackermann)
        world.listeners.append(self.constant_velocity)
        world.on_error = self._log_error
        self._logged: set[tuple[str, str]] = set()
        self.on_settings: list[Callable[[], None]] = []
        self.batches: set[asyncio.Future[Any]] = set()
        self.lookups = ThreadPoolExecutor(1, "carla-recap-releases")
        self._frames_before = 0
        self._loads_ahead = False
        self._actors = ActorCache()
        self._begin()

    def load_ahead(self) -> None:
        """Load in the background what sensors will need, now and after each change of the map."""
        self._loads_ahead = True
        self.sensors.load_ahead()

    def prepare(self) -> None:
        """Compute what the first calls of clients need: on a busy machine, they would time out."""
        encoded_definitions(self.world.blueprints, self.release or DEFAULT)
        prepare_navigation(self.world.town)

    @property
    def frame(self) -> int:
        """The number of the latest frame; it never goes back, not even in a new episode."""
        return self._frames_before + self.world.frame

    @property
    def episode(self) -> int:
        """The number of the episode."""
        return self.world.episode.number

    def take(self, steps: Generator[None, None, T], *, at_once: bool = False) -> T | asyncio.Future[T]:
        """Take steps, and return their result; if they take long, calls of other clients are served in between.

        Then what is returned is a future of the result: see `between_batches`.
        """
        try:
            _take(steps, inf if at_once else _SLICE)
        except StopIteration as end:
            result: T = end.value
            return result

        async def take_rest() -> T:
            while True:
                await asyncio.sleep(0)
                try:
                    _take(steps, _SLICE)
                except StopIteration as end:
                    result: T = end.value
                    return result

        rest = asyncio.ensure_future(take_rest())
        self.batches.add(rest)
        rest.add_done_callback(self.batches.discard)
        return rest

    async def between_batches(self) -> None:
        """Wait for what is being done in steps, such as batches of commands: no tick and no new episode falls within."""
        while self.batches:
            await asyncio.wait(self.batches)

    def tick(self, delta: float | None = None) -> int:
        """Tick the world, send the data of sensors and the snapshot, and return the number of the frame."""
        before = self.world.frame
        self.world.tick(delta)
        for actor in self.world.events.spawned:
            self.remember(actor)
        for id in self.world.events.destroyed:
            self._actors.evict(id)
        self.check_episode(before)
        self.sensors.send(self.frame)
        self.publish()
        return self.frame

    def _log_error(self, actor: object, error: Exception) -> None:
        """Log what a controller or listener of the world has raised in a tick, once for each text."""
        key = type(actor).__name__, str(error)
        if key not in self._logged:
            self._logged = {*self._logged, key} if len(self._logged) < _MAX_LOGGED else {key}
            _LOG.error("a tick goes on without %s: %s", *key, exc_info=error)

    def begin_episode(self, town: Town, client: Client) -> None:
        """Begin a new episode for a client, and send its first snapshot to all; see `SnapshotStreams.renew`."""
        frames = self.world.frame
        self.recordings.stop()  # another client may have begun one meanwhile
        self.world.reload(town)
        self.sensors.end_episode()
        self.check_episode(frames)
        client.stream = self.snapshots.renew(client.stream)
        self.publish()

    def apply_settings(self, settings: EpisodeSettings) -> None:
        """Apply settings; raise `SimError` if the length of a tick is out of range."""
        delta = settings.fixed_delta_seconds or None
        mine = self.world.settings
        mine.fixed_delta_seconds = delta
        self.settings = replace(settings, fixed_delta_seconds=delta)
        mine.synchronous_mode = settings.synchronous_mode
        mine.no_rendering_mode = settings.no_rendering_mode
        mine.substepping = settings.substepping
        for callback in self.on_settings:
            callback()

    def close(self) -> None:
        """End sensors, recording and replay."""
        self.lookups.shutdown(wait=False, cancel_futures=True)
        self.sensors.close()
        self.world.close()
        self.recordings.close()

    def publish(self) -> None:
        """Send a snapshot to all clients."""
        payload = self._encoder.encode(self.episode, self.frame)
        if self._is_new:
            payload = with_map_changed(payload)
            self._is_new = False
        self.snapshots.publish(payload)

    def publish_again(self, client: Client) -> None:
        """Send a client a snapshot of the unchanged world as a new frame."""
        self._frames_before += 1
        self.prepare_snapshot(client)

    def prepare_snapshot(self, client: Client) -> None:
        """Keep a snapshot for a client that is about to subscribe."""
        self.snapshots.keep(client.stream, self._encoder.encode(self.episode, self.frame))

    def check_episode(self, frames: int) -> bool:
        """Return whether a new episode has begun, after the given number of frames of the last one."""
        if self._episode == self.world.episode.number:
            return False
        self._frames_before += frames + 1
        self._begin()
        if self._loads_ahead:
            self.sensors.load_ahead()
        return True

    def actor(self, id: int) -> Actor:
        """Return an actor that is alive; raise `DeadActor` for a destroyed one, and `CallError` if there is none."""
        if id in self.world.actors:
            return self.world.actors[id]
        destroyed = self._actors.find(id)
        if destroyed is not None:
            raise DeadActor(f"actor {id} ({destroyed.type_id}) has been destroyed")
        raise CallError(f"actor {id} not found")

    def known_actor(self, id: int) -> Actor | DestroyedActor:
        """Return an actor, even a destroyed one; raise `CallError` if there has never been one, or it has been evicted."""
        return self._actors.find(id) or self.actor(id)

    def remember(self, actor: Actor) -> None:
        """Keep an actor known after its destruction."""
        self._actors.add(actor)

    def _begin(self) -> None:
        self._episode = self.world.episode.number
        self._is_new = True
        self._actors.evict_destroyed()
        self._encoder = SnapshotEncoder(self.world)


def _take(steps: Generator[None, None, object], seconds: float) -> None:
    """Take steps for some time, one at least; StopIteration is raised at their end."""
    end = time.monotonic() + seconds
    while True:
        next(steps)
        if time.monotonic() >= end:
            return


class Client:
    """A client, and what the server knows of it.

    Attributes:
        refusal: Why all its calls are refused; empty if they are not.
        stream: The number of its stream of snapshots; see `SnapshotStreams`.
        cycle: The state of its traffic manager.
        pause: The pause of its traffic manager, while an episode begins.
        queries: A lock that is held while a recording is queried for it: the answers of a client are made one by one.
    """

    def __init__(self, host: Host, connection: ClientConnection) -> None:
        self.host = host
        self.connection = connection
        self.cycle = TrafficManagerCycle(connection.address)
        self.pause: TrafficManagerPause | None = None
        self.queries = asyncio.Lock()
        self.release = host.release or DEFAULT
        self.refusal = ""
        self.stream = host.snapshots.open(self.release)
        if connection.ends is not None:
            connection.read_after(self._identify(*connection.ends))

    async def _identify(self, client: Address, server: Address) -> None:
        """Find the release of the client; one of another release than all must have is refused before it crashes.

        The answer to `version` tells it why, too: of errors, a client of 0.10 shows no text, but it shows a version.
        """
        loop = asyncio.get_running_loop()
        found = await loop.run_in_executor(self.host.lookups, release_of, client, server)
        if found is None or found is self.release:
            return
        if self.host.release is not None:
            own = self.host.release.name
            self.refusal = f"expected a client of CARLA {own}, found one of {found.name}: the server runs with --carla {own}"
            _LOG.warning("%s", self.refusal)
            return
        self.release = found
        self.host.snapshots.close(self.stream)
        self.stream = self.host.snapshots.open(found)

    @property
    def known_episode(self) -> int:
        """The number of the episode that the client learns of; while its traffic manager pauses, of the one before.

        The first snapshot then tells the client of a new episode, which makes it reset its traffic manager.
        """
        return self.host.episode - (self.pause is not None)

    def begin_call(self, name: str) -> None:
        """Take note of a call of the client, or of its traffic manager: they share a connection. It may be refused."""
        if self.refusal and name != "version":
            raise CallError(self.refusal)
        self.cycle.begin_call(name)

    def hold(self, name: str, answer: Any) -> Any:
        """Return the answer to a call, or an awaitable of it while the traffic manager pauses."""
        return answer if self.pause is None else self.pause.hold(name, answer)

    def leave(self) -> None:
        """Release everything when the client has left."""
        self.cycle.expect([])
        self.host.traffic_managers.remove_all(self.cycle)
        self.host.snapshots.close(self.stream)
