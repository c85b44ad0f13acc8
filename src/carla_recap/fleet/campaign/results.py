"""What is measured in the recording of each run of a campaign, and which of two runs is worse."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from carla_recap.errors import RecapError, RecapWarning
from carla_recap.fleet.scores import score
from carla_recap.queries.measures import MEASURES, SHORT_NAMES, Measure
from carla_recap.queries.score import Route, route_for

if TYPE_CHECKING:
    from collections.abc import Mapping

    from carla_recap.recording import Recording

COLLISIONS: Final = Measure(
    name="collisions",
    unit="",
    extreme="greatest",
    text="the number of contacts of the heroes; without a hero, of all actors with a collision sensor",
)
BROKEN_RULES: Final = Measure(
    name="broken_rules", unit="", extreme="greatest", text="the number of rules that the recording breaks"
)
IMPACT_SPEED: Final = Measure(
    name="impact_speed",
    unit="m/s",
    extreme="greatest",
    text="the greatest relative speed just before one of these contacts; without a value where it is unknown",
)
SCORE: Final = Measure(name="score", unit="", extreme="least", text="the driving score of the Leaderboard")
EFFICIENCY: Final = MEASURES["driving_efficiency"]
SMOOTHNESS: Final = MEASURES["driving_smoothness"]
RESULTS: Final[Mapping[str, Measure]] = {
    measure.name: measure
    for measure in (COLLISIONS, IMPACT_SPEED, BROKEN_RULES, SCORE, EFFICIENCY, SMOOTHNESS, *MEASURES.values())
    if not measure.needs_roads
}
"""What the runs of a campaign can be compared by, by name."""


@dataclass(frozen=True, slots=True)
class Result:
    """The value of a measure in a recording."""

    value: float
    time: float | None = None  # in elapsed seconds; None if it has no time
    actor: int | None = None  # the id of the actor; None if there is none


@dataclass(frozen=True, slots=True)
class Scoring:
    """How the recordings of a campaign are scored."""

    routes: tuple[Route, ...] | None  # of a file; None: the driven path of the hero
    route_id: str | None = None  # None: that of the recording's town
    road_map: str | None = None  # the map, or the folder to look in; None: the usual folders

    def results(self, recording: Recording) -> dict[str, Result]:
        """Return the score of a recording, with the time of the first infraction, and the known numbers of Bench2Drive."""
        route = None if self.routes is None else route_for(self.routes, recording.reader, self.route_id)
        found = score(recording, route, road_map=self.road_map)
        values = {EFFICIENCY.name: found.efficiency, SMOOTHNESS.name: found.smoothness}
        driving = {name: Result(value) for name, value in values.items() if value is not None}
        return {SCORE.name: Result(found.score, found.infractions[0].time if found.infractions else None), **driving}


def result_named(name: str) -> Measure:
    """Return what runs can be compared by, by its name, such as `time_to_collision`, or the short one, such as `ttc`."""
    plain = name.lower().replace("-", "_")
    found = RESULTS.get(SHORT_NAMES.get(plain, plain))
    if found is None:
        raise RecapError(f"{name[:100]!r}: is no measure of a run; one of {', '.join(RESULTS)} was expected")
    return found


def severity(results: Mapping[str, Result], measure: Measure) -> tuple[float, float, float]:
    """Return what sorts runs, the worst first: a measure, unknown last; of equal values crashes first, the fastest first."""
    found, collisions, impact = (results.get(each.name) for each in (measure, COLLISIONS, IMPACT_SPEED))
    return (
        math.inf if found is None else measure.key(found.value),
        -float(collisions is not None and collisions.value > 0),
        0.0 if impact is None else -impact.value,
    )


def result_text(results: Mapping[str, Result], measure: Measure) -> str:
    """Return that a run has crashed, and how fast, if it has; and the value of a measure, or that there is none."""
    collisions, impact, found = (results.get(each.name) for each in (COLLISIONS, IMPACT_SPEED, measure))
    said = []
    if collisions is not None and collisions.value:
        said.append("crashed" if impact is None else f"crashed at {impact.value * 3.6:.0f} km/h")
    value = f"no {measure.title}" if found is None else f"{measure.title} {found.value:.3g} {measure.unit}".rstrip()
    return ", ".join((*said, value))


def measured(recording: Recording, scoring: Scoring | None = None) -> dict[str, Result]:
    """Return the most critical values of the measures of a recording's heroes, or if there is none, of all vehicles.

    With `scoring`, it has a score, too; that it cannot be scored is a warning.
    """
    rows, has_hero = recording.collisions(), bool(recording.heroes)
    hits = [
        (row, row.id1 if row.hero1 or not has_hero else row.id2) for row in rows if not has_hero or row.hero1 or row.hero2
    ]
    count = float(len({row.contact for row, _ in hits}))
    first, actor = hits[0] if hits else (None, None)
    found = {COLLISIONS.name: Result(count, first.elapsed if first else None, actor)}
    impacts = [hit for hit in hits if not math.isnan(hit[0].relative_speed)]
    if impacts:
        row, actor = max(impacts, key=lambda hit: hit[0].relative_speed)
        found[IMPACT_SPEED.name] = Result(row.relative_speed, row.elapsed, actor)
    for each in recording.measures():
        best, key = found.get(each.measure), MEASURES[each.measure].key
        if each.measure in RESULTS and (best is None or key(each.value) < key(best.value)):
            found[each.measure] = Result(each.value, each.time, each.actor)
    if scoring is not None:
        try:
            found.update(scoring.results(recording))
        except RecapError as error:
            warnings.warn(f"{error}; it has no score", RecapWarning, stacklevel=2)
    return found
