"""The criteria of CARLA's Leaderboard, by the definitions of ScenarioRunner's, for a drive that was recorded.

Each is a function that returns infractions, or the frame at which the route ends. docs/scores.md says where they differ.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from carla_recap.model.frame import SAME_TIME
from carla_recap.model.motion import LONGEST_STEP
from carla_recap.queries.measures.drives import WINDOW, traffic_shares
from carla_recap.queries.score.infractions import Infraction
from carla_recap.roads.lanes import DRIVING
from carla_recap.roads.waypoints import NONE, PARKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from carla_recap.model.contacts import Contact
    from carla_recap.model.lives import ActorLife, ActorLives
    from carla_recap.queries.measures.drives import Drive, PlannedRoute
    from carla_recap.queries.measures.road_signals import LightHistory, StopLines
    from carla_recap.roads.network import RoadNetwork
    from carla_recap.roads.waypoints import LaneMap, Waypoints
    from carla_recap.tables.trajectories import Trajectory
    from carla_recap.util.arrays import Booleans, Floats


_SCENARIO: Final = "scenario"  # the role_name of the actors of scenarios
_STATIONARY: Final = 0.1  # m/s: a hero that is slower is stationary
_COMPLETE: Final = (99.0, 10.0)  # % of the route that are passed, and m from its end, where it is complete
_WIDE_WINDOW: Final = 3  # the same, of criteria other than the completion
_NEAR_WINDOW: Final = 5  # points ahead of which the nearest one counts
_FAR: Final = 30.0  # m from the route: a hero that is farther away has left it
_UNSAFE: Final = _FAR / 2  # m from the route
_MOST_UNSAFE: Final = 30.0  # % of the route
_BLOCKED: Final = 180.0  # s
_CUT_OFF: Final = 0.5  # s that may be missing of being blocked at the end: the evaluator then ends the recording
_PATIENCE: Final = 300.0  # s for a route of no length
_CRAWLING: Final = 0.1  # of the speed limit
_USUAL_LIMIT: Final = 30 / 3.6  # m/s, where a map says nothing
_SAME_PLACE: Final = 5.0  # m between two collisions
_SAME_ACTOR: Final = 5.0  # s between two collisions with an actor
_REAR: Final = (0.8, 1.0)  # the rear of the hero: from this share of half its length to m behind its end
_WIDER: Final = 1.2  # a stop line is wider than its lane
_NEAR_LIGHT: Final = 90.0  # degrees between the hero and the lane of a light
_NEAR_STOP: Final = 100.0  # degrees between the hero and the lane of a stop sign
_STOP_ZONE: Final = 6.0  # m before the stop line
_SIGN: Final = 3.0  # m between a recorded stop sign and that of the map
_OUTSIDE: Final = 0.5  # m outside a lane
_AGAINST_LANE: Final = 120.0  # degrees between the hero and a lane that it enters from a junction
_TURNED: Final = 150.0  # degrees between a lane and the next one
_QUARTERS: Final = 4
_HIDDEN: Final = 100.0  # m below the hero: an actor of a scenario that has not begun


class Ending(NamedTuple):
    """How a route ends."""

    frame: int  # the last one that counts
    completion: float  # the completed part of the route in %
    infraction: Infraction | None  # the one that has ended it


def ending(drive: Drive, route: PlannedRoute, network: RoadNetwork) -> Ending:
    """Return how a route ends: at its end, or because the hero has left it, is blocked, or takes too long."""
    last, endings = len(drive) - 1, (_deviation(drive, route), _blocked(drive), _timeout(drive, route, network))
    stop, infraction = min(filter(None, endings), key=lambda each: each[0], default=(last, None))
    shares = np.round(route.travelled / max(route.length, 1e-9) * 100, 2)[route.reached(drive, WINDOW)]
    near = np.linalg.norm(drive.position - route.points[-1], axis=1) < _COMPLETE[1]
    complete = np.flatnonzero((shares > _COMPLETE[0]) & near)
    if len(complete) and complete[0] < stop + (infraction is None):
        return Ending(min(int(complete[0]) + 1, last), 100.0, None)
    return Ending(stop, float(shares[stop]), infraction)


def ending_of_drive(drive: Drive) -> Ending:
    """Return how a drive without a route ends: with the recording, or because it is blocked."""
    stop, infraction = _blocked(drive) or (len(drive) - 1, None)
    return Ending(stop, 100.0, infraction)


def _deviation(drive: Drive, route: PlannedRoute) -> tuple[int, Infraction] | None:
    """Return the frame in which the hero has left the route, if there is one."""
    points, travelled = route.points[:, :2].tolist(), route.travelled.tolist()
    index, unsafe, is_safe = 0, 0.0, True
    for frame, (x, y, _) in zip(drive.frames.tolist(), drive.ticks, strict=True):
        apart, nearest = math.inf, index
        for number, (px, py) in enumerate(points[index : index + _NEAR_WINDOW + 1], index):
            away = math.hypot(x - px, y - py)
            if away <= apart:
                apart, nearest = away, number
        has_left = apart >= _FAR
        if not has_left:
            is_safe = apart < _UNSAFE
        if nearest != index and not is_safe:
            unsafe += travelled[nearest] - travelled[index]
            has_left |= 100 * unsafe / travelled[-1] > _MOST_UNSAFE
        index = nearest
        if has_left:
            return frame, _infraction("route_dev", drive, frame, f"Agent deviated from the route at {_place(drive, frame)}")
    return None


def _blocked(drive: Drive) -> tuple[int, Infraction] | None:
    """Return the frame in which the hero has been stationary for too long, if there is one."""
    since = np.maximum.accumulate(np.where(drive.speed < _STATIONARY, 0, np.arange(len(drive))))
    stationary = np.where(drive.speed < _STATIONARY, drive.time - drive.time[since], 0.0)
    stationary[-1] += _CUT_OFF
    frames = np.flatnonzero(stationary > _BLOCKED)
    if not len(frames):
        return None
    frame = int(frames[0])
    return frame, _infraction("vehicle_blocked", drive, frame, f"Agent got blocked at {_place(drive, frame)}")


def _timeout(drive: Drive, route: PlannedRoute, network: RoadNetwork) -> tuple[int, Infraction] | None:
    """Return the frame in which the time of the hero is up, if there is one."""
    if drive.time[-1] - drive.time[0] <= _PATIENCE:
        return None
    limits = network.lanes_at(drive.position, drive.yaw).limit
    known = np.maximum.accumulate(np.where(np.isfinite(limits), np.arange(len(limits)), -1))
    limits = np.where(known >= 0, limits[known], _USUAL_LIMIT)  # a vehicle keeps the limit that it had last
    driven = np.diff(route.travelled[route.reached(drive, _WIDE_WINDOW)], prepend=0.0)
    allowed = _PATIENCE + np.cumsum(driven / (_CRAWLING * limits))
    late = np.flatnonzero(drive.time - drive.time[0] > allowed)
    return (int(late[0]), _infraction("route_timeout", drive, int(late[0]), "Route timeout.")) if len(late) else None


def collisions(drive: Drive, contacts: Iterable[Contact], actors: ActorLives) -> Iterator[Infraction]:
    """Yield the collisions of the hero: the frames of its contacts that count as new and as its fault.

    A contact in whose frames the hero has no pose counts in the next one that has it, else in the last one, within 1 s.
    """
    hero, end = drive.actor.id, len(drive) - 1
    touches = []
    for contact in contacts:
        if contact.is_of(drive.actor):
            first, last = np.searchsorted(drive.time, (contact.start - SAME_TIME, contact.stop + SAME_TIME)).tolist()
            if first == last and abs(drive.time[min(first, end)] - contact.start) <= LONGEST_STEP:
                first, last = min(first, end), min(first, end) + 1
            other = contact.ids[contact.ids[0] == hero]
            touches += [(frame, other) for frame in range(first, last)]
    place: Floats | None = None
    with_actor, since = None, -math.inf
    at = 0
    for frame, other in sorted(touches):
        before = max(frame - 1, 0)
        if place is not None and (np.linalg.norm(drive.position[at:frame] - place, axis=1) > _SAME_PLACE).any():
            place = None
        at = frame
        if with_actor is not None and drive.time[before] - since > _SAME_ACTOR:
            with_actor = None
        if other == with_actor or drive.speed[before] < _STATIONARY:
            continue
        if place is not None and np.linalg.norm(drive.position[before] - place) <= _SAME_PLACE:
            continue
        place, since = drive.position[before], float(drive.time[before])
        life = None if actors.is_object(other) else actors.at(other, float(drive.time[frame]))
        if not actors.is_object(other):
            with_actor = other
        kind = _kind_of_collision(life, is_object=actors.is_object(other))
        if kind:
            type_id, id = ("static", None) if life is None else (life.type_id, other)
            text = f"Agent collided against object with type={type_id} and id={id or 0} at {_place(drive, before)}"
            yield _infraction(kind, drive, frame, text, id, type_id, at=before)


def _kind_of_collision(life: ActorLife | None, *, is_object: bool) -> str:
    """Return the kind of a collision with an actor or a static object; empty if it is none."""
    type_id = "static" if is_object else life.type_id if life else ""
    if ("static" in type_id or "traffic" in type_id) and "sidewalk" not in type_id:
        return "collisions_layout"
    return "collisions_vehicle" if "vehicle" in type_id else "collisions_pedestrian" if "walker" in type_id else ""


class Passage(NamedTuple):
    """The rear of the hero passes a stop line."""

    start: float  # the elapsed seconds at which the front end of the rear is above the line
    stop: float  # those at which its back end is
    line: int


def passages(drive: Drive, lines: StopLines) -> list[Passage]:
    """Return where the rear of the hero passes the stop lines of lights, in order; at the end, it may be above one."""
    near, far = drive.half_length * _REAR[0], drive.half_length + _REAR[1]
    entered, left = (_crossings(drive, lines, drive.behind(each), _WIDER, _NEAR_LIGHT) for each in (near, far))
    end = float(drive.time[-1])
    return [
        Passage(start, min((stop for stop, other in left if other == line and stop >= start), default=end), line)
        for start, line in entered
        if not lines.is_stop[line]
    ]


def red_lights(drive: Drive, passed: Iterable[Passage], lines: StopLines, lights: LightHistory) -> Iterator[Infraction]:
    """Yield where the rear of the hero is above the stop line of a light that is red."""
    latest: int | None = None
    for start, stop, line in passed:
        signal = int(lines.signal[line])
        light = lights.red(signal, start, stop, always=False)
        if light is not None and light != latest:
            latest = light
            text = f"Agent ran a red light {light} at {_in_carla_axes(lines.place(signal))}"
            yield _infraction("red_light", drive, _frame_at(drive, start), text, light, "traffic.traffic_light")


def stop_signs(drive: Drive, lines: StopLines, actors: ActorLives) -> Iterator[Infraction]:
    """Yield where the hero crosses the stop line of a stop sign without having stopped."""
    latest: int | None = None
    for time, line in _crossings(drive, lines, drive.position, 1.0, _NEAR_STOP):
        signal, frame = int(lines.signal[line]), _frame_at(drive, time)
        if not lines.is_stop[line] or signal == latest:
            continue
        away = np.linalg.norm(drive.position[: frame + 1, :2] - lines.middle[line, :2], axis=1)
        outside = np.flatnonzero(away > _STOP_ZONE)
        first = int(outside[-1]) + 1 if len(outside) else 0
        if not (drive.speed[first : frame + 1] < _STATIONARY).any():
            latest = signal
            place = lines.place(signal)
            signs = (life for life in actors if life.type_id == "traffic.stop")
            id = next((life.id for life in signs if math.dist(life.place[:2], place[:2]) < _SIGN), None)
            text = f"Agent ran a stop with id={id} at {_in_carla_axes(place)}"
            yield _infraction("stop_infraction", drive, frame, text, id, "traffic.stop")


def _crossings(drive: Drive, lines: StopLines, points: Floats, wider: float, turned: float) -> list[tuple[float, int]]:
    """Return when a point of the hero crosses lines, in elapsed seconds, and which, in order; none in a jump."""
    with np.errstate(all="ignore"):
        steps, crossed, shares = lines.crossed(points[:-1], points[1:], drive.yaw[1:], wider=wider, turned=turned)
    driven = drive.steps[steps + 1] > 0
    steps, crossed, shares = steps[driven], crossed[driven], shares[driven]
    times = drive.time[steps] + shares * (drive.time[steps + 1] - drive.time[steps])
    return sorted(zip(times.tolist(), crossed.tolist(), strict=True))


def outside_lanes(drive: Drive, route: PlannedRoute, town: LaneMap) -> Iterator[Infraction]:
    """Yield an infraction for all that the hero drives outside the lanes for cars, or on those of the other direction."""
    driving, parking = (town.nearest(drive.position, kind) for kind in (DRIVING, PARKING))
    outside = _outside(drive, driving, parking) | _against(drive, driving, town)
    total = wrong = 0.0
    index, latest = 0, 0
    for tick, number in route.passed(drive.ticks, _WIDE_WINDOW):
        driven = route.travelled[number] - route.travelled[index]  # a driven path has jumps
        step = min(float(np.linalg.norm(route.points[number] - route.points[index])), float(driven))
        index, frame = number, int(drive.frames[tick])
        total += step
        if outside[frame]:
            wrong += step
            latest = latest or frame
    if wrong:
        share = wrong / total
        text = (
            f"Agent went outside its route lanes for about {round(wrong, 3)} meters "
            f"({round(share * 100, 2)}% of the completed route)"
        )
        yield _infraction("outside_route_lanes", drive, latest, text, share=share)


def _outside(drive: Drive, driving: Waypoints, parking: Waypoints) -> Booleans:
    """Return in which frames the hero is outside the nearest lane for cars or for parking."""
    best, widths = np.full(len(drive), np.inf), np.zeros(len(drive))
    for at in (parking, driving):
        away = np.where(at.lane == NONE, np.inf, np.linalg.norm(drive.position - at.position, axis=1))
        best, widths = np.where(away < best, away, best), np.where(away < best, at.width, widths)
    outside: Booleans = best > widths / 2 + _OUTSIDE
    return outside


def _against(drive: Drive, at: Waypoints, town: LaneMap) -> Booleans:
    """Return in which frames the hero is on a lane of the other direction, as it is when it changes to one."""
    flags = np.zeros(len(drive), np.bool_)
    last, was_in_junction, last_heading, is_against = (-1, 0), False, 0.0, False
    headings, yaws = np.degrees(at.heading).tolist(), np.degrees(drive.yaw).tolist()
    for frame, lane in enumerate(at.lane.tolist()):
        if lane != NONE:
            name = town.lanes[lane].road, town.lanes[lane].id
            in_junction = bool(town.in_junction[lane])
            if in_junction:
                is_against = False
            elif frame and name != last:
                if was_in_junction:
                    is_against = _between(headings[frame], yaws[frame]) >= _AGAINST_LANE
                elif _between(headings[frame], last_heading) > _TURNED:
                    is_against = not is_against
            last, was_in_junction, last_heading = name, in_junction, headings[frame]
        flags[frame] = is_against
    return flags


def _between(one: float, other: float) -> float:
    """Return the angle between two directions in degrees, up to 180."""
    return abs((one - other + 180) % 360 - 180)


def slow_quarters(drive: Drive, travelled: Floats, length: float, others: Iterable[Trajectory]) -> Iterator[Infraction]:
    """Yield the quarters of the route along which the hero is slower than the background vehicles; see `traffic_shares`."""
    for end, percentage in traffic_shares(drive, travelled, length, others, _QUARTERS):
        if percentage < 100:
            text = f"Average speed is {percentage}% of the surrounding traffic's one"
            yield _infraction("min_speed_infractions", drive, end, text, share=1 - percentage / 100)


def not_yielded(drive: Drive, others: Iterable[tuple[ActorLife, Trajectory]]) -> Iterator[Infraction]:
    """Yield the emergency vehicles of scenarios that are behind the hero when they disappear, or at the end."""
    for life, path in others:
        frames = np.flatnonzero((path.time >= drive.time[0]) & (path.time <= drive.time[-1]))
        if len(frames) and is_emergency(life):
            row = int(frames[-1])
            frame = _frame_at(drive, float(path.time[row]))
            x, y, z = drive.position[frame] - (path.x[row], path.y[row], path.z[row])
            yaw = math.radians(path.yaw[row])
            if z < _HIDDEN and x * math.cos(yaw) + y * math.sin(yaw) > 0:
                text = "Agent failed to yield to an emergency vehicle"
                yield _infraction("yield_emergency_vehicle_infractions", drive, frame, text, life.id, life.type_id)


def is_emergency(life: ActorLife) -> bool:
    """Return whether an actor is an emergency vehicle of a scenario."""
    return life.attributes.get("special_type") == "emergency" and life.role_name == _SCENARIO


def _frame_at(drive: Drive, time: float) -> int:
    """Return the first frame at a time or after it, or the last one."""
    return min(int(np.searchsorted(drive.time, time - SAME_TIME)), len(drive) - 1)


def _infraction(
    kind: str,
    drive: Drive,
    frame: int,
    text: str,
    actor: int | None = None,
    type_id: str = "",
    *,
    share: float = 1.0,
    at: int | None = None,
) -> Infraction:
    """Return an infraction at the time of a frame, and at the place of the hero then or in another frame."""
    x, y, z = drive.position[frame if at is None else at].tolist()
    return Infraction(kind, float(drive.time[frame]), x, y, z, actor, type_id, share, text)


def _place(drive: Drive, frame: int) -> str:
    return _in_carla_axes(drive.position[frame].tolist())


def _in_carla_axes(place: Sequence[float]) -> str:
    """Return a place in CARLA's axes, as the Leaderboard writes it."""
    x, y, z = place
    return f"(x={round(x, 3)}, y={round(0.0 - y, 3)}, z={round(z, 3)})"
