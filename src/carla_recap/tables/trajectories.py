"""The records of each actor over a whole recording: trajectories, vehicle controls, traffic light states."""

from __future__ import annotations

from dataclasses import dataclass, fields
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal, get_args

import numpy as np

from carla_recap.errors import RecapError
from carla_recap.model.records import CM
from carla_recap.tables import Columns, Tabular

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.model.batch import Batch
    from carla_recap.model.frame import Frame

    Floats = NDArray[np.float64]
    Integers = NDArray[np.int64]

Axes = Literal["right-handed", "carla"]
"""Right-handed: x forward, y left, z up, as in ROS, Rerun and Foxglove. CARLA's own: y right, yaw and pitch reversed."""

_FRAMES: Final = 1024  # unlike their neighbours, which are handled at once


@dataclass(frozen=True)
class Trajectory(Columns):
    """The trajectory of an actor: arrays of one length, a value for each frame in which it has a transform.

    World axes are right-handed (x forward, y left, z up) by default; see `Axes`.

    As a table it has these arrays, the speed, and the id in each row.

    Attributes:
        id: The actor.
        time: Elapsed seconds.
        x, y, z: Position in m.
        roll, pitch, yaw: Rotation about x, y, z in degrees; right-handed, a positive yaw turns left.
        vx, vy, vz: Velocity along the world's axes in m/s.
        velocity_recorded: Whether the velocity was recorded; otherwise it is derived from the positions.
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


class Trajectories(dict[int, Trajectory], Tabular):
    """Trajectories by actor; as a table, a row for each actor and frame."""

    def columns(self) -> dict[str, Any]:
        """See `Tabular.columns`."""
        every = [trajectory.columns() for trajectory in self.values()] or [Trajectory.empty(0).columns()]
        return {name: np.concatenate([columns[name] for columns in every]) for name in ("id", *every[0])}

    def units(self) -> Mapping[str, str]:
        """See `Tabular.units`."""
        return Trajectory.column_units


@dataclass(frozen=True)
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


@dataclass(frozen=True)
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
    """Return the trajectories of actors, in one pass over a recording.

    Args:
        reader: The recording.
        actors: Their ids; None for all.
        axes: See `Recording.trajectory`.

    Raises:
        RecapError: There are no such axes.
        FormatError: The file contradicts its format.
    """
    if axes not in get_args(Axes):
        raise RecapError(f"axes must be one of {', '.join(get_args(Axes))}, not {axes!r}")
    rows = actor_rows(reader, ("transforms", "velocities"), actors)
    poses, velocities = rows["transforms"], rows["velocities"]
    flip = -1.0 if axes == "right-handed" else 1.0
    found = Trajectories()
    for id in list(poses):
        found[id] = _trajectory(id, poses.pop(id), velocities.pop(id, None), flip)
    return found


def _trajectory(id: int, poses: ActorRows, velocities: ActorRows | None, flip: float) -> Trajectory:
    records, time = poses.records, poses.time
    position = {axis: records[axis].astype(np.float64) * CM for axis in "xyz"}
    velocity = {axis: _slope(position[axis], time) for axis in "xyz"}
    recorded = np.zeros(len(time), np.bool_)
    if velocities is not None:
        where = np.minimum(np.searchsorted(velocities.frame, poses.frame), len(velocities.frame) - 1)
        recorded = velocities.frame[where] == poses.frame
        for axis in "xyz":
            velocity[axis][recorded] = velocities.records[axis][where[recorded]]
    for values in (position["y"], velocity["y"]):
        values *= flip
    return Trajectory(
        id=id,
        time=time,
        **position,
        roll=records["roll"].astype(np.float64),
        pitch=flip * records["pitch"].astype(np.float64),
        yaw=flip * records["yaw"].astype(np.float64),
        vx=velocity["x"],
        vy=velocity["y"],
        vz=velocity["z"],
        velocity_recorded=recorded,
    )


def _slope(values: NDArray[np.float64], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the change per second between the neighbours of each sample; 0 if no time passes between them."""
    if len(values) < 2:
        return np.zeros(len(values))
    before = np.maximum(np.arange(len(values)) - 1, 0)
    after = np.minimum(np.arange(len(values)) + 1, len(values) - 1)
    span = times[after] - times[before]
    return np.divide(values[after] - values[before], span, out=np.zeros(len(values)), where=span > 0)


@dataclass(frozen=True, eq=False)
class ActorRows:
    """The records of one actor, a row for each frame that has one.

    Attributes:
        frame: The indices of the frames in the recording, (n,).
        time: The elapsed seconds of the frames, (n,).
        records: The records, (n,).
    """

    frame: Integers
    time: Floats
    records: NDArray[np.void]


@dataclass(frozen=True, eq=False)
class _ActorBlock:
    """Frames with the same actors: their indices and times, and the records, (frames, actors)."""

    ids: NDArray[np.uint32]
    frame: Integers
    time: Floats
    records: NDArray[np.void]


def actor_rows(
    reader: Reader, names: Collection[str], actors: Collection[int] | None = None
) -> dict[str, dict[int, ActorRows]]:
    """Return the records by type and actor, in one pass over a recording.

    If a frame has several records of an actor, as in some builds, the last one counts.

    Args:
        reader: The recording.
        names: Record types whose records have one size, and an id.
        actors: The ids of the actors; None for all.

    Raises:
        FormatError: The file contradicts its format.
    """
    wanted = None if actors is None else np.array(sorted(actors), np.uint32)
    blocks: dict[str, list[_ActorBlock]] = {name: [] for name in names}
    frames: list[Frame] = []  # of batches of one
    for batch in chain(reader.batches(tuple(names)), (None,)):
        if frames and (len(frames) == _FRAMES or batch is None or len(batch) > 1):
            for name in names:
                blocks[name].extend(_blocks_of_frames(frames, name, wanted))
            frames = []
        if batch is not None and len(batch) == 1:
            frames.append(batch.frame(0))
        elif batch is not None:
            for name in names:
                blocks[name].extend(_blocks(batch, name, wanted))
    return {name: _by_actor(blocks.pop(name)) for name in names}


def _blocks(batch: Batch, name: str, wanted: NDArray[np.uint32] | None) -> Iterator[_ActorBlock]:
    """Yield the records of a type in a batch, in blocks of frames with the same actors."""
    records = batch.records(name)
    if not records.shape[1]:
        return
    ids = records["id"]
    frame = np.arange(batch.index, batch.index + len(batch))
    changes = np.flatnonzero((ids[1:] != ids[:-1]).any(axis=1)) + 1 if len(ids) > 1 else ids[:0, 0]
    edges = [0, *changes.tolist(), len(ids)]
    for start, stop in pairwise(edges):
        listed = np.ascontiguousarray(ids[start])
        kept = np.arange(len(listed)) if wanted is None else np.flatnonzero(_among(listed, wanted))
        if not len(kept):
            continue
        if len(kept) > 1:
            _, from_end = np.unique(listed[kept][::-1], return_index=True)
            if len(from_end) < len(kept):  # the last record of each actor counts
                kept = kept[np.sort(len(kept) - 1 - from_end)]
        part = records[start:stop] if len(kept) == len(listed) else records[start:stop, kept]
        yield _ActorBlock(listed[kept], frame[start:stop], batch.elapsed[start:stop].copy(), part.copy())


def _blocks_of_frames(frames: list[Frame], name: str, wanted: NDArray[np.uint32] | None) -> Iterator[_ActorBlock]:
    """Yield the records of a type in frames, a block for each actor."""
    pieces = [np.ascontiguousarray(frame[name]) for frame in frames]
    dtype = next((piece.dtype for piece in pieces if len(piece)), pieces[0].dtype)
    records = np.frombuffer(b"".join(piece.data for piece in pieces), dtype)  # `np.concatenate` is slow here
    rows = np.repeat(np.arange(len(frames)), [len(piece) for piece in pieces])
    if wanted is not None:
        kept = _among(records["id"], wanted)
        records, rows = records[kept], rows[kept]
    order = np.argsort(records["id"], kind="stable")
    ids, rows = records["id"][order], rows[order]
    last = np.append((ids[1:] != ids[:-1]) | (rows[1:] != rows[:-1]), True)[: len(ids)]  # of an actor in a frame
    order, ids, rows = order[last], ids[last], rows[last]
    starts = np.flatnonzero(np.append(True, ids[1:] != ids[:-1])[: len(ids)])
    frame, time = np.array([frame.index for frame in frames]), np.array([frame.elapsed for frame in frames])
    blocks = zip(np.split(order, starts[1:]), np.split(rows, starts[1:]), ids[starts].tolist(), strict=True)
    for mine, at, id in sorted(blocks, key=lambda block: int(block[0][0])) if len(ids) else ():
        yield _ActorBlock(np.array([id], np.uint32), frame[at], time[at], records[mine, None])


def _among(ids: NDArray[np.uint32], wanted: NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Return which ids are among others, which ascend; `np.isin` takes longer for few."""
    if not len(wanted):
        return np.zeros(len(ids), np.bool_)
    found: NDArray[np.bool_] = wanted[np.minimum(np.searchsorted(wanted, ids), len(wanted) - 1)] == ids
    return found


def _by_actor(blocks: list[_ActorBlock]) -> dict[int, ActorRows]:
    """Return the rows by actor, in the order in which the actors appear; empties the list of blocks, to save memory."""
    pieces: dict[int, list[tuple[int, int]]] = {}
    merged = list(_merged(blocks))
    for number, block in enumerate(merged):
        for row, id in enumerate(block.ids.tolist()):
            pieces.setdefault(id, []).append((number, row))
    return {
        id: ActorRows(
            np.concatenate([merged[number].frame for number, _ in mine]),
            np.concatenate([merged[number].time for number, _ in mine]),
            np.concatenate([merged[number].records[row] for number, row in mine]),
        )
        for id, mine in pieces.items()
    }


def _merged(blocks: list[_ActorBlock]) -> Iterator[_ActorBlock]:
    """Yield blocks of the same actors as one, with records by actor, (actors, frames); empties the list."""
    blocks.reverse()
    while blocks:
        same = [blocks.pop()]
        while blocks and np.array_equal(blocks[-1].ids, same[0].ids):
            same.append(blocks.pop())
        frame, time = (np.concatenate([getattr(block, name) for block in same]) for name in ("frame", "time"))
        records = np.empty((len(same[0].ids), len(frame)), same[0].records.dtype)
        start = 0
        for block in same:
            records[:, start : start + len(block.frame)] = block.records.T
            start += len(block.frame)
        yield _ActorBlock(same[0].ids, frame, time, records)
