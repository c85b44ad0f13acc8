"""A recording, or the frames of a running simulation, as a Rerun stream."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Final

import numpy as np
import rerun as rr

from carla_recap.errors import RecapWarning
from carla_recap.formats.sources import unsigned
from carla_recap.model.actors import ROAD_USERS
from carla_recap.queries.actors import actors
from carla_recap.recording import Recording
from carla_recap.rendering.town import town_of_map
from carla_recap.replay import Played, Player, right_handed
from carla_recap.replay.pose import LOCATION
from carla_recap.replay.recorded_map import map_around
from carla_recap.roads.surfaces import road_network_of_map
from carla_recap.scene.ahead import stop_points
from carla_recap.scene.captions import PlayedIncidents
from carla_recap.scene.description import SceneDescriber
from carla_recap.scene.follow import FollowedActor
from carla_recap.show.rerun import paths
from carla_recap.show.rerun.actors import ActorWriter
from carla_recap.show.rerun.events import EventWriter
from carla_recap.show.rerun.followed import FollowedWriter, OpacityWriter
from carla_recap.show.rerun.ground import ground_below, write_ground
from carla_recap.show.rerun.lights import LightAheadWriter, TrafficLightWriter
from carla_recap.show.rerun.plots import write_measures
from carla_recap.show.rerun.stream import Stream, TimeColumns
from carla_recap.show.rerun.town import write_map, write_sky, write_town
from carla_recap.util.text import readable

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

    from carla_recap.model.frame import Header
    from carla_recap.queries.incidents import Incident, IncidentOptions
    from carla_recap.queries.measures import MeasureSeries
    from carla_recap.replay import SceneBatch
    from carla_recap.replay.player import Progress
    from carla_recap.roads import RoadMap
    from carla_recap.scene.ahead import StopPoints

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
    """Writes scenes: the actors, the traffic lights, the events, and what is shown of the followed actor.

    Args:
        stream: The stream.
        followed: The actor that the camera follows, if any.
        road_map: The map of the town.
        cameras: Ids of other actors that get the axes of a camera.
        stops: The points at which traffic lights stop cars; see `carla_recap.scene.ahead`. More may be added later.
        live: Whether all roads are on the map from the start on, and not only at the end those around the actors.
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
        self._describer = SceneDescriber(signs=town is None)
        self._lights = TrafficLightWriter(self._stream)
        self._events = EventWriter(self._stream)
        self._actor: FollowedActor | None = None
        self._followed: FollowedWriter | None = None
        self._ahead: LightAheadWriter | None = None
        self._opacity: OpacityWriter | None = None
        if followed is not None:
            self.follow(followed)

    def follow(self, id: int) -> None:
        """Follow another actor from the next scene on."""
        if self._followed is not None:
            self._followed.flush()
        if self._ahead is not None:
            self._ahead.flush()
        self._actors.follow(id)
        self._actor = FollowedActor(id, self._stops)
        self._ahead = LightAheadWriter(self._stream)
        self._opacity = OpacityWriter(self._stream, id, self._actors.looks)
        self._followed = FollowedWriter(self._stream, id, ground=not self._has_ground)

    def recall(self, recording: Recording, time: float) -> None:
        """Learn what of the time before the first scene is still to be seen then; see `SceneDescriber.recall`."""
        self._describer.recall(recording, time)

    def write(self, batch: SceneBatch) -> None:
        """Write scenes."""
        times = TimeColumns.of(batch)
        if self._followed is None and not self._is_ground_placed:
            self._place_ground(batch, times)
        description = self._describer.describe(batch)
        self._actors.write(description, times)
        self._lights.write(batch, times)
        self._events.write(description, times)
        if self._actor is not None:
            series = self._actor.series(batch)
            for writer in (self._followed, self._ahead, self._opacity):
                if writer is not None:
                    writer.write(batch, times, series)

    def _place_ground(self, batch: SceneBatch, times: TimeColumns) -> None:
        """Move the ground to the first actor, as long as none is followed."""
        poses = [pose for id in batch.actors if (pose := batch.pose_of(id, 0)) is not None and np.isfinite(pose).all()]
        if poses:
            self._is_ground_placed = True
            point = ground_below(right_handed(poses[0])[None, LOCATION])[0]
            self._stream.log(paths.GROUND, times.point(0), rr.Transform3D(translation=point))

    def write_incidents(self, found: Iterable[Incident]) -> None:
        """Write the incidents that began during the scenes so far."""
        self._events.write_incidents(found)

    def write_measures(self, series: MeasureSeries) -> None:
        """Write how close others were to the followed actor during the scenes so far."""
        write_measures(self._stream, self._events.clock, series)

    def flush(self) -> None:
        """Write what is held back."""
        self._actors.flush()
        self._lights.flush()
        self._events.flush()
        if self._followed is not None:
            self._followed.flush()
        if self._ahead is not None:
            self._ahead.flush()

    def close(self) -> None:
        """Write what is held back, and what is known only at the end.

        Warns:
            RecapWarning: There are too many actors to show all of them.
        """
        self.flush()
        self._actors.close()
        if self._road_map is not None and not self._live:
            write_map(self._stream, self._road_map, self._actors.extent)


def write(
    stream: rr.RecordingStream,
    player: Player,
    *,
    road_map: RoadMap | None = None,
    incidents: IncidentOptions | None = None,
    progress: Progress | None = None,
    cameras: Collection[int] = (),
) -> Played:
    """Play a recording into a stream, which has to be flushed afterwards.

    Args:
        stream: A file, a viewer or a pipe.
        player: The player of the recording.
        road_map: The map of the town.
        incidents: Which incidents are in the log; None: all kinds, those against the rules of the road if the map is given.
        progress: Is given the stream of scenes and their player, and passes the scenes on.
        cameras: Ids of other actors than the followed one that get the axes of a camera, too.

    Warns:
        RecapWarning: The map is that of another town, or there are too many actors to show all of them.

    Raises:
        FormatError: The file contradicts its format.
    """
    reader = player.reader
    describe(stream, reader.header, reader.path.name, unsigned(reader.location))
    road_map = map_around(road_map, player)
    writer = SceneWriter(stream, followed=player.followed, road_map=road_map, cameras=cameras, stops=stop_points(reader))
    if player.start > 0:
        writer.recall(Recording(reader), player.start)
    count = 0
    played = PlayedIncidents(player, road_network_of_map(road_map), incidents)
    for batch in player.batches(progress):
        writer.write(batch)
        count += len(batch)
    writer.write_incidents(played.found())
    series = played.series()
    if series is not None:
        writer.write_measures(series)
    writer.close()
    return Played(count, player.stop - player.start)


def filmed(player: Player) -> list[int]:
    """Return the vehicles and walkers that get a camera: the first ones of those present while the recording is played."""
    ids: dict[int, None] = {}  # in their order, each once
    for actor in actors(player.reader):
        gone = actor.destroyed_at is not None and actor.destroyed_at <= player.start
        if actor.kind in ROAD_USERS and actor.spawned_at <= player.stop and not gone:
            ids[actor.id] = None
    if len(ids) > MOST_CAMERAS:
        warnings.warn(
            f"{player.reader.location}: only {MOST_CAMERAS} of {len(ids)} actors get a camera", RecapWarning, stacklevel=3
        )
    return list(ids)[:MOST_CAMERAS]
