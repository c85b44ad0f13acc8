"""`Recording`: the frames, actors, tables and queries of a recording of either format."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from numbers import Integral
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np

from carla_recap.errors import Closed, RecapError
from carla_recap.formats import open_reader
from carla_recap.model.lives import ROAD_USERS, ActorLife, ActorLives, ActorName, find_actor, heroes_of
from carla_recap.queries.recorded_actors import RecordedActors, actors
from carla_recap.tables import Rows, Tabular
from carla_recap.tables.records import RecordTable, record_table
from carla_recap.tables.trajectories import (
    ActorRows,
    Axes,
    Controls,
    LightStates,
    Trajectories,
    Trajectory,
    actor_rows,
    trajectories,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
    from pathlib import Path
    from types import TracebackType
    from typing import Unpack

    from carla_recap.formats.base import Reader, TopicMessage
    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Frame, Header
    from carla_recap.queries.blocked import Blocked
    from carla_recap.queries.collisions import Collisions
    from carla_recap.queries.detectors import IncidentKeywords
    from carla_recap.queries.differences import Differences
    from carla_recap.queries.incidents import Incidents
    from carla_recap.queries.measures import Measures
    from carla_recap.queries.measures.definitions import MeasureSeries
    from carla_recap.queries.measures.series import Subjects
    from carla_recap.queries.sensors import RecordedSensors
    from carla_recap.queries.summary import RecordingSummary
    from carla_recap.roads.network import RoadNetwork
    from carla_recap.tables.display import Preview
    from carla_recap.util.arrays import Booleans, Floats

T = TypeVar("T")


@dataclass(frozen=True)
class RecordingInfo:
    """The summary of a recording.

    Attributes:
        map_name: The name of the map.
        date: The time of its beginning, in UTC; None if the file's date is out of range.
        version: The version of CARLA's format.
        frames: The number of frames.
        duration: The elapsed time of the last frame, in s.
        additional_data: Whether the first frame has additional data: velocities, bounding boxes, physics, times of lights.
    """

    map_name: str
    date: datetime | None
    version: int
    frames: int
    duration: float
    additional_data: bool


class ActorTable(Rows[ActorLife]):
    """Actors as rows."""

    row_type = ActorLife
    row_units = RecordedActors.row_units


class ActorsById(dict[int, ActorLife], Tabular):
    """Actors by id, of several with the same id the latest; as a table, a row for each actor, also for the earlier ones.

    Attributes:
        lives: All actors, in order of appearance.
    """

    __repr__ = Tabular.__repr__

    def __init__(self, lives: Iterable[ActorLife]) -> None:
        self.lives = ActorLives(lives)
        super().__init__((actor.id, actor) for actor in self.lives)

    def columns(self) -> dict[str, Any]:
        """See `Tabular.columns`."""
        return ActorTable(self.lives).columns()

    def units(self) -> Mapping[str, str]:
        """See `Tabular.units`."""
        return ActorTable.row_units

    def _types(self) -> Mapping[str, Any]:
        return ActorTable(self.lives)._types()

    def _preview(self) -> Preview:
        return ActorTable(self.lives)._preview()._replace(name=type(self).__name__)


class Recording:
    """An open recording; a context manager, which closes it, and iterable over its frames.

    Whatever reads the file raises `FormatError` if the file contradicts its format, and `Closed` after `close`. Times are
    elapsed seconds, from the beginning of the recording; a time within a microsecond of a frame is that of the frame.

    Args:
        reader: The reader of the file's format.
    """

    def __init__(self, reader: Reader) -> None:
        self._reader = reader
        self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def __iter__(self) -> Iterator[Frame]:
        return self.frames()

    def __repr__(self) -> str:
        return f"Recording({self.location!r})"

    def _repr_html_(self) -> str:
        from html import escape

        from carla_recap.output.html import recording_html

        return escape(repr(self)) if self._closed else recording_html(self.reader)

    @property
    def path(self) -> Path:
        """The path of the file; of a URL, one with the same name, which says nothing about this machine."""
        return self._reader.path

    @property
    def location(self) -> str:
        """The path of the file, or its URL, as given."""
        return self._reader.location

    @property
    def header(self) -> Header:
        """The header: map, date, version."""
        return self._reader.header

    @property
    def reader(self) -> Reader:
        """The reader of the file's format."""
        if self._closed:
            raise Closed(self.location)
        return self._reader

    def close(self) -> None:
        """Close the file; do nothing if it is closed."""
        if not self._closed:
            self._closed = True
            self._reader.close()

    @cached_property
    def info(self) -> RecordingInfo:
        """The summary: map, date, version, frames, duration."""
        header, extent = self.header, self.reader.extent()
        first = next(self.reader.frames(), None)
        additional = first is not None and any(p.type is not None and p.type.additional for p in first.packets)
        try:
            date = datetime.fromtimestamp(header.date, UTC)
        except (OverflowError, OSError, ValueError):
            date = None
        return RecordingInfo(header.map_name, date, header.version, extent.frames, extent.duration, additional)

    @cached_property
    def summary(self) -> RecordingSummary:
        """The overview: actors and incidents by kind, and how far and how fast the hero drives.

        Raises:
            FormatError: The file contradicts its format.

        Warns:
            RecapWarning: The map is unknown, and incidents that need it are left out.
        """
        from carla_recap.queries.summary import summary

        return summary(self.reader)[0]

    @cached_property
    def actors(self) -> ActorsById:
        """The actors by id, in order of appearance; of several with the same id, the latest."""
        return ActorsById(actors(self.reader))

    @property
    def heroes(self) -> list[ActorLife]:
        """The actors whose role_name is hero, vehicles and walkers first."""
        return heroes_of(self.actors.lives)

    @cached_property
    def sensors(self) -> RecordedSensors:
        """The sensors whose data the recording has, with their topics; a `.log` has none.

        Raises:
            FormatError: The file contradicts its format.
        """
        from carla_recap.queries.sensors import sensors

        return sensors(self.reader)

    def sensor_messages(self, id: str, start: float = -math.inf, stop: float = math.inf) -> Iterator[TopicMessage]:
        """Yield the messages of a sensor: `topic`, `elapsed` in s, and `data`, which are encoded as the topic's schema says.

        Those of all its topics come in order of time. Only the chunks of its topics are read.

        Args:
            id: The sensor's id.
            start: The time of the first message, in s.
            stop: The time before which the last message is, in s.

        Raises:
            RecapError: There is no such sensor.
        """
        from carla_recap.queries.sensors import sensor_messages

        return sensor_messages(self.reader, id, start, stop)

    def frames(self, start: float = -math.inf, stop: float = math.inf) -> Iterator[Frame]:
        """Yield the frames.

        Args:
            start: The time of the first frame, in s.
            stop: The time before which the last frame begins, in s.
        """
        return self.reader.frames(start=start, stop=stop)

    def frame_at(self, elapsed: float) -> Frame:
        """Return the last frame before the first one that begins later than a time; after the end, the last one of all.

        Args:
            elapsed: The time, in s.

        Raises:
            RecapError: The recording begins later, or has no frames.
        """
        frame = self.reader.frame_at(elapsed)
        if frame is None:
            raise RecapError(
                f"{self.location}: no frame at {elapsed:g} s; it has {self.info.frames}, up to {self.info.duration:g} s"
            )
        return frame

    def trajectory(self, actor_id: ActorName, *, axes: Axes = "right-handed") -> Trajectory:
        """Return the trajectory of an actor: arrays of shape (n,), for the n frames in which it has a transform.

        Positions are in m, rotations in degrees, velocities in m/s. An id stands for all actors that had it, "hero" for one.

        Args:
            actor_id: The id of the actor, or "hero".
            axes: "right-handed", x forward, y left, z up, as in ROS, Rerun and Foxglove; or "carla", CARLA's own, with y to
                the right, and pitch and yaw turning the other way.

        Raises:
            RecapError: There is no such actor, or no such axes.
        """
        id = self._id(actor_id)
        found = self._of_one(id, trajectories(self.reader, {id}, axes=axes), lambda: Trajectory.empty(id))
        return found.at(self._counts(actor_id, found.time))

    def trajectories(self, kind: str | None = None, *, axes: Axes = "right-handed") -> Trajectories:
        """Return the trajectories of actors by id, read in one pass; see `trajectory`. They are a table, too.

        Args:
            kind: The kind of the actors, such as "vehicle" or "walker"; None for all that have transforms.
            axes: See `trajectory`.

        Raises:
            RecapError: There is no such kind of actors, or no such axes.
        """
        ids = None
        if kind is not None:
            kinds = sorted({actor.kind for actor in self.actors.lives})
            if kind not in (*ROAD_USERS, *kinds):
                raise RecapError(f"{self.location}: no actors of kind {kind!r}; there are {', '.join(kinds) or 'none'}")
            ids = {actor.id for actor in self.actors.lives if actor.kind == kind}
        found = trajectories(self.reader, ids, axes=axes)
        for id in self.actors.lives.reuses().keys() & found.keys() if kind is not None else ():
            found[id] = found[id].at(
                np.array([self.actors.lives.kind(id, time) == kind for time in found[id].time.tolist()])
            )
        return found

    def table(self, name: str) -> RecordTable:
        """Return all records of a type as columns: arrays of shape (n,), a value for each of n records.

        The first columns are the frame number and the time of the frame. Numbers have CARLA's units: cm, degrees, s, in
        left-handed axes.

        Args:
            name: The record type, such as "transforms"; docs/records.md lists them.

        Raises:
            RecordError: There is no such type.
        """
        return record_table(self.reader, name)

    def batches(
        self, types: Collection[str] | None = None, start: float = -math.inf, stop: float = math.inf
    ) -> Iterator[Batch]:
        """Yield the frames in batches: consecutive frames with the same packets and the same numbers of records.

        `batch.records(name)` is a structured array of shape (frames, records of a frame), in CARLA's units.

        Args:
            types: The names of record types; frames have only their packets, and no empty ones. None: all packets.
            start: The time of the first frame, in s.
            stop: The time before which the last frame begins, in s.
        """
        return self.reader.batches(types, start=start, stop=stop)

    def controls(self, actor_id: ActorName) -> Controls:
        """Return the controls of a vehicle: arrays of shape (n,), for the n frames in which they are recorded.

        Args:
            actor_id: The id of the vehicle, or "hero".

        Raises:
            RecapError: There is no such actor.
        """
        found = self._rows(actor_id, "vehicle_controls")
        rows = found.records
        return Controls(found.time, rows["steer"], rows["throttle"], rows["brake"], rows["hand_brake"] != 0, rows["gear"])

    def light_states(self, actor_id: int) -> LightStates:
        """Return the states of a traffic light: arrays of shape (n,), for the n frames in which they are recorded.

        Raises:
            RecapError: There is no such actor.
        """
        found = self._rows(actor_id, "light_states")
        rows = found.records
        return LightStates(found.time, rows["state"], rows["elapsed"], rows["frozen"] != 0)

    def collisions(self, type1: str = "a", type2: str = "a", *, compat: bool = False) -> Collisions:
        """Return the collisions between two kinds of actors, a row for each contact of two actors.

        Args:
            type1: The kind of the first actor, which has the collision sensor: h hero, v vehicle, w walker, t traffic light,
                o other, a any.
            type2: The kind of the second actor.
            compat: Answer as CARLA 0.9.16 does, errors included.

        Raises:
            RecapError: There is no such kind.
        """
        from carla_recap.queries.collisions import collisions

        return collisions(self.reader, type1, type2, compat=compat)

    def blocked(self, min_time: float = 30.0, min_distance: float = 10.0, *, compat: bool = False) -> Blocked:
        """Return the stops of actors, the longest first.

        Args:
            min_time: The least duration of a stop, in s.
            min_distance: The distance from which on an actor has moved, in cm.
            compat: Answer as CARLA 0.9.16 does, errors included.

        Raises:
            RecapError: `min_time` is below 0, which only `compat` accepts.
        """
        from carla_recap.queries.blocked import blocked

        return blocked(self.reader, min_time, min_distance, compat=compat)

    def incidents(self, **options: Unpack[IncidentKeywords]) -> Incidents:
        """Return the incidents in order of time: by default collisions, long stops and hard braking.

        Args:
            options: The fields of `carla_recap.queries.incidents.IncidentOptions`: `kinds`, such as `["near miss"]` or
                "all"; `roads` or `road_map`, the map, for kinds that need it; `min_time` in s and `min_distance` in cm of
                stops; `deceleration` in m/s² of hard braking; `time_to_collision` and `post_encroachment_time` in s and
                `required_deceleration` in m/s² of near misses; `start` and `stop`, in s, of the part to look at; `actor`, an
                id or "hero", that takes part.

        Raises:
            RecapError: A limit makes no sense, there is no such kind or actor, or all kinds need the map, which is unknown.

        Warns:
            RecapWarning: The map is unknown, and kinds that need it are left out.
        """
        from carla_recap.queries.incidents import IncidentOptions, incidents

        return incidents(self.reader, IncidentOptions(**options))

    def diff(
        self, other: Recording, *, tolerance: float = 0.0, time_tolerance: float | None = None, events: bool = True
    ) -> Differences:
        """Return the differences from another recording of the same scenario, such as another run of a test.

        Args:
            other: The other recording.
            tolerance: The distance in m that counts as equal.
            time_tolerance: The time in s that counts as equal; None: 0 if the tolerance is 0, else 1.
            events: Whether to compare incidents.

        Raises:
            RecapError: A tolerance is negative.
        """
        from carla_recap.queries.differences import differences

        return differences(self.reader, other.reader, tolerance=tolerance, time_tolerance=time_tolerance, events=events)

    def measures(
        self,
        actors: Subjects = None,
        *,
        roads: RoadNetwork | None = None,
        start: float = -math.inf,
        stop: float = math.inf,
    ) -> Measures:
        """Return the extreme values of measures: how close others came to an actor, how hard and how fast it drives.

        Args:
            actors: The ids of vehicles or walkers, "hero" or "all"; None: the heroes, or if there is none, all vehicles.
            roads: The roads of the map, for measures of the road; None: without these.
            start: The elapsed seconds from which on to measure.
            stop: The elapsed seconds until which to measure.

        Raises:
            RecapError: There is no such vehicle or walker, or no hero.
        """
        from carla_recap.queries.measures import measures

        return measures(self.reader, actors, roads=roads, start=start, stop=stop)

    def time_series(
        self, actor_id: ActorName, other_id: ActorName | None = None, *, start: float = -math.inf, stop: float = math.inf
    ) -> MeasureSeries:
        """Return the measures of a vehicle or walker over time: arrays of shape (n,), for the n frames that have it.

        Args:
            actor_id: The id of the actor, or "hero".
            other_id: The same of the only other actor that counts; None for all.
            start: The elapsed seconds from which on to measure.
            stop: The elapsed seconds until which to measure.

        Raises:
            RecapError: There is no such vehicle or walker.
        """
        from carla_recap.queries.measures import time_series

        return time_series(self.reader, actor_id, other_id, start=start, stop=stop)

    def _rows(self, actor_id: ActorName, name: str) -> ActorRows:
        """Return the records of an actor; of several in a frame, the last one; raise if there is no such actor."""
        id = self._id(actor_id)
        rows = actor_rows(self.reader, (name,), {id})[name]
        empty = ActorRows(np.empty(0, np.int64), np.empty(0), np.empty(0, self.header.table.named(name).dtype))
        found = self._of_one(id, rows, lambda: empty)
        counts = self._counts(actor_id, found.time)
        return ActorRows(found.frame[counts], found.time[counts], found.records[counts])

    def _id(self, actor_id: ActorName) -> int:
        """Return the id of an actor; one that is an id need not have been spawned in the recording."""
        return int(actor_id) if isinstance(actor_id, Integral) else find_actor(self.location, self.actors.lives, actor_id).id

    def _counts(self, actor_id: ActorName, time: Floats) -> Booleans | slice:
        """Return which elapsed seconds, (n,), are of an actor: of an id, all; of the hero, those in which it has its id."""
        if isinstance(actor_id, Integral):
            return slice(None)
        lives = self.actors.lives
        hero = find_actor(self.location, lives, actor_id)
        if hero.id not in lives.reuses():
            return slice(None)
        return np.array([lives.at(hero.id, each) is hero for each in time.tolist()], np.bool_)

    def _of_one(self, id: int, found: Mapping[int, T], empty: Callable[[], T]) -> T:
        """Return the result for an actor, or an empty one; raise if there is no such actor."""
        if id in found:
            return found[id]
        find_actor(self.location, self.actors.lives, id)
        return empty()


def open_recording(location: Path | str) -> Recording:
    """Open a recording: CARLA's log or MCAP, recognized by the content.

    Args:
        location: The path of a file, or a URL: `s3://`, `gs://`, `az://`, `abfs://`, `http://`, `https://` or `file://`; all
            but the last need the extra `remote`. Keys and regions come from the environment. Of a remote MCAP file, only
            the parts that are asked for are read; a remote log is copied to a temporary file.

    Raises:
        NotARecording: The file is neither.
        FormatError: The file is damaged.
        RecapError: The file cannot be read.
        MissingExtra: It is remote, and the extra for that is not installed.
    """
    return Recording(open_reader(location))
