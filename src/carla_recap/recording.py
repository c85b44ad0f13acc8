"""A recording of any format as Python sees it: what is in it, who was there, and where they went."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Self, get_args

import numpy as np

from carla_recap.errors import Closed, RecapError
from carla_recap.formats import open_reader
from carla_recap.queries.actors import CM, Actor, actors
from carla_recap.tables import Columns, Rows, Tabular

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.frame import Frame, Header
    from carla_recap.queries.blocked import Blocked
    from carla_recap.queries.collisions import Collisions
    from carla_recap.queries.incidents import Incidents

Axes = Literal["right-handed", "carla"]
"""Right-handed: x forward, y left, z up, as in ROS, Rerun and Foxglove. CARLA's own: y right, and yaw and pitch turn the
other way."""


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
class Trajectory(Columns):
    """Where an actor went; arrays of one length, a value per frame in which it has a transform.

    World axes are right-handed (x forward, y left, z up) unless CARLA's own (y right) were asked for.

    Attributes:
        time: Elapsed seconds.
        x, y, z: Position in m.
        roll, pitch, yaw: Rotation about x, y, z in degrees; right-handed, a positive yaw turns left.
        vx, vy, vz: Velocity along the world's axes in m/s.
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


class ActorRows(Rows[Actor]):
    """Actors as rows."""

    row_type = Actor


class ActorsById(dict[int, Actor], Tabular):
    """Actors by id; as a table, a row for each."""

    def _columns(self) -> list[tuple[str, bool, Any]]:
        return ActorRows(self.values())._columns()


class Recording:
    """A recording, open for reading; also a context manager, and iterable over its frames.

    Args:
        reader: The format's reader.
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
        """The reader of the file's format.

        Raises:
            Closed: The recording is closed.
        """
        if self._closed:
            raise Closed(self.path)
        return self._reader

    def close(self) -> None:
        """Let go of the file; twice is harmless."""
        if not self._closed:
            self._closed = True
            self._reader.close()

    @cached_property
    def info(self) -> RecordingInfo:
        """What the recording is."""
        header, extent = self.header, self.reader.extent()
        first = next(self.reader.frames(), None)
        additional = first is not None and any(p.type is not None and p.type.additional for p in first.packets)
        try:
            date = datetime.fromtimestamp(header.date, UTC)
        except (OverflowError, OSError, ValueError):
            date = None
        return RecordingInfo(header.map_name, date, header.version, extent.frames, extent.duration, additional)

    @cached_property
    def actors(self) -> ActorsById:
        """Who was there, by id, in order of appearance; of several that had an id, the latest.

        On MCAP, read from the events alone.
        """
        return ActorsById((actor.id, actor) for actor in actors(self.reader))

    @property
    def heroes(self) -> list[Actor]:
        """The actors whose role_name is hero."""
        return [actor for actor in self.actors.values() if actor.is_hero]

    def frames(self, start: float = -math.inf, stop: float = math.inf) -> Iterator[Frame]:
        """Stream the frames.

        Args:
            start: First elapsed time, in seconds.
            stop: Elapsed time, in seconds, at which to stop (exclusive). A frame within a microsecond of either is at it.

        Raises:
            FormatError: The file contradicts its format.
        """
        return self.reader.frames(start=start, stop=stop)

    def frame_at(self, elapsed: float) -> Frame:
        """Return the last frame that begins at or before a time in seconds, or within a microsecond of it; found by index.

        Raises:
            RecapError: The recording has none.
        """
        frame = self.reader.frame_at(elapsed)
        if frame is None:
            raise RecapError(
                f"{self.path}: no frame at {elapsed:g} s; it has {self.info.frames}, up to {self.info.duration:g} s"
            )
        return frame

    def trajectory(self, actor_id: int, *, axes: Axes = "right-handed") -> Trajectory:
        """Where an actor went, in metres.

        Args:
            actor_id: The actor.
            axes: "right-handed", x forward, y left, z up, as in ROS, Rerun and Foxglove; or "carla", CARLA's own, with y to
                the right, and pitch and yaw turning the other way.

        Where a recording gives an id out again, the trajectory is of all actors that had it.

        Raises:
            RecapError: There is no such actor.
        """
        if axes not in get_args(Axes):
            raise RecapError(f"axes must be one of {', '.join(get_args(Axes))}, not {axes!r}")
        times, poses = self._rows(actor_id, "transforms")
        velocity_times, velocities = self._rows(actor_id, "velocities", known=bool(len(times)))
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
        return Controls(times, rows["steer"], rows["throttle"], rows["brake"], rows["hand_brake"] != 0, rows["gear"])

    def light_states(self, actor_id: int) -> LightStates:
        """What a traffic light showed.

        Raises:
            RecapError: There is no such actor.
        """
        times, rows = self._rows(actor_id, "light_states")
        return LightStates(times, rows["state"], rows["elapsed"], rows["frozen"] != 0)

    def collisions(self, type1: str = "a", type2: str = "a", *, compat: bool = False) -> Collisions:
        """Who collided with whom; see `carla_recap.queries.collisions`."""
        from carla_recap.queries import collisions

        return collisions(self.reader, type1, type2, compat=compat)

    def blocked(self, min_time: float = 30.0, min_distance: float = 10.0, *, compat: bool = False) -> Blocked:
        """Who stood still for long; see `carla_recap.queries.blocked`. Seconds and centimetres."""
        from carla_recap.queries import blocked

        return blocked(self.reader, min_time, min_distance, compat=compat)

    def incidents(self, **which: Any) -> Incidents:
        """What went wrong: collisions, long stops, hard braking; see `carla_recap.queries.incidents`."""
        from carla_recap.queries import incidents

        return incidents(self.reader, **which)

    def _rows(self, actor_id: int, name: str, *, known: bool = False) -> tuple[NDArray[np.float64], NDArray[np.void]]:
        """Elapsed seconds and record of an actor in each frame that has one; the last, where a frame has several."""
        times: list[float] = []
        rows: list[NDArray[np.void]] = []
        for frame in self.reader.frames((name,)):
            records = frame[name]
            assert isinstance(records, np.ndarray)
            found = np.flatnonzero(records["id"] == actor_id)
            if len(found):
                times.append(frame.elapsed)
                rows.append(records[found[-1] :][:1])
        if not rows:
            if not known:
                self._check_actor(actor_id)
            return np.empty(0), np.empty(0, self.header.table.named(name).dtype)
        return np.array(times), np.concatenate(rows)

    def _check_actor(self, actor_id: int) -> None:
        if actor_id in self.actors:
            return
        near = sorted(self.actors, key=lambda id: abs(id - actor_id))[:3]
        raise RecapError(f"{self.path}: no actor {actor_id}; near ids are {', '.join(map(str, near)) or 'none'}")


def open_recording(path: Path | str) -> Recording:
    """Open a recording of either format, CARLA's log or MCAP; the content says which.

    Raises:
        NotARecording: It is neither.
        FormatError: It is damaged.
        RecapError: It cannot be read.
    """
    return Recording(open_reader(path))


def _slope(values: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Change per second, from the neighbours of each sample; 0 for a single one, and across gaps of no time."""
    if len(values) < 2:
        return np.zeros(len(values))
    before = np.maximum(np.arange(len(values)) - 1, 0)
    after = np.minimum(np.arange(len(values)) + 1, len(values) - 1)
    span = times[after] - times[before]
    return np.divide(values[after] - values[before], span, out=np.zeros(len(values)), where=span > 0)
