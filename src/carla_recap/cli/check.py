"""The commands that judge recordings: by rules, for continuous integration, by ScenarioRunner's metrics, by another one."""

from __future__ import annotations

import traceback
from contextlib import ExitStack, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NoReturn

import click

from carla_recap.cli import opening, options
from carla_recap.cli.many import SourcesRequest
from carla_recap.cli.options import NUMBER, argument, command, flag, option
from carla_recap.cli.output import counted, emit, end, fail, indented, warn, wrote
from carla_recap.cli.progress import watch
from carla_recap.output.terminal import TableColumn, print_table
from carla_recap.util.signals import unwind_on_termination
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from carla_recap.fleet.check import CheckedRecording
    from carla_recap.queries.differences import Differences
    from carla_recap.recording import Recording
    from carla_recap.rules.rule_sets import RuleSet

_STYLES: Final = {"pass": "green", "fail": "red", "error": "magenta"}
_COLUMNS: Final = (
    TableColumn("", style=_STYLES.__getitem__),
    TableColumn("Recording", narrowed="middle"),
    TableColumn("Rule"),
    TableColumn("Time", is_number=True),
    TableColumn("What happens", narrowed="words"),
)


@command()
def check(
    sources: tuple[str, ...] = options.sources,
    rules_file: str = options.path("--rules", "rules_file", required=True, help="The rules, a TOML file."),
    junit: str | None = options.path("--junit", help="Write the verdicts as JUnit XML, over those of before."),
    html: str | None = options.path(
        "--html", metavar="DIR", help="Write an overview, and the incident page of each recording that fails."
    ),
    clips: bool = flag("--clips", help="Cut a clip of the first offence of each of these, too."),
    is_strict: bool = flag("--strict", "is_strict", help="Rules fail that have nothing to judge, as without their actors."),
    road_map: str | None = options.road_map,
    force: bool = options.force,
    jobs: int | None = options.jobs,
    dask: str | None = options.dask,
    form: str | None = options.json_or_text,
) -> NoReturn:
    """Check recordings by rules.

    SOURCE is a recording, a folder, a glob or a URL; - means a list of these on stdin. The exit code is 0 if all pass, 1 if
    one fails, 2 if one cannot be judged.
    """
    from carla_recap.errors import RecapError
    from carla_recap.fleet.check import WORST_FIRST, check_sources, strict, worst
    from carla_recap.fleet.junit import prepare_junit, write_junit
    from carla_recap.util.files import new_folder

    if html is None and clips:
        raise click.UsageError("--clips goes with --html.")
    rules = loaded_rules(rules_file)
    if junit:
        prepare_junit(junit)
    judged: list[CheckedRecording] = []
    checked, is_judged, failures = judged, False, []
    try:
        check_each = partial(check_sources, rules=rules, road_map=road_map)
        with unwind_on_termination(), nullcontext() if html is None else new_folder(html, force=force) as room:
            with SourcesRequest(sources=sources, jobs=jobs, dask=dask).reading("checking", check_each) as (given, messages):
                for each in given:
                    judged.append(strict(each) if is_strict else each)
                    messages.add(each.recording, each.warnings)
            is_judged = True
            shown = judged
            if room is not None:
                from carla_recap.fleet.pages import write_pages

                how: dict[str, Any] = {"clips": clips, "road_map": road_map, "shown": html, "jobs": jobs}
                shown = write_pages(judged, rules, room, messages.add, **how)
        checked = shown if html is None else [each.in_folder(html) for each in shown]
        messages.end()
    except RecapError as error:
        if not is_judged:
            raise
        failures.append(error)
    if junit:
        try:
            write_junit(checked, junit)
        except RecapError as error:
            failures.append(error)
    ordered = sorted(checked, key=lambda each: WORST_FIRST.index(each.status))
    rows = [row for each in ordered for row in _rows(each)]
    json, table = partial(indented, _plain(ordered, rules)), partial(print_table, _COLUMNS, rows)
    emit(form, json=json, table=table, text=partial(_text, rows))
    if form != "json":
        totals = f"{counted(len(checked), 'recording')}, {counted(len(rules), 'rule')} of {visible(rules.path)}"
        click.echo(f"{summary(checked)}; {totals}")
    if html and checked is not judged:  # else the folder could not be written
        wrote(Path(html) / "index.html")
    if junit and not failures:
        wrote(junit)
    if failures:  # after the verdicts, which took longer than the writing
        raise failures[0]
    status = worst(each.status for each in checked)
    end(failed=status == "error", unmet=status == "fail")


def loaded_rules(path: str) -> RuleSet:
    """Return the rules of a file; end the program with a line for each of its faults."""
    from carla_recap.rules.rule_sets import RulesError, load_rules

    try:
        return load_rules(path)
    except RulesError as error:
        for fault in error.faults:
            fail(fault)
        end(failed=True)


def _counts(checked: Sequence[CheckedRecording]) -> dict[str, int]:
    return {status: sum(each.status == status for each in checked) for status in ("pass", "fail", "error")}


def summary(checked: Sequence[CheckedRecording]) -> str:
    """Return the numbers of recordings by status, in words."""
    counts = _counts(checked)
    words = (("pass", "passed"), ("fail", "failed"), ("error", "not judged"))
    return ", ".join(f"{counts[status]} {word}" for status, word in words if counts[status] or status != "error")


def _text(rows: Sequence[tuple[str, ...]]) -> Iterator[str]:
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)][:-1]
    for *cells, last in rows:
        aligned = [cell.ljust(width) for cell, width in zip(cells, widths, strict=True) if width]
        yield "  ".join((*aligned, last)) + "\n"


def _rows(checked: CheckedRecording) -> list[tuple[str, str, str, str, str]]:
    """Return the status, recording, rule, time and message of each rule that is broken, or of all rules in one row.

    Rules that had nothing to judge follow.
    """
    name, rules = visible(checked.recording), counted(len(checked.verdicts), "rule")
    idle = [("pass", name, visible(each.rule), "", each.message) for each in checked.idle]
    if checked.status == "pass":
        return [("pass", name, "", "", rules), *idle]
    bad = [verdict for status in ("error", "fail") for verdict in checked.verdicts if verdict.status == status]
    if len(bad) > 1 and len({(verdict.status, verdict.message) for verdict in bad}) == 1:
        return [(checked.status, name, counted(len(bad), "rule"), "", bad[0].message), *idle]
    return [(each.status, name, visible(each.rule), _seconds(each.time), each.message) for each in bad] + idle


def _plain(checked: Sequence[CheckedRecording], rules: RuleSet) -> dict[str, Any]:
    """Return the verdicts as they are printed in JSON."""
    from dataclasses import asdict

    listed = [{"name": rule.name, "condition": rule.kind, "description": rule.description} for rule in rules]
    return {"counts": _counts(checked), "rules": listed, "recordings": [asdict(each) for each in checked]}


def _seconds(time: float | None) -> str:
    return "" if time is None else f"{time:.2f} s"


@command()
def metrics(
    metric: str = options.path("--metric", required=True, help="The metric, a .py file."),
    source: str = options.path("--log", "source", required=True, help="The recording."),
    criteria: str | None = options.path("--criteria", help="A JSON file of criteria, as ScenarioRunner writes it."),
    road_map: str | None = options.road_map,
) -> None:
    """Run a metric that was written for ScenarioRunner, without a server.

    The file of the metric runs as it is, whether or not ScenarioRunner is installed. If it raises an error, the exit code
    is 1.
    """
    from carla_recap.errors import RecapError
    from carla_recap.metrics import MetricsLog, run_metric
    from carla_recap.queries.roads import find_map_of
    from carla_recap.recording import open_recording

    with open_recording(source) as recording:
        opendrive = find_map_of(recording.reader, road_map)
        if opendrive is None:
            warn(f"no map for {recording.header.map_name!r}: the metric's town_map is None; --map names the file")
        try:
            run_metric(metric, MetricsLog(recording), opendrive=opendrive, criteria=criteria)
        except RecapError:
            raise
        except Exception as error:
            trace = error.__traceback__
            while trace is not None and Path(trace.tb_frame.f_code.co_filename).name != Path(metric).name:
                trace = trace.tb_next
            traceback.print_exception(type(error), error, trace)
            end(unmet=True)


@command()
def diff(
    first: str = argument("first", "A"),
    second: str = argument("second", "B"),
    tolerance: float = option("--tolerance", type=NUMBER, default=0, metavar="M", help="The distance that is equal, in m."),
    time_tolerance: float | None = option(
        "--time-tolerance",
        type=NUMBER,
        metavar="S",
        help="The time that is equal, of spawns, lights and events, in s; 0, or 1 with a tolerance.",
    ),
    events: bool = option(
        "--events/--no-events", default=True, show_default=False, help="Compare incidents, too; by default it does."
    ),
    rrd: str | None = options.path("--rrd", metavar="OUT.rrd", help="Write A for Rerun, with B as a ghost."),
    html: str | None = options.path("--html", metavar="OUT.html", help="Write a page of A, with B as a ghost."),
    road_map: str | None = options.road_map,
    force: bool = options.force,
    form: str | None = options.json_or_text,
) -> NoReturn:
    """Compare two recordings of a scenario.

    Data of sensors are not compared. The exit code is 0 if they are equal within the tolerance, 1 if they differ, 2 if one
    cannot be read.
    """
    from carla_recap.editing.convert import check_destination
    from carla_recap.output import differences as output
    from carla_recap.recording import open_recording

    for path in filter(None, (rrd, html)):
        if Path(path).is_file():  # a folder is a page, too
            for source in (first, second):
                check_destination(source, path, force=force)
    with ExitStack() as stack:
        a, b = (stack.enter_context(open_recording(path)) for path in (first, second))
        found = a.diff(b, tolerance=tolerance, time_tolerance=time_tolerance, events=events)
        emit(form, **{each: partial(getattr(output, each), found) for each in ("text", "table", "json")})
        if rrd:
            _write_rrd(a, b, rrd, road_map, force=force)
        if html:
            _write_page(a, b, found, html, road_map, force=force)
    end(unmet=not found.equal)


def _write_rrd(a: Recording, b: Recording, path: str, road_map: str | None, *, force: bool) -> None:
    from carla_recap.show.rerun.export import export_rerun

    roads = opening.road_map_of(a, road_map)
    played = export_rerun(a, path, ghost=b, road_map=roads, force=force, progress=watch("exporting"))
    wrote(path, frames=played.frames, seconds=played.seconds)


def _write_page(a: Recording, b: Recording, found: Differences, path: str, road_map: str | None, *, force: bool) -> None:
    from carla_recap.show.page import write_report

    progress, town = watch("sampling"), opening.town_of(a, road_map)
    written = write_report(a, path, other=b, differences=found, town=town, force=force, progress=progress)
    wrote(path, counted(written.incidents, "incident"), size=written.size, incidents=written.incidents)
