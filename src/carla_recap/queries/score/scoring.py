"""The score of a recording by a route: how much of it the hero completes, and what it does wrong."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING, Final, TypedDict

import numpy as np

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.model.lives import HERO, ActorName, find_actor
from carla_recap.queries.measures.drives import (
    BACKGROUND,
    LONGEST_FRAME,
    Drive,
    PlannedRoute,
    background,
    comfort,
    efficiency,
)
from carla_recap.queries.measures.road_signals import LightHistory, StopLines
from carla_recap.queries.recorded_actors import lives_and_contacts
from carla_recap.queries.roads import find_map_of
from carla_recap.queries.score import criteria
from carla_recap.queries.score.infractions import FORMULAS, INFRACTIONS, Formula, Infraction, penalty_of
from carla_recap.queries.score.route_files import repetition
from carla_recap.roads.planning import RoutePlanner
from carla_recap.roads.polylines import stations
from carla_recap.roads.surfaces import load_road_network
from carla_recap.roads.waypoints import load_lane_map
from carla_recap.tables.trajectories import Trajectory, trajectories
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from carla_recap.formats.base import Reader
    from carla_recap.queries.score.route_files import Route
    from carla_recap.roads.network import RoadNetwork
    from carla_recap.roads.waypoints import LaneMap

PERFECT, COMPLETED, FAILED, DRIVEN = "Perfect", "Completed", "Failed", "Driven"
"""The status of a route that is completed without infractions, or with some, or not; and that of a drive without a route."""

_UNPUNISHED: Final = "min_speed_infractions"  # the kind with which a route is a success
_BEHIND_JUNCTION: Final = 8  # points behind the first one in a junction, by which Bench2Drive has passed it
_AROUND: Final = 1.0  # s around stop lines in which lights are read
_DROP: Final = 0.5
"""The height above the road of the first point of a route in m: the evaluator drops the hero there."""


@dataclass(frozen=True, kw_only=True)
class ScoreOptions:
    """How to score.

    Attributes:
        formula: The version of the Leaderboard whose formula counts.
        actor: The vehicle that is scored: its id, or "hero".
        road_map: The OpenDRIVE file of the map, or the folder to look in; None: the usual folders.
        start: The elapsed seconds from which the drive counts.
        stop: The elapsed seconds until which it counts, unless the route ends earlier.

    Raises:
        RecapError: There is no such formula.
    """

    formula: Formula = "2.0"
    actor: ActorName = HERO
    road_map: str | None = None
    start: float = -np.inf
    stop: float = np.inf

    def __post_init__(self) -> None:
        if self.formula not in FORMULAS:
            raise RecapError(f"{self.formula!r} is no formula; there are {', '.join(FORMULAS)}")


class ScoreKeywords(TypedDict, total=False):
    """The fields of `ScoreOptions`, as keywords."""

    formula: Formula
    actor: ActorName
    road_map: str | None
    start: float
    stop: float


@dataclass(frozen=True, slots=True)
class Score:
    """The score of a recording.

    Attributes:
        recording: The path or URL of the recording.
        route: The id of the route; empty without one.
        repetition: The number of the repetition of the route, by the name of the recording.
        town: The name of the map.
        formula: The version of the Leaderboard whose formula counts.
        status: `Perfect`, `Completed`, or `Failed` with the reason, if the Leaderboard has one; `Driven` without a route.
        score: The driving score: the completion times the penalty, 0 to 100.
        completion: The completed part of the route in %; 100 without a route, where it means nothing.
        penalty: The factor by which infractions reduce the score, 0 to 1.
        infractions: The infractions, in order of time.
        route_length: The length of the route in m, or without one that of the driven path.
        driven: The distance driven in m.
        start: The elapsed seconds at which the drive begins.
        stop: The elapsed seconds at which it ends.
        scenarios: The types of the scenarios along the route.
        efficiency: Bench2Drive's driving efficiency, the speed in % of that of the background vehicles; None without any.
        smoothness: Bench2Drive's driving smoothness, the windows of 2 s in % in which all quantities are within nuPlan's
            bounds of comfort; None for a drive that is too short.
        within: The same for each quantity, by its name in `driving.COMFORT`.
        junction: The part of the route in % that ends behind its first junction; None without one.
    """

    recording: str
    route: str
    repetition: int
    town: str
    formula: Formula
    status: str
    score: float
    completion: float
    penalty: float
    infractions: tuple[Infraction, ...] = field(repr=False)
    route_length: float
    driven: float
    start: float
    stop: float
    scenarios: tuple[str, ...] = ()
    efficiency: float | None = None
    smoothness: float | None = None
    within: Mapping[str, float] = field(default_factory=dict, repr=False, hash=False)
    junction: float | None = None

    @property
    def success(self) -> bool | None:
        """Whether the route is completed without infractions, but for those of the minimum speed; None without a route."""
        if not self.route:
            return None
        is_clean = all(infraction.kind == _UNPUNISHED for infraction in self.infractions)
        return is_clean and self.status in (PERFECT, COMPLETED)

    @property
    def outcome(self) -> str:
        """The status, with the reason where the Leaderboard has none: that the recording ends on the route."""
        return f"{FAILED} - Recording ends at {self.completion:.2f} % of the route" if self.status == FAILED else self.status

    @property
    def duration(self) -> float:
        """The time of the drive in s."""
        return self.stop - self.start

    def count(self, kind: str) -> int:
        """Return the number of infractions of a kind."""
        return sum(infraction.kind == kind for infraction in self.infractions)


def score(source: Reader, route: Route | None, options: ScoreOptions | None = None) -> Score:
    """Return the score of a recording; without a route, infractions are judged along the driven path.

    Raises:
        RecapError: The map is unknown, there is no such vehicle, the route does not fit the map, or events were lost.
        FormatError: The file contradicts its format.
        RecapWarning: A leg of the route is many times its straight distance, a speed is unknown, or a frame lasts long.
    """
    options = options or ScoreOptions()
    source.expect_events()
    path = find_map_of(source, options.road_map, needed=True)
    assert path is not None
    town, network = load_lane_map(path), load_road_network(path)
    actors, contacts = lives_and_contacts(source)
    hero = find_actor(source.location, [life for life in actors if life.kind == "vehicle"], options.actor, "vehicle")
    also = (life for life in actors if life.role_name == BACKGROUND or criteria.is_emergency(life))
    lives = [hero, *(life for life in also if life is not hero)]
    paths = trajectories(source, {life.id for life in lives})
    of_hero, *others = [(life, paths.get(life.id, Trajectory.empty(life.id)).of_life(life)) for life in lives]
    whole = _drive(source, Drive.of(*of_hero), options)
    unknown = int(np.count_nonzero(np.isnan(whole.velocity).any(axis=1)))
    if unknown > 1:
        text = f"the speed of actor {hero.id} is unknown in {unknown} of {len(whole)} frames, in which it counts as moving"
        warnings.warn(f"{source.location}: {text}", RecapWarning, stacklevel=2)
    long = np.flatnonzero(np.diff(whole.time) > LONGEST_FRAME)
    if len(long):
        text = f"{len(long)} frames last longer than {LONGEST_FRAME:g} s, the first at {whole.time[long[0]]:.2f} s"
        warnings.warn(f"{source.location}: {text}; of each, {LONGEST_FRAME:g} s count", RecapWarning, stacklevel=2)
    touched = [each for each in contacts if each.start <= options.stop and each.stop >= options.start]
    planned = PlannedRoute.of_drive(whole) if route is None else _planned(route, town, path)
    end = criteria.ending(whole, planned, network) if route else criteria.ending_of_drive(whole)
    drive = whole.part(0, end.frame)
    lines = StopLines(network)
    passed = criteria.passages(drive, lines)
    traffic = background(paths, lives)
    travelled = drive.driven if route is None else planned.travelled_by(drive)
    length = planned.length if route else drive.driven[-1]
    found = [
        *(each for each in criteria.collisions(whole, touched, actors) if each.time <= drive.time[-1]),
        *criteria.red_lights(drive, passed, lines, _lights(source, network, passed)),
        *criteria.stop_signs(drive, lines, actors),
        *criteria.outside_lanes(drive, planned, town),
        *criteria.slow_quarters(drive, travelled, length, traffic),
        *criteria.not_yielded(drive, others),
        *([end.infraction] if end.infraction else []),
    ]
    counted = [each for each in found if INFRACTIONS[each.kind].counts(options.formula)]
    penalty = penalty_of(counted, options.formula)
    smooth = comfort(drive.time, drive.velocity, drive.yaw)
    return Score(
        source.location,
        route.id if route else "",
        repetition(source.location),
        source.header.map_name,
        options.formula,
        _status(end, counted, has_route=route is not None),
        round(end.completion * penalty, 6),
        end.completion,
        round(penalty, 6),
        tuple(sorted(counted, key=lambda each: each.time)),
        round(planned.length, 3),
        round(float(drive.driven[-1]), 3),
        float(drive.time[0]),
        float(drive.time[-1]),
        route.scenarios if route else (),
        efficiency(drive, travelled, length, traffic),
        smooth and smooth.smoothness,
        smooth.within if smooth else {},
        planned.junction,
    )


def _drive(source: Reader, drive: Drive, options: ScoreOptions) -> Drive:
    """Return the part of a drive that counts."""
    rows = np.flatnonzero((drive.time >= options.start) & (drive.time <= options.stop)).tolist()
    if len(rows) < 2:
        raise RecapError(f"{source.location}: the vehicle to score has {len(rows)} poses; 2 or more were expected")
    return drive.part(rows[0], rows[-1])


def _lights(source: Reader, network: RoadNetwork, passed: list[criteria.Passage]) -> LightHistory:
    """Return the states of traffic lights while the hero passes stop lines."""
    lights = LightHistory(source, network)
    if passed:
        start, stop = passed[0].start - _AROUND, max(passage.stop for passage in passed) + _AROUND
        for batch in source.batches(("light_states",), start=start, stop=stop):
            lights.add(batch)
    return lights


def _planned(route: Route, town: LaneMap, path: Path) -> PlannedRoute:
    """Return the points of a route along the lanes of a town."""
    name = f"{route.path}: route {visible(route.id)!r}"
    try:
        at = _planner(town).route(route.positions, name)
    except ValueError as error:
        raise RecapError(f"{name}: {error} of {path}") from None
    points = at.position.copy()
    points[0, 2] += _DROP
    junctions = np.flatnonzero(town.in_junction[at.lane])
    behind = 100 * float(junctions[0] + 1 + _BEHIND_JUNCTION) / len(points) if len(junctions) else None
    return PlannedRoute(points, at.ahead, stations(points), behind)


_planner = lru_cache(2)(RoutePlanner)


def _status(end: criteria.Ending, infractions: list[Infraction], *, has_route: bool) -> str:
    if not has_route and end.infraction is None:
        return DRIVEN
    if has_route and end.completion >= 100:
        return COMPLETED if infractions else PERFECT
    return f"{FAILED} - {INFRACTIONS[end.infraction.kind].ends}" if end.infraction else FAILED
