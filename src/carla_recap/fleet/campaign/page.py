"""The page of a campaign: heat maps over two parameters, a table of all runs, and the runs that failed."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from dataclasses import dataclass
from datetime import UTC, datetime
from html import escape
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

from carla_recap.fleet.campaign.plan import SEED, text_of
from carla_recap.fleet.campaign.report import RUNS, address_from, worst_first
from carla_recap.fleet.campaign.results import (
    BROKEN_RULES,
    COLLISIONS,
    EFFICIENCY,
    IMPACT_SPEED,
    SCORE,
    SMOOTHNESS,
    severity,
)
from carla_recap.fleet.pages import document
from carla_recap.util.resources import viewer_folder
from carla_recap.util.text import visible

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from carla_recap.fleet.campaign.report import CampaignRow
    from carla_recap.queries.measures import Measure

_MOST_ROWS: Final = 2000  # of the table
_MOST_FAILED: Final = 100  # runs that failed, with their errors
_MOST_VALUES: Final = 24  # of an axis, each with a row or column of its own; more are put together
_BINS: Final = 12
_TONES: Final = 7
_CELL, _HIGH, _LEFT, _TOP = 74, 36, 106, 54  # units of the heat map
_LONGEST: Final = 11  # characters of a label
_FEW: Final = 6  # columns that also fit on a phone


@dataclass(frozen=True)
class _Axis:
    """The rows or the columns of a heat map.

    Attributes:
        name: The parameter.
        labels: A text for each.
        index: Returns which one a row of the campaign belongs to.
    """

    name: str
    labels: tuple[str, ...]
    index: Callable[[CampaignRow], int]


def campaign_page(rows: Sequence[CampaignRow], folder: Path, measure: Measure, title: str) -> str:
    """Return the page of a campaign, which loads nothing and runs nothing.

    Args:
        rows: The rows.
        folder: The folder of the page, from which it links to pages and recordings.
        measure: What the runs are compared by.
        title: What is simulated, in words.
    """
    sheets = (viewer_folder() / "check" / name for name in ("check.css", "campaign.css"))
    style = "".join(sheet.read_text("utf-8") for sheet in sheets)
    counts = Counter(_status(row) for row in rows)
    said = [f"{len(rows):,} {'run' if len(rows) == 1 else 'runs'}"]
    said += [f"{counts['fail']:,} {'breaks' if counts['fail'] == 1 else 'break'} rules"] if counts["fail"] else []
    said += [f"{counts['error']:,} failed"] if counts["error"] else []
    origin = f"{title} · {datetime.now(UTC):%d %B %Y, %H:%M} UTC · carla-recap {version('carla-recap')}"
    has_rules = any(row.broken is not None for row in rows)
    known = {name for row in rows for name in row.results}
    scores = (each for each in (IMPACT_SPEED, SCORE, EFFICIENCY, SMOOTHNESS) if each.name in known)
    others = [COLLISIONS, *[BROKEN_RULES] * has_rules, *scores]
    shown = [measure, *(each for each in others if each is not measure)]
    maps = "".join(_heat_map(rows, folder, each) for each in shown)
    main = f"{maps}{_table(rows, folder, shown, has_rules=has_rules)}{_failed(rows)}"
    return document(", ".join(said), origin, "", main, style)


def _status(row: CampaignRow) -> str:
    return "error" if row.error is not None else "fail" if row.broken else "pass"


# --- heat maps -----------------------------------------------------------------------------------------------------------


def _axes(rows: Sequence[CampaignRow]) -> tuple[_Axis, _Axis] | None:
    """Return the first two parameters that vary, the seed as the last one; None if there are no two."""
    values: dict[str, set[Any]] = defaultdict(set)
    for row in rows:
        for name, value in (*row.parameters.items(), (SEED, row.seed)):
            values[name].add(value)
    names = [name for name in values if name != SEED and len(values[name]) > 1]
    names += [SEED] if len(values[SEED]) > 1 else []
    if len(names) < 2:
        return None
    down, across = (_axis(name, values[name]) for name in names[:2])
    return down, across


def _axis(name: str, values: set[Any]) -> _Axis:
    def of(row: CampaignRow) -> Any:
        return row.seed if name == SEED else row.parameters.get(name)

    numbers = [value for value in values if isinstance(value, (int, float))]
    if len(values) <= _MOST_VALUES or len(numbers) < len(values):
        ordered = sorted(values, key=lambda value: (isinstance(value, str), value))[: 4 * _MOST_VALUES]
        places = {value: index for index, value in enumerate(ordered)}
        return _Axis(name, tuple(map(_label, ordered)), lambda row: places.get(of(row), -1))
    low, high = min(numbers), max(numbers)
    width = (high - low) / _BINS
    labels = tuple(_label(low + (index + 0.5) * width) for index in range(_BINS))
    return _Axis(name, labels, lambda row: min(int((of(row) - low) / width), _BINS - 1))


def _label(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else visible(text_of(value))


def _heat_map(rows: Sequence[CampaignRow], folder: Path, measure: Measure) -> str:
    """Return the worst value of each cell as a drawing, in which each links to the run that has it."""
    axes = _axes(rows)
    if axes is None:
        return ""
    down, across = axes
    cells: dict[tuple[int, int], list[CampaignRow]] = defaultdict(list)
    for row in rows:
        cells[down.index(row), across.index(row)].append(row)
    known = [row.results[measure.name].value for row in rows if measure.name in row.results]
    known = [value for value in known if math.isfinite(value)]
    span = (min(known), max(known)) if known else (0.0, 0.0)
    size = _LEFT + _CELL * len(across.labels), _TOP + _HIGH * len(down.labels)
    parts = [
        f'<text class="axis" x="{_LEFT}" y="16">{_text(across.name)} →</text>',
        f'<text class="axis" x="{_LEFT - 10}" y="{_TOP - 10}" text-anchor="end">{_short(down.name)} ↓</text>',
    ]
    for index, label in enumerate(across.labels):
        x = _LEFT + _CELL * (index + 0.5)
        parts.append(f'<text class="axis" x="{x:g}" y="{_TOP - 10}" text-anchor="middle">{_short(label)}</text>')
    for index, label in enumerate(down.labels):
        y = _TOP + _HIGH * (index + 0.5) + 5
        parts.append(f'<text class="axis" x="{_LEFT - 10}" y="{y:g}" text-anchor="end">{_short(label)}</text>')
        parts += [
            _cell(cells[index, column], folder, measure, span, _LEFT + _CELL * column, _TOP + _HIGH * index)
            for column in range(len(across.labels))
            if cells[index, column]
        ]
    worst = "least" if measure.extreme == "least" else "greatest"
    unit = f", in {measure.unit}" if measure.unit else ""
    text = f"the {worst} of each cell{unit}"
    heading = f"<h2>{escape(measure.title.capitalize())} <span>{escape(text)}</span></h2>"
    kind = "heat few" if len(across.labels) <= _FEW else "heat"
    shape = f'viewBox="0 0 {size[0]} {size[1]}" width="{size[0]}" height="{size[1]}"'
    drawn = f'<svg class="{kind}" {shape}>{"".join(parts)}</svg>'
    return f'<section>\n{heading}\n<div class="wide">{drawn}</div>\n</section>\n'


def _cell(rows: Sequence[CampaignRow], folder: Path, measure: Measure, span: tuple[float, float], x: float, y: float) -> str:
    there = [row for row in rows if row.error is None]
    known = [row for row in there if measure.name in row.results]
    box = f'x="{x + 1.5:g}" y="{y + 1.5:g}" width="{_CELL - 3}" height="{_HIGH - 3}" rx="5"'
    middle = f'x="{x + _CELL / 2:g}" y="{y + _HIGH / 2 + 5:g}" text-anchor="middle"'
    if not there:
        tip = f"{_run_text(rows[0])}: {rows[0].error}"
        return f'<g class="none"><title>{_text(tip)}</title><rect {box}/><text {middle}>failed</text></g>'
    worst = min(known, key=lambda row: severity(row.results, measure)) if known else there[0]
    if known:
        value = worst.results[measure.name].value
        low, high = span
        share = 0.0 if high <= low else (value - low) / (high - low)
        share = 1.0 - share if measure.extreme == "least" else share
        unit, tone, said = measure.unit, f"tone-{min(int(share * _TONES), _TONES - 1) if high > low else 0}", f"{value:.3g}"
    else:
        unit, tone, said = "", "unknown", "none"
    others = f", the worst of {len(rows)} runs" if len(rows) > 1 else ""
    tip = f"{_run_text(worst)}: {said} {unit}".rstrip() + others
    inner = f"<title>{_text(tip)}</title><rect {box}/><text {middle}>{said}</text>"
    return f'<a class="{tone}" href="{_href(address_from(folder, worst))}">{inner}</a>'


def _short(label: str) -> str:
    return _text(label if len(label) <= _LONGEST else f"{label[: _LONGEST - 1]}…")


# --- tables --------------------------------------------------------------------------------------------------------------


def _table(rows: Sequence[CampaignRow], folder: Path, shown: Sequence[Measure], *, has_rules: bool) -> str:
    """Return the table of the runs that have a recording, the worst first."""
    ordered = worst_first(rows, shown[0])
    if not ordered:
        return ""
    names = list(dict.fromkeys(name for row in ordered for name in row.parameters))
    columns = [each for each in shown if each is not BROKEN_RULES]
    titles = ["seed", *names, *(each.title for each in columns)]
    head = "".join(f'<th scope="col" class="number">{_text(title)}</th>' for title in titles)
    head += '<th scope="col">rules</th>' * has_rules + '<th scope="col">watch</th>'
    body = "".join(_row(row, names, folder, columns, has_rules=has_rules) for row in ordered[:_MOST_ROWS])
    more = len(ordered) - _MOST_ROWS
    rest = f'<p class="nothing">and {more:,} more in {RUNS}</p>\n' if more > 0 else ""
    return (
        f"<section>\n<h2>Runs <span>{len(ordered):,}, the worst first</span></h2>\n"
        f'<div class="wide"><table class="runs">\n<tr>{head}</tr>\n{body}</table></div>\n{rest}</section>\n'
    )


def _row(row: CampaignRow, names: Iterable[str], folder: Path, columns: Iterable[Measure], *, has_rules: bool) -> str:
    cells = [str(row.seed), *(_label(row.parameters[name]) if name in row.parameters else "" for name in names)]
    for measure in columns:
        found = row.results.get(measure.name)
        cells.append("none" if found is None else f"{found.value:.3g} {measure.unit}".rstrip())
    numbers = "".join(f'<td class="number">{_text(cell[:40])}</td>' for cell in cells)
    rules = f'<td class="fail"><span class="rule">{_text(", ".join(row.broken or ()))}</span></td>' if has_rules else ""
    if row.page is not None:
        link = f'<a class="when" href="{_href(row.page)}">Incident page</a>'
    else:
        link = f'<a href="{_href(address_from(folder, row))}" download>Recording</a>'
    return f"<tr>{numbers}{rules}<td>{link}</td></tr>\n"


def _failed(rows: Sequence[CampaignRow]) -> str:
    """Return the runs that failed, with their errors and what they printed."""
    failed = [row for row in rows if row.error is not None]
    if not failed:
        return ""
    cards = []
    for row in failed[:_MOST_FAILED]:
        details = (
            f"<details><summary>Details</summary><pre>{escape(_lines(row.details))}</pre></details>" if row.details else ""
        )
        name = _text(_run_text(row))
        cards.append(f'<li class="card error">\n<h3>{name}</h3><p class="meta">{_text(row.error or "")}</p>{details}</li>\n')
    more = len(failed) - _MOST_FAILED
    rest = f'<p class="nothing">and {more:,} more in {RUNS}</p>\n' if more > 0 else ""
    listed = "".join(cards)
    return f'<section>\n<h2>Failed <span>{len(failed):,}</span></h2>\n<ul class="cards">\n{listed}</ul>\n{rest}</section>\n'


def _lines(text: str) -> str:
    return "\n".join(map(visible, text.split("\n")))


def _run_text(row: CampaignRow) -> str:
    return ", ".join(f"{name}={_label(value)[:60]}" for name, value in {SEED: row.seed, **row.parameters}.items())[:300]


def _href(address: str) -> str:
    return escape(address if "://" in address else quote(address))


def _text(text: str) -> str:
    return escape(visible(text))
