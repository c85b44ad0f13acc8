"""The replayer of a world: re-enacts a recording tick by tick, and hands the actors back to traffic at its end."""

from __future__ import annotations

import re
import warnings
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.formats import SUFFIXES, open_reader
from carla_recap.maps.road_map import plain_name
from carla_recap.replay import Player, level
from carla_recap.replay.camera import CHASE_BACK, CHASE_PITCH, CHASE_UP
from carla_recap.sim.actors.actors import Mover, Vehicle, Walker
from carla_recap.sim.actors.control import VehicleControl
from carla_recap.sim.errors import MapMissing, SimError
from carla_recap.sim.geometry import Location, Rotation, Transform, Vector
from carla_recap.sim.recording.poses import CM_PER_M, transform
from carla_recap.sim.recording.recorder import recording_path
from carla_recap.sim.replaying.actor_mapping import Cast
from carla_recap.sim.replaying.kinematic import KinematicReplay
from carla_recap.sim.town.town import load_town
from carla_recap.sim.weather import Weather

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import numpy as np

    from carla_recap.formats.base import Reader
    from carla_recap.replay import Follow, Scene
    from carla_recap.sim.interfaces import ReplayWorld


CHASE: Final = Transform(Location(-CHASE_BACK / CM_PER_M, 0.0, CHASE_UP / CM_PER_M), Rotation(pitch=CHASE_PITCH))
"""Where the spectator is whom nobody has told so: behind and above whom it follows, looking down, as with CARLA."""


@dataclass(frozen=True, slots=True)
class Replay:
    """What is being replayed.

    Attributes:
        path: The recording.
        map_name: Its map, as it is told there.
        loaded: Whether that map had to be loaded.
        total: How long the recording is, in s.
        start: Where the replay begins, in elapsed seconds.
        stop: Where it ends.
        time_factor: How many seconds of the recording pass in a second of the world.
        followed: The id, in the recording, of whom the spectator follows; None: of nobody.
    """

    path: Path
    map_name: str
    loaded: bool
    total: float
    start: float
    stop: float
    time_factor: float
    followed: int | None

    @property
    def duration(self) -> float:
        """How many seconds of the recording are replayed."""
        return self.stop - self.start


class Replayer:
    """Replays recordings in a world; a controller of its ticks.

    The recording says where its actors are, what they do, and what the lights show; all others go on as if nothing
    happened, and bump into the actors of the recording, which nothing moves out of their way.

    Args:
        world: The world.

    Attributes:
        ignore_hero: Whether the next replays leave the actors with the role name hero out.
        ignore_spectator: Whether they leave the spectator alone.
        error: Why the latest replay ended early; None where it did not.
    """

    def __init__(self, world: ReplayWorld) -> None:
        self.ignore_hero = False
        self.ignore_spectator = True
        self.error: RecapError | None = None
        self._world = world
        self._time_factor = 1.0
        self._follow: int | None = None
        self._offset = CHASE
        self._player: Player | None = None
        self._path: Path | None = None
        self._close: Callable[[], object] = lambda: None
        self._cast = Cast(world, replay_sensors=False)
        self._kinematic = KinematicReplay(world, self._cast)
        self._frozen = world.signals.frozen.copy()
        self._doors: Mapping[int, frozenset[int]] = {}
        self._weather: np.void | None = None

    @property
    def is_playing(self) -> bool:
        """Whether a replay is running."""
        return self._player is not None

    @property
    def path(self) -> Path | None:
        """What is being replayed; None between replays."""
        return self._path if self.is_playing else None

    @property
    def mapping(self) -> Mapping[int, int]:
        """Ids of the recording, and those of the actors that play them; that of the latest replay."""
        return self._cast.mapping

    @property
    def substitutes(self) -> Mapping[str, str]:
        """Blueprints of the recording that the library does not have, and what stands for each; "" for a mere box."""
        return self._cast.substitutes

    @property
    def time_factor(self) -> float:
        """How many seconds of the recording pass in a second of the world; from 2 on, nothing is interpolated.

        Can be changed while a replay runs; 0 holds it.
        """
        return self._time_factor

    @time_factor.setter
    def time_factor(self, factor: float) -> None:
        if not 0 <= factor < float("inf"):
            raise SimError(f"a time factor of {factor:g} cannot be played; it must be 0 or more")
        self._time_factor = factor
        if self._player is not None:
            self._player.time_factor = factor

    def start(
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
        """Begin a replay; a recording that is running is completed, and a replay ends: who was spawned for it disappears.

        The actors stand where they are at the start when this returns, and go on with the next tick.

        Args:
            name: The recording; without a suffix, `.mcap` or `.log`; see `recorder.recording_path`.
            start: Where to begin, in elapsed seconds; negative: so long before the end.
            duration: How many seconds of the recording to replay; 0: all of the rest.
            follow: Whom the spectator follows: an id in the recording, or "hero"; None or 0: nobody.
            replay_sensors: Spawn the sensors of the recording, too.
            offset: Where the spectator is that follows, in the axes of whom it follows, which stay level: it neither
                rolls nor pitches with them; None: `CHASE`.
            keep_town: Stay in the town, whatever the map of the recording is; a warning tells of another one.

        Raises:
            RecapError: There is no such recording, it is damaged, or there is no such start or actor.
            MapMissing: It is of another map, and that is not to be had.
        """
        self.stop()
        self._world.stop_recorder()
        self.error = None
        path = find_recording(name, self._world.recordings)
        reader = open_reader(path)
        self._close = weakref.finalize(self, reader.close)
        try:
            player = Player(
                reader,
                start=start,
                duration=duration,
                time_factor=self._time_factor,
                follow=follow or None,
                ignore_hero=self.ignore_hero,
                ignore_spectator=self.ignore_spectator,
            )
            self._follow = player.followed if follow else None
            self._offset = offset or CHASE
            loaded = self._load(reader, keep_town=keep_town)
            self._path = path
            self._begin(player, replay_sensors)
        except BaseException:
            self.stop()
            self._close()
            raise
        return Replay(
            path,
            reader.header.map_name,
            loaded,
            player.total,
            player.start,
            player.stop,
            player.time_factor,
            self._follow,
        )

    def stop(self, keep_actors: bool = False) -> None:
        """End the replay, if there is one.

        Vehicles go on by autopilot at the speed that they had, pedestrians stop, and the lights change by themselves.

        Args:
            keep_actors: Keep those that were spawned for the replay, too; else they disappear.
        """
        if self._player is None:
            return
        self._player = None
        self._close()
        self._world.signals.held = False
        self._world.signals.frozen[:] = self._frozen
        self._cast.forget_dead()
        if not keep_actors:
            self._cast.dismiss()
        for actor in self._cast.roles.values():
            self._hand_back(actor)

    def step(self, delta: float) -> None:
        """Re-enact a tick; a recording that turns out to be damaged ends the replay, and a warning tells of it."""
        player = self._player
        if player is None:
            return
        before = player.time
        try:
            scene = player.tick(delta)
            if scene is None:
                self.stop(keep_actors=True)
            else:
                self._show(scene, delta, player.time - before)
        except RecapError as error:
            self.error = error
            self.stop(keep_actors=True)
            warnings.warn(f"the replay has ended: {error}", RecapWarning, stacklevel=3)

    def _load(self, reader: Reader, *, keep_town: bool) -> bool:
        """Make the world that of the recording's map, unless it has to stay; returns whether it was another one."""
        name, town_name = _plain(reader.header.map_name), _plain(self._world.town.name)
        if name == town_name:
            return False
        if keep_town:
            told = f"{reader.path}: is a recording of the map {name!r}, and replayed in {town_name!r}"
            warnings.warn(told, RecapWarning, stacklevel=4)
            return False
        maps = None if self._world.maps is None else Path(self._world.maps)
        try:
            town = load_town(plain_name(reader.header.map_name), maps)
        except RecapError as error:
            raise MapMissing(reader.path, reader.header.map_name, str(error)) from None
        self._world.reload(town)
        return True

    def _begin(self, player: Player, replay_sensors: bool) -> None:
        world = self._world
        self._player = player
        self._cast = Cast(world, replay_sensors=replay_sensors)
        self._kinematic = KinematicReplay(world, self._cast)
        self._doors, self._weather = {}, None
        self._frozen = world.signals.frozen.copy()
        world.signals.held = True
        scene = player.tick(0.0)
        assert scene is not None
        self._show(scene, 0.0, 0.0)

    def _show(self, scene: Scene, delta: float, seconds: float) -> None:
        if self._world.events.destroyed or self._world.pending.destroyed:
            self._cast.forget_dead()
        for gone in scene.destroyed:
            self._cast.leave(gone.id)
        if scene.spawned:
            self._cast.enter({came.actor.id: came.actor for came in scene.spawned}.values(), scene)
        self._kinematic.move(scene, delta, seconds)
        self._move_doors(scene)
        self._change_weather(scene)
        pose = None if self._follow is None else scene.pose_of(self._follow)
        if pose is not None:
            self._world.spectator.transform = transform(level(pose)).attached(self._offset)

    def _move_doors(self, scene: Scene) -> None:
        if scene.doors == self._doors:
            return
        self._doors = scene.doors
        for id, actor in self._cast.roles.items():
            if isinstance(actor, Vehicle):
                doors = scene.doors.get(id, frozenset())
                for door in sorted(doors ^ actor.open_doors):
                    actor.set_door(door, door in doors)

    def _change_weather(self, scene: Scene) -> None:
        if scene.weather is not None and scene.weather is not self._weather:
            self._weather = scene.weather
            self._world.weather = Weather(*scene.weather.item())

    def _hand_back(self, actor: object) -> None:
        """Let an actor go on by itself."""
        if isinstance(actor, Mover):
            actor.set_simulate_physics(True)
        if isinstance(actor, Vehicle):
            actor.set_target_velocity(Vector(*self._kinematic.velocity(actor)))
            actor.apply_control(VehicleControl())
            actor.set_autopilot(True)
        if isinstance(actor, Walker):
            self._world.walkers.speed[actor.row] = 0.0
            actor.set_target_velocity(Vector())


def find_recording(name: Path | str, folder: Path | str | None = None) -> Path:
    """Where a recording lies whose suffix may be missing; whether it is there is another question.

    Args:
        name: See `recording_path`.
        folder: See `recorder.recordings_folder`.
    """
    path = recording_path(name, folder)
    candidates = [path, *(path.with_name(path.name + suffix) for suffix in reversed(SUFFIXES))]
    return next((candidate for candidate in candidates if candidate.is_file()), path)


def _plain(map_name: str) -> str:
    """The name of a map without folders, and without what stands for its layers."""
    return re.split(r"[/\\]", map_name)[-1].removesuffix("_Opt")
