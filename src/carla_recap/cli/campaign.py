"""The command that runs a simulation with many seeds and parameters, and compares the runs."""

from __future__ import annotations

import math
import os
import sys
from collections import Counter
from contextlib import ExitStack, closing
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

import click

from carla_recap.cli import options
from carla_recap.cli.check import loaded_rules
from carla_recap.cli.many import cluster
from carla_recap.cli.options import JOBS, NUMBER, POSITIVE, argument, command, flag, option, together
from carla_recap.cli.output import counted, emit, end, fail, note, say, warn, wrote
from carla_recap.cli.progress import SourcesBar

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence

    from carla_recap.fleet.campaign import Campaign, FinishedRun
    from carla_recap.fleet.campaign.plan import ParameterRange, Value
    from carla_recap.fleet.campaign.results import Scoring
    from carla_recap.fleet.engine import Processes
    from carla_recap.queries.measures import Measure

_SHOWN: Final = 5  # of the worst runs, and of failed ones
_OF_CAMPAIGNS: Final = ("out", "town", "duration", "additional_data", "limit", "jobs", "again", "carla", "python")
"""The fields of `Campaign` that are options."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignRequest:
    """The arguments and options of the command; those that are fields of `Campaign` mean what they mean there."""

    function: str | None = argument("function", "[FILE.py:FUNCTION]", required=False, type=str)
    script: str | None = options.path(
        "--serve", "script", metavar="SCRIPT.py", help="Run this script for CARLA's client instead."
    )
    carla: str = options.carla
    python: str | None = option(
        "--python",
        type=click.Path(exists=True, dir_okay=False, executable=True),
        metavar="PATH",
        help="The interpreter of SCRIPT.py, such as that of an environment with another client; else this one.",
    )
    out: str = option(
        "--out", required=True, metavar="DIR", help="The folder of the recordings, or a prefix of an object store."
    )
    seeds: str = option("--seeds", default="1", metavar="A:B|N,...", help="The seeds of the worlds.")
    params: tuple[str, ...] = option(
        "--param", "params", multiple=True, metavar="NAME=V,...", help="Values of a parameter, or a range A..B to search."
    )
    town: str | None = option("--town", metavar="NAME", help="A map's name or an .xodr; else the built-in town.")
    duration: float = option(
        "--duration",
        type=NUMBER,
        default=0,
        show_default=False,
        metavar="S",
        help="Tick on until this time when FUNCTION returns.",
    )
    additional_data: bool = options.additional_data
    again: bool = flag("--again", help="Make recordings anew that another function, code, town or duration has made.")
    keep_going: bool = flag("--keep-going", help="Go on when as many runs in a row as there are workers have failed.")
    limit: float | None = option(
        "--limit", type=POSITIVE, metavar="S", help="End a run that takes more wall-clock seconds; else none is ended."
    )
    jobs: int | None = option(
        "--workers", "jobs", type=JOBS, metavar="N", help="Worker processes; else one for each processor."
    )
    dask: str | None = option("--dask", metavar="ADDRESS", help="Run on the Dask cluster with this scheduler.")
    rules_file: str | None = options.path("--rules", "rules_file", help="Check the recordings by the rules of a TOML file.")
    routes_file: str | None = options.path("--route", "routes_file", help="Score the recordings along a route of FILE.")
    route_id: str | None = option("--route-id", metavar="ID", help="The id of the route; else the only one of the town.")
    from_drive: bool = flag("--from-drive", help="Score them without a route, along the driven path.")
    measure: str | None = option(
        "--measure",
        metavar="NAME",
        help="What the runs are compared by; else the time to collision (see `measures`), or the objective.",
    )
    is_search: bool = flag("--search", "is_search", help="Choose values from ranges, towards the objective.")
    minimize: str | None = option(
        "--minimize", metavar="NAME", help="The objective: a measure, such as ttc, or collisions, to be small."
    )
    maximize: str | None = option("--maximize", metavar="NAME", help="The same, to be great.")
    count: int = option("--runs", "count", type=click.IntRange(1, 100_000), default=100, help="Runs of a search.")
    report: str | None = options.path(
        "--report", metavar="DIR", help="The folder of the page and the index; else that of --out."
    )
    pages: int = option(
        "--pages", type=click.IntRange(0, 1000), default=20, metavar="N", help="Incident pages of the worst."
    )
    road_map: str | None = options.road_map
    form: str | None = together(options.json, options.csv)

    @property
    def objective(self) -> str | None:
        """The name of what a search minimizes or maximizes."""
        return self.minimize or self.maximize

    def scoring(self) -> Scoring | None:
        """Return how the recordings are scored; None if they are not."""
        from carla_recap.fleet.campaign.results import Scoring
        from carla_recap.queries.score import read_routes

        if self.routes_file is not None and self.from_drive:
            raise click.UsageError("either --route or --from-drive was expected.")
        if self.routes_file is None and self.route_id is not None:
            raise click.UsageError("--route-id goes with --route.")
        if self.routes_file is not None:
            return Scoring(tuple(read_routes(self.routes_file)), self.route_id, self.road_map)
        return Scoring(None, road_map=self.road_map) if self.from_drive else None

    def folder_of_report(self) -> Path | None:
        """Return the folder of pages; None if the recordings go to an object store, and none was given."""
        from carla_recap.formats.sources import is_remote
        from carla_recap.util.files import made_folder

        if self.report is None and is_remote(self.out):
            return None
        folder = Path(self.report or self.out)
        with made_folder(folder):
            return folder


@command(
    options.described_by(CampaignRequest),
    options.merged("request", lambda: CampaignRequest),
)
def campaign(request: CampaignRequest) -> NoReturn:
    """Run a simulation with many seeds and parameters, each run a recording, and compare them.

    FUNCTION is called as function(world, NAME=VALUE) with a World that is recorded. Recordings that are in DIR are not made
    again. A run that fails is a row with its error. The exit code is 2 if one failed, else 1 if rules are broken.
    """
    from carla_recap.errors import RecapError
    from carla_recap.fleet.campaign import Campaign
    from carla_recap.fleet.campaign.report import judged, runs_as_json
    from carla_recap.fleet.campaign.results import SCORE, result_named
    from carla_recap.sim import load_town

    if (request.function is None) == (request.script is None):
        raise click.UsageError("either FILE.py:FUNCTION or --serve SCRIPT.py was expected.")
    if request.script is None and request.python is not None:
        raise click.UsageError("--python goes with --serve.")
    if request.is_search and (request.minimize is None) == (request.maximize is None):
        raise click.UsageError("--search needs either --minimize or --maximize.")
    if not request.is_search and request.objective:
        raise click.UsageError("--minimize and --maximize go with --search.")
    compared = result_named(request.measure or request.objective or "time_to_collision")
    scoring = request.scoring()
    if compared is SCORE and scoring is None:
        raise click.UsageError("a score needs --route or --from-drive.")
    rules = None if request.rules_file is None else loaded_rules(request.rules_file)
    if request.town is not None:
        load_town(request.town)  # whose error would be that of each run
    values = _parameters(request.params, is_search=request.is_search)
    how: dict[str, Any] = {name: getattr(request, name) for name in _OF_CAMPAIGNS}
    function = _function(request, [*values])
    rows: list[FinishedRun] = []
    with ExitStack() as stack:
        processes: Processes = {"jobs": request.jobs, "client": stack.enter_context(cluster(request.dask))}
        made = Campaign(function=function, scoring=scoring, client=processes["client"], **how)
        total, runs = _runs(made, request, values)
        folder = request.folder_of_report()
        try:
            most = math.inf if request.keep_going else max(_workers(processes), 2)
            for finished in _watched(stack.enter_context(closing(runs)), total, most):
                rows.append(finished)  # noqa: PERF402 - the rows so far are counted if it is interrupted
        except (KeyboardInterrupt, SystemExit):
            note(f"interrupted: {len(rows)} of {counted(total, 'run')} done; the same command makes the others")
            raise
        if not rows:
            raise RecapError("no runs were made")
        if rules is not None:
            with SourcesBar("checking", len(rows)) as bar:
                rows = list(bar.counted(judged(rows, rules, road_map=request.road_map, **processes)))
            for row in rows:
                for line in row.checked.warnings if row.checked else ():
                    warn(f"{row.run.location}: {line}")
        if folder is not None:
            rows = _reported(rows, folder, compared, request, processes)
    json, text = (lambda: [runs_as_json(rows)]), (lambda: _say_worst(rows, compared))
    emit(request.form, json=json, csv=lambda: _csv(rows), text=text)
    failed, broken = sum(row.report.error is not None for row in rows), sum(bool(row.broken) for row in rows)
    there = sum(row.report.was_there for row in rows)
    note(
        f"runs: {len(rows) - failed - there} done, {there} were there, {failed} failed"
        + (f"; {counted(broken, 'recording')} of {len(rows) - failed} break rules" if rules is not None else "")
    )
    end(failed=failed, unmet=broken)


def _parameters(params: Sequence[str], *, is_search: bool) -> dict[str, Sequence[Value] | ParameterRange]:
    from carla_recap.errors import RecapError
    from carla_recap.fleet.campaign.plan import ParameterRange, parse_parameter

    found: dict[str, Sequence[Value] | ParameterRange] = {}
    for text in params:
        name, values = parse_parameter(text)
        if name in found:
            raise RecapError(f"parameter {name}: is given twice")
        if isinstance(values, ParameterRange) and not is_search:
            raise RecapError(f"parameter {name}: a range goes with --search; values with commas between them were expected")
        found[name] = values
    if is_search and not any(isinstance(values, ParameterRange) or len(values) > 1 for values in found.values()):
        raise RecapError("--search: a parameter with a range or several values was expected, such as --param delay=0.2..1.2")
    return found


def _function(request: CampaignRequest, names: Sequence[str]) -> Any:
    from carla_recap.errors import RecapError
    from carla_recap.fleet.campaign.plan import check_keywords
    from carla_recap.util.functions import function_in

    if request.function is not None:
        found, keywords = function_in(request.function)
        check_keywords(keywords, names)
        return found
    if not Path(str(request.script)).is_file():
        raise RecapError(f"{request.script}: is no file; a script for CARLA's client was expected")
    return request.script


def _runs(
    made: Campaign, request: CampaignRequest, values: dict[str, Sequence[Value] | ParameterRange]
) -> tuple[int, Generator[FinishedRun]]:
    """Return the number of runs, and a generator of them."""
    from carla_recap.fleet.campaign.plan import ParameterRange, parse_seeds, planned

    seeds, count = parse_seeds(request.seeds), request.count
    if request.objective is not None:
        from carla_recap.fleet.campaign.results import result_named
        from carla_recap.fleet.campaign.search import search

        objective = result_named(request.objective)
        return count, search(made, seeds, values, objective, count, is_maximized=request.maximize is not None)
    fixed = {name: given for name, given in values.items() if not isinstance(given, ParameterRange)}
    runs = list(planned(seeds, fixed, made.folder.location))
    return len(runs), made.run(runs)


def _workers(processes: Processes) -> int:
    from carla_recap.fleet.cluster import workers_of
    from carla_recap.fleet.engine import processors

    client = processes["client"]
    return processes["jobs"] or processors() if client is None else workers_of(client)


def _watched(runs: Generator[FinishedRun], total: int, most: float) -> Generator[FinishedRun]:
    """Yield runs until `most` have failed in a row; show the progress, the warnings, and each error once."""
    errors: Counter[str] = Counter()
    failed = done = 0  # failed ones in a row
    with SourcesBar("running", total) as bar:
        for finished in bar.counted(runs):
            error = finished.report.error
            failed = 0 if error is None else failed + 1
            with bar.aside():
                for line in finished.warnings:
                    warn(f"{finished.run.name}: {line}")
                if error is not None:
                    errors[error] += 1
                    if errors[error] == 1:
                        fail(f"{finished.run.name}: {error}")
            yield finished
            done += 1
            if failed >= most:
                break
    for error, count in errors.items():
        if count > 1:
            fail(f"{count} runs: {error}")
    if failed >= most and done < total:
        note(f"ended after {failed} failed runs in a row; --keep-going makes the others, too")


def _reported(
    rows: list[FinishedRun],
    folder: Path,
    measure: Measure,
    request: CampaignRequest,
    processes: Processes,
) -> list[FinishedRun]:
    """Write the pages, the index and the rows into a folder; return the rows with the paths of their pages."""
    from carla_recap.fleet.campaign import report
    from carla_recap.fleet.campaign.report import INDEX, PAGE, RUNS
    from carla_recap.util.files import WholeFile

    road_map = request.road_map
    rows, warnings = report.with_pages(rows, folder, measure, request.pages, road_map=road_map, jobs=request.jobs)
    for line in warnings:
        warn(line)
    if any(row.report.error is None for row in rows):
        reason = report.write_campaign_index(rows, folder / INDEX, road_map=road_map, **processes)
        if reason is not None:
            warn(reason)
        else:
            wrote(folder / INDEX)
    report.write_runs(rows, folder / RUNS)
    wrote(folder / RUNS)
    with WholeFile(folder / PAGE) as file:
        title = request.function or str(request.script)
        file.write(report.campaign_page(rows, folder, measure, title).encode("utf-8", "backslashreplace"))
    wrote(folder / PAGE)
    return rows


def _csv(rows: Sequence[FinishedRun]) -> Iterator[str]:
    from carla_recap.fleet.campaign.report import columns
    from carla_recap.output.csv import line

    found = list(map(columns, rows))
    names = list(dict.fromkeys(chain.from_iterable(found)))
    return (line(each) for each in chain([names], (map(row.get, names) for row in found)))


def _say_worst(rows: Sequence[FinishedRun], measure: Measure) -> None:
    from carla_recap.fleet.campaign.report import worst_first
    from carla_recap.fleet.campaign.results import result_text

    for row in worst_first(rows, measure)[:_SHOWN]:
        found = row.report.results.get(measure.name)
        time = "" if found is None or found.time is None else f" at {found.time:.2f} s"
        rules = f"; breaks {', '.join(row.broken)}" if row.broken else ""
        say(f"{os.fspath(row.run.location)}: {result_text(row.report.results, measure)}{time}{rules}", stream=sys.stdout)
