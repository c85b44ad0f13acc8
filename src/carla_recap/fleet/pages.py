"""Pages of a check: the overview of all recordings and verdicts, and the incident page of each recording that fails."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple
from urllib.parse import quote

from carla_recap.fleet.check import WORST_FIRST
from carla_recap.fleet.engine import map_sources
from carla_recap.fleet.sources import SourceFile
from carla_recap.show.page import Opening
from carla_recap.show.page.script import hash_source
from carla_recap.util.resources import viewer_folder
from carla_recap.util.text import number, visible

if TYPE_CHECKING:
    from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence

    from carla_recap.fleet.check import CheckedRecording
    from carla_recap.rules.rule_sets import RuleSet, Status, Verdict

PAGES: Final = "pages"
CLIPS: Final = "clips"
"""The folders of incident pages and of clips."""
MOST: Final = 200
"""The most recordings with a page."""

_BAR: Final = 1000  # units of the width of a bar
_GAP: Final = 5  # units between two parts
_LEAD: Final = 3.0  # s before an offence at which a link into a page begins
_AROUND: Final = 5.0  # s before and after an offence in a clip
_NAME: Final = 80  # characters of the name of a page
_OPEN: Final = 60  # recordings that pass, up to which they are shown at once
_WORDS: Final[dict[Status, str]] = {"pass": "passed", "fail": "failed", "error": "not judged"}
_ICON: Final = (
    "data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 16 16'%3E%3Ccircle cx='8' cy='8' r='7' "
    "fill='%23ffb020'/%3E%3Cpath d='M4.5 8.2l2.4 2.4 4.6-5' fill='none' stroke='%2314161c' stroke-width='1.8'/%3E%3C/svg%3E"
)


class _Wanted(NamedTuple):
    """The files of a recording to be written.

    Attributes:
        page: The path of its incident page.
        clip: The path of the clip of an offence; None: no clip.
        opening: What the page shows first: the offence, and the broken rules.
        road_map: The map, or the folder of maps; None: the usual folders.
    """

    page: Path
    clip: Path | None
    opening: Opening
    road_map: str | None


class WrittenPage(NamedTuple):
    """Where the incident page of a recording is.

    Attributes:
        page: The path of the page, relative to the folder of pages; None if it could not be made.
        clip: The path of the clip, relative to the folder of pages; None if there is none.
        warnings: The warnings about it, a line each.
    """

    page: str | None
    clip: str | None
    warnings: tuple[str, ...]


def write_pages(
    checked: Sequence[CheckedRecording],
    folder: Path,
    *,
    clips: bool = False,
    road_map: str | None = None,
    jobs: int | None = None,
) -> Generator[tuple[CheckedRecording, tuple[str, ...]]]:
    """Write the incident page of each recording that fails into a folder; yield each recording, and the warnings about it.

    The first `MOST` recordings that fail get a page. One whose page cannot be made has none, which is a warning.

    Args:
        checked: The recordings.
        folder: The folder.
        clips: Write a clip of the first offence of each, too.
        road_map: The map, or the folder of maps; None: the usual folders.
        jobs: See `map_sources`.
    """
    failed = [each for each in checked if each.status == "fail"][:MOST]
    openings = {each.recording: opening_of(each.verdicts) for each in failed}
    written = write_incident_pages(openings, folder, clips=clips, road_map=road_map, jobs=jobs)
    for each in checked:
        if each.recording not in openings:
            yield each, ()
        else:
            page, clip, messages = next(written)
            yield replace(each, page=page, clip=clip), messages


def write_incident_pages(
    openings: Mapping[str, Opening],
    folder: Path,
    *,
    clips: bool = False,
    road_map: str | None = None,
    force: bool = False,
    jobs: int | None = None,
) -> Generator[WrittenPage]:
    """Write the incident pages of recordings below a folder, and yield where they are, in the order of the recordings.

    Args:
        openings: What the page of each recording shows first.
        folder: The folder.
        clips: See `write_pages`.
        road_map: See `write_pages`.
        force: Replace pages that exist.
        jobs: See `map_sources`.
    """
    wanted = {}
    for recording, name in zip(openings, _names(openings), strict=True):
        opening = openings[recording]
        clip_path = folder / CLIPS / f"{name}.mcap" if clips and opening.time is not None else None
        wanted[recording] = _Wanted(folder / PAGES / f"{name}.html", clip_path, opening, road_map)
    if wanted:
        (folder / PAGES).mkdir(exist_ok=True)
    if any(each.clip for each in wanted.values()):
        (folder / CLIPS).mkdir(exist_ok=True)
    for outcome in map_sources(partial(_write_files, wanted, force=force), map(SourceFile, wanted), jobs=jobs):
        files = wanted[outcome.source.location]
        failures = () if outcome.error is None else (visible(f"no page: {outcome.error}"),)
        page, clip = (_relative(path, folder) for path in (files.page, files.clip))
        yield WrittenPage(page, clip, (*map(visible, outcome.warnings), *failures))


def opening_of(verdicts: Iterable[Verdict]) -> Opening:
    """Return what the page of a recording shows first: the first offence, and the rules that are broken."""
    broken = [verdict for verdict in verdicts if verdict.status != "pass"]
    first = min((each for each in broken if each.time is not None), key=lambda each: each.time or 0.0, default=None)
    notes = tuple(f"{visible(each.rule)}: {each.message}" for each in broken)
    return Opening(notes=notes) if first is None else Opening(first.time, first.actors, notes)


def _relative(path: Path | None, folder: Path) -> str | None:
    return path.relative_to(folder).as_posix() if path is not None and path.exists() else None


def _write_files(wanted: dict[str, _Wanted], source: SourceFile, *, force: bool) -> None:
    from carla_recap.editing.clip import clip
    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.recording import open_recording
    from carla_recap.show.page import write_report

    files = wanted[source.location]
    if files.clip is not None:
        time = files.opening.time or 0.0
        start = max(time - _AROUND, 0.0)
        clip(source.location, files.clip, start=start, duration=time + _AROUND - start)
    with open_recording(source.location) as recording:
        options = IncidentOptions(kinds="all", road_map=files.road_map)
        write_report(recording, files.page, options, opening=files.opening, force=force)


def _names(recordings: Iterable[str]) -> Iterator[str]:
    """Yield a name for the files of each recording; no two are equal, whatever the file system."""
    used: Counter[str] = Counter()
    for recording in recordings:
        path = Path(recording.partition("?")[0])
        name = re.sub(r"[^\w.-]+", "-", path.stem, flags=re.ASCII).strip("-.")[:_NAME] or "recording"
        while used[name.lower()]:
            used[name.lower()] += 1
            name = f"{name}-{used[name.lower()]}"
        used[name.lower()] += 1
        yield name


# --- the overview --------------------------------------------------------------------------------------------------------


def overview(checked: Sequence[CheckedRecording], rules: RuleSet) -> str:
    """Return the overview of a check as a page that loads nothing and runs nothing."""
    style = (viewer_folder() / "check" / "check.css").read_text("utf-8")
    counts = Counter(each.status for each in checked)
    bad = sorted((each for each in checked if each.status != "pass"), key=lambda each: WORST_FIRST.index(each.status))
    good = [each for each in checked if each.status == "pass"]
    title = _title(counts, len(checked))
    program = f"carla-recap {version('carla-recap')}"
    origin = f"{rules.path} · {datetime.now(UTC):%d %B %Y, %H:%M} UTC · {program}"
    header = f'{_bar(counts)}<p class="legend">{_legend(counts)}</p>\n'
    return document(title, origin, header, _rules(checked, rules) + _bad(bad) + _good(good), style)


def document(title: str, origin: str, header: str, main: str, style: str) -> str:
    """Return a page that loads nothing and runs nothing.

    Args:
        title: Its title, as a text.
        origin: What it is made of, and when, as a text.
        header: What is below them, as HTML.
        main: The rest, as HTML.
        style: The style sheet.
    """
    return "".join(
        (
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n',
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n',
            '<meta name="color-scheme" content="dark light">\n<meta name="referrer" content="no-referrer">\n',
            '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; ',
            f"style-src {hash_source(style)}; img-src data:; base-uri 'none'; form-action 'none'\">\n",
            f'<title>{escape(title)} · carla-recap</title>\n<link rel="icon" href="{_ICON}">\n<style>{style}</style>\n',
            f'</head>\n<body>\n<header>\n<h1>{escape(title)}</h1>\n<p class="origin">{escape(visible(origin))}</p>\n',
            header,
            f"</header>\n<main>\n{main}</main>\n</body>\n</html>\n",
        )
    )


def _title(counts: Counter[Status], total: int) -> str:
    recordings = "1 recording" if total == 1 else f"{total} recordings"
    broken = [
        f"{counts[status]} {_WORDS[status]}" for status in reversed(WORST_FIRST) if status != "pass" and counts[status]
    ]
    if not broken:
        return f"{recordings}, all passed" if total > 1 else f"{recordings}, passed"
    return f"{' and '.join(broken)} of {recordings}"


def _bar(counts: Counter[Status]) -> str:
    """Return the shares of the statuses as a bar, drawn, since the policy of the page forbids styles of elements."""
    total, left, parts = sum(counts.values()), 0.0, []
    present = [status for status in WORST_FIRST if counts[status]]
    for status in present:
        width = counts[status] / total * _BAR
        gap = 0 if status == present[-1] else min(_GAP, width / 2)
        parts.append(f'<rect class="{status}" x="{left:.1f}" width="{width - gap:.1f}" height="10"/>')
        left += width
    return f'<svg class="bar" viewBox="0 0 {_BAR} 10" preserveAspectRatio="none" aria-hidden="true">{"".join(parts)}</svg>\n'


def _legend(counts: Counter[Status]) -> str:
    return "".join(
        f'<span><i class="dot {status}"></i><b>{counts[status]}</b> {_WORDS[status]}</span>'
        for status in WORST_FIRST
        if counts[status]
    )


def _rules(checked: Sequence[CheckedRecording], rules: RuleSet) -> str:
    """Return the table of the rules, and how many recordings break each."""
    rows = []
    for index, rule in enumerate(rules):
        counts = Counter(each.verdicts[index].status for each in checked)
        said = f'<b class="fail">{counts["fail"]}</b> failed' if counts["fail"] else '<span class="quiet">all passed</span>'
        if counts["error"] and not counts["fail"]:
            said = f'<span class="quiet">{counts["error"]} not judged</span>'
        if idle := sum(not each.verdicts[index].applies for each in checked):
            said += f'<br><span class="quiet">nothing to judge in {idle}</span>'
        rows.append(
            f'<tr><th scope="row">{_text(rule.name)}</th><td class="description">{_text(rule.description)}</td>'
            f'<td class="number">{said}</td><td class="share">{_bar(counts)}</td></tr>\n'
        )
    return (
        f'<section>\n<h2>Rules <span>{len(rules)}</span></h2>\n<table class="rules">\n{"".join(rows)}</table>\n</section>\n'
    )


def _bad(checked: Sequence[CheckedRecording]) -> str:
    """Return the cards of the recordings that do not pass."""
    if not checked:
        return ""
    cards = "".join(_card(each) for each in checked)
    return f'<section>\n<h2>Not passed <span>{len(checked)}</span></h2>\n<ul class="cards">\n{cards}</ul>\n</section>\n'


def _card(checked: CheckedRecording) -> str:
    broken = [verdict for verdict in checked.verdicts if verdict.status != "pass"]
    met = [verdict.rule for verdict in checked.verdicts if verdict.status == "pass" and verdict.applies]
    links = [f'<a href="{_address(checked.page)}">Incident page</a>'] if checked.page else []
    links += [f'<a href="{_address(checked.clip)}" download>Clip</a>'] if checked.clip else []
    facts = f"{_text(checked.map)} · {number(checked.duration)} s · {checked.frames} frames"
    meta = f'<p class="meta">{facts}</p>' if checked.map or checked.frames else ""
    parts = [
        f'<li class="card {checked.status}">\n<div class="head"><div><h3>{_name(checked.recording)}</h3>{meta}</div>',
        f'<p class="links">{"".join(links)}</p></div>\n',
    ]
    rules = [verdict.rule for verdict in broken]
    if len({(verdict.status, verdict.message) for verdict in broken}) == 1 < len(broken):
        broken, rules = broken[:1], ["all rules" if not met else f"{len(broken)} rules"]
    verdicts = "".join(_verdict(verdict, checked, rule) for verdict, rule in zip(broken, rules, strict=True))
    parts.append(f'<ul class="verdicts">\n{verdicts}</ul>\n')
    parts += [f'<p class="met">Passed: {_text(", ".join(met))}</p>\n'] if met else []
    return "".join((*parts, _idle(checked), "</li>\n"))


def _idle(checked: CheckedRecording) -> str:
    """Return a line for each rule that had nothing to judge."""
    return "".join(f'<p class="met">{_text(verdict.rule)}: {_text(verdict.message)}</p>\n' for verdict in checked.idle)


def _verdict(verdict: Verdict, checked: CheckedRecording, rule: str) -> str:
    message = _text(verdict.message)
    if verdict.time is not None and checked.page:
        address = f"{_address(checked.page)}#t={max(verdict.time - _LEAD, 0.0):.2f}"
        address += f"&amp;follow={verdict.actors[0]}" if verdict.actors else ""
        message += f' <a class="when" href="{address}">Watch</a>'
    more = "".join(f"<li>{_text(line)}</li>" for line in verdict.details[1:])
    return (
        f'<li class="{verdict.status}"><span class="rule">{_text(rule)}</span>'
        f'<div class="message">{message}{f"<ul>{more}</ul>" if more else ""}</div></li>\n'
    )


def _good(checked: Sequence[CheckedRecording]) -> str:
    """Return the table of the recordings that pass."""
    if not checked:
        return ""
    rows = "".join(
        f'<tr><td><i class="dot pass"></i>{_name(each.recording)}{_idle(each)}</td>'
        f'<td class="minor quiet">{_text(each.map)}</td>'
        f'<td class="number quiet">{number(each.duration)} s</td></tr>\n'
        for each in checked
    )
    is_open = " open" if len(checked) <= _OPEN else ""
    heading = f"<summary><h2>Passed <span>{len(checked)}</span></h2></summary>"
    return f"<details{is_open}>\n{heading}\n<table>\n{rows}</table>\n</details>\n"


def _name(recording: str) -> str:
    """Return the path of a recording, its folder less visible."""
    folder, slash, name = recording.rpartition("/")
    return f'<span class="folder">{_text(folder + slash)}</span>{_text(name)}' if slash else _text(name)


def _address(path: str) -> str:
    return escape(quote(path))


def _text(text: str) -> str:
    """Return a text of a recording or of rules as HTML."""
    return escape(visible(text))
