"""Scores of one recording or of many, and limits for them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final

from carla_recap.fleet.check import CheckedRecording, unread
from carla_recap.fleet.engine import map_sources
from carla_recap.queries.score import Route, ScoreOptions, read_routes, route_for
from carla_recap.queries.score import score as score_of
from carla_recap.recording import open_recording
from carla_recap.rules.rule_sets import Verdict
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Mapping, Sequence
    from pathlib import Path
    from typing import Unpack

    from carla_recap.fleet.engine import Processes
    from carla_recap.fleet.outcomes import Outcome
    from carla_recap.fleet.sources import SourceFile
    from carla_recap.queries.score import Infraction, Score
    from carla_recap.queries.score.scoring import ScoreKeywords
    from carla_recap.recording import Recording

_LISTED: Final = 20  # infractions that a verdict lists


def score(
    recording: Recording,
    route: Route | Path | str | None = None,
    *,
    route_id: str | None = None,
    **options: Unpack[ScoreKeywords],
) -> Score:
    """Return the score of a recording, as CARLA's Leaderboard scores a drive.

    Args:
        recording: The recording.
        route: A route, or a route file; None: infractions are judged along the driven path.
        route_id: The id of the route in the file; None: the one in the name of the recording, if the evaluator has named it
            (`RouteScenario_3_rep0.log`), else the only one of its town.
        options: The fields of `ScoreOptions`: `formula`, "1.0", "2.0" or "2.1"; `actor`; `road_map`; `start` and `stop`.

    Raises:
        RecapError: The map is unknown, there is no such vehicle or route, or the route does not fit the map.
        FormatError: The recording or the route file contradicts its format.
    """
    if route is not None and not isinstance(route, Route):
        route = route_for(read_routes(route), recording.reader, route_id)
    return score_of(recording.reader, route, ScoreOptions(**options))


def score_sources(
    sources: Iterable[SourceFile],
    routes: Sequence[Route] | None,
    options: ScoreOptions,
    *,
    route_id: str | None = None,
    **processes: Unpack[Processes],
) -> Generator[Outcome[Score], None, None]:
    """Yield the scores of many recordings, in their order, by routes of files; None: the driven path of each vehicle."""
    return map_sources(partial(_scored, routes, route_id, options), sources, **processes)


def _scored(routes: Sequence[Route] | None, route_id: str | None, options: ScoreOptions, source: SourceFile) -> Score:
    with open_recording(source.address) as recording:
        route = None if routes is None else route_for(routes, recording.reader, route_id)
        return score_of(recording.reader, route, options)


@dataclass(frozen=True, kw_only=True)
class ScoreLimits:
    """Limits for the score of a recording."""

    score: float | None = None  # the least driving score; None for any
    completion: float | None = None  # the least completion in %
    infractions: int | None = None  # the most infractions of all kinds
    of_kind: Mapping[str, int] = field(default_factory=dict)  # the most of a kind, by its name

    def __bool__(self) -> bool:
        return self != ScoreLimits()

    def check(self, outcome: Outcome[Score]) -> CheckedRecording:
        """Return a recording with a verdict on its score for each limit."""
        least = {name: limit for name in ("score", "completion") if (limit := getattr(self, name)) is not None}
        most = ({} if self.infractions is None else {"infractions": self.infractions}) | {**self.of_kind}
        score = outcome.value
        if score is None:
            return unread(outcome, (*least, *most))
        verdicts = []
        for name, limit in least.items():
            value = getattr(score, name)
            message = f"{name} {value:.2f}, at least {limit:g} was expected; {score.status}"
            verdicts.append(_verdict(name, value >= limit, message, score.infractions))
        for name, limit in most.items():
            found = [each for each in score.infractions if name in ("infractions", each.kind)]
            message = f"{len(found)} {name}, at most {limit} were expected"
            verdicts.append(_verdict(name, len(found) <= limit, message, found))
        return CheckedRecording(outcome.source.location, tuple(verdicts), visible(score.town), warnings=outcome.warnings)


def _verdict(name: str, passes: bool, message: str, infractions: Sequence[Infraction]) -> Verdict:
    if passes:
        return Verdict(name, "pass", message)
    first = infractions[0] if infractions else None
    details = tuple(f"{each.time:.2f} s: {visible(each.text)}" for each in infractions[:_LISTED])
    actors = () if first is None or first.actor is None else (first.actor,)
    return Verdict(name, "fail", message, None if first is None else first.time, actors, details)
