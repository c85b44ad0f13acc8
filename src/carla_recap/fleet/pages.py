"""Pages of a check: the overview of all recordings and verdicts, and the incident page of each recording that fails."""

from __future__ import annotations

import re
from collections import Counter
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, cast

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from carla_recap.fleet.check import WORST_FIRST
from carla_recap.fleet.engine import map_sources
from carla_recap.fleet.sources import SourceFile
from carla_recap.show.page import Opening
from carla_recap.show.page.script import hash_source
from carla_recap.util.resources import viewer_folder
from carla_recap.util.text import number, visible

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence

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


@dataclass(frozen=True, slots=True, kw_only=True)
class _PageSource(SourceFile):
    """A recording, and the files of it to be written."""

    page: Path  # its incident page
    clip: Path | None  # that of an offence; None: none
    opening: Opening  # what the page shows first: the offence, and the broken rules


class WrittenPage(NamedTuple):
    """Where the incident page of a recording is, relative to the folder of pages."""

    page: str | None  # None if it could not be made
    clip: str | None  # None if there is none
    warnings: tuple[str, ...]  # about it, a line each


def write_pages(
    checked: Sequence[CheckedRecording],
    rules: RuleSet,
    folder: Path,
    say: Callable[[str, tuple[str, ...]], object],
    *,
    clips: bool = False,
    road_map: str | None = None,
    shown: Path | str | None = None,
    jobs: int | None = None,
) -> list[CheckedRecording]:
    """Write the overview of a check, and incident pages, into a folder; return the recordings with their pages.

    The first `MOST` recordings that fail get a page, and with `clips` a clip of the first offence. One whose page cannot be
    made has none, which is a warning. `say` is called with each of these recordings, and the warnings about its page.
    """
    failed = [each for each in checked if each.status == "fail"][:MOST]
    openings = {each.recording: opening_of(each.verdicts) for each in failed}
    found = {each.recording: each for each in checked}
    written = write_incident_pages(openings, folder, clips=clips, road_map=road_map, shown=shown, jobs=jobs)
    with closing(written):
        for each, (page, clip, messages) in zip(failed, written, strict=True):
            say(each.recording, messages)
            found[each.recording] = replace(each, page=page, clip=clip, warnings=(*each.warnings, *messages))
    (folder / "index.html").write_text(overview([*found.values()], rules), "utf-8")
    return [*found.values()]


def write_incident_pages(
    openings: Mapping[str, Opening],
    folder: Path,
    *,
    clips: bool = False,
    road_map: str | None = None,
    force: bool = False,
    shown: Path | str | None = None,
    jobs: int | None = None,
) -> Generator[WrittenPage]:
    """Write the incident pages of recordings below a folder, and yield where they are, in the order of the recordings.

    The openings are what each page shows first; `force` replaces pages that exist. The folder is called `shown` in warnings.
    """
    wanted = []
    for (recording, opening), name in zip(openings.items(), _names(openings), strict=True):
        clip_path = folder / CLIPS / f"{name}.mcap" if clips and opening.time is not None else None
        wanted.append(_PageSource(recording, page=folder / PAGES / f"{name}.html", clip=clip_path, opening=opening))
    for outcome in map_sources(partial(_write_files, road_map, force), wanted, jobs=jobs):
        files = cast("_PageSource", outcome.source)
        error = (outcome.error or "").replace(str(folder), str(shown or folder))
        failures = (visible(f"no page: {error}"),) if error else ()
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


def _write_files(road_map: str | None, force: bool, source: _PageSource) -> None:
    from carla_recap.editing.clip import clip
    from carla_recap.queries.incidents import IncidentOptions
    from carla_recap.recording import open_recording
    from carla_recap.show.page import write_report

    if source.clip is not None:
        time = source.opening.time or 0.0
        start = max(time - _AROUND, 0.0)
        clip(source.location, source.clip, start=start, duration=time + _AROUND - start)
    with open_recording(source.location) as recording:
        options = IncidentOptions(kinds="all", road_map=road_map)
        write_report(recording, source.page, options, opening=source.opening, force=force)


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


def overview(checked: Sequence[CheckedRecording], rules: RuleSet) -> str:
    """Return the overview of a check as a page that loads nothing and runs nothing."""
    counts = Counter(each.status for each in checked)
    content = {
        "counts": counts,
        "rules": [
            (
                rule,
                Counter(each.verdicts[index].status for each in checked),
                sum(not each.verdicts[index].applies for each in checked),
            )
            for index, rule in enumerate(rules)
        ],
        "bad": sorted((each for each in checked if each.status != "pass"), key=lambda each: WORST_FIRST.index(each.status)),
        "good": [each for each in checked if each.status == "pass"],
        "statuses": WORST_FIRST,
        "words": _WORDS,
        "bar_width": _BAR,
        "lead": _LEAD,
        "most_open": _OPEN,
        "shares": _shares,
        "offences": _offences,
    }
    return render("check", _title(counts, len(checked)), rules.path, content)


def _title(counts: Counter[Status], total: int) -> str:
    recordings = "1 recording" if total == 1 else f"{total} recordings"
    broken = [
        f"{counts[status]} {_WORDS[status]}" for status in reversed(WORST_FIRST) if status != "pass" and counts[status]
    ]
    if not broken:
        return f"{recordings}, all passed" if total > 1 else f"{recordings}, passed"
    return f"{' and '.join(broken)} of {recordings}"


def _shares(counts: Counter[Status]) -> Iterator[tuple[Status, float, float]]:
    """Yield the shares of the statuses as parts of a bar: where each begins, and its width."""
    left = 0.0
    present = [status for status in WORST_FIRST if counts[status]]
    for status in present:
        width = counts[status] / counts.total() * _BAR
        gap = 0 if status == present[-1] else min(_GAP, width / 2)
        yield status, left, width - gap
        left += width


def _offences(checked: CheckedRecording) -> list[tuple[Verdict, str]]:
    """Return the verdicts on a recording that are no passes, with the names of their rules; equal ones are put together."""
    broken = [verdict for verdict in checked.verdicts if verdict.status != "pass"]
    if len({(verdict.status, verdict.message) for verdict in broken}) == 1 < len(broken):
        has_met = any(verdict.status == "pass" and verdict.applies for verdict in checked.verdicts)
        return [(broken[0], f"{len(broken)} rules" if has_met else "all rules")]
    return [(verdict, verdict.rule) for verdict in broken]


def render(name: str, title: str, origin: str, content: Mapping[str, Any]) -> str:
    """Return the page of a template, and of a style sheet of the same name, if there is one, with what it is made of.

    It loads nothing and runs nothing; what it shows is escaped, and cannot control a terminal.
    """
    folder = viewer_folder() / "check"
    sheets = dict.fromkeys(folder / f"{each}.css" for each in ("check", name))
    style = "".join(sheet.read_text("utf-8") for sheet in sheets)
    environment = Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters["number"] = number
    return environment.get_template(f"{name}.html").render(
        content,
        title=title,
        origin=origin,
        date=f"{datetime.now(UTC):%d %B %Y, %H:%M} UTC",
        version=version("carla-recap"),
        style=Markup(style),
        style_hash=Markup(hash_source(style)),
    )


def _shown(value: Any) -> Any:
    return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value
