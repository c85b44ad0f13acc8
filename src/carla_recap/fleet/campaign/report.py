"""What is written and shown about the runs of a campaign: rows, JSON, an index, pages."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.fleet.campaign.plan import SEED
from carla_recap.fleet.campaign.results import BROKEN_RULES, RESULTS, Result, crash_text, severity
from carla_recap.fleet.check import check_sources
from carla_recap.fleet.pages import PAGES, opening_of, write_incident_pages
from carla_recap.formats.sources import is_remote
from carla_recap.output.json import array_of, encoded
from carla_recap.show.page import Opening
from carla_recap.util.files import WholeFile

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from typing import Unpack

    from carla_recap.fleet.campaign.runs import FinishedRun
    from carla_recap.fleet.engine import Processes
    from carla_recap.queries.measures import Measure
    from carla_recap.rules.rule_sets import RuleSet

RUNS: Final = "campaign.json"
INDEX: Final = "index.duckdb"
PAGE: Final = "index.html"
"""The files that are written beside the recordings."""
_REPORTED: Final = ("error", "details", "was_there", "seconds", "frames", "duration", "results")
"""What is written of a run's report."""


def columns(row: FinishedRun) -> dict[str, Any]:
    """Return a run as columns: results and parameters have one each, such as `param.page` of a parameter `page`."""
    run, report = row.run, row.report
    first = {"recording": run.location, "error": report.error, "seed": run.seed}
    others = {
        "frames": report.frames,
        "duration": report.duration,
        "seconds": round(report.seconds, 3),
        **{name: report.results[name].value if name in report.results else None for name in RESULTS},
        "rules": None if row.broken is None else " ".join(row.broken),
        "page": row.page,
    }
    known = first | others
    given = {f"param.{name}" if name in known else name: value for name, value in run.parameters.items()}
    return first | given | others


def judged(
    rows: Sequence[FinishedRun], rules: RuleSet, *, road_map: str | None = None, **processes: Unpack[Processes]
) -> Iterator[FinishedRun]:
    """Yield rows with the verdicts of rules on their recordings."""
    from carla_recap.fleet.sources import find_sources

    there = [row.run.location for row in rows if row.report.error is None]
    checked = check_sources(find_sources(there), rules, road_map=road_map, **processes)
    for row in rows:
        if row.report.error is not None:
            yield row
            continue
        verdicts = next(checked)
        found, opening = replace(row, checked=verdicts), opening_of(verdicts.verdicts)
        result = Result(float(len(found.broken or ())), opening.time, opening.actors[0] if opening.actors else None)
        yield replace(found, report=replace(row.report, results={**row.report.results, BROKEN_RULES.name: result}))


def worst_first(rows: Iterable[FinishedRun], measure: Measure) -> list[FinishedRun]:
    """Return the rows with recordings: those that break most rules first, then as `severity` has it."""

    def key(row: FinishedRun) -> tuple[int, tuple[float, float, float]]:
        return -len(row.broken or ()), severity(row.report.results, measure)

    return sorted((row for row in rows if row.report.error is None), key=key)


def with_pages(
    rows: Sequence[FinishedRun],
    folder: Path,
    measure: Measure,
    most: int,
    *,
    road_map: str | None = None,
    jobs: int | None = None,
) -> tuple[list[FinishedRun], list[str]]:
    """Write the incident pages of the worst runs, `most` of them, and remove all others; return the rows with their paths.

    Also return warnings. Rows are compared by the rules that they break, then by the measure.
    """
    openings = {row.run.location: _opening(row, measure) for row in worst_first(rows, measure)[:most]}
    written = write_incident_pages(openings, folder, road_map=road_map, force=True, jobs=jobs)
    found = dict(zip(openings, written, strict=True))
    pages = {recording: each.page for recording, each in found.items()}
    for path in (folder / PAGES).glob(f"{SEED}-*.html"):
        if path.relative_to(folder).as_posix() not in pages.values():
            path.unlink()
    warnings = [f"{recording}: {line}" for recording, each in found.items() for line in each.warnings]
    return [replace(row, page=pages.get(row.run.location)) for row in rows], warnings


def _opening(row: FinishedRun, measure: Measure) -> Opening:
    if row.broken and row.checked:
        return opening_of(row.checked.verdicts)
    found = row.report.results.get(measure.name)
    run = ", ".join(f"{name}={value}" for name, value in row.run.values.items())[:200]
    if found is None:
        return Opening(notes=(run,))
    actors = () if found.actor is None else (found.actor,)
    value = f"{measure.title} {found.value:.3g} {measure.unit}".rstrip()
    return Opening(found.time, actors, (f"{run}: {', '.join(filter(None, (crash_text(row.report.results), value)))}",))


def write_runs(rows: Iterable[FinishedRun], path: Path) -> None:
    """Write rows as JSON."""
    with WholeFile(path) as file:
        file.write(runs_as_json(rows).encode())


def runs_as_json(rows: Iterable[FinishedRun]) -> str:
    """Return rows as JSON, an object with a list of them."""
    return '{"runs": ' + "".join(array_of(encoded(_plain(row)) for row in rows)) + "}\n"


def _plain(row: FinishedRun) -> dict[str, Any]:
    run, report = row.run, {name: getattr(row.report, name) for name in _REPORTED}
    about = {"seed": run.seed, "parameters": run.parameters, "recording": run.location}
    return {**about, **report, "broken": row.broken, "page": row.page}


def write_campaign_index(
    rows: Sequence[FinishedRun], path: Path, *, road_map: str | None, **processes: Unpack[Processes]
) -> str | None:
    """Write the index of the recordings, and of no others; return why it is not written, if it is not."""
    from carla_recap.fleet.index.writing import write_index

    there = [row.run.location for row in rows if row.report.error is None]
    try:
        write_index(there, path, measures=True, road_map=road_map, prune=True, **processes)
    except MissingExtra:
        return "no index is written: it needs the extra sql"
    except RecapError as error:
        return f"no index is written: {error}"
    return None


def address_from(folder: Path, row: FinishedRun) -> str:
    """Return the address of a run's page, or else of its recording, relative to the folder of the campaign's page."""
    if row.page is not None:
        return row.page
    if is_remote(row.run.location):
        return row.run.location
    return Path(os.path.relpath(row.run.location, folder)).as_posix()
