"""Traffic lights, signs and junctions: the lanes that they govern, the lights that change together, and the right of way."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import combinations
from typing import TYPE_CHECKING, Final

import numpy as np

from carla_recap.roads import opendrive
from carla_recap.roads.speed_limits import sign_limit
from carla_recap.sim.geometry import Location, Rotation, Transform

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from carla_recap.roads.landmarks import Landmark
    from carla_recap.roads.lanes import LaneGeometry
    from carla_recap.roads.opendrive import OpenDrive
    from carla_recap.sim.town.lanes import Lane


class SignalKind(StrEnum):
    """The kind of a signal."""

    LIGHT = "light"
    STOP = "stop"
    YIELD = "yield"
    SPEED_LIMIT = "speed_limit"


@dataclass(frozen=True, slots=True)
class Signal:
    """A traffic light or sign, which faces the traffic that it governs.

    Attributes:
        opendrive_id: Its id in the file.
        speed_limit: The speed limit in m/s, if it is a speed-limit sign.
        junction: The id of the junction before which it stands, if there is one.
        controller: The id of the controller of a light; lights of one controller change together.
        stops: The lanes that it governs, and the distance along each of the stop line, or of the begin of the speed
            limit.
        governs: The lanes beyond it, in the junction.
    """

    index: int
    opendrive_id: str
    kind: SignalKind
    transform: Transform
    speed_limit: float | None
    junction: int | None
    controller: str | None
    stops: tuple[tuple[int, float], ...]
    governs: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Conflict:
    """A stretch of a lane in a junction, between two distances along it in m, where another lane crosses it, or comes to it.

    Every conflict is listed twice, once for each of the two lanes.

    Attributes:
        merging: Whether both lanes lead to the same one; otherwise they cross.
        yields: Whether the traffic of the lane yields to that of the other one.
    """

    lane: int
    other: int
    begin: float
    end: float
    merging: bool
    yields: bool


@dataclass(frozen=True, slots=True)
class Junction:
    """A junction, with the lanes through it, and the stretches where two of them cross or merge.

    Attributes:
        phases: The lights that are green together, as indices of signals: one phase after another; empty without lights.
    """

    id: int
    lanes: tuple[int, ...]
    conflicts: tuple[Conflict, ...]
    phases: tuple[tuple[int, ...], ...]


_KINDS: Final = {
    opendrive.LIGHT: SignalKind.LIGHT,
    opendrive.STOP: SignalKind.STOP,
    opendrive.YIELD: SignalKind.YIELD,
    opendrive.SPEED_LIMIT: SignalKind.SPEED_LIMIT,
}
_SAME_WAY: Final = np.cos(np.radians(35))  # approaches of a junction that are one, or opposite to each other


def make_signals(
    landmarks: Iterable[Landmark],
    lanes: Sequence[Lane],
    courses: Sequence[LaneGeometry],
    controllers: Mapping[str, list[str]],
) -> list[Signal]:
    """Return the lights and signs in the order of their ids, each once."""
    by_road = defaultdict(list)
    for lane in lanes:
        by_road[lane.road_id].append(lane)
    places: dict[str, list[Landmark]] = defaultdict(list)
    for sign in landmarks:
        if sign.kind in _KINDS and np.isfinite((*sign.location, sign.heading, sign.station)).all():
            places[sign.id].append(sign)
    ordered = sorted(places.items(), key=lambda item: _in_order(item[0]))
    signals = [_signal(index, signs, by_road, lanes, courses) for index, (_, signs) in enumerate(ordered)]
    return _controlled(signals, lanes, controllers)


def _in_order(name: str) -> tuple[int, str]:
    return (int(name) if name.isdecimal() and len(name) < 20 else 0), name


def _signal(
    index: int,
    signs: list[Landmark],
    by_road: Mapping[int, list[Lane]],
    lanes: Sequence[Lane],
    courses: Sequence[LaneGeometry],
) -> Signal:
    first = signs[0]
    kind = _KINDS[first.kind]
    governed = [
        (lane, sign)
        for sign in signs
        for lane in by_road.get(sign.road, ())
        if _is_at(sign, courses[lane.index])
        and (_faces(sign, courses[lane.index]) if sign.is_for_all else _names(sign, lane))
    ]
    if not governed:  # it says that it is for no lane, and no other road refers to it
        governed = [
            (lane, sign)
            for sign in signs
            for lane in by_road.get(sign.road, ())
            if _is_at(sign, courses[lane.index]) and _faces(sign, courses[lane.index])
        ]
    stops, governs = _stops(kind, governed, lanes, courses)
    junctions = (lanes[lane].junction for lane in governs)
    (x, y, z), yaw = first.location.tolist(), float(np.degrees(-first.heading))
    return Signal(
        index=index,
        opendrive_id=first.id,
        kind=kind,
        transform=Transform(Location(x, -y, z), Rotation(yaw=(yaw + 180) % 360 - 180)),
        speed_limit=sign_limit(first.value) if kind is SignalKind.SPEED_LIMIT else None,
        junction=min((junction for junction in junctions if junction is not None), default=None),
        controller=None,
        stops=tuple(sorted(stops.items())),
        governs=tuple(sorted(governs)),
    )


def _is_at(sign: Landmark, course: LaneGeometry) -> bool:
    """Return whether a lane is at the station of a sign."""
    return bool(course.stations[0] - 1 <= sign.station <= course.stations[-1] + 1)


def _names(sign: Landmark, lane: Lane) -> bool:
    """Return whether a sign names a lane."""
    return any(min(pair) <= lane.lane_id <= max(pair) for pair in sign.lanes)


def _faces(sign: Landmark, course: LaneGeometry) -> bool:
    """Return whether a sign is for the direction of travel of a lane."""
    return sign.ahead is None or sign.ahead != course.reverse


def _stops(
    kind: SignalKind, governed: list[tuple[Lane, Landmark]], lanes: Sequence[Lane], courses: Sequence[LaneGeometry]
) -> tuple[dict[int, float], set[int]]:
    """Return the stop lines, at the end of a lane before a junction, else at the sign, and the lanes governed beyond."""
    stops: dict[int, float] = {}
    governs: set[int] = set()
    for lane, sign in governed:
        after = [index for index in lane.successors if lanes[index].junction is not None]
        if lane.junction is not None and kind is not SignalKind.SPEED_LIMIT:
            governs.add(lane.index)
            before = (lanes[index] for index in lane.predecessors)
            stops.update((other.index, other.length) for other in before if other.junction != lane.junction)
        elif after and kind is not SignalKind.SPEED_LIMIT:
            governs.update(after)
            stops[lane.index] = lane.length
        else:
            start, stop = courses[lane.index].stations[[-1, 0] if courses[lane.index].reverse else [0, -1]].tolist()
            share = (sign.station - start) / (stop - start) if stop != start else 1.0
            stops[lane.index] = min(max(share, 0.0), 1.0) * lane.length
    return stops, governs


def _controlled(signals: list[Signal], lanes: Sequence[Lane], controllers: Mapping[str, list[str]]) -> list[Signal]:
    """Give every light a controller: that of the file, or else one for all that stand on the same axis of a junction."""
    of_file = {signal: name for name, controlled in reversed(list(controllers.items())) for signal in controlled}
    axes: dict[int | None, list[tuple[str, float]]] = defaultdict(list)
    found = []
    for signal in signals:
        name = of_file.get(signal.opendrive_id) if signal.kind is SignalKind.LIGHT else None
        if name is None and signal.kind is SignalKind.LIGHT:
            heading = _approach(signal, lanes)
            known = axes[signal.junction] if signal.junction is not None else []
            same = [other for other, axis in known if abs(np.cos(heading - axis)) > _SAME_WAY]
            name = same[0] if same else f"light {signal.opendrive_id}"
            known.append((name, heading))
        found.append(replace(signal, controller=name))
    return found


def _approach(signal: Signal, lanes: Sequence[Lane]) -> float:
    """Return the direction of the traffic that a light governs."""
    if signal.stops:
        return float(lanes[signal.stops[0][0]].heading[-1])
    return float(np.radians(signal.transform.rotation.yaw + 90))


def _phases(junction: int, signals: Iterable[Signal], controllers: Iterable[str]) -> Iterator[tuple[int, ...]]:
    """Yield the lights of a junction that are green together, phase by phase."""
    groups = defaultdict(list)
    for signal in signals:
        if signal.kind is SignalKind.LIGHT and signal.junction == junction:
            groups[signal.controller].append(signal.index)
    order = [name for name in controllers if name in groups]
    for name in (*order, *(name for name in groups if name not in order)):
        yield tuple(groups[name])


_TOUCHING: Final = 0.7  # of half of both widths: nearer than that, two vehicles on two lanes touch
_ONCOMING: Final = np.cos(np.radians(135))
_ALIKE: Final = np.cos(np.radians(45))
_RANKS: Final = {False: {"straight": 0, "right": 1, "left": 2}, True: {"straight": 0, "left": 1, "right": 2}}
"""The ranks of turns, by whether traffic keeps left."""
_MOST: Final = 1_000_000  # pairs of lanes in all junctions


def make_junctions(lanes: Sequence[Lane], signals: Sequence[Signal], content: OpenDrive) -> list[Junction]:
    """Return the junctions in the order of their ids; ValueError: they have too many lanes."""
    within = defaultdict(list)
    for lane in lanes:
        if lane.junction is not None:
            within[lane.junction].append(lane)
    slowed = {lane for signal in signals if signal.kind in (SignalKind.STOP, SignalKind.YIELD) for lane in signal.governs}
    if sum(len(group) ** 2 for group in within.values()) > 2 * _MOST:
        raise ValueError("more lanes cross each other in its junctions than in any town")
    return [_junction(junction, within[junction], slowed, signals, content) for junction in sorted(within)]


def _junction(junction: int, lanes: list[Lane], slowed: set[int], signals: Sequence[Signal], content: OpenDrive) -> Junction:
    priorities = content.priorities.get(junction, set())
    conflicts = [
        conflict for one, other in combinations(lanes, 2) for conflict in _conflicts(one, other, slowed, priorities)
    ]
    conflicts.sort(key=lambda conflict: (conflict.lane, conflict.other))
    phases = tuple(_phases(junction, signals, content.controllers))
    return Junction(junction, tuple(lane.index for lane in lanes), tuple(conflicts), phases)


def _conflicts(one: Lane, other: Lane, slowed: set[int], priorities: set[tuple[int, int]]) -> Iterator[Conflict]:
    """Yield the conflict of two lanes, if there is one, once for each of them."""
    if set(one.predecessors) & set(other.predecessors):
        return  # they part
    near = (one.width + other.width) / 2 * _TOUCHING
    if not _boxes_touch(one.points[:, :2], other.points[:, :2], near):
        return
    close = np.linalg.norm(one.points[:, None] - other.points, axis=2) < near
    if not close.any():
        return
    merging = bool(set(one.successors) & set(other.successors))
    yields = _yields(one, other, slowed, priorities)
    for lane, rival, axis, gives_way in ((one, other, 1, yields), (other, one, 0, not yields)):
        along = close.any(axis=axis)
        begin, end = (np.flatnonzero(along)[[0, -1]] * lane.length / (len(along) - 1)).tolist()
        yield Conflict(lane.index, rival.index, begin, end, merging, gives_way)


def _boxes_touch(one: NDArray[np.float64], other: NDArray[np.float64], near: float) -> bool:
    return bool((one.min(axis=0) - near < other.max(axis=0)).all() and (other.min(axis=0) - near < one.max(axis=0)).all())


def _yields(one: Lane, other: Lane, slowed: set[int], priorities: set[tuple[int, int]]) -> bool:
    """Return whether the traffic of one lane yields to that of the other.

    The first rule that distinguishes them decides: stop and yield signs; priorities of the file; right before left; straight
    on before a turn; turns to the own side of the road before those across oncoming traffic.
    """
    if (one.index in slowed) != (other.index in slowed):
        return one.index in slowed
    roads = one.road_id, other.road_id
    if (roads in priorities) != (roads[::-1] in priorities):
        return roads not in priorities
    between = other.heading[0] - one.heading[0]
    if abs(np.cos(between)) < _ALIKE and np.cos(between) > _ONCOMING:
        return bool(np.sin(between) < 0)  # traffic that heads to the left comes from the right
    ranks = _RANKS[one.keeps_left][one.turn], _RANKS[other.keeps_left][other.turn]
    return ranks[0] > ranks[1] if ranks[0] != ranks[1] else one.index > other.index
