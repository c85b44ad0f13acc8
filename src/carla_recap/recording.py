"""A recording of any format as Python sees it: what is in it, who was there, and where they went."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import UTC, datetime
from difflib import get_close_matches
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Self

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.formats import open_reader
from carla_recap.records import ActorKind, Spawn
from carla_recap.tables import Columns, Rows

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import TracebackType

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.frame import Frame, Header
    from carla_recap.queries.blocked import Blocked
    from carla_recap.queries.collisions import Collisions

Axes = Literal["right-handed", "carla"]
"""Right-handed: x forward, y left, z up, as in ROS, Rerun and Foxglove. CARLA's own: y right, and yaw and pitch turn the
other way."""

CM = 0.01  # m


@dataclass(frozen=True)
class RecordingInfo:
    """What a recording is.

    Attributes:
        map_name: The map.
        date: When it began, UTC; None where the file's date is out of range.
        version: The version of CARLA's format.
        frames: How many frames it has.
        duration: Elapsed seconds of its last frame.
        additional_data: Whether CARLA recorded additional data: velocities, boxes, physics, times.
    """

    map_name: str
    date: datetime | None
    version: int
    frames: int
    duration: float
    additional_data: bool


@dataclass(frozen=True)
class BoundingBox:
    """The box of an actor, in its own axes, right-handed (x forward, y left, z up): centre and half extents in m."""

    x: float
    y: float
    z: float
    extent_x: float
    extent_y: float
    extent_z: float


@dataclass
class Actor:
    """An actor of a recording.

    Attributes:
        id: The actor id; where a recording gives it out again, the latest actor has it.
        type_id: The blueprint, such as vehicle.tesla.model3.
        kind: `ActorKind`, or the plain number where it is none.
        role_name: The attribute role_name, "" without one.
        spawned_at: Elapsed seconds at which it appeared.
        destroyed_at: Elapsed seconds at which it disappeared; None: it stayed.
        parent: The actor that it is attached to, if any.
        attributes: All attributes, as text.
        bounding_box: Its box, where a sane one is recorded.
    """

    id: int
    type_id: str
    kind: int
    role_name: str
    spawned_at: float
    destroyed_at: float | None = None
    parent: int | None = None
    attributes: dict[str, str] = field(default_factory=dict)
    bounding_box: BoundingBox | None = None

    @property
    def is_hero(self) -> bool:
        """Whether its role_name is hero."""
        return self.role_name == "hero"

    @property
    def kind_name(self) -> str:
        """The kind in words, such as vehicle."""
        return ActorKind(self.kind).name.lower() if self.kind in set(ActorKind) else str(self.kind)


class Actors(dict[int, Actor]):
    """The actors of a recording, by id, in order of appearance; as a table, a row for each."""

    def table(self) -> Rows[ActorRow]:
        """The actors as rows."""
        return ActorRows(
            ActorRow(a.id, a.type_id, a.kind_name, a.role_name, a.spawned_at, a.destroyed_at, a.parent)
            for a in self.values()
        )


@dataclass(frozen=True)
class ActorRow:
    """An actor as a row; see `Actor`."""

    id: int
    type_id: str
    kind: str
    role_name: str
    spawned_at: float
    destroyed_at: float | None
    parent: int | None


class ActorRows(Rows[ActorRow]):
    """Actors as rows."""

    row_type = ActorRow


@dataclass(frozen=True)
class Trajectory(Columns):
    """Where an actor went; arrays of one length, a value per frame in which it has a transform.

    Attributes:
        time: Elapsed seconds.
        x, y, z: Position in m.
        roll, pitch, yaw: Rotation in degrees.
        vx, vy, vz: Velocity in m/s.
        velocity_recorded: Whether the velocity was recorded; elsewhere it is the slope of the positions around.
    """

    time: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    roll: NDArray[np.float64]
    pitch: NDArray[np.float64]
    yaw: NDArray[np.float64]
    vx: NDArray[np.float64]
    vy: NDArray[np.float64]
    vz: NDArray[np.float64]
    velocity_recorded: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.time)

    @property
    def speed(self) -> NDArray[np.float64]:
        """Speed in m/s."""
        return np.sqrt(self.vx**2 + self.vy**2 + self.vz**2)


@dataclass(frozen=True)
class Controls(Columns):
    """What a driver did; arrays of one length.

    Attributes:
        time: Elapsed seconds.
        steer: -1 full left to 1 full right.
        throttle, brake: 0 to 1.
        hand_brake: Whether it was on.
        gear: -1 reverse, 0 neutral, 1 and up forward.
    """

    time: NDArray[np.float64]
    steer: NDArray[np.float32]
    throttle: NDArray[np.float32]
    brake: NDArray[np.float32]
    hand_brake: NDArray[np.bool_]
    gear: NDArray[np.int32]


@dataclass(frozen=True)
class LightStates(Columns):
    """What a traffic light showed; arrays of one length.

    Attributes:
        time: Elapsed seconds of the recording.
        state: 0 red, 1 yellow, 2 green, 3 off, 4 unknown.
        elapsed: Seconds that it has been in this state.
        frozen: Whether its time stood still.
    """

    time: NDArray[np.float64]
    state: NDArray[np.int8]
    elapsed: NDArray[np.float32]
    frozen: NDArray[np.bool_]


class Recording:
    """A recording, open for reading; also a context manager, and iterable over its frames.

    Args:
        reader: The format's reader.
    """

    def __init__(self, reader: Reader) -> None:
        self._reader = reader

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __iter__(self) -> Iterator[Frame]:
        return self.frames()

    def __repr__(self) -> str:
        return f"Recording({str(self.path)!r})"

    @property
    def path(self) -> Path:
        """The file."""
        return self._reader.path

    @property
    def header(self) -> Header:
        """The header."""
        return self._reader.header

    @property
    def reader(self) -> Reader:
        """The reader of the file's format."""
        return self._reader

    def close(self) -> None:
        """Let go of the file."""
        self._reader.close()

    @cached_property
    def info(self) -> RecordingInfo:
        """What the recording is."""
        header, extent = self.header, self._reader.extent()
        first = next(self._reader.frames(), None)
        additional = first is not None and any(
            p.type is not None and p.type.additional for p in first.packets
        )
        try:
            date = datetime.fromtimestamp(header.date, UTC)
        except (OverflowError, OSError, ValueError):
            date = None
        return RecordingInfo(
            header.map_name, date, header.version, extent.frames, extent.duration, additional
        )

    @cached_property
    def actors(self) -> Actors:
        """Who was there, by id; read from the events alone."""
        actors = Actors()
        for frame in self._reader.frames(("spawned", "destroyed", "parented", "bounding_boxes"), sparse=True):
            for packet in frame.packets:
                if packet.type is not None:
                    _ACTOR_EVENTS[packet.type.name](actors, packet.records, frame.elapsed)
        return actors

    def frames(self, start: float = -math.inf, stop: float = math.inf) -> Iterator[Frame]:
        """Stream the frames.

        Args:
            start: First elapsed time, in seconds.
            stop: Elapsed time, in seconds, at which to stop (exclusive).

        Raises:
            FormatError: The file contradicts its format.
        """
        return self._reader.frames(start=start, stop=stop)

    def frame_at(self, elapsed: float) -> Frame:
        """The last frame that begins at or before a time in seconds; found by index.

        Raises:
            RecapError: The recording has none.
        """
        frame = self._reader.frame_at(elapsed)
        if frame is None:
            raise RecapError(
                f"{self.path}: no frame at {elapsed:g} s; the recording ends at {self.info.duration:g} s"
            )
        return frame

    def trajectory(self, actor_id: int, *, axes: Axes = "right-handed") -> Trajectory:
        """Where an actor went, in metres.

        Args:
            actor_id: The actor.
            axes: See `Axes`.

        Raises:
            RecapError: There is no such actor.
        """
        times, poses = self._rows(actor_id, "transforms")
        velocity_times, velocities = self._rows(actor_id, "velocities")
        position = {axis: poses[axis].astype(np.float64) * CM for axis in "xyz"}
        slopes = {axis: _slope(position[axis], times) for axis in "xyz"}
        recorded = np.isin(times, velocity_times)
        where = np.searchsorted(velocity_times, times[recorded])
        for axis in "xyz":
            slopes[axis][recorded] = velocities[axis][where]
        flip = -1.0 if axes == "right-handed" else 1.0
        return Trajectory(
            times,
            position["x"],
            flip * position["y"],
            position["z"],
            poses["roll"].astype(np.float64),
            flip * poses["pitch"].astype(np.float64),
            flip * poses["yaw"].astype(np.float64),
            slopes["x"],
            flip * slopes["y"],
            slopes["z"],
            recorded,
        )

    def controls(self, actor_id: int) -> Controls:
        """What the driver of a vehicle did.

        Raises:
            RecapError: There is no such actor.
        """
        times, rows = self._rows(actor_id, "vehicle_controls")
        return Controls(
            times, rows["steer"], rows["throttle"], rows["brake"], rows["hand_brake"] != 0, rows["gear"]
        )

    def light_states(self, actor_id: int) -> LightStates:
        """What a traffic light showed.

        Raises:
            RecapError: There is no such actor.
        """
        times, rows = self._rows(actor_id, "light_states")
        return LightStates(times, rows["state"], rows["elapsed"], rows["frozen"] != 0)

    def collisions(self, type1: str = "a", type2: str = "a", *, compat: bool = False) -> Collisions:
        """Who collided with whom; see `carla_recap.queries.collisions`."""
        from carla_recap.queries import collisions  # noqa: PLC0415

        return collisions(self._reader, type1, type2, compat=compat)

    def blocked(self, min_time: float = 30.0, min_distance: float = 10.0, *, compat: bool = False) -> Blocked:
        """Who stood still for long; see `carla_recap.queries.blocked`. Seconds and centimetres."""
        from carla_recap.queries import blocked  # noqa: PLC0415

        return blocked(self._reader, min_time, min_distance, compat=compat)

    def _rows(self, actor_id: int, name: str) -> tuple[NDArray[np.float64], NDArray[np.void]]:
        """Elapsed seconds and record of an actor in each frame that has one; the last, where a frame has several."""
        times: list[float] = []
        rows: list[NDArray[np.void]] = []
        for frame in self._reader.frames((name,)):
            records = frame[name]
            assert isinstance(records, np.ndarray)
            found = np.flatnonzero(records["id"] == actor_id)
            if len(found):
                times.append(frame.elapsed)
                rows.append(records[found[-1] :][:1])
        if not rows:
            self._check_actor(actor_id)
            return np.empty(0), np.empty(0, self.header.table.named(name).dtype)
        return np.array(times), np.concatenate(rows)

    def _check_actor(self, actor_id: int) -> None:
        if actor_id in self.actors:
            return
        near = get_close_matches(str(actor_id), map(str, self.actors), 3, 0.0) or ["none"]
        raise RecapError(f"{self.path}: no actor {actor_id}; near ids are {', '.join(near)}")


def open_recording(path: Path | str) -> Recording:
    """Open a recording of either format, CARLA's log or MCAP; the content says which.

    Raises:
        NotARecording: It is neither.
        FormatError: It is damaged.
        RecapError: It cannot be read.
    """
    return Recording(open_reader(path))


def _add_spawned(actors: Actors, spawns: list[Spawn], elapsed: float) -> None:
    for spawn in spawns:
        attributes = {attribute.key: attribute.value for attribute in spawn.attributes}
        actors[spawn.id] = Actor(
            spawn.id,
            spawn.type_id,
            spawn.kind,
            attributes.get("role_name", ""),
            elapsed,
            attributes=attributes,
        )


def _add_destroyed(actors: Actors, records: NDArray[np.void], elapsed: float) -> None:
    for id in records["id"].tolist():
        if id in actors:
            actors[id].destroyed_at = elapsed


def _add_parented(actors: Actors, records: NDArray[np.void], elapsed: float) -> None:
    for id, parent in records.tolist():
        if id in actors:
            actors[id].parent = parent


def _add_boxes(actors: Actors, records: NDArray[np.void], elapsed: float) -> None:
    for id, *sizes in records.tolist():
        if id in actors and all(map(math.isfinite, sizes)) and min(sizes[3:]) > 0:
            x, y, z, *extent = (size * CM for size in sizes)
            actors[id].bounding_box = BoundingBox(x, -y, z, *extent)


_ACTOR_EVENTS: dict[str, Callable[..., None]] = {
    "spawned": _add_spawned,
    "destroyed": _add_destroyed,
    "parented": _add_parented,
    "bounding_boxes": _add_boxes,
}


def _slope(values: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Change per second, from the neighbours of each sample; 0 for a single one, and across gaps of no time."""
    if len(values) < 2:
        return np.zeros(len(values))
    before = np.maximum(np.arange(len(values)) - 1, 0)
    after = np.minimum(np.arange(len(values)) + 1, len(values) - 1)
    span = times[after] - times[before]
    return np.divide(values[after] - values[before], span, out=np.zeros(len(values)), where=span > 0)
