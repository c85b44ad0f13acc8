"""The command that scores recordings as CARLA's Leaderboard scores drives."""

from __future__ import annotations

import shlex
from functools import partial
from itertools import groupby
from typing import TYPE_CHECKING, Final, NoReturn

import click

from carla_recap.cli import options
from carla_recap.cli.many import SourcesRequest
from carla_recap.cli.options import FOLLOW, PERCENT, Parsed, command, flag, option
from carla_recap.cli.output import emit, end, fail, indented, wrote
from carla_recap.output.terminal import TableColumn, number_column, print_table
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from carla_recap.fleet.outcomes import Outcome
    from carla_recap.model.lives import ActorName
    from carla_recap.queries.score import Formula, Score

_SUITE: Final = "carla-recap score"
FORMULAS: Final = ("1.0", "2.0", "2.1")
"""The formulas of `carla_recap.queries.score`, which takes long to import."""


def _limit(text: str) -> tuple[str, int]:
    """Return a kind of infraction, and how many of it are allowed."""
    from carla_recap.queries.score import INFRACTIONS

    kind, _, number = text.partition("=")
    if kind not in INFRACTIONS or not (number.isascii() and number.isdecimal() and len(number) < 10):
        kinds = ", ".join(INFRACTIONS)
        raise ValueError(f"{text!r} is no limit; KIND=N was expected, such as red_light=0, where KIND is of {kinds}")
    return kind, int(number)


@command(epilog="Each SOURCE is a recording, a folder, a glob in quotes, or a URL; - is a list of them on stdin.")
def score(
    sources: tuple[str, ...] = options.sources,
    route_files: tuple[str, ...] = options.path(
        *("--route", "route_files"),
        multiple=True,
        help="The route, in a Leaderboard route file; several files may be given.",
    ),
    route_id: str | None = option(
        "--route-id", metavar="ID", help="Its id; else the one that the recording's name or town says."
    ),
    from_drive: bool = flag("--from-drive", help="Score without a route: the infractions along the driven path."),
    formula: Formula = option(
        "--formula",
        type=click.Choice(FORMULAS),
        default="2.0",
        help="The version of the Leaderboard whose formula counts.",
    ),
    actor: ActorName = option(
        "--actor",
        type=FOLLOW,
        default="hero",
        show_default=False,
        metavar="ID|hero",
        help="The vehicle to score; else the hero.",
    ),
    min_score: float | None = option(
        "--min-score", type=PERCENT, metavar="N", help="End with exit code 1 if a score is lower."
    ),
    min_completion: float | None = option(
        "--min-completion", type=PERCENT, metavar="N", help="The same for the completion in %."
    ),
    max_infractions: int | None = option(
        "--max-infractions", type=click.IntRange(min=0), metavar="N", help="End with exit code 1 if a recording has more."
    ),
    limits: tuple[tuple[str, int], ...] = option(
        *("--max", "limits"),
        type=Parsed("limit", _limit),
        multiple=True,
        metavar="KIND=N",
        help="The same for a kind: red_light=0.",
    ),
    junit: str | None = options.path("--junit", help="Write what becomes of these limits as JUnit XML."),
    road_map: str | None = options.road_map,
    jobs: int | None = options.jobs,
    dask: str | None = options.dask,
    form: str | None = options.json_or_text,
) -> NoReturn:
    """Score recordings of drives along routes, as CARLA's Leaderboard does.

    Several recordings also get a mean. --json prints the Leaderboard's form of results. The exit code is 1 if a limit is
    not kept, 2 if a recording cannot be scored.
    """
    from carla_recap.fleet.junit import prepare_junit, write_junit
    from carla_recap.fleet.scores import ScoreLimits, score_sources
    from carla_recap.queries.score import ScoreOptions, read_routes
    from carla_recap.queries.score.checkpoint import checkpoint

    if bool(route_files) == from_drive:
        raise click.UsageError("One of --route and --from-drive was expected.")
    if min_completion is not None and from_drive:
        raise click.UsageError("--min-completion goes with --route.")
    if route_id is not None and from_drive:
        raise click.UsageError("--route-id goes with --route.")
    allowed = ScoreLimits(score=min_score, completion=min_completion, infractions=max_infractions, of_kind=dict(limits))
    if junit and not allowed:
        raise click.UsageError("--junit goes with a limit, such as --min-score.")
    routes = read_routes(*route_files) if route_files else None
    wanted = ScoreOptions(formula=formula, actor=actor, road_map=road_map)
    if junit:
        prepare_junit(junit)
    outcomes: list[Outcome[Score]] = []
    score_each = partial(score_sources, routes=routes, options=wanted, route_id=route_id)
    request = SourcesRequest(sources=sources, jobs=jobs, dask=dask)
    with request.reading("scoring", score_each) as (scored, messages):
        for outcome in scored:
            outcomes.append(outcome)
            messages.add(outcome.source.location, outcome.warnings, outcome.error)
        messages.end()
    scores = [outcome.value for outcome in outcomes if outcome.value is not None]
    if scores or form == "json":
        text = partial(_lines, scores[0]) if len(scores) == 1 else partial(_text, scores)
        table = text if len(scores) == 1 else lambda: print_table(_COLUMNS, _rows(scores))
        emit(form, json=lambda: indented(checkpoint(scores)), text=text, table=table)
    judged = [allowed.check(outcome) for outcome in outcomes]
    if junit:
        write_junit(judged, junit, suite=_SUITE)
        wrote(junit)
    broken = [(each, verdict) for each in judged for verdict in each.verdicts if verdict.status == "fail"]
    for each, verdict in broken:
        fail(f"{each.recording}: {verdict.message}")
    end(failed=messages.failed, unmet=broken)


def _lines(score: Score) -> Iterator[str]:
    """Yield a score in words, its infractions, a line each, and how to see the first of them."""
    from carla_recap.queries.score import INFRACTIONS

    name, of_route = "no route", ""
    product = f"{score.score:.2f} = 100 x {score.penalty:.4f}, without completion"
    if score.route:
        name, of_route = f"route {score.route}", f", along a route of {score.route_length:.0f} m"
        product = f"{score.score:.2f} = {score.completion:.2f} % x {score.penalty:.4f}"
    yield f"{visible(name)} of {visible(score.town)}: {score.outcome}\n"
    yield f"score {product}, by the formula of Leaderboard {score.formula}\n"
    yield f"{score.driven:.0f} m driven in {score.duration:.1f} s{of_route}; Bench2Drive: {_driving(score)}\n"
    for each, same in groupby(score.infractions):
        cost, count = _cost(each.kind, each.share, score.formula), len(list(same))
        times = "" if count == 1 else ", counted twice" if count == 2 else f", counted {count} times"
        yield f"{each.time:9.2f} s  {cost:7}  {INFRACTIONS[each.kind].label} ({each.kind}): {visible(each.text)}{times}\n"
    if score.infractions:
        link = score.infractions[0].link
        moment, recording = shlex.quote(score.recording + link), shlex.quote(score.recording)
        yield f"to see the first: carla-recap view {moment}\n"
        yield f"as a picture: carla-recap snapshot {moment} moment.png\n"
        yield f"as a page, at page.html{link}: carla-recap report {recording} page.html\n"


def _driving(score: Score) -> str:
    """Return the numbers of Bench2Drive in words."""
    efficiency = "unknown without background vehicles" if score.efficiency is None else f"{score.efficiency:.2f} %"
    smoothness = "unknown" if score.smoothness is None else f"{score.smoothness:.2f} %"
    success = "" if score.success is None else "success, " if score.success else "no success, "
    return f"{success}efficiency {efficiency}, smoothness {smoothness}"


def _cost(kind: str, share: float, formula: Formula) -> str:
    """Return what an infraction costs: a factor, or what it adds to the divisor."""
    from carla_recap.queries.score import INFRACTIONS

    row = INFRACTIONS[kind]
    if formula == "2.1" and row.coefficient is not None:
        return f"+{row.coefficient * share:.3f}"
    return "" if row.factor is None else f"x{1 - (1 - row.factor) * share:.3f}"


def _text(scores: Sequence[Score]) -> Iterator[str]:
    headings = tuple(column.heading for column in _COLUMNS)
    return ("\t".join(row) + "\n" for row in (headings, *_rows(scores)))


def _rows(scores: Sequence[Score]) -> list[tuple[str, ...]]:
    """Return a row for each score, and the mean and the standard deviation of all."""
    from carla_recap.queries.score.checkpoint import bench2drive, means

    rows = [tuple(column.cell(each) for column in _COLUMNS) for each in scores]
    averages, overall = means(scores), bench2drive(scores)
    rate = overall["success_rate"]
    driving = (
        "" if rate is None else f"{rate:.2f} %",
        *map(_percent, (overall["driving_efficiency"], overall["driving_smoothness"])),
    )
    for word, number in (("mean", 0), ("std. deviation", 1)):
        score, completion, penalty = (averages[name][number] for name in ("score", "completion", "penalty"))
        completed = f"{completion:.2f}" if any(each.route for each in scores) else ""
        rows.append(
            (word, "", f"{score:.2f}", completed, f"{penalty:.3f}", "", "", "", *(("", "", "") if number else driving))
        )
    return rows


def _percent(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _counts(score: Score) -> str:
    """Return the numbers of infractions by kind."""
    from carla_recap.queries.score import INFRACTIONS

    counts = {name: score.count(name) for name in INFRACTIONS}
    return ", ".join(f"{count} x {name}" for name, count in counts.items() if count)


_COLUMNS: Final = (
    TableColumn("Recording", lambda each: visible(each.recording), narrowed="middle"),
    TableColumn("Route", lambda each: visible(each.route)),
    number_column("Score", lambda each: f"{each.score:.2f}"),
    number_column("Completion (%)", lambda each: f"{each.completion:.2f}" if each.route else ""),
    number_column("Penalty", lambda each: f"{each.penalty:.3f}"),
    number_column("Duration (s)", lambda each: f"{each.duration:.1f}", rank=2),
    TableColumn("Status", lambda each: each.outcome, narrowed="end", rank=1),
    TableColumn("Infractions", _counts, narrowed="words"),
    TableColumn("Success", lambda each: "" if each.success is None else "yes" if each.success else "no", rank=3),
    number_column("Efficiency (%)", lambda each: _percent(each.efficiency), rank=4),
    number_column("Smoothness (%)", lambda each: _percent(each.smoothness), rank=4),
)
