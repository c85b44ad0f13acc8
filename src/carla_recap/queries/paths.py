"""How far the paths of an actor in two recordings part, and how long the states of a traffic light differ.

Frames are compared on their elapsed times. Nothing is aligned or shifted.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.motion import possible_step
from carla_recap.model.records import CM
from carla_recap.tables.trajectories import portions, rows_by_actor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from carla_recap.formats.base import Reader
    from carla_recap.util.arrays import Booleans, Floats, Indices

_FIELDS: Final = {"transforms": ("x", "y", "z", "yaw"), "light_states": ("state",)}
_ROUNDING: Final = 1e-9  # degrees; between angles that are whole turns apart


class ActorFrames(NamedTuple):
    """The frames that have a record of an actor, ascending, (n,), and fields of the records, (n, fields)."""

    frame: NDArray[np.int32]
    values: NDArray[Any]


@dataclass(frozen=True, eq=False)
class RecordedPaths:
    """What is compared of a recording.

    Attributes:
        elapsed: The elapsed seconds of its frames, (frames,).
        duration: The seconds from each frame to the next one, (frames,).
        poses: x, y and z in cm and yaw in degrees of the actors, by id.
        states: The states of the traffic lights, by id.
    """

    elapsed: Floats
    duration: Floats
    poses: dict[int, ActorFrames]
    states: dict[int, ActorFrames]

    @classmethod
    def of(cls, source: Reader) -> RecordedPaths:
        """Read a recording.

        Raises:
            FormatError: The file contradicts its format.
        """
        elapsed, duration, first = [np.empty(0)], [np.empty(0)], 0
        pieces: dict[str, dict[int, list[ActorFrames]]] = {name: defaultdict(list) for name in _FIELDS}
        for batches in portions(batch for batch in source.batches(tuple(_FIELDS)) if not batch.preamble):
            if len(elapsed) == 1:
                first = batches[0].index
            elapsed.append(np.concatenate([batch.elapsed for batch in batches]))
            duration.append(np.concatenate([batch.duration for batch in batches]))
            for name, fields in _FIELDS.items():
                for id, rows in rows_by_actor(batches, name):
                    values = np.stack([rows.records[field] for field in fields], axis=1)
                    pieces[name][id].append(ActorFrames((rows.frame - first).astype(np.int32), values))
        found = {
            name: {id: ActorFrames(*map(np.concatenate, zip(*by_id.pop(id), strict=True))) for id in list(by_id)}
            for name, by_id in pieces.items()
        }
        return cls(np.concatenate(elapsed), np.concatenate(duration), found["transforms"], found["light_states"])


class FramePairs(NamedTuple):
    """Which frames of recording b are around each frame of recording a, (frames of a,).

    Attributes:
        before, after: The last one before and the first one after it; both the same, where it has the same time. Those of
            frames that b has none around are no numbers of its frames.
        weight: The share of the latter.
        seconds: The time between the two.
    """

    before: Indices
    after: Indices
    weight: Floats
    seconds: Floats


@np.errstate(all="ignore")
def pair_frames(a: Floats, b: Floats) -> FramePairs:
    """Return which frames of b are around each frame of a, by their elapsed seconds.

    Times that go back, or are no numbers, count as the latest before. Of several frames at one time, the n-th of a has the
    n-th of b, or the last one.
    """
    if not len(b):
        nowhere = np.full(len(a), -1)
        return FramePairs(nowhere, nowhere, *np.zeros((2, len(a))))
    a, b = _ascending(a), _ascending(b)
    first, stop = np.searchsorted(b, a), np.searchsorted(b, a, "right")
    rank = np.arange(len(a)) - np.searchsorted(a, a)
    is_same = first < stop
    before = np.where(is_same, np.minimum(first + rank, stop - 1), first - 1)
    after = np.where(is_same, before, first)
    earlier, later = a - b[np.maximum(before, 0)], b[np.minimum(after, len(b) - 1)] - a
    is_after = (after < len(b)) & (later <= SAME_TIME)
    is_before = (before >= 0) & (earlier <= SAME_TIME) & ~is_after
    before, after = np.where(is_after, after, before), np.where(is_before, before, after)
    valid = (before >= 0) & (after < len(b))
    before, after = np.where(valid, before, -1), np.where(valid, after, -1)
    seconds = b[after] - b[before]
    return FramePairs(before, after, np.where(seconds > 0, earlier / seconds, 0.0), seconds)


def _ascending(time: Floats) -> Floats:
    return np.maximum.accumulate(np.nan_to_num(np.fmax(time, 0.0)))


class PathDifference(NamedTuple):
    """How far two paths part: fields of `ActorDifference`."""

    frames: int = 0
    first: float | None = None
    first_distance: float | None = None
    mean: float = math.nan
    rms: float = math.nan
    max: float = math.nan
    max_at: float = math.nan
    final: float = math.nan
    heading: float = 0.0


@np.errstate(all="ignore")
def compare_paths(a: ActorFrames, b: ActorFrames, pairs: FramePairs, time: Floats, tolerance: float) -> PathDifference:
    """Return how far the paths of an actor part, at the frames of a.

    Args:
        a: The poses in recording a.
        b: Those in recording b.
        pairs: Which frames of b are around those of a.
        time: The elapsed seconds of the frames of a.
        tolerance: The distance in m beyond which paths differ.
    """
    theirs, known = _interpolated(a, b, pairs)
    mine, theirs, time = a.values[known], theirs[known], time[a.frame[known]]
    if not len(time):
        return PathDifference()
    same = (mine == theirs) | (np.isnan(mine) & np.isnan(theirs))
    steps = np.where(same, 0.0, mine - theirs)
    distance = np.sqrt((steps[:, :3] ** 2).sum(axis=1)) * CM
    is_finite = np.isfinite(distance)
    finite = distance[is_finite]
    distance = np.where(is_finite, distance, np.inf)
    turn = np.abs(_turn(steps[:, 3]))
    beyond, largest = np.flatnonzero(distance > tolerance), int(distance.argmax())
    return PathDifference(
        frames=len(time),
        first=float(time[beyond[0]]) if len(beyond) else None,
        first_distance=float(distance[beyond[0]]) if len(beyond) else None,
        mean=float(finite.mean()) if len(finite) else math.nan,
        rms=float(np.sqrt((finite**2).mean())) if len(finite) else math.nan,
        max=float(distance[largest]),
        max_at=float(time[largest]),
        final=float(distance[-1]),
        heading=float(np.where(np.isfinite(turn) & (turn > _ROUNDING), turn, 0.0).max()),
    )


def compare_states(a: ActorFrames, b: ActorFrames, pairs: FramePairs) -> NDArray[np.int32]:
    """Return the frames of a in which the state of a traffic light is that of neither of the frames of b around them."""
    before, is_before = _rows_of(b, pairs.before[a.frame])
    after, is_after = _rows_of(b, pairs.after[a.frame])
    differs = is_before & (a.values != b.values[before])[:, 0] & ((a.values != b.values[after])[:, 0] | ~is_after)
    frames: NDArray[np.int32] = a.frame[differs]
    return frames


def _interpolated(a: ActorFrames, b: ActorFrames, pairs: FramePairs) -> tuple[Floats, Booleans]:
    """Return the poses of b at the frames of a, (n, 4), and whether they are known: not across a jump, (n,)."""
    before, is_before = _rows_of(b, pairs.before[a.frame])
    poses = b.values[before].astype(np.float64)
    if (pairs.before == pairs.after).all():
        return poses, is_before
    after, is_after = _rows_of(b, pairs.after[a.frame])
    steps = b.values[after] - poses
    steps[:, 3] = _turn(steps[:, 3])
    is_jump = np.sqrt((steps[:, :3] ** 2).sum(axis=1)) * CM > possible_step(pairs.seconds[a.frame])
    between = poses + pairs.weight[a.frame, None] * steps
    return np.where((before != after)[:, None], between, poses), is_before & is_after & ~is_jump


def _rows_of(rows: ActorFrames, frame: Indices) -> tuple[Indices, Booleans]:
    """Return the row of each frame, and whether there is one."""
    row = np.minimum(np.searchsorted(rows.frame, frame), len(rows.frame) - 1)
    return row, rows.frame[row] == frame


def _turn(degrees: Floats) -> Floats:
    """Return angles within half a turn."""
    return (degrees + 180.0) % 360.0 - 180.0
