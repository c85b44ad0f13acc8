"""A recording, or the frames of a running simulation, as a Rerun stream."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.errors import MissingExtra, RecapWarning
from carla_recap.formats.sources import unsigned
from carla_recap.model.lives import ROAD_USERS
from carla_recap.queries.sensors import sensors
from carla_recap.replay import Played, Player
from carla_recap.replay.follow import HERO
from carla_recap.replay.pose import LOCATION
from carla_recap.replay.recorded_map import map_around
from carla_recap.roads.surfaces import road_network_of_map
from carla_recap.scene.ahead import stop_points
from carla_recap.scene.appearance import look_of_present
from carla_recap.scene.captions import PlayedIncidents
from carla_recap.scene.description import SceneDescriber
from carla_recap.scene.follow import LiveFollow
from carla_recap.show.rerun import entities
from carla_recap.show.rerun.blueprint import live_blueprint
from carla_recap.show.rerun.bodies import ActorWriter
from carla_recap.show.rerun.followed import FollowedWriter, write_measures
from carla_recap.show.rerun.sinks import send_blueprint
from carla_recap.show.rerun.stream import Stream, TimeColumns
from carla_recap.show.rerun.surroundings import ground_below, write_ground, write_map, write_sky, write_town
from carla_recap.show.rerun.timeline import EventWriter, TrafficLightWriter
from carla_recap.town.mesh import town_of_map
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from carla_recap.model.frame import Frame, Header
    from carla_recap.model.lives import ActorLife
    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.queries.verdicts import Verdict
    from carla_recap.replay import SceneBatch
    from carla_recap.replay.follow import Follow
    from carla_recap.replay.player import Progress
    from carla_recap.roads import RoadMap
    from carla_recap.scene.ahead import StopPoints
    from carla_recap.scene.description import SceneDescription
    from carla_recap.show.rerun.blueprint import View
    from carla_recap.show.rerun.sensor_writer import SensorWriter

MOST_CAMERAS: Final = 500
"""The number of actors that get a camera, the first ones."""

_MAX_DATE: Final = 9_000_000_000  # s; as nanoseconds it fits into 64 bits


def describe(stream: rr.RecordingStream, header: Header, name: str, source: str) -> None:
    """Write the name, the date and the properties of a recording."""
    stream.send_recording_name(readable(name))
    if 0 <= header.date <= _MAX_DATE:
        stream.send_recording_start_time_nanos(header.date * 1_000_000_000)
    about = rr.AnyValues(map=readable(header.map_name), source=readable(source), recorder_version=header.version)
    stream.send_property("recording", about)


class SceneWriter:
    """Writes scenes: the actors, the traffic lights, the events, and what is shown of the followed actor, if any.

    Other actors get the axes of a camera. For the stops, of which more may be added later, see `carla_recap.scene.ahead`.
    Live, all roads are on the map from the start on, and not only at the end those around the actors.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        *,
        followed: int | None = None,
        road_map: RoadMap | None = None,
        cameras: Iterable[int] = (),
        stops: StopPoints | None = None,
        live: bool = False,
    ) -> None:
        self._live = live
        self._stream = Stream(stream)
        self._stops = {} if stops is None else stops
        self._road_map = road_map
        town = town_of_map(road_map)
        if town is not None:
            write_town(self._stream, town)
        if live and road_map is not None:
            write_map(self._stream, road_map)
        self._has_ground = town is not None
        if town is None:
            write_sky(self._stream, np.zeros(3), 0.0)
            write_ground(self._stream)
        self._is_ground_placed = town is not None
        self._actors = ActorWriter(self._stream, followed, roads=road_map is not None, cameras=cameras)
        self.describer = SceneDescriber(signs=town is None)
        self._lights = TrafficLightWriter(self._stream)
        self.events = EventWriter(self._stream, live=live)
        self._followed: FollowedWriter | None = None
        if followed is not None:
            self.follow(followed)

    def follow(self, id: int) -> None:
        """Follow another actor from the next scene on."""
        if self._followed is not None:
            self._followed.flush()
        self._actors.follow(id)
        models, ground = self._actors.models, not self._has_ground
        self._followed = FollowedWriter(self._stream, id, self._stops, models, ground=ground)

    def write(self, batch: SceneBatch) -> None:
        """Write scenes."""
        times, description = TimeColumns.of(batch), self.describer.describe(batch)
        if self._followed is None and not self._is_ground_placed:
            self._place_ground(description, times)
        self._actors.write(description, times)
        self._lights.write(description, times)
        self.events.write(description, times)
        if self._followed is not None:
            self._followed.write(description, times)

    def _place_ground(self, description: SceneDescription, times: TimeColumns) -> None:
        """Move the ground to the first actor, as long as none is followed."""
        for id in description.batch.actors:
            pose = description.pose_of(id, 0)
            if pose is not None:
                self._is_ground_placed = True
                point = ground_below(pose[None, LOCATION])[0]
                self._stream.log(entities.GROUND, times.point(0), rr.Transform3D(translation=point))
                return

    def flush(self) -> None:
        """Write what is held back."""
        self._actors.flush()
        if self._followed is not None:
            self._followed.flush()
        self._stream.flush()

    def close(self) -> None:
        """Write what is held back, and what is known only at the end."""
        self.flush()
        self._actors.close()
        if self._road_map is not None and not self._live:
            write_map(self._stream, self._road_map, self._actors.extent)


class LiveView:
    """Shows frames as they come, in a stream whose blueprint is that of `live_blueprint`.

    For the actor that the camera follows as soon as it is present, see `LiveFollow`.
    """

    def __init__(
        self,
        stream: rr.RecordingStream,
        header: Header,
        source: str,
        *,
        follow: Follow = HERO,
        view: View = "chase",
        road_map: RoadMap | None = None,
    ) -> None:
        self._stream = stream
        self._view: View = view
        self._follow = LiveFollow(follow)
        describe(stream, header, f"{header.map_name}, live", source)
        self._writer = SceneWriter(stream, road_map=road_map, stops=self._follow.stops, live=True)

    def enter(self, frame: Frame) -> None:
        """Add a frame."""
        scene, chosen = self._follow.scene(frame)
        if chosen is not None:
            self._writer.follow(chosen)
            look = look_of_present(scene.actors[chosen])
            half_extents = None if look is None else look.half_extents
            send_blueprint(live_blueprint(view=self._view, followed=chosen, half_extents=half_extents), self._stream)
        self._writer.write(scene.batch)

    def flush(self) -> None:
        """Show all frames that were added."""
        self._writer.flush()

    def close(self) -> None:
        """Show all frames that were added, and what is known only at the end."""
        self._writer.close()


def write(
    stream: rr.RecordingStream,
    player: Player,
    *,
    road_map: RoadMap | None = None,
    incidents: IncidentOptions | None = None,
    verdicts: Iterable[Verdict] = (),
    progress: Progress | None = None,
    cameras: Collection[int] = (),
) -> Played:
    """Play a recording into a stream, which has to be flushed afterwards; for the arguments, see `export_rerun`.

    Actors other than the followed one get the axes of a camera, too, if they are among `cameras`. A `RecapWarning` says that
    the map is that of another town, there are too many actors to show all of them, or sensors are left out.
    """
    reader = player.reader
    describe(stream, reader.header, reader.path.name, unsigned(reader.location))
    road_map = map_around(road_map, player)
    writer = SceneWriter(stream, followed=player.followed, road_map=road_map, cameras=cameras, stops=stop_points(reader))
    measured = _sensor_writer(Stream(stream), player)
    played = PlayedIncidents(player, road_network_of_map(road_map), incidents)
    writer.describer.recall(player)
    clocks: list[TimeColumns] = []
    for batch in player.batches(progress):
        writer.write(batch)
        clocks.append(TimeColumns.of(batch))
        if measured is not None:
            measured.write(clocks[-1])
    clock = TimeColumns.joined([TimeColumns.of_points(()), *clocks])
    writer.events.write_incidents(played.found(), verdicts, clock)
    series = played.series()
    if series is not None:
        write_measures(Stream(stream), clock, series)
    if measured is not None:
        measured.close()
    writer.close()
    return Played(len(clock.frame), player.stop - player.start)


def _sensor_writer(stream: Stream, player: Player) -> SensorWriter | None:
    """Return what writes the sensors of a recording; None if it has none, or they cannot be decoded here."""
    reader = player.reader
    if not sensors(reader):
        return None
    try:
        from carla_recap.show.rerun.sensor_writer import SensorWriter
    except MissingExtra as error:
        warnings.warn(f"{reader.location}: its sensors are left out: {error}", RecapWarning, stacklevel=3)
        return None
    return SensorWriter(stream, reader, player.start, player.stop)


def filmed(player: Player, lives: Iterable[ActorLife]) -> list[int]:
    """Return the vehicles and walkers that get a camera: the first ones of those present while the recording is played."""
    ids = {
        life.id: None  # in their order, each once
        for life in lives
        if life.kind in ROAD_USERS
        and life.spawned_at <= player.stop
        and not (life.destroyed_at is not None and life.destroyed_at <= player.start)
    }
    if len(ids) > MOST_CAMERAS:
        warnings.warn(
            f"{player.reader.location}: only {MOST_CAMERAS} of {len(ids)} actors get a camera", RecapWarning, stacklevel=3
        )
    return list(ids)[:MOST_CAMERAS]
