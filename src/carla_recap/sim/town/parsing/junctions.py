"""Junctions: which lanes are in each other's way, and who has to let the other go."""

from __future__ import annotations

from collections import defaultdict
from itertools import combinations
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from carla_recap.sim.town.parsing.signals import phases

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from carla_recap.sim.town.parsing.lanes import ParsedLane
    from carla_recap.sim.town.parsing.records import Records

    Row = dict[str, Any]

_TOUCHING: Final = 0.7  # of half of both widths: nearer than that, two vehicles on two lanes touch
_ONCOMING: Final = np.cos(np.radians(135))
_ALIKE: Final = np.cos(np.radians(45))
_RANKS: Final = {"straight": 0, "right": 1, "left": 2}
_MOST: Final = 2000  # lanes in a junction


def parse_junctions(lanes: list[ParsedLane], signals: list[Row], records: Records) -> list[Row]:
    """The junctions in the order of their ids.

    Raises:
        ValueError: One has too many lanes.
    """
    within = defaultdict(list)
    for lane in lanes:
        if lane.junction is not None:
            within[lane.junction].append(lane)
    return [_junction(junction, within[junction], signals, records) for junction in sorted(within)]


def _junction(junction: int, lanes: list[ParsedLane], signals: list[Row], records: Records) -> Row:
    if len(lanes) > _MOST:
        raise ValueError(f"junction {junction} has more than {_MOST} lanes")
    slowed = {lane for row in signals if row["kind"] in ("stop", "yield") for lane in row["governs"]}
    priorities = records.priorities[junction]
    conflicts = [
        conflict for one, other in combinations(lanes, 2) for conflict in _conflicts(one, other, slowed, priorities)
    ]
    return {
        "id": junction,
        "lanes": [lane.index for lane in lanes],
        "conflicts": sorted(conflicts, key=lambda conflict: (conflict["lane"], conflict["other"])),
        "phases": phases(junction, signals, records),
    }


def _conflicts(one: ParsedLane, other: ParsedLane, slowed: set[int], priorities: set[tuple[int, int]]) -> Iterator[Row]:
    """The conflict of two lanes, if there is one, as each of them has it."""
    if set(one.row["predecessors"]) & set(other.row["predecessors"]):
        return  # they part; who comes first is first
    near = (one.width + other.width) / 2 * _TOUCHING
    if not _boxes_touch(one.rows[:, :2], other.rows[:, :2], near):
        return
    close = np.linalg.norm(one.rows[:, None, :3] - other.rows[None, :, :3], axis=2) < near
    if not close.any():
        return
    merging = bool(set(one.row["successors"]) & set(other.row["successors"]))
    yields = _yields(one, other, slowed, priorities)
    for lane, rival, axis, gives_way in ((one, other, 1, yields), (other, one, 0, not yields)):
        along = close.any(axis=axis)
        begin, end = np.flatnonzero(along)[[0, -1]] * lane.length / (len(along) - 1)
        yield {
            "lane": lane.index,
            "other": rival.index,
            "begin": float(begin),
            "end": float(end),
            "merging": merging,
            "yields": gives_way,
        }


def _boxes_touch(one: NDArray[np.float64], other: NDArray[np.float64], near: float) -> bool:
    return bool((one.min(axis=0) - near < other.max(axis=0)).all() and (other.min(axis=0) - near < one.max(axis=0)).all())


def _yields(one: ParsedLane, other: ParsedLane, slowed: set[int], priorities: set[tuple[int, int]]) -> bool:
    """Whether who is on one lane has to let go who is on the other.

    What the first of these rules says that knows a difference: stop and yield signs; priorities of the file; a turn to the
    left lets go what comes towards it; right before left; straight on before a turn.
    """
    if (one.index in slowed) != (other.index in slowed):
        return one.index in slowed
    roads = one.name[0], other.name[0]
    if (roads in priorities) != (roads[::-1] in priorities):
        return roads not in priorities
    between = other.rows[0, 3] - one.rows[0, 3]
    if abs(np.cos(between)) < _ALIKE and np.cos(between) > _ONCOMING:
        return bool(np.sin(between) < 0)  # who heads to one's left comes from one's right
    ranks = _RANKS[one.row["turn"]], _RANKS[other.row["turn"]]
    return ranks[0] > ranks[1] if ranks[0] != ranks[1] else one.index > other.index
