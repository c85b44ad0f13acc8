"""The replayer of a world: replays a recording tick by tick, and returns the actors to traffic at its end."""

from __future__ import annotations

import warnings
import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.formats import SUFFIXES, open_reader
from carla_recap.model.packets import pose
from carla_recap.model.records import CM_PER_M
from carla_recap.replay import Player, level
from carla_recap.replay.camera import CHASE_BACK, CHASE_PITCH, CHASE_UP
from carla_recap.replay.follow import find_followed
from carla_recap.roads.find import described_folder, map_key, plain_name
from carla_recap.sim.actors.moving import ALL_DOORS, MovingActor, Vehicle, VehicleControl, Walker
from carla_recap.sim.errors import MapMissing, SimError
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector
from carla_recap.sim.physics import drivetrain
from carla_recap.sim.recording.packets import possible, transform
from carla_recap.sim.recording.recorder import recording_path
from carla_recap.sim.replaying.actor_mapping import ActorMapping
from carla_recap.sim.replaying.kinematic import CollisionReplay, KinematicReplay
from carla_recap.sim.settings import Weather
from carla_recap.sim.town.loading import is_unknown, load_corridors, load_town

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Generator, Iterator, Mapping
    from pathlib import Path

    from carla_recap.formats.base import Reader
    from carla_recap.replay import Follow, Scene
    from carla_recap.sim.episode import Actor, Episode
    from carla_recap.sim.physics.vehicles import Vehicles
    from carla_recap.sim.town.loading import Town
    from carla_recap.util.arrays import Integers


T = TypeVar("T")

_SETTLING: Final = 0.4  # s, after which engine and wheels turn evenly
_EXACT_STEP, _LONG_STEP = 0.01, 0.05  # s of physics, of the vehicles of clients and of the autopilot
CHASE: Final = Transform(Location(-CHASE_BACK / CM_PER_M, 0.0, CHASE_UP / CM_PER_M), Rotation(pitch=CHASE_PITCH))
"""The default offset of a spectator that follows an actor: behind and above it, looking down, as in CARLA."""


@dataclass(frozen=True, slots=True)
class Replay:
    """A replay.

    Attributes:
        path: The recording.
        map_name: The map on which it is replayed, as the recording or the caller names it.
        loaded: Whether that map had to be loaded.
        on_corridors: Whether the map is unavailable, and its roads are what the vehicles of the recording have driven along.
        total: The length of the recording, in s.
        start: The beginning of the replay, in elapsed seconds.
        stop: Its end, in elapsed seconds.
        time_factor: The seconds of the recording that pass in a second of the world.
        followed: The recorded id of the actor that the spectator follows; None for none.
    """

    path: Path
    map_name: str
    loaded: bool
    total: float
    start: float
    stop: float
    time_factor: float
    followed: int | None
    on_corridors: bool = False

    @property
    def duration(self) -> float:
        """The seconds of the recording that are replayed."""
        return self.stop - self.start


@dataclass(frozen=True, slots=True)
class OpenedRecording:
    """A recording to be replayed: its player has played the first scene, and the spectator may follow an actor."""

    path: Path
    player: Player
    scene: Scene
    follows: bool


class Replayer:
    """Replays recordings in a world; a controller of its ticks.

    Replayed actors have the poses, the controls, the lights and the collisions of the recording, until they are released.
    All others go on as before, and collide with replayed actors without moving them.

    Attributes:
        ignore_hero: Whether later replays leave out the actors with the role name hero.
        ignore_spectator: Whether later replays leave out the spectator.
        error: The error that ended the latest replay early; None without one.
    """

    def __init__(self, episode: Episode, maps: Path | None = None) -> None:
        self._maps = maps
        self.ignore_hero = False
        self.ignore_spectator = True
        self.error: RecapError | None = None
        self._time_factor = 1.0
        self._follow: int | None = None
        self._offset = CHASE
        self._player: Player | None = None
        self._shows_start = False
        self._path: Path | None = None
        self._close: Callable[[], object] = lambda: None
        self._doors: Mapping[int, frozenset[int]] = {}
        self._weather: np.void | None = None
        self._replay_weather = True
        self.enter(episode)

    def enter(self, episode: Episode) -> None:
        """Replay in another episode from now on."""
        self._episode = episode
        self._mapping = ActorMapping(episode)
        self._kinematic = KinematicReplay(episode, self._mapping)
        self._collisions = CollisionReplay(episode, self._mapping, self._kinematic)
        self._frozen = episode.signals.frozen.copy()

    @property
    def is_playing(self) -> bool:
        """Whether a replay is running."""
        return self._player is not None

    @property
    def shows_start(self) -> bool:
        """Whether a replay has begun, and no tick has followed yet."""
        return self.is_playing and self._shows_start

    @property
    def path(self) -> Path | None:
        """The recording that is being replayed; None between replays."""
        return self._path if self.is_playing else None

    @property
    def mapping(self) -> Mapping[int, int]:
        """The ids of the replayed actors of the latest replay, released ones included, by the ids of the recording."""
        return self._mapping.ids

    @property
    def substitutes(self) -> Mapping[str, str]:
        """Blueprints of the recording that are not in the library, and those that replace them; "" for a box."""
        return self._mapping.substitutes

    @property
    def time_factor(self) -> float:
        """The seconds of the recording that pass in a second of the world; from 2 on, nothing is interpolated.

        It can be changed while a replay runs; 0 pauses it.
        """
        return self._time_factor

    @time_factor.setter
    def time_factor(self, factor: float) -> None:
        if not 0 <= factor < float("inf"):
            raise SimError(f"a time factor of {factor:g} cannot be played; it must be 0 or more")
        self._time_factor = factor
        if self._player is not None:
            self._player.time_factor = factor

    def follows(self, actor: Actor) -> bool:
        """Return whether an actor of the world follows the recording of a running replay."""
        return self.is_playing and any(other is actor for other in self._mapping.replayed.values())

    def open(
        self, path: Path, start: float = 0.0, duration: float = 0.0, follow: Follow | None = None, *, lenient: bool = False
    ) -> OpenedRecording:
        """Open a recording for a replay, and seek its start; it may run in a thread, as it leaves the world alone.

        The start is in elapsed seconds, a negative one counts from the end; a duration of 0 s is the rest. The spectator
        follows an id of the recording, or "hero"; None or 0 is none. If it is `lenient`, a start after the end, which is the
        end, and an actor to follow that is missing, which is none, are accepted with a warning, as by CARLA; else they are
        errors.

        Raises:
            RecapError: There is no such recording, it is damaged, or there is no such start or actor.
        """
        reader = open_reader(path)
        try:
            if lenient:
                start, follow = self._accept(reader, start, follow)
            player = Player(
                reader,
                start=start,
                duration=duration,
                time_factor=self._time_factor,
                follow=follow or None,
                ignore_hero=self.ignore_hero,
                ignore_spectator=self.ignore_spectator,
            )
            scene = player.tick(0.0)
            assert scene is not None
        except BaseException:
            reader.close()
            raise
        return OpenedRecording(path, player, scene, bool(follow))

    def begin(
        self,
        opened: OpenedRecording,
        reload: Callable[[Town], None],
        replay_sensors: bool = False,
        offset: Transform | None = None,
        *,
        keep_town: bool = False,
        replay_weather: bool = True,
        map_name: str = "",
    ) -> Generator[None, None, Replay]:
        """Begin to replay an opened recording: the replayed actors have their first poses, and move with the next tick.

        Another map than the town's is loaded first by `reload`, see `town_to_load`; errors and warnings are of that, too. It
        takes a step for each actor that is spawned; no tick may fall between two. The recording is closed when the replay
        ends. The offset is the transform of the spectator relative to the actor that it follows, with the actor's yaw alone;
        None for `CHASE`.
        """
        self.stop()
        self.error = None
        path, player = opened.path, opened.player
        player.time_factor = self._time_factor
        close = self._close = weakref.finalize(self, player.reader.close)
        try:
            town = town_to_load(opened, self._episode.town, self._maps, map_name, keep=keep_town)
            if town is not None:
                reload(town)
            self._follow = player.followed if opened.follows else None
            self._offset = offset or CHASE
            self._replay_weather = replay_weather
            earlier = self._mapping.replayed if path == self._path else {}
            self._path = path
            self._mapping = ActorMapping(self._episode, replay_sensors=replay_sensors, earlier=earlier)
            for _ in self._begin(player, opened.scene):
                yield
                if self._player is not player:
                    raise SimError(f"{path}: its replay was stopped before it had begun")
            self._shows_start = True
        except BaseException:
            if self._close is close:
                self.stop()
            close()
            raise
        return Replay(
            path,
            map_name or player.reader.header.map_name,
            town is not None,
            player.total,
            player.start,
            player.stop,
            player.time_factor,
            self._follow,
            self._episode.town.is_of_corridors,
        )

    def stop(self, keep_actors: bool = False) -> None:
        """End the replay, if there is one, and destroy the actors that were spawned for it, unless they are kept.

        Vehicles go on by autopilot at their speed, pedestrians stop, and the lights change by themselves.
        """
        if self._player is None:
            return
        self._player = self._episode.replayed = None
        self._close()
        self._episode.signals.held = False
        self._episode.signals.frozen[:] = self._frozen
        self._mapping.forget_dead()
        if not keep_actors:
            self._mapping.destroy_spawned()
        self._return_to_traffic(self._mapping.replayed.values(), autopilot=True)

    def release(self, actor: Actor) -> None:
        """Let an actor leave the replay, and go on by itself: from its pose, at its recorded speed.

        It is left to its control, and stays when the replay ends; `stop` does not destroy it. All others follow the
        recording. To release a vehicle to the autopilot, call its `set_autopilot` instead.

        Raises:
            SimError: It does not follow a recording.
        """
        recorded = next((id for id, other in self._mapping.replayed.items() if other is actor), None)
        if not self.is_playing or recorded is None or not isinstance(actor, MovingActor):
            raise SimError(f"{actor!r}: is no vehicle or walker that follows a recording")
        self._mapping.release(recorded)
        self._return_to_traffic([actor], autopilot=False)

    def step(self, delta: float) -> None:
        """Replay a tick; a damaged recording ends the replay, with a warning."""
        player = self._player
        if player is None:
            return
        self._shows_start = False
        self._release_to_autopilot()
        before = player.time
        try:
            scene = player.tick(delta)
            if scene is None:
                self.stop(keep_actors=True)
            else:
                finished(self._show(scene, delta, player.time - before))
        except RecapError as error:
            self.error = error
            self.stop(keep_actors=True)
            warnings.warn(f"the replay has ended: {error}", RecapWarning, stacklevel=3)

    def _accept(self, reader: Reader, start: float, follow: Follow | None) -> tuple[float, Follow | None]:
        """Return the start, at most the end, and the actor to follow if it can be followed; warn where they change."""
        total = reader.extent().duration
        if start > total:
            warnings.warn(
                f"{reader.location}: the replay starts at its end, {total:g} s, instead of {start:g} s",
                RecapWarning,
                stacklevel=4,
            )
            start = total
        try:
            return start, find_followed(reader, follow, ignore_hero=self.ignore_hero) if follow else None
        except RecapError as error:
            warnings.warn(f"the spectator follows no actor: {error}", RecapWarning, stacklevel=4)
            return start, None

    def _begin(self, player: Player, scene: Scene) -> Iterator[None]:
        episode = self._episode
        self._player, episode.replayed = player, self._path
        self._kinematic = KinematicReplay(episode, self._mapping)
        self._collisions = CollisionReplay(episode, self._mapping, self._kinematic)
        self._doors, self._weather = {}, None
        self._frozen = episode.signals.frozen.copy()
        episode.signals.held = True
        self._shows_start = False
        return self._show(scene, 0.0, 0.0)

    def _release_to_autopilot(self) -> None:
        """Release the vehicles that have been given to the autopilot, once their speed is known."""
        vehicles, released = self._episode.vehicles, []
        for row in np.flatnonzero(vehicles.autopilot & ~vehicles.simulated).tolist():
            vehicle = vehicles.actors[row]
            recorded = next((id for id, actor in self._mapping.replayed.items() if actor is vehicle), None)
            if recorded is not None and self._kinematic.has_moved(vehicle):
                self._mapping.release(recorded)
                released.append(vehicle)
        self._return_to_traffic(released, autopilot=True)

    def _show(self, scene: Scene, delta: float, seconds: float) -> Generator[None, None, None]:
        """Show a scene, with a step for each actor that is spawned."""
        if self._episode.events.destroyed or self._episode.pending.destroyed:
            self._mapping.forget_dead()
        self._collisions.prepare(scene)
        for gone in scene.destroyed:
            self._mapping.remove(gone.id)
        if scene.destroyed:  # and with them what was attached to them
            self._mapping.forget_dead()
        if scene.spawned:
            yield from self._mapping.add({came.actor.id: came.actor for came in scene.spawned}.values(), scene)
            self._mapping.forget_dead()  # what clients have destroyed between two steps
        self._mapping.change_physics(scene.actors)
        self._kinematic.move(scene, delta, seconds)
        self._collisions.report()
        self._move_doors(scene)
        if self._replay_weather:
            self._change_weather(scene)
        if self._follow is not None:
            self._move_spectator(self._follow, scene)

    def _move_spectator(self, followed: int, scene: Scene) -> None:
        released = self._mapping.released.get(followed)
        recorded = scene.pose_of(followed) if released is None else np.array(pose(released.transform))
        if recorded is not None and possible(recorded):
            self._episode.spectator.transform = transform(level(recorded)).attached(self._offset)

    def _move_doors(self, scene: Scene) -> None:
        if scene.doors == self._doors:
            return
        self._doors = scene.doors
        for id, actor in self._mapping.replayed.items():
            if isinstance(actor, Vehicle):
                doors = scene.doors.get(id, frozenset())
                for door in sorted(door for door in doors ^ actor.open_doors if door < ALL_DOORS):
                    actor.set_door(door, door in doors)

    def _change_weather(self, scene: Scene) -> None:
        if scene.weather is not None and scene.weather is not self._weather:
            self._weather = scene.weather
            try:
                self._episode.weather = Weather(*scene.weather.item())
            except SimError as error:
                warnings.warn(f"{self._path}: a recorded weather is left out: {error}", RecapWarning, stacklevel=4)

    def _return_to_traffic(self, actors: Collection[Actor], *, autopilot: bool) -> None:
        """Let actors move by themselves again."""
        driven = [actor for actor in actors if isinstance(actor, Vehicle) and actor.parent is None]
        for vehicle in driven:
            *velocity, yaw_rate = self._kinematic.motion(vehicle)
            _drive_on(vehicle, Vector(*velocity), yaw_rate)
        _settle(self._episode.vehicles, np.array([vehicle.row for vehicle in driven], np.int64), exactly=not autopilot)
        for vehicle in driven:
            vehicle.rows.engage(vehicle.row)
            if not autopilot:  # which acts at the beginning of the next tick
                vehicle.apply_control(VehicleControl())
            vehicle.set_autopilot(autopilot)
        for actor in actors:
            if isinstance(actor, Walker):
                actor.set_simulate_physics(True)
                self._episode.walkers.speed[actor.row] = 0.0
                actor.set_target_velocity(Vector())


def _drive_on(vehicle: Vehicle, velocity: Vector, yaw_rate: float) -> None:
    """Let physics move a vehicle on, at a yaw rate in degrees/s, with its recorded gear, pedals and steering."""
    rows, row = vehicle.rows, vehicle.row
    gear, own, tables = min(rows.gear[row], vehicle.gears), rows.table[row], rows.tables
    vehicle.set_simulate_physics(True)
    rows.gear[row] = rows.target_gear[row] = gear
    vehicle.set_target_velocity(velocity)
    rows.turning[row] = np.radians(yaw_rate)
    throttle, steer, brake = np.nan_to_num((rows.throttle[row], rows.steer[row], rows.brake[row])).tolist()
    vehicle.apply_control(VehicleControl(throttle, steer, brake, bool(rows.hand_brake[row]), reverse=bool(gear < 0)))
    for reached, control in (
        (rows.throttle_input, rows.throttle),
        (rows.steer_input, rows.steer),
        (rows.brake_input, rows.brake),
    ):
        reached[row] = control[row]
    if abs(tables.ratios[own, gear] * rows.omega[row, 0]) > tables.most_turns[own]:  # as no engine does
        rows.gear[row] = rows.target_gear[row] = 0


def _settle(fleet: Vehicles, rows: Integers, *, exactly: bool) -> None:
    """Let engines and wheels of vehicles in gear turn as they do after a while at their speed."""
    rows = rows[fleet.gear[rows] != 0]
    fleet.since_shift[rows] = 0.0
    motion = [(column, column[rows]) for column in (fleet.speed, fleet.sideways, fleet.turning)]
    step = _EXACT_STEP if exactly else _LONG_STEP
    for _ in range(round(_SETTLING / step) if len(rows) else 0):
        drivetrain.advance(fleet, rows, step, exactly=exactly)
        for column, values in motion:
            column[rows] = values


def finished(steps: Generator[None, None, T]) -> T:
    """Take all steps at once, and return their result."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: T = end.value
            return result


def find_recording(name: Path | str, folder: Path | str | None = None) -> Path:
    """Return the path of a recording whose suffix may be missing, whether or not it exists."""
    path = recording_path(name, folder)
    candidates = [path, *(path.with_name(path.name + suffix) for suffix in reversed(SUFFIXES))]
    return next((candidate for candidate in candidates if candidate.is_file()), path)


def town_to_load(opened: OpenedRecording, town: Town, maps: Path | None, map_name: str = "", *, keep: bool) -> Town | None:
    """Return the town that has to be loaded for a replay; None if it can begin in the present one, which `keep` stays in.

    A map without a name is that of the recording, whose corridors are the town if there is no such map; a warning says so,
    and if the town that is kept has another one. `MapMissing`: the map cannot be loaded.
    """
    path, name = opened.player.reader.path, map_name or opened.player.reader.header.map_name
    if is_of(town, name):
        return None
    if keep:
        if map_key(name) != map_key(town.name):
            reason = f"is a recording of the map {plain_name(name)!r}, and replayed in {town.name!r}"
            warnings.warn(f"{path}: {reason}", RecapWarning, stacklevel=4)
        return None
    try:
        if map_name or not is_unknown(name, maps):
            return load_town(plain_name(name), maps)
        corridors = load_corridors(path, name)
    except RecapError as error:
        raise MapMissing(path, name, str(error)) from None
    if corridors is town:
        return None
    warnings.warn(
        f"{path}: there is no map {plain_name(name)!r} in {described_folder(maps)}; "
        "the roads are the corridors that the vehicles of the recording have driven",
        RecapWarning,
        stacklevel=4,
    )
    return corridors


def is_of(town: Town, map_name: str) -> bool:
    """Return whether a town is made of a map, and not of the corridors of a recording of it."""
    return map_key(map_name) == map_key(town.name) and not town.is_of_corridors
