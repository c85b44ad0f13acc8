"""The records of each actor over a whole recording: trajectories, vehicle controls, traffic light states."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, get_args

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.motion import MOTION, counts, motion_of, possible_step
from carla_recap.model.records import CM
from carla_recap.tables import Columns, Tabular
from carla_recap.tables.display import Preview, first_and_last

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.lives import ActorLife
    from carla_recap.util.arrays import Floats, Indices, Integers


Axes = Literal["right-handed", "carla"]
"""Right-handed: x forward, y left, z up, as in ROS, Rerun and Foxglove. CARLA's own: y right, yaw and pitch reversed."""

_FRAMES: Final = 1024  # that are handled at once


@dataclass(frozen=True, repr=False)
class Trajectory(Columns):
    """The trajectory of an actor: arrays of one length, a value for each frame in which it has a transform.

    World axes are right-handed (x forward, y left, z up); with `axes="carla"`, they are CARLA's (y right).

    As a table it has these arrays, the speed, and the id in each row.

    Attributes:
        id: The actor.
        time: Elapsed seconds.
        x, y, z: Position in m.
        roll, pitch, yaw: Rotation about x, y, z in degrees; right-handed, a positive yaw turns left.
        vx, vy, vz: Velocity along the world's axes in m/s; NaN where it is unknown (`model/motion.py` has the rule).
        velocity_recorded: Whether the velocity is the recorded one; otherwise it is derived from the positions.
    """

    column_units: ClassVar = {
        "time": "s",
        **dict.fromkeys("xyz", "m"),
        **dict.fromkeys(("roll", "pitch", "yaw"), "deg"),
        **dict.fromkeys(("vx", "vy", "vz", "speed"), "m/s"),
    }

    id: int
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

    @classmethod
    def empty(cls, id: int) -> Trajectory:
        """Return the trajectory of an actor without transforms."""
        arrays = {field.name: np.empty(0) for field in fields(cls)[1:-1]}
        return cls(id, **arrays, velocity_recorded=np.empty(0, np.bool_))

    def columns(self) -> dict[str, Any]:
        """See `Tabular.columns`."""
        arrays = {name: values for name, values in super().columns().items() if name != "id"}
        return {**arrays, "speed": self.speed, "id": np.full(len(self), self.id)}

    @property
    def speed(self) -> NDArray[np.float64]:
        """The speed in m/s, (n,)."""
        return np.sqrt(self.vx**2 + self.vy**2 + self.vz**2)

    @property
    def steps(self) -> NDArray[np.float64]:
        """The distance from each position to the next one in m, (n - 1,); NaN for a jump."""
        distance = np.sqrt(np.diff(self.x) ** 2 + np.diff(self.y) ** 2 + np.diff(self.z) ** 2)
        known = np.where(self.velocity_recorded, self.speed, np.nan)
        jumps = distance > possible_step(np.diff(self.time), np.fmax(known[1:], known[:-1]))
        return np.where(jumps, np.nan, distance)

    def during(self, start: float, stop: float) -> Trajectory:
        """Return the part between two times in elapsed seconds, without positions that are not finite."""
        finite = np.isfinite(self.x) & np.isfinite(self.y) & np.isfinite(self.z)
        return self.at((self.time >= start) & (self.time <= stop) & finite)

    def of_life(self, life: ActorLife) -> Trajectory:
        """Return the part of one of the actors that had the id, without positions that are not finite."""
        return self.at(self.time < life.end).during(life.spawned_at, life.end)

    def ascending(self) -> Trajectory:
        """Return the rows that are later than all before."""
        latest = np.fmax.accumulate(np.append(-math.inf, self.time))
        return self.at(self.time > latest[:-1])

    def at(self, rows: NDArray[np.bool_] | slice) -> Trajectory:
        """Return some of the rows, such as those that are flagged, (n,)."""
        return replace(self, **{field.name: getattr(self, field.name)[rows] for field in fields(self)[1:]})


class Trajectories(dict[int, Trajectory], Tabular):
    """Trajectories by actor; as a table, a row for each actor and frame."""

    __repr__ = Tabular.__repr__

    def columns(self) -> dict[str, Any]:
        """See `Tabular.columns`."""
        every = [trajectory.columns() for trajectory in self.values()] or [Trajectory.empty(0).columns()]
        return {name: np.concatenate([columns[name] for columns in every]) for name in ("id", *every[0])}

    def units(self) -> Mapping[str, str]:
        """See `Tabular.units`."""
        return Trajectory.column_units

    def _preview(self) -> Preview:
        """Return a row for each of the first and last actors, instead of one for each frame."""
        some = [trajectory for trajectory in first_and_last(list(self.values())) if len(trajectory)]
        columns = {
            "id": [trajectory.id for trajectory in some],
            "frames": [len(trajectory) for trajectory in some],
            "from": [trajectory.time[0] for trajectory in some],
            "to": [trajectory.time[-1] for trajectory in some],
            "top speed": [np.fmax.reduce(trajectory.speed) for trajectory in some],
        }
        return Preview(type(self).__name__, columns, {"from": "s", "to": "s", "top speed": "m/s"}, len(self))


@dataclass(frozen=True, repr=False)
class Controls(Columns):
    """The controls of a vehicle: arrays of one length.

    Attributes:
        time: Elapsed seconds.
        steer: -1 full left to 1 full right.
        throttle, brake: 0 to 1.
        hand_brake: Whether the hand brake was on.
        gear: -1 reverse, 0 neutral, 1 and up forward.
    """

    column_units: ClassVar = {"time": "s"}

    time: NDArray[np.float64]
    steer: NDArray[np.float32]
    throttle: NDArray[np.float32]
    brake: NDArray[np.float32]
    hand_brake: NDArray[np.bool_]
    gear: NDArray[np.int32]


@dataclass(frozen=True, repr=False)
class LightStates(Columns):
    """The states of a traffic light: arrays of one length.

    Attributes:
        time: Elapsed seconds of the recording.
        state: 0 red, 1 yellow, 2 green, 3 off, 4 unknown.
        elapsed: Seconds since the light changed to this state.
        frozen: Whether the light was frozen.
    """

    column_units: ClassVar = {"time": "s", "elapsed": "s"}

    time: NDArray[np.float64]
    state: NDArray[np.int8]
    elapsed: NDArray[np.float32]
    frozen: NDArray[np.bool_]


def trajectories(reader: Reader, actors: Collection[int] | None = None, *, axes: Axes = "right-handed") -> Trajectories:
    """Return the trajectories of some actors, or of all, in one pass over a recording; see `Recording.trajectory`."""
    if axes not in get_args(Axes):
        raise RecapError(f"axes must be one of {', '.join(get_args(Axes))}, not {axes!r}")
    return trajectories_of(actor_rows(reader, MOTION, actors), spawn_times(reader), axes=axes)


def spawn_times(reader: Reader, start: float = -math.inf, stop: float = math.inf) -> dict[int, list[float]]:
    """Return the elapsed seconds at which actors appear, by id."""
    spawned: dict[int, list[float]] = {}
    for frame in reader.frames(("spawned",), sparse=True, start=start, stop=stop):
        for spawn in frame["spawned"]:
            spawned.setdefault(spawn.id, []).append(frame.elapsed)
    return spawned


def life_numbers(time: Floats | Integers, spawned: Sequence[float]) -> Indices:
    """Return the number of the life at elapsed seconds, (n,), of an id whose actors appear at some."""
    return np.searchsorted(np.sort(spawned), time, side="right")


def trajectories_of(
    rows: dict[str, dict[int, ActorRows]], spawned: Mapping[int, Sequence[float]], *, axes: Axes = "right-handed"
) -> Trajectories:
    """Return the trajectories that records of the types `MOTION` make, by type and actor; these are taken out.

    No velocity is derived from one life to the next: at `spawned`, by id in elapsed seconds, another one begins.
    """
    poses, recorded = rows["transforms"], rows["velocities"]
    flip = -1.0 if axes == "right-handed" else 1.0
    found = Trajectories()
    for id in list(poses):
        with np.errstate(invalid="ignore", over="ignore"):  # signalling NaN, and numbers of damaged files
            found[id] = _trajectory(id, poses.pop(id), recorded.pop(id, None), spawned.get(id, []), flip)
    return found


def _trajectory(id: int, poses: ActorRows, recorded: ActorRows | None, spawned: Sequence[float], flip: float) -> Trajectory:
    records, time = poses.records, poses.time
    place = np.stack([records[axis].astype(np.float64) for axis in "xyz"]) * CM
    velocity = np.full(place.shape, np.nan)
    if recorded is not None:
        where = np.minimum(np.searchsorted(recorded.frame, poses.frame), len(recorded.frame) - 1)
        own = recorded.frame[where] == poses.frame
        velocity[:, own] = [recorded.records[axis][where[own]] for axis in "xyz"]
    known = counts(velocity)
    velocity, _ = motion_of(time, place, velocity, life_numbers(time, spawned))
    for values in (place, velocity):
        values[1] = flip * values[1] + 0.0  # no -0.0
    return Trajectory(
        id=id,
        time=time,
        **dict(zip("xyz", place, strict=True)),
        roll=records["roll"].astype(np.float64),
        pitch=flip * records["pitch"].astype(np.float64) + 0.0,
        yaw=flip * records["yaw"].astype(np.float64) + 0.0,
        **dict(zip(("vx", "vy", "vz"), velocity, strict=True)),
        velocity_recorded=known,
    )


@dataclass(frozen=True, eq=False)
class ActorRows:
    """The records of one actor, a row for each frame that has one."""

    frame: Integers  # the indices of the frames in the recording, (n,)
    time: Floats  # the elapsed seconds of the frames, (n,)
    records: NDArray[np.void]  # the records, (n,)


def actor_rows(
    reader: Reader,
    names: Collection[str],
    actors: Collection[int] | None = None,
    *,
    start: float = -math.inf,
    stop: float = math.inf,
) -> dict[str, dict[int, ActorRows]]:
    """Return the records of types with an id, by type and actor, from one elapsed time to before another, in one pass.

    If a frame has several records of an actor, as in some builds, the last one counts.
    """
    collector = RowCollector(names, actors)
    for batches in portions(reader.batches(tuple(names), start=start, stop=stop)):
        collector.add(batches)
    return collector.finish()


class RowCollector:
    """Collects the records of actors from batches; see `actor_rows`."""

    def __init__(self, names: Collection[str], actors: Collection[int] | None = None) -> None:
        self._wanted = None if actors is None else np.array([id for id in actors if 0 <= id < 1 << 32], np.uint32)
        self._pieces: dict[str, dict[int, list[ActorRows]]] = {name: {} for name in names}

    def add(self, batches: list[Batch]) -> None:
        """Add the records of the next frames."""
        for name, found in self._pieces.items():
            for id, rows in rows_by_actor(batches, name, self._wanted):
                found.setdefault(id, []).append(rows)

    def finish(self) -> dict[str, dict[int, ActorRows]]:
        """Return the records by type and actor."""
        return {name: {id: _joined(found.pop(id)) for id in list(found)} for name, found in self._pieces.items()}


def portions(batches: Iterable[Batch]) -> Iterator[list[Batch]]:
    """Yield batches in lists of about `_FRAMES` frames."""
    portion, frames = [], 0
    for batch in batches:
        for start in range(0, len(batch), _FRAMES):
            part = batch if len(batch) <= _FRAMES else batch[start : start + _FRAMES]
            portion.append(part)
            frames += len(part)
            if frames >= _FRAMES:
                yield portion
                portion, frames = [], 0
    if portion:
        yield portion


def rows_by_actor(
    batches: list[Batch], name: str, wanted: NDArray[np.uint32] | None = None
) -> Iterator[tuple[int, ActorRows]]:
    """Yield the records of a type in batches by actor, in the order in which the actors appear."""
    pieces = [np.ascontiguousarray(batch.records(name)) for batch in batches]
    dtype = next((piece.dtype for piece in pieces if piece.size), pieces[0].dtype)
    records = np.frombuffer(b"".join(piece.data for piece in pieces if piece.size), dtype)
    counts = np.repeat([piece.shape[1] for piece in pieces], [len(piece) for piece in pieces])
    frame = np.concatenate([np.arange(batch.index, batch.index + len(batch)) for batch in batches])
    rows, ids = np.repeat(np.arange(len(frame)), counts), records["id"]
    kept = np.arange(len(ids)) if wanted is None else np.flatnonzero(np.isin(ids, wanted))
    order = kept[np.argsort(ids[kept], kind="stable")]
    ids, rows = ids[order], rows[order]
    is_last = np.append((ids[1:] != ids[:-1]) | (rows[1:] != rows[:-1]), True)[: len(ids)]  # of an actor in a frame
    order, ids, rows = order[is_last], ids[is_last], rows[is_last]
    time = np.concatenate([batch.elapsed for batch in batches])[rows]
    frame, records = frame[rows], records.take(order)  # several times faster than an index of records
    edges = np.flatnonzero(np.append(True, ids[1:] != ids[:-1])[: len(ids)]).tolist()
    for start, stop in sorted(pairwise([*edges, len(ids)]), key=lambda edge: int(order[edge[0]])):
        yield int(ids[start]), ActorRows(frame[start:stop], time[start:stop], records[start:stop])


def _joined(pieces: list[ActorRows]) -> ActorRows:
    """Return rows of an actor, one after the other."""
    frame, time, records = (
        np.concatenate([getattr(piece, name) for piece in pieces]) for name in ("frame", "time", "records")
    )
    return ActorRows(frame, time, records)
