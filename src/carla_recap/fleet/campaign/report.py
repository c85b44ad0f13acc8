"""What is written about the runs of a campaign: JSON, an index, incident pages, and a page with heat maps and tables."""

from __future__ import annotations

import math
import os
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple
from urllib.parse import quote

from carla_recap.errors import MissingExtra, RecapError
from carla_recap.fleet.campaign.plan import SEED, text_of
from carla_recap.fleet.campaign.results import (
    BROKEN_RULES,
    COLLISIONS,
    EFFICIENCY,
    IMPACT_SPEED,
    RESULTS,
    SCORE,
    SMOOTHNESS,
    Result,
    result_text,
    severity,
)
from carla_recap.fleet.check import check_sources
from carla_recap.fleet.pages import PAGES, opening_of, render, write_incident_pages
from carla_recap.formats.sources import is_remote
from carla_recap.output.json import array_of, encoded
from carla_recap.show.page import Opening
from carla_recap.util.files import WholeFile
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from typing import Unpack

    from carla_recap.fleet.campaign.runs import FinishedRun
    from carla_recap.fleet.engine import Processes
    from carla_recap.queries.measures import Measure
    from carla_recap.rules.rule_sets import RuleSet

RUNS: Final = "campaign.json"
INDEX: Final = "index.duckdb"
PAGE: Final = "index.html"
"""The files that are written beside the recordings."""
_MOST_ROWS: Final = 2000  # of the table
_MOST_FAILED: Final = 100  # runs that failed, with their errors
_MOST_VALUES: Final = 24  # of an axis, each with a row or column of its own; more are put together
_BINS: Final = 12
_TONES: Final = 7
_CELL, _HIGH, _LEFT, _TOP = 74, 36, 106, 54  # units of the heat map
_LONGEST: Final = 11  # characters of a label
_FEW: Final = 6  # columns that also fit on a phone
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
    return Opening(found.time, actors, (f"{run}: {result_text(row.report.results, measure)}",))


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


def _address(folder: Path, row: FinishedRun) -> str:
    """Return the address of a run's page, or else of its recording, relative to the folder of the campaign's page."""
    if row.page is None and is_remote(row.run.location):
        return row.run.location
    return quote(row.page or Path(os.path.relpath(row.run.location, folder)).as_posix())


# --- the page ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Axis:
    """The rows or the columns of a heat map."""

    name: str  # the parameter
    labels: tuple[str, ...]  # a text for each
    index: Callable[[FinishedRun], int]  # returns which one a row of the campaign belongs to


class _Cell(NamedTuple):
    """A cell of a heat map."""

    row: int
    column: int
    text: str  # the worst value of its runs
    tone: str  # the class of its colour
    tip: str  # what it is, in words
    address: str | None  # where it leads; None: nowhere


class _HeatMap(NamedTuple):
    """A heat map: the worst value of a measure in each cell."""

    measure: Measure
    down: _Axis
    across: _Axis
    cells: list[_Cell]  # those that have runs


def campaign_page(rows: Sequence[FinishedRun], folder: Path, measure: Measure, title: str) -> str:
    """Return the page of a campaign in a folder, by rows and what they are compared by; the title says what is simulated."""
    counts = Counter("error" if row.report.error is not None else "fail" if row.broken else "pass" for row in rows)
    said = [f"{len(rows):,} {'run' if len(rows) == 1 else 'runs'}"]
    said += [f"{counts['fail']:,} {'breaks' if counts['fail'] == 1 else 'break'} rules"] if counts["fail"] else []
    said += [f"{counts['error']:,} failed"] if counts["error"] else []
    has_rules = any(row.broken is not None for row in rows)
    known = {name for row in rows for name in row.report.results}
    scores = (each for each in (IMPACT_SPEED, SCORE, EFFICIENCY, SMOOTHNESS) if each.name in known)
    others = [COLLISIONS, *[BROKEN_RULES] * has_rules, *scores]
    shown = [measure, *(each for each in others if each is not measure)]
    axes = _axes(rows)
    ordered = worst_first(rows, measure)
    columns = [each for each in shown if each is not BROKEN_RULES]
    names = list(dict.fromkeys(name for row in ordered for name in row.run.parameters))
    failed = [row for row in rows if row.report.error is not None]
    content = {
        "maps": [] if axes is None else [_heat_map(rows, folder, each, *axes) for each in shown],
        "titles": ["seed", *names, *(each.title for each in columns)],
        "runs": [(row, _cells(row, names, columns), _address(folder, row)) for row in ordered[:_MOST_ROWS]],
        "total": len(ordered),
        "has_rules": has_rules,
        "failed": [(_run_text(row), row) for row in failed[:_MOST_FAILED]],
        "failures": len(failed),
        "runs_file": RUNS,
        "size": (_CELL, _HIGH, _LEFT, _TOP),
        "few": _FEW,
        "longest": _LONGEST,
    }
    return render("campaign", ", ".join(said), title, content)


# --- heat maps -----------------------------------------------------------------------------------------------------------


def _axes(rows: Sequence[FinishedRun]) -> tuple[_Axis, _Axis] | None:
    """Return the first two parameters that vary, the seed as the last one; None if there are no two."""
    values: dict[str, set[Any]] = defaultdict(set)
    for row in rows:
        for name, value in row.run.values.items():
            values[name].add(value)
    names = [name for name in values if name != SEED and len(values[name]) > 1]
    names += [SEED] if len(values[SEED]) > 1 else []
    if len(names) < 2:
        return None
    down, across = (_axis(name, values[name]) for name in names[:2])
    return down, across


def _axis(name: str, values: set[Any]) -> _Axis:
    numbers = [value for value in values if isinstance(value, (int, float))]
    if len(values) <= _MOST_VALUES or len(numbers) < len(values):
        ordered = sorted(values, key=lambda value: (isinstance(value, str), value))
        places = {value: index for index, value in enumerate(ordered[: 4 * _MOST_VALUES])}
        labels = (*map(_label, places), *(["others"] if len(ordered) > len(places) else []))
        return _Axis(name, labels, lambda row: places.get(row.run.values.get(name), len(places)))
    low, high = min(numbers), max(numbers)
    width = (high - low) / _BINS
    labels = tuple(_label(low + (index + 0.5) * width) for index in range(_BINS))
    return _Axis(name, labels, lambda row: min(int((float(row.run.values[name]) - low) / width), _BINS - 1))


def _label(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else visible(text_of(value))


def _heat_map(rows: Sequence[FinishedRun], folder: Path, measure: Measure, down: _Axis, across: _Axis) -> _HeatMap:
    """Return the worst value of each cell, which leads to the run that has it."""
    cells: dict[tuple[int, int], list[FinishedRun]] = defaultdict(list)
    for run in rows:
        cells[down.index(run), across.index(run)].append(run)
    values = (run.report.results[measure.name].value for run in rows if measure.name in run.report.results)
    known = [value for value in values if math.isfinite(value)]
    span = (min(known), max(known)) if known else (0.0, 0.0)
    found = [_Cell(row, column, *_worst(of_cell, folder, measure, span)) for (row, column), of_cell in sorted(cells.items())]
    return _HeatMap(measure, down, across, found)


def _worst(
    rows: Sequence[FinishedRun], folder: Path, measure: Measure, span: tuple[float, float]
) -> tuple[str, str, str, str | None]:
    """Return the text, the tone, the tip and the address of the worst of some runs."""
    there = [row for row in rows if row.report.error is None]
    known = [row for row in there if measure.name in row.report.results]
    if not there:
        return "failed", "none", f"{_run_text(rows[0])}: {rows[0].report.error}", None
    worst = min(known, key=lambda row: severity(row.report.results, measure)) if known else there[0]
    unit, tone, said = "", "unknown", "none"
    if known:
        value = worst.report.results[measure.name].value
        low, high = span
        share = 0.0 if high <= low else (value - low) / (high - low)
        share = 1.0 - share if measure.extreme == "least" else share
        unit, tone, said = measure.unit, f"tone-{min(int(share * _TONES), _TONES - 1) if high > low else 0}", f"{value:.3g}"
    others = f", the worst of {len(rows)} runs" if len(rows) > 1 else ""
    return said, tone, f"{_run_text(worst)}: {said} {unit}".rstrip() + others, _address(folder, worst)


# --- tables --------------------------------------------------------------------------------------------------------------


def _cells(row: FinishedRun, names: Iterable[str], columns: Iterable[Measure]) -> list[str]:
    """Return the cells of a run in the table, without its rules and its link."""
    cells = [str(row.run.seed), *(_label(row.run.parameters[name]) if name in row.run.parameters else "" for name in names)]
    for measure in columns:
        found = row.report.results.get(measure.name)
        cells.append("none" if found is None else f"{found.value:.3g} {measure.unit}".rstrip())
    return [cell[:40] for cell in cells]


def _run_text(row: FinishedRun) -> str:
    return ", ".join(f"{name}={_label(value)[:60]}" for name, value in row.run.values.items())[:300]
